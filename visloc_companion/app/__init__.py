"""The shell: live daemon, worker, journal, replay."""
