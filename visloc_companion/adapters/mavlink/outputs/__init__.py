"""The messages that can carry our position to an autopilot, one module each, and which one is sent (choice.py)."""
