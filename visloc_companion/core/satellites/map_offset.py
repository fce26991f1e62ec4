"""How far the map lies beside GNSS while GNSS is good: a shift that is more than GNSS explains may be the map's own.

Nobody can say which of the two is wrong, so positions are not corrected by it; but the covariance and the protection level of
what is stated later, by the map alone, must not claim the map's usual accuracy. A GNSS that once agreed with the map and then did
not was led away; where the two never agreed, the map may lie beside its place as well (georeferencing, datum).

Fixes of frames that come late lie behind the vehicle, by as much as it flew meanwhile: that goes round with the course, where a
map's offset stays in north and east. On one course the two look the same.
"""

from __future__ import annotations

import math
from itertools import takewhile
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from visloc_companion.core.filter.lasting import LEAST_APART_M, unclaimed_m
from visloc_companion.types import Command, FloatArray, Notice, Severity, Vec2

ComplexArray = NDArray[np.complex128]

SPAN_NS = 120_000_000_000
SOILED_NS = 30_000_000_000
"""What was compared so shortly before GNSS became suspect may have been dragged already."""
FEWEST = 20
BORNE_OUT_BY = 5
"""So many fixes beside a trusted GNSS, with a mean that it explains: the map lies where it should. Fewer tell of no shift."""
MOST_M = 50.0
"""Georeferencing and datums are off by tens of metres; a GNSS that is further off is false."""
GNSS_SIGMA_M = 3.0
"""1-sigma of what GNSS is off by for minutes, on each axis."""
BEYOND_SIGMAS = 2.0
LEAST_LAG_S, MOST_LAG_S, LEAST_SPEED_MPS = 0.25, 4.0, 2.0
FITS_SHARE = 0.4
"""Of the offset, rms: what a lag, or a map's place, leaves unexplained where that is what it is."""


class Beside(NamedTuple):
    """GNSS beside an accepted fix at its time: GNSS less it, the velocity, and what a lens that is twice as long adds to the fix,
    all north and east; what the fix claims (variance of both axes together); the way to other ground (lasting.apart_m)."""

    t_ns: int
    off_ne_m: Vec2
    v_ne_mps: Vec2 = (0.0, 0.0)
    per_focal_ne_m: Vec2 = (0.0, 0.0)
    claimed_m2: float = 0.0
    apart_m: float = LEAST_APART_M


class _Differences:
    """What `Beside` says of K fixes, in the order in which they were compared, all north + i east, and to how many ways to other
    ground all have come by then. Arrays, for the mean of some hundred is asked for with each fix."""

    def __init__(self) -> None:
        self._t_ns: list[int] = []
        self._rows: ComplexArray = np.zeros((3, 0), dtype=complex)
        self.claimed_m2: FloatArray = np.zeros(0)
        self._gone: list[float] = []

    def __len__(self) -> int:
        return len(self._t_ns)

    @property
    def off(self) -> ComplexArray:
        """(K,) GNSS less the fixes, metres."""
        return np.asarray(self._rows[0])

    @property
    def v(self) -> ComplexArray:
        """(K,) velocities, m/s."""
        return np.asarray(self._rows[1])

    @property
    def per_focal(self) -> ComplexArray:
        """(K,) what a lens that is twice as long adds to the fixes, metres."""
        return np.asarray(self._rows[2])

    @property
    def gone(self) -> float:
        """To how many ways to other ground the last has come since the first."""
        return self._gone[-1] - self._gone[0] if self._gone else 0.0

    def add(self, one: Beside) -> None:
        """One more, beside those of the last SPAN_NS."""
        since_s = max(0, one.t_ns - self._t_ns[-1]) * 1e-9 if self._t_ns else 0.0
        gone = (self._gone[-1] if self._gone else 0.0) + math.hypot(*one.v_ne_mps) * since_s / one.apart_m
        n_old = sum(1 for _ in takewhile(lambda then_ns: then_ns < one.t_ns - SPAN_NS, self._t_ns))
        self._keep(n_old, len(self))
        self._t_ns.append(one.t_ns)
        self._gone.append(gone)
        column = [[complex(*each)] for each in (one.off_ne_m, one.v_ne_mps, one.per_focal_ne_m)]
        self._rows = np.concatenate((self._rows, column), axis=1)
        self.claimed_m2 = np.concatenate((self.claimed_m2, (one.claimed_m2,)))

    def until(self, t_ns: int) -> None:
        """No longer those after a time."""
        n_late = sum(1 for _ in takewhile(lambda then_ns: then_ns > t_ns, reversed(self._t_ns)))
        self._keep(0, len(self) - n_late)

    def _keep(self, first: int, end: int) -> None:
        self._t_ns, self._gone = self._t_ns[first:end], self._gone[first:end]
        self._rows, self.claimed_m2 = self._rows[:, first:end], self.claimed_m2[first:end]


class MapOffset:
    """The mean difference of GNSS and fixes over the last two minutes of a good GNSS, and how far fixes lag behind it."""

    def __init__(self, map_sigma_m: float) -> None:
        self._map_sigma_m = map_sigma_m
        self._differences = _Differences()
        self._told: set[str] = set()
        self._borne_out = False
        self._lag_s = self._lag_m = self._mean_m = 0.0
        self._place_fits = True
        self.sigma_m = map_sigma_m
        """1-sigma of the map on each axis: as configured, or half of what fixes do not claim of the distance, where GNSS does not
        explain that."""

    def compared(self, one: Beside) -> None:
        """Take a trusted GNSS beside a fix. One that is further off than map and lag may be tells of neither: it is GNSS that
        jumped, and nobody has said so yet."""
        if math.hypot(*one.off_ne_m) > MOST_M + MOST_LAG_S * math.hypot(*one.v_ne_mps):
            return
        self._differences.add(one)
        self._average()

    def suspected(self, t_ns: int, one: Beside) -> None:
        """GNSS is suspect since a time; take it beside the newest fix, which counts until the map was borne out."""
        if not self._borne_out:
            self.compared(one)
            return
        self._differences.until(t_ns - SOILED_NS)
        self._average()

    @property
    def distance_m(self) -> float:
        """Length of the mean difference, or that of a lag; 0 while too little is known."""
        if not self._enough:
            return 0.0
        mean_m, off = self._mean_m, self._differences.off
        if self._borne_out and len(off):  # a GNSS that has just jumped, and is not suspect yet, moves the mean by a part of that
            mean_m = min(mean_m, math.hypot(median(off.real), median(off.imag)))
        offset_m = max(mean_m, self._lag_m)
        return offset_m if self._borne_out or offset_m <= MOST_M else 0.0

    @property
    def _enough(self) -> bool:
        return len(self._differences) >= (FEWEST if self._borne_out else BORNE_OUT_BY)

    def _average(self) -> None:
        n, off = len(self._differences), self._differences.off
        self._mean_m = abs(complex(off.mean())) if n else 0.0
        self._borne_out |= n >= BORNE_OUT_BY and self._mean_m <= self._explained_m
        lagging = self._lagging(off, self._differences.v) if self._enough else (0.0, 0.0, True)
        self._lag_s, self._lag_m, self._place_fits = lagging
        self.sigma_m = self._sigma_m()

    def _lagging(self, off: ComplexArray, v: ComplexArray) -> tuple[float, float, bool]:
        """By how many seconds fixes lag behind GNSS, 0 where that is not what they do; how far that is, m; and whether an offset
        that stays where it is explains the differences as well. `off` (K,) are the differences, m, `v` (K,) the velocities, m/s,
        north + i east."""
        speed_mps = math.sqrt(float(np.vdot(v, v).real) / len(v))
        if speed_mps < LEAST_SPEED_MPS:
            return 0.0, 0.0, True
        lag_s = float(np.vdot(v, off).real) / (len(v) * speed_mps**2)
        lag_m = abs(lag_s) * speed_mps
        if not LEAST_LAG_S <= abs(lag_s) <= MOST_LAG_S or lag_m <= self._explained_m:
            return 0.0, 0.0, True
        left_m, left_of_place_m = (math.sqrt(float(np.mean(np.abs(rest) ** 2))) for rest in (off - lag_s * v, off - off.mean()))
        if left_m > FITS_SHARE * lag_m:
            return 0.0, 0.0, True
        return lag_s, lag_m, left_of_place_m <= FITS_SHARE * lag_m

    @property
    def _explained_m(self) -> float:
        return BEYOND_SIGMAS * math.hypot(GNSS_SIGMA_M, self._map_sigma_m)

    def _sigma_m(self) -> float:
        if max(self._mean_m, self._lag_m) <= self._explained_m:  # as it mostly is: the distance is no longer
            return self._map_sigma_m
        known = self._differences
        left_m = unclaimed_m(self.distance_m, float(known.claimed_m2.mean()), known.gone) if len(known) else self.distance_m
        return self._map_sigma_m if left_m <= self._explained_m else max(self._map_sigma_m, left_m / 2)

    def _is_the_lens(self, longer_share: float) -> bool:
        """Whether a lens that is longer by a share leaves nothing of the mean difference that GNSS does not explain."""
        if longer_share == 0:
            return False
        known = self._differences
        left = [off + longer_share * lens for off, lens in zip(known.off.tolist(), known.per_focal.tolist(), strict=True)]
        return bool(abs(sum(left)) <= self._explained_m * len(left))

    def notices(self, *, delay_told: bool = False, longer_share: float = 0.0) -> list[Command]:
        """The operator is told once of what it may be, and once of what it is; not of a lag where the camera's delay was told,
        nor while a lens that fixes show to be longer by a share explains it."""
        if self.sigma_m <= self._map_sigma_m or self._told & {"map", "lag"} or self._is_the_lens(longer_share):
            return []
        kind = "map" if self._lag_s == 0 else "either" if self._place_fits else "lag"
        if kind in self._told or (delay_told and kind != "map"):
            return []
        self._told.add(kind)
        way = "behind" if self._lag_s > 0 else "ahead of"
        text = {
            "map": f"visloc: map is {self.distance_m:.0f} m off GNSS",
            "either": f"visloc: fixes {self.distance_m:.0f} m {way} GNSS: delay, or map?",
            "lag": f"visloc: fixes {abs(self._lag_s):.1f} s {way} GNSS: camera's delay",
        }[kind]
        data = (("distance_m", self.distance_m), ("lag_s", self._lag_s))
        return [Notice(Severity.WARNING, text, to_operator=True, data=data)]


def median(values: FloatArray) -> float:
    """Of K finite numbers, as `numpy.median` has it, in a third of its time."""
    half, odd = divmod(len(values), 2)
    middle = np.partition(values, half if odd else (half - 1, half))
    return float(middle[half]) if odd else float((middle[half - 1] + middle[half]) / 2)
