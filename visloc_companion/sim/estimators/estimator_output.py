"""The output predictor of both autopilots: the present state follows corrections of the delayed one with a time constant.

Both apply err / tau + 0.1 / tau² x (integral of err) per second, for position and velocity each (AP_NavEKF3_core.cpp:962,
EK3_TAU_OUTPUT; output_predictor.cpp:321, EKF2_TAU_POS and EKF2_TAU_VEL).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

INTEGRAL_SHARE = 0.1


@dataclass(frozen=True, slots=True)
class OutputTaus:
    """Time constants, s; one that is no longer than a step follows at once."""

    position_s: float = 0.0
    velocity_s: float = 0.0


def output_taus(parameters: Mapping[str, float]) -> OutputTaus:
    """Of an autopilot by its parameters; EK3_TAU_OUTPUT is in hundredths of a second."""
    if "EK3_TAU_OUTPUT" in parameters:
        return OutputTaus(parameters["EK3_TAU_OUTPUT"] / 100, parameters["EK3_TAU_OUTPUT"] / 100)
    return OutputTaus(parameters["EKF2_TAU_POS"], parameters["EKF2_TAU_VEL"])


class Due:
    """What the present state of one axis has still to follow: metres and m/s."""

    __slots__ = ("_sum_p", "_sum_v", "_taus", "p", "v")

    def __init__(self, taus: OutputTaus) -> None:
        self._taus = taus
        self.clear()

    def clear(self) -> None:
        """Nothing is due."""
        self.p = self.v = self._sum_p = self._sum_v = 0.0

    def step(self, dt_s: float) -> tuple[float, float]:
        """What position and velocity are changed by in a step. While the velocity follows, the position falls behind."""
        self.p += self.v * dt_s
        self._sum_p += self.p
        self._sum_v += self.v
        p = _followed(self.p, self._sum_p, dt_s, self._taus.position_s)
        v = _followed(self.v, self._sum_v, dt_s, self._taus.velocity_s)
        self.p -= p
        self.v -= v
        return p, v


def _followed(due: float, total: float, dt_s: float, tau_s: float) -> float:
    if tau_s <= dt_s:
        return due
    gain = dt_s / tau_s
    return due * gain + total * gain * gain * INTEGRAL_SHARE
