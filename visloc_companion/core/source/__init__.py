"""The navigator's mode, and the position source that the autopilot is brought to."""
