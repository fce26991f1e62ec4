"""Flights as the GNSS monitor sees them, without any picture: a receiver under attack, fixes, odometry and a barometer.

What is drawn for each flight: the receiver's wander (1 to 2 m, 50 to 200 s), fixes at 1 Hz good to 2 m per axis whose error lasts
for 2 to 8 s in part, with claims that are up to a quarter too small or too large, outages and a few wrong ones; a constant
offset of the map; a delay of the receiver that acts along the track; odometry with errors of scale, heading and velocity that
last; a barometer that drifts and stretches climbs. Speeds of 5 to 20 m/s, turns, climbs.

Each fix tells what it looked at, as the daemon does (gnss_held.py). With `World.lasting_wrong` wrong matches are of the ground:
over the same ground one is found again (same_ground.py), and the monitor is shown what the filter takes.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from random import Random

import numpy as np

from benchmarks.flown.same_ground import Match, lasts_m
from benchmarks.gnss_runs.gnss_held import METHOD, Held
from visloc_companion.core.satellites.gnss_witness import Ground
from visloc_companion.sim.faults import FaultSchedule
from visloc_companion.sim.gnss import GnssReceiver, ReceiverErrors
from visloc_companion.sim.vehicles.vehicle_noise import GaussMarkov
from visloc_companion.types import FloatArray, Vec2, Vec3

PERIOD_S = 0.5
FIX_S = 1.0
WRONG_SHARE = 0.002
"""Of the fixes is wrong, and claimed by each of them; with `World.lasting_wrong` `World.wrong_share`."""
VELOCITY_SIGMA_MPS = 0.3
"""Of the velocity that drives the filter where there is no odometry."""


@dataclass(frozen=True, slots=True)
class World:
    """Ranges that a flight is drawn from."""

    fix_sigma_m: float = 2.0
    lasting_share: tuple[float, float] = (0.3, 0.7)
    lasting_s: tuple[float, float] = (2.0, 8.0)
    claim: tuple[float, float] = (0.8, 1.25)
    wander_m: tuple[float, float] = (1.0, 2.0)
    wander_s: tuple[float, float] = (50.0, 200.0)
    outage_every_s: float = 120.0
    outage_s: float = 10.0
    odometry: bool = True
    lasting_wrong: bool = False
    wrong_share: float = WRONG_SHARE
    wrong_m: tuple[float, float] = (10.0, 60.0)
    speed_mps: tuple[float, float] = (5.0, 20.0)


@dataclass(frozen=True, slots=True)
class Moment:
    """Every PERIOD_S: what the receiver says, and once a second a fix and the odometry's displacement, where there are any.

    `difference_ne_m` is GNSS minus fix, `ground` what that looked at; `*_moved_ne_m` are displacements since the last second;
    `over` is by what factor the variance of fixes is more than they claim.
    """

    t_s: float
    has_fix: bool
    h_gnss_m: float
    pressure_h_m: float
    v_ned_mps: Vec3
    false_m: float
    difference_ne_m: Vec2 | None
    claimed_var_m2: float
    gnss_moved_ne_m: Vec2 | None
    odometry_moved_ne_m: Vec2
    odometry_var_m2: float
    ground: Ground | None
    over: float


class Flight:
    """Deterministic by seed; iterate over `moments`."""

    def __init__(self, seed: int, faults: FaultSchedule, duration_s: float, world: World) -> None:
        self._rng = rng = Random(seed)
        self._faults, self._duration_s, self._world = faults, duration_s, world
        errors = ReceiverErrors(rng.uniform(*world.wander_m), rng.uniform(2.0, 4.0), rng.uniform(*world.wander_s), 0.3, 0.1)
        self._receiver = GnssReceiver(rng, PERIOD_S, errors)
        share, lasting_s = rng.uniform(*world.lasting_share), rng.uniform(*world.lasting_s)
        self._lasting = [GaussMarkov(rng, world.fix_sigma_m * math.sqrt(share), lasting_s) for _ in range(2)]
        self._white_m = world.fix_sigma_m * math.sqrt(1 - share)
        self._claim_m = world.fix_sigma_m * rng.uniform(*world.claim)
        self._map = (rng.gauss(0.0, 1.0), rng.gauss(0.0, 1.0))
        self._delay_s = rng.gauss(0.0, 0.05)
        self._speed = rng.uniform(*world.speed_mps)
        self._heading = rng.uniform(-math.pi, math.pi)
        self._p: list[float] = [0.0, 0.0, -rng.uniform(80.0, 250.0)]
        self._climb_to_m, self._turn_s, self._climb_s = self._p[2], rng.expovariate(1 / 40), rng.expovariate(1 / 120)
        self._scale, self._skew = rng.gauss(0.0, 0.01), math.radians(rng.gauss(0.0, 1.0))
        self._odometry = [GaussMarkov(rng, 0.03 + 0.003 * self._speed, 20.0) for _ in range(2)]
        self._baro, self._stretch = GaussMarkov(rng, 2.0, 300.0), 1 + rng.uniform(-0.05, 0.05)
        self._outage = (rng.expovariate(1 / world.outage_every_s), 0.0)
        self._held, self._match, self._matches = Held(), Match(METHOD), np.random.default_rng([seed, 79])

    def moments(self) -> Iterator[Moment]:
        """The flight, in steps of PERIOD_S."""
        steps = round(FIX_S / PERIOD_S)
        moved, before = [0.0, 0.0], None
        for k in range(round(self._duration_s / PERIOD_S)):
            t_s = k * PERIOD_S
            v = self._fly(t_s)
            effect = self._faults.gnss(t_s)
            sample = self._receiver.sample(t_s, (self._p[0], self._p[1], self._p[2]), v, effect)
            g = (sample.p_ned_m[0] - self._delay_s * v[0], sample.p_ned_m[1] - self._delay_s * v[1])
            seen = self._seen(v)
            moved = [moved[0] + seen[0], moved[1] + seen[1]]
            difference, ground, gnss_moved, odometry_moved = None, None, None, (moved[0], moved[1])
            if k % steps == 0:
                position = g if sample.has_fix else None
                self._carry(odometry_moved, sample.v_ned_mps)
                difference, ground = self._compared(t_s, position)
                if self._world.odometry and position is not None and before is not None:
                    gnss_moved = (position[0] - before[0], position[1] - before[1])
                moved, before = [0.0, 0.0], position
            yield Moment(
                t_s, sample.has_fix, -sample.p_ned_m[2], -self._p[2] * self._stretch + self._baro.step(PERIOD_S),
                sample.v_ned_mps, math.hypot(*sample.false_ned_m), difference, self._claim_m**2, gnss_moved, odometry_moved,
                self._odometry_var_m2, ground, self._held.over,
            )  # fmt: skip

    def _fly(self, t_s: float) -> Vec3:
        if t_s >= self._turn_s:
            self._heading += self._rng.uniform(-2.0, 2.0)
            self._turn_s = t_s + self._rng.expovariate(1 / 40)
        if t_s >= self._climb_s:
            self._climb_to_m = -self._rng.uniform(60.0, 300.0)
            self._climb_s = t_s + self._rng.expovariate(1 / 120)
        down = min(3.0, max(-3.0, self._climb_to_m - self._p[2]))
        v = (self._speed * math.cos(self._heading), self._speed * math.sin(self._heading), down)
        for axis in range(3):
            self._p[axis] += v[axis] * PERIOD_S
        return v

    def _seen(self, v: Vec3) -> Vec2:
        """Displacement of one step as odometry sees it."""
        c, s = math.cos(self._skew) * (1 + self._scale), math.sin(self._skew) * (1 + self._scale)
        error = [slow.step(PERIOD_S) for slow in self._odometry]
        return (c * v[0] - s * v[1] + error[0]) * PERIOD_S, (s * v[0] + c * v[1] + error[1]) * PERIOD_S

    @property
    def _odometry_var_m2(self) -> float:
        return (FIX_S * (0.03 + 0.01 * self._speed)) ** 2

    @property
    def _driving_sigma_mps(self) -> float:
        return math.sqrt(self._odometry_var_m2) / FIX_S if self._world.odometry else VELOCITY_SIGMA_MPS

    def _carry(self, odometry_moved: Vec2, v_ned_mps: Vec3) -> None:
        """The filter goes on by odometry or, without, by the receiver's velocity."""
        moved = odometry_moved if self._world.odometry else (v_ned_mps[0] * FIX_S, v_ned_mps[1] * FIX_S)
        self._held.carry(moved, self._driving_sigma_mps, FIX_S)

    def _compared(self, t_s: float, g: Vec2 | None) -> tuple[Vec2 | None, Ground | None]:
        """GNSS minus a fix, None without either, and what the fix looked at. Fixes stop for a while now and then."""
        begin, end = self._outage
        if t_s >= max(begin, end):
            begin = t_s + self._rng.expovariate(1 / self._world.outage_every_s)
            self._outage = (begin, begin + self._rng.expovariate(1 / self._world.outage_s))
        wrong, world = self._rng.random() < WRONG_SHARE, self._world
        reach, direction = self._rng.uniform(*world.wrong_m) if wrong else 0.0, self._rng.uniform(-math.pi, math.pi)
        off = (reach * math.cos(direction), reach * math.sin(direction))
        if world.lasting_wrong:
            off = self._lastingly_wrong()
        missing = begin <= t_s < end or self._rng.random() < 0.05
        fix = [
            self._p[axis] + self._map[axis] + self._lasting[axis].step(FIX_S) + self._rng.gauss(0.0, self._white_m)
            for axis in (0, 1)
        ]
        if missing:
            return None, None
        seen = (fix[0] + off[0], fix[1] + off[1])
        ground, taken = self._held.take(seen, self._claim_m**2, self._driving_sigma_mps, -self._p[2], world.wrong_share)
        if g is None or (world.lasting_wrong and not taken):
            return None, None
        return (g[0] - seen[0], g[1] - seen[1]), ground

    def _lastingly_wrong(self) -> Vec2:
        least, most = self._world.wrong_m

        def drawn() -> FloatArray:
            angle, reach = self._matches.uniform(-math.pi, math.pi), self._matches.uniform(least, most)
            return reach * np.array([math.cos(angle), math.sin(angle)])

        way_m, height_m = self._speed * FIX_S, -self._p[2]
        wrong_by = self._match.look(way_m, lasts_m(height_m), self._world.wrong_share, self._matches, drawn)
        return (0.0, 0.0) if wrong_by is None else (float(wrong_by[0]), float(wrong_by[1]))
