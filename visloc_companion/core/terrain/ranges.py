"""Distances to the ground that rangefinders measured, for the frames that are asked about: near a frame's time, and believed.

A distance is not believed where the sensor says so, or said so just before or after (at the end of its reach, what comes back
comes from crowns), where it has stood still to the last digit while the vehicle moved, or where two sensors that look down
contradict each other. RANGEFINDER says nothing of a sensor's reach: it is not heard beside DISTANCE_SENSOR. Whether a distance
fits the map is for the worker to say (localise/ranged.py), which has the map.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass

from visloc_companion.types import Range

KEPT = 64
"""Readings of a sensor: six seconds of 10 Hz."""
MOST_SENSORS = 8
NEAR_NS = 200_000_000
"""A reading says something of a frame taken no longer before or after."""
STUCK_NS, STUCK_READINGS, MOVING_MPS = 2_000_000_000, 8, 2.0
"""So many readings over so long that are the same to the last digit, of a vehicle that moves so fast, are no measurements: eight
that come in centimetres and err by one (1-sigma) are the same once in 800, twenty of them, as come at 10 Hz, once in 10^8."""
SIGMA_M, SIGMA_SHARE = 0.1, 0.01
"""1-sigma of what stays wrong with a distance: data sheets of laser rangefinders state 0.1 m, from 10 m on 1 % (TF03)."""
CONTRADICT_SIGMAS = 4.0
UNNAMED = -1
"""RANGEFINDER (173), which has no sensor's number and no time."""
NAMED_LASTS_NS = 3_000_000_000


@dataclass(frozen=True, slots=True)
class Reading:
    """A distance at a time on the shell's clock, m, and the 1-sigma of what is wrong with it, constant errors included."""

    t_ns: int
    distance_m: float
    sigma_m: float
    valid: bool


class Ranges:
    """The readings of the last seconds, by sensor."""

    def __init__(self) -> None:
        self._of_sensor: dict[int, deque[Reading]] = {}
        self._named_ns: int | None = None

    def clear(self) -> None:
        """A clock stepped: times before say nothing of times after."""
        self._of_sensor.clear()
        self._named_ns = None

    def on_range(self, event: Range, t_ns: int) -> None:
        """Keep a reading, with its time on the shell's clock. Readings of a sensor that come out of order are left out."""
        sensor = event.sensor if event.t_boot_ns else UNNAMED
        if sensor != UNNAMED:
            self._named_ns = t_ns
        if sensor not in self._of_sensor and len(self._of_sensor) >= MOST_SENSORS:
            return
        readings = self._of_sensor.setdefault(sensor, deque(maxlen=KEPT))
        if readings and t_ns <= readings[-1].t_ns:
            return
        sigma_m = math.hypot(SIGMA_M, SIGMA_SHARE * event.distance_m, event.sigma_m or 0.0)
        readings.append(Reading(t_ns, event.distance_m, sigma_m, event.valid and event.distance_m > 0))

    def near(self, t_ns: int, speed_mps: float) -> Reading | None:
        """What was measured nearest to a time, of a vehicle of a speed; None where nothing is believed."""
        found = []
        for sensor, readings in self._of_sensor.items():
            if sensor == UNNAMED and self._named_ns is not None and abs(t_ns - self._named_ns) <= NAMED_LASTS_NS:
                continue
            reading = _believed(readings, t_ns, speed_mps)
            if reading is not None:
                found.append(reading)
        if not found:
            return None
        best = min(found, key=lambda r: r.sigma_m)
        alike = all(abs(r.distance_m - best.distance_m) <= CONTRADICT_SIGMAS * math.hypot(r.sigma_m, best.sigma_m) for r in found)
        return best if alike else None


def _believed(readings: deque[Reading], t_ns: int, speed_mps: float) -> Reading | None:
    """A sensor's reading nearest to a time, or None."""
    near = [r for r in readings if abs(r.t_ns - t_ns) <= NEAR_NS]
    if not near or not all(r.valid for r in near):
        return None
    nearest = min(near, key=lambda r: abs(r.t_ns - t_ns))
    return None if speed_mps >= MOVING_MPS and _stuck(readings, nearest) else nearest


def _stuck(readings: deque[Reading], reading: Reading) -> bool:
    """Whether a sensor has said the same for as long as it takes to see that it measures nothing."""
    same_since_ns, same = reading.t_ns, 0
    for before in reversed(readings):
        if before.t_ns > reading.t_ns:
            continue
        if before.distance_m != reading.distance_m:
            break
        same_since_ns, same = before.t_ns, same + 1
    return same >= STUCK_READINGS and reading.t_ns - same_since_ns >= STUCK_NS
