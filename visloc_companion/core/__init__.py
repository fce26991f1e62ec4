"""The navigator and its parts, pure: no I/O, no clock, no waiting."""
