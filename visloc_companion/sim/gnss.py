"""A simulated satellite receiver: white and correlated errors, loss of fix, and whatever false place it is made to report."""

from __future__ import annotations

from dataclasses import dataclass
from random import Random

from visloc_companion.geo.se3 import plus
from visloc_companion.sim.faults import GnssEffect
from visloc_companion.sim.faults.gnss import REGAIN_S
from visloc_companion.sim.vehicles.vehicle_noise import GaussMarkov
from visloc_companion.types import FIX_3D, Vec3

FIX_GOOD, FIX_NONE = 6, 1
SATELLITES_GOOD, SATELLITES_NONE = 10, 3
H_ACC_M, V_ACC_M, SPEED_ACC_MPS = 0.4, 0.6, 0.2
HDOP = 1.21


@dataclass(frozen=True, slots=True)
class GnssSample:
    """One solution, valid at `t_s`: position NED about home (m, true metres), velocity, and what the receiver says of it.

    `false_ned_m` is the part of the position that a spoofer put there (for the simulator's own accounts). Without a fix
    position and velocity are the last good ones.
    """

    t_s: float
    fix_type: int
    n_satellites: int
    p_ned_m: Vec3
    v_ned_mps: Vec3
    h_acc_m: float = H_ACC_M
    v_acc_m: float = V_ACC_M
    false_ned_m: Vec3 = (0.0, 0.0, 0.0)
    false_v_ned_mps: Vec3 = (0.0, 0.0, 0.0)

    @property
    def has_fix(self) -> bool:
        """Whether position and velocity mean anything."""
        return self.fix_type >= FIX_3D


@dataclass(frozen=True, slots=True)
class ReceiverErrors:
    """1-sigma per axis of a receiver's errors: what wanders (first-order Gauss-Markov over `slow_s`), white, velocity.

    The default is a good receiver in the open; single-frequency receivers wander by 1 to 2 m over a minute or two.
    """

    slow_m: float = 0.35
    slow_down_m: float = 0.6
    slow_s: float = 60.0
    white_m: float = 0.15
    velocity_mps: float = 0.08


class GnssReceiver:
    """Makes a sample every `period_s`, with the errors given.

    It loses its fix within 0.5 s of jamming and needs REGAIN_S to regain it (measured in ArduPilot's simulator: fix 6 -> 1,
    10 -> 3 satellites, accuracies left at the last good value).
    """

    def __init__(self, rng: Random, period_s: float = 0.2, errors: ReceiverErrors | None = None) -> None:
        self.period_s = period_s
        self._rng = rng
        self._errors = errors or ReceiverErrors()
        sigmas = (self._errors.slow_m, self._errors.slow_m, self._errors.slow_down_m)
        self._slow = tuple(GaussMarkov(rng, sigma, self._errors.slow_s) for sigma in sigmas)
        self._jammed_until_s = float("-inf")
        self._last_good: tuple[Vec3, Vec3] = ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0))

    def sample(self, t_s: float, p_ned_m: Vec3, v_ned_mps: Vec3, effect: GnssEffect) -> GnssSample:
        """The solution at a time, from the true position and velocity and what reaches the antenna."""
        errors = self._errors
        noise = [slow.step(self.period_s) + self._rng.gauss(0.0, errors.white_m) for slow in self._slow]
        noise_v = [self._rng.gauss(0.0, errors.velocity_mps) for _ in range(3)]
        if effect.jammed:
            self._jammed_until_s = t_s
        if t_s < self._jammed_until_s + REGAIN_S:
            return GnssSample(t_s, FIX_NONE, SATELLITES_NONE, *self._last_good)
        shift, shift_v = _false(p_ned_m, v_ned_mps, effect)
        p = (p_ned_m[0] + noise[0] + shift[0], p_ned_m[1] + noise[1] + shift[1], p_ned_m[2] + noise[2] + shift[2])
        v = (
            v_ned_mps[0] + noise_v[0] + shift_v[0],
            v_ned_mps[1] + noise_v[1] + shift_v[1],
            v_ned_mps[2] + noise_v[2] + shift_v[2],
        )
        self._last_good = (p, v)
        return GnssSample(t_s, FIX_GOOD, SATELLITES_GOOD, p, v, false_ned_m=shift, false_v_ned_mps=shift_v)


def _false(p_ned_m: Vec3, v_ned_mps: Vec3, effect: GnssEffect) -> tuple[Vec3, Vec3]:
    """What a transmitter adds to position and velocity."""
    if effect.meacon_ned_m is None:
        return effect.offset_ned_m, effect.offset_v_ned_mps
    n, e, d = plus(effect.meacon_ned_m, effect.offset_ned_m)
    v_n, v_e, v_d = effect.offset_v_ned_mps
    return (n - p_ned_m[0], e - p_ned_m[1], d - p_ned_m[2]), (v_n - v_ned_mps[0], v_e - v_ned_mps[1], v_d - v_ned_mps[2])
