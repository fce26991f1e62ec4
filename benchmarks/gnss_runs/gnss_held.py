"""What the daemon knows of the fixes that the GNSS monitor is shown, for flights without a filter (gnss_flights.py): which ground
each looked at, where the fixes before had the vehicle, by how much they scatter more than they claim (core/gnss_aiding.py)."""

from __future__ import annotations

import math

import numpy as np

from visloc_companion.core.filter import claims
from visloc_companion.core.filter.votes import spacing_m
from visloc_companion.core.gnss_aiding import GNSS_AFTER_NS
from visloc_companion.core.satellites.gnss_witness import Ground
from visloc_companion.core.settings import NavigatorSettings
from visloc_companion.types import FloatArray, Vec2

METHOD = "image"
HELD_BY_FIXES_S = GNSS_AFTER_NS * 1e-9
STARTS_ANEW_AFTER = 5
"""Refused fixes in a row after which the filter starts at the next."""
WALK_M_PER_SQRT_S = 0.05


class Held:
    """A filter of place and of an error of the velocity that lasts, the same on both axes: it rests on fixes, and in between on
    displacements; places are metres north, east."""

    def __init__(self) -> None:
        settings = NavigatorSettings()
        self._gate, self._lasts_s = settings.gate_sigma, settings.velocity_correlation_s
        self._held, self._age_s, self._refused = False, 0.0, 0
        self._t_s, self._moved_m = 0.0, np.zeros(2)
        self._claims: tuple[claims.Claim, ...] = ()
        self._x: FloatArray = np.zeros((2, 2))  # place and error of the velocity, of each axis
        self._P: FloatArray = np.zeros((2, 2))

    def carry(self, moved_ne_m: Vec2, sigma_mps: float, dt_s: float) -> None:
        """The vehicle has moved, as is said with that 1-sigma of a velocity; without fixes GNSS holds it soon."""
        self._age_s += dt_s
        self._t_s, self._moved_m = self._t_s + dt_s, self._moved_m + np.array(moved_ne_m)
        self._held &= self._age_s <= HELD_BY_FIXES_S
        kept = math.exp(-dt_s / self._lasts_s)
        F, Q = np.array([[1.0, -dt_s], [0.0, kept]]), np.diag([WALK_M_PER_SQRT_S**2 * dt_s, sigma_mps**2 * (1 - kept**2)])
        self._x = F @ self._x + np.array([moved_ne_m, (0.0, 0.0)])
        self._P = F @ self._P @ F.T + Q

    @property
    def over(self) -> float:
        """By what factor the variance of the last fix is more than it claims."""
        return claims.scattered(self._claims, METHOD)

    def take(self, fix_ne_m: Vec2, claimed_m2: float, sigma_mps: float, height_m: float, claim: float) -> tuple[Ground, bool]:
        """A fix with its variance per axis: what it looked at, straight below, and whether the filter takes it; it starts with
        that 1-sigma of a velocity."""
        ground = Ground(METHOD, fix_ne_m, spacing_m(None, height_m), claim)
        taken, var_m2 = False, claims.over(self._claims, METHOD) * claimed_m2
        if self._held:
            off, sum_m2 = np.array(fix_ne_m) - self._x[0], float(self._P[0, 0]) + var_m2
            ground = ground._replace(off_ne_m=(float(off[0]), float(off[1])), off_var_m2=sum_m2)
            taken = math.hypot(*off) <= self._gate * math.sqrt(sum_m2)
        if taken:
            (north, east), white = (np.array(fix_ne_m) - self._moved_m).tolist(), (off / math.sqrt(sum_m2)).tolist()
            apart = claims.Apart((north, east), round(self._t_s * 1e9), claimed_m2)
            self._claims = claims.learned(self._claims, METHOD, (white[0], white[1]), apart, sigma_mps)
            gain = self._P[:, 0] / sum_m2
            self._x, self._P = self._x + gain[:, None] * off, self._P - np.outer(gain, self._P[0])
        elif self._held and self._refused < STARTS_ANEW_AFTER - 1:
            self._refused += 1
            return ground, False
        else:
            self._x, self._P = np.array([fix_ne_m, (0.0, 0.0)]), np.diag([var_m2, sigma_mps**2])
        self._held, self._age_s, self._refused = True, 0.0, 0
        return ground, True
