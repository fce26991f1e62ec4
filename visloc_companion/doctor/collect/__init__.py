"""Reads the facts: from the autopilot over its link, and from this machine."""
