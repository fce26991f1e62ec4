"""Height sanity: the receiver's height must change as the barometer's does.

The difference wanders (weather, orbits) and has an unknown constant; in climbs it stretches, for the air is not the standard
atmosphere's. What remains is held against steps and ramps.
"""

from __future__ import annotations

import math

from visloc_companion.core.satellites.shift import ShiftModel, ShiftTest
from visloc_companion.types import Baro

SEA_LEVEL_HPA = 1013.25
BLOCK_NS = 2_000_000_000
BARO_AGE_NS = 1_500_000_000
LEVEL_S = 60.0
CLIMB_SHARE = 0.1
"""Air warmer or colder by 25 degrees than the standard atmosphere's stretches heights by a tenth."""
BLOCK_SIGMA_M = 1.0
PRESSURE_SIGMA_M = 1.0
"""Static pressure follows airspeed and wind, for some seconds."""
MODEL = ShiftModel(
    constant=100.0,
    constant_walk_per_sqrt_s=0.1,
    slow=3.0,
    slow_s=100.0,
    quick_s=10.0,
    steps=(20.0, 100.0),
    ramps=(1.0, 3.0),
    components=1,
)


def pressure_altitude_m(pressure_hpa: float) -> float:
    """Height of a static pressure in the standard atmosphere (ICAO Doc 7488), metres above 1013.25 hPa."""
    return 44330.77 * (1.0 - math.pow(pressure_hpa / SEA_LEVEL_HPA, 0.190263))


class HeightTest:
    """The sequential test of GNSS height against the barometer."""

    def __init__(self) -> None:
        self._test = ShiftTest(MODEL)
        self._baro: tuple[int, float] | None = None
        self._level_m: float | None = None
        self._finished_ns: int | None = None

    @property
    def log_r(self) -> float:
        """The statistic; minus infinity before the first comparison."""
        return self._test.log_r

    def forget(self) -> None:
        """Begin anew (trust was lost, or a probation starts)."""
        self._test = self._test.fork()

    def learn_anew(self) -> None:
        """What the receiver gave until now is no measure for what it will give."""
        if self._test.log_r > -math.inf:
            self._test = ShiftTest(MODEL)

    def on_baro(self, baro: Baro) -> None:
        """Take a pressure; impossible ones are left out."""
        if 100.0 <= baro.pressure_hpa <= 1200.0:
            self._baro = (baro.t_rx_ns, pressure_altitude_m(baro.pressure_hpa))

    def on_gnss(self, t_rx_ns: int, h_amsl_m: float, v_acc_m: float | None) -> None:
        """Hold a receiver's height against the latest pressure, every other second."""
        if self._baro is None or t_rx_ns - self._baro[0] > BARO_AGE_NS:
            return
        elapsed_ns = BLOCK_NS if self._finished_ns is None else t_rx_ns - self._finished_ns
        if elapsed_ns < BLOCK_NS:
            return
        h_m, self._finished_ns = self._baro[1], t_rx_ns
        level_m = h_m if self._level_m is None else self._level_m
        self._level_m = h_m + (level_m - h_m) * math.exp(-elapsed_ns * 1e-9 / LEVEL_S)
        quick_var = PRESSURE_SIGMA_M**2 + (CLIMB_SHARE * (h_m - self._level_m)) ** 2
        white_var = BLOCK_SIGMA_M**2 + min(v_acc_m or 0.0, 10.0) ** 2
        self._test.update(t_rx_ns * 1e-9, h_amsl_m - h_m, white_var, quick_var)
