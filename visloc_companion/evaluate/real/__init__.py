"""Flights against the real autopilots' simulators, judged."""
