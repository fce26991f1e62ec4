"""The outside world: MAVLink, cameras, logs, systemd."""
