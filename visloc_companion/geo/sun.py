"""Azimuths of the sun."""

from __future__ import annotations

from visloc_companion.types import Sun


def turned(sun: Sun, turn_deg: float) -> Sun:
    """A sun as from axes that are turned to the left by so much."""
    return Sun((sun.azimuth_deg + turn_deg) % 360, sun.elevation_deg)


def turn_between_deg(a: Sun, b: Sun) -> float:
    """Angle between the azimuths of two suns, 0 to 180 degrees."""
    return abs((a.azimuth_deg - b.azimuth_deg + 180) % 360 - 180)
