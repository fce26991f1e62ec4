"""Recorded flights: tlog, DataFlash, ulog, journal."""
