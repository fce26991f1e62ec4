"""systemd notification protocol."""
