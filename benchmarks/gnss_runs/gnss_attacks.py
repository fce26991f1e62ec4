"""The flights under attack that benchmarks/gnss_roc.py judges: what, when, whereto and how far is drawn."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from random import Random

from visloc_companion.sim import faults
from visloc_companion.sim.faults import FaultSchedule

ATTACK_SEED = 20_000
QUIET_S = 60.0
"""No attack begins before."""


@dataclass(frozen=True, slots=True)
class Attack:
    """One flight's attack: its class, and when it begins. Only where it `ends` is the flight watched beyond its declaration."""

    name: str
    faults: FaultSchedule
    begins_s: float
    ends: bool = True


def attacks(scale: float) -> Iterator[Attack]:
    """The flights under attack; begin, direction and size are drawn."""
    rng = Random(ATTACK_SEED)

    def times(n: int) -> range:
        return range(max(1, round(n * scale)))

    for rate in (0.2, 0.5, 1.0, 2.0):
        for _ in times(200):
            t, heading = rng.uniform(QUIET_S, 120.0), rng.uniform(-math.pi, math.pi)
            yield Attack(
                f"drag {rate:g} m/s", faults.slow_drag(t, rate, heading, consistent_velocity=rng.random() < 0.5), t, False
            )
    for size in (10.0, 20.0, 50.0, 100.0, 200.0, 500.0):
        for _ in times(50):
            t = rng.uniform(QUIET_S, 120.0)
            yield Attack(f"step {size:g} m", faults.step_spoof(t, around(rng, size)), t, False)
    for _ in times(120):
        t = rng.uniform(QUIET_S, 120.0)
        yield Attack("jam of 20 to 60 s", faults.jam(t, t + rng.uniform(20.0, 60.0)), t)
    for _ in times(100):
        t = rng.uniform(QUIET_S, 120.0)
        yield Attack("intermittent jam", faults.intermittent(t, rng.uniform(3.0, 10.0), rng.uniform(5.0, 15.0), t + 90.0), t)
    for low, high in ((8.0, 15.0), (15.0, 100.0)):
        for _ in times(90):
            t = rng.uniform(QUIET_S, 120.0)
            back = t + rng.uniform(10.0, 60.0)
            bad = faults.gnss_returns_bad(t, back, around(rng, rng.uniform(low, high)))
            yield Attack(f"jam, back {low:g} to {high:g} m off", bad, t)
    for _ in times(100):
        t = rng.uniform(QUIET_S, 120.0)
        place = around(rng, rng.uniform(50.0, 2000.0))
        yield Attack("jam, then meaconing", faults.meaconed(t, t + rng.uniform(0.0, 60.0), (place[0], place[1], -20.0)), t)


def around(rng: Random, distance_m: float) -> tuple[float, float, float]:
    angle = rng.uniform(-math.pi, math.pi)
    return distance_m * math.cos(angle), distance_m * math.sin(angle), 0.0
