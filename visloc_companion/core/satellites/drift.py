"""Vision against GNSS over time: finds a step, a slow drag, and a GNSS that comes back beside the truth.

Differences (GNSS minus vision, NED metres) are averaged over blocks of one second and go into a `ShiftTest`
(core/satellites/shift.py). What is healthy: a constant (registration of the map, orbits), the receiver's wander over a minute or
two, and what lasts for some seconds (fixes from overlapping frames err alike; delays act along the track). While GNSS is trusted
the test learns the healthy difference. When trust is lost it is kept, less what the shift put into it; the probation is a test
that begins anew from there, with a large weight on "false since it came back", which only agreement takes away. That the fixes
over some ground are wrong alike explains differences, too (core/satellites/gnss_witness.py).
"""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import dataclass

from visloc_companion.core.satellites.gnss_witness import REACH_M, SIZES_M, Ground, Grounds, Place
from visloc_companion.core.satellites.shift import FIRST_WEIGHT_S, ShiftModel, ShiftTest
from visloc_companion.types import Vec2

BLOCK_S = 1.0
ALMOST = 0.95
"""A block may be this much shorter, for frames that jitter about one a second."""
STALE_S = 3.0
MAX_BIAS_M = 4.0
BIAS_SIGMA_M = 2.0
BIAS_WALK_M_PER_SQRT_S = 0.02
WANDER_S = 100.0
QUICK_S = 5.0
QUICK_SHARE = 0.5
"""Share of a fix's claimed variance that lasts for QUICK_S; the rest differs from frame to frame."""
DELAY_SIGMA_S = 0.1
DELAY_WALK_S_PER_SQRT_S = 0.002
"""1-sigma of the receiver's own delay, and how it may change."""
STEPS_M = (10.0, 30.0, 300.0)
DRAGS_MPS = (0.3, 1.0, 3.0)


@dataclass(frozen=True, slots=True)
class BlockResult:
    """One finished block: distance from the healthy difference in sigma, and log R of the test that runs."""

    t_ns: int
    distance_sigma: float
    log_r: float


class DriftTest:
    """The test while GNSS is trusted, and in its probation; `add` answers when a block is finished."""

    def __init__(
        self,
        gnss_sigma_m: float,
        grounds: Grounds | None = None,
        first_weight_s: float = FIRST_WEIGHT_S,
        first_drag_weight_s: float | None = None,
    ) -> None:
        """`first_weight_s` weighs "false before the first comparison", and where it is told `first_drag_weight_s` "dragged from
        there on"."""
        self.grounds = Grounds() if grounds is None else grounds
        """What fixes looked at, and how the first of each ground lay: that outlives a test."""
        model = ShiftModel(
            constant=BIAS_SIGMA_M,
            constant_walk_per_sqrt_s=BIAS_WALK_M_PER_SQRT_S,
            slow=gnss_sigma_m,
            slow_s=WANDER_S,
            quick_s=QUICK_S,
            steps=STEPS_M,
            ramps=DRAGS_MPS,
            factor=DELAY_SIGMA_S,
            factor_walk_per_sqrt_s=DELAY_WALK_S_PER_SQRT_S,
            max_constant=MAX_BIAS_M,
            causes=SIZES_M,
        )
        self._home = ShiftTest(model, first_weight_s, first_drag_weight_s)
        self._over = 1.0
        self._trial: ShiftTest | None = None
        self._finished_ns: int | None = None
        self._clear_block()

    @property
    def bias_m(self) -> Vec2:
        """The learned part of the difference that lasts, north and east."""
        healthy = self._running.healthy
        return healthy.real, healthy.imag

    @property
    def log_r(self) -> float:
        """The running test's statistic; minus infinity before its first block."""
        return self._running.log_r

    @property
    def in_probation(self) -> bool:
        """Whether a GNSS that is not trusted is being tested."""
        return self._trial is not None

    @property
    def _running(self) -> ShiftTest:
        return self._home if self._trial is None else self._trial

    def lose(self) -> None:
        """Trust is lost: from now on nothing is learned for good."""
        self._home = self._home.fork()

    def probation(self, first_weight_s: float) -> None:
        """Begin (again) to test a GNSS that is not trusted; `first_weight_s` weighs "false from the beginning"."""
        self._trial = self._home.fork(first_weight_s)

    def regain(self) -> None:
        """GNSS is trusted (again), as it was found in the probation; where nothing was compared, no agreement has taken away that
        it may have been false from the beginning."""
        running = self._running
        self._home, self._trial = running.fork() if running.log_r > -math.inf else running, None

    def _clear_block(self) -> None:
        self._n = 0
        self._north, self._east, self._fix_var = 0.0, 0.0, 0.0
        self._looked_at: Counter[Place] = Counter()

    def add(
        self,
        t_ns: int,
        difference_ne_m: Vec2,
        fix_var_m2: float,
        common_var_m2: float,
        v_ne_mps: Vec2 = (0.0, 0.0),
        ground: Ground | None = None,
        over: float = 1.0,
    ) -> BlockResult | None:
        """Take one comparison: variance per axis of the fix, and that of the map, which lasts a while; the velocity; what the fix
        looked at; by what factor that variance is more than the fix claims (claims.py)."""
        if over > self._over:
            self._running.unlearn((1 - self._over / over) * fix_var_m2)
            self._over = over
        since_s = math.inf if self._finished_ns is None else (t_ns - self._finished_ns) * 1e-9
        if since_s > STALE_S:
            self._clear_block()
        self._n += 1
        self._north += difference_ne_m[0]
        self._east += difference_ne_m[1]
        self._fix_var += fix_var_m2
        if ground is not None:
            self._looked_at[self.grounds.see(t_ns, ground)] += 1
        if since_s < ALMOST * BLOCK_S:
            return None
        n, fix_var = self._n, self._fix_var / self._n
        mean = complex(self._north, self._east) / n
        causes = self.grounds.causes({place: k / n for place, k in self._looked_at.items()}) if abs(mean) <= REACH_M else []
        self._clear_block()
        self._finished_ns = t_ns
        white, quick = (1 - QUICK_SHARE) * fix_var / n, QUICK_SHARE * fix_var + common_var_m2
        result = self._running.update(t_ns * 1e-9, mean, white, quick, complex(*v_ne_mps), causes)
        return BlockResult(t_ns, result.distance_sigma, result.log_r)
