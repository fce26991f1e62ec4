"""Flights of the real daemon against the real autopilots' own simulators (ArduPilot SITL, PX4 SIH)."""
