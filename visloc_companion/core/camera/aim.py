"""Where the camera looks beside where it should: an offset of fixes that goes round with the vehicle's heading.

A principal point that is set up wrongly, a mounting that is tilted or a wrong lever arm moves each fix in the vehicle's own axes.
What GNSS and map differ by stays in north and east, and a delay lies along the velocity. A Kalman filter of these five tells them
apart as far as the flight allows it. boresight.py sees no principal point: the picture shows no tilt, so what it lays into the
mounting comes back in what fixes say of the tilt.

On one heading an offset may be GNSS's, the map's or the camera's: what fixes do not claim of it themselves is doubted, so that
level and gates reckon with it. Where headings tell, it is taken off. A camera whose fixes once agreed with GNSS looks where it
should: nobody who sends a false GNSS later can use it.
"""

from __future__ import annotations

import cmath
import math

import numpy as np

from visloc_companion.core import kalman
from visloc_companion.core.filter.lasting import SHARE, apart_m, unclaimed_m
from visloc_companion.types import Command, Cov2, FloatArray, Notice, Rejected, Severity, Vec2

AIM, DIFFERENCE, DELAY, STATES = slice(0, 2), slice(2, 4), 4, 5
FIRST_SIGMA = np.array([0.05, 0.05, 3.0, 3.0, 0.1])
"""Aim forward and right (shares of the height); difference north and east (m); delay (s)."""
WALK_PER_SQRT_S = np.array([0.0, 0.0, 0.1, 0.1, 1e-4])
EVERY_NS = 1_000_000_000
GNSS_SIGMA_M, LASTS_S = 1.0, 5.0
"""1-sigma of what comes and goes of GNSS from second to second; what fixes get wrong lasts for so long."""
SURE = 0.01
GATE_SIGMA = 5.0
MIN_HEIGHT_M = 20.0
FEWEST = 8
DOUBT_M, AGREES_M = 2.2, 1.2
"""An aim that moves fixes by as much more than they claim is doubted: less is in any level. One that moves them by less than the
other is none."""
STEADY_SHARE, MOST_NOISE = 0.4, 0.32
"""Of the offset, rms: what is left of it where it has always been there, and what fixes claim of that at most. A drag that grows
evenly leaves 0.58, and still 0.48 with so much taken off."""
USE_M, USE_SIGMAS, USE_SIGMA_M = 2.0, 4.0, 1.2
"""It is taken off once it moves fixes by as much, and by so many 1-sigmas, each of them no more than that."""
TELL_M = 6.0
"""On one heading the operator is told from here on: GNSS and a map are often as far apart as less."""
AGAIN_NS, AGAIN = 20_000_000_000, 5
"""And where so many fixes show it after so long, over other ground (lasting.apart_m): an autopilot's tilt errs for some 20 s
(boresight.TILT_S), and over one ground a wrong match stays wrong, so all fixes until then are no more than one."""
FOLLOW_M = 0.5
LARGEST = 0.1
"""A share of the height: 10 % of the width of a picture over 53 degrees."""
AGREED, AGREES_OFF_M = 20, 1.5
"""So many seconds of fixes that lie within that of GNSS, rms, beyond what they claim: the camera looks where it should."""
HIGHER = 1.5
"""Up to so many times the height at which it was seen to."""


class Aim:
    """`on_fix` learns; `used` is to be taken off fixes, `doubt` to be reckoned with: shares of the height, as complex numbers
    (forward + i right) and as a length."""

    def __init__(self) -> None:
        self._x = np.zeros(STATES)
        self._P = np.diag(FIRST_SIGMA**2)
        self._t_ns: int | None = None
        self._n, self._turned, self._squares, self._heights, self._claimed_m2 = 0, 0j, 0.0, 0.0, 0.0
        self._agreed_to_m = 0.0
        self._first_ns, self._way_m = 0, 0.0
        self._later, self._again_turned, self._again_heights = 0, 0j, 0.0
        self._told: set[str] = set()
        self.used, self.doubt = 0j, 0.0

    @property
    def estimate(self) -> complex:
        """What flight shows of it, taken off or not."""
        return complex(*self._x[AIM])

    @property
    def sigma(self) -> float:
        """Its 1-sigma, along the less certain axis."""
        return math.sqrt(float(np.linalg.eigvalsh(self._P[AIM, AIM])[-1]))

    def on_fix(
        self,
        t_ns: int,
        off_ne_m: Vec2,
        cov_ne_m2: Cov2,
        heading_rad: float,
        v_ne_mps: Vec2,
        height_m: float,
        *,
        timed: bool = True,
    ) -> list[Command]:
        """Take how far a fix, less what is taken off, lies from a trusted GNSS, with heading, velocity and height at its time;
        `timed`: that is known. Says once what it may be, and once what is taken off."""
        early = self._t_ns is not None and t_ns - self._t_ns < EVERY_NS
        if early or height_m < MIN_HEIGHT_M or height_m <= self._agreed_to_m:
            return []
        dt_s = 0.0 if self._t_ns is None else (t_ns - self._t_ns) * 1e-9
        self._t_ns = t_ns
        self._P = self._P + np.diag(WALK_PER_SQRT_S**2) * dt_s
        ahead = cmath.rect(height_m, heading_rad)
        off = complex(*off_ne_m) + self.used * ahead
        if not self._learned(off, ahead, np.array(cov_ne_m2), v_ne_mps):
            return []
        self._first_ns = t_ns if self._n == 0 else self._first_ns
        self._way_m += math.hypot(*v_ne_mps) * min(dt_s, LASTS_S)
        self._n += 1
        self._turned += off * ahead.conjugate()
        self._squares += abs(off) ** 2
        self._heights += height_m**2
        if t_ns - self._first_ns >= AGAIN_NS and self._way_m >= apart_m(height_m):
            self._later += 1
            self._again_turned += off * ahead.conjugate()
            self._again_heights += height_m**2
        self._claimed_m2 += cov_ne_m2[0][0] + cov_ne_m2[1][1]
        self._judge(height_m, timed=timed)
        return self._notices(height_m)

    def _learned(self, off: complex, ahead: complex, cov: FloatArray, v_ne_mps: Vec2) -> bool:
        H = np.zeros((2, STATES))
        H[:, AIM] = ((ahead.real, -ahead.imag), (ahead.imag, ahead.real))
        H[:, DIFFERENCE] = np.eye(2)
        H[:, DELAY] = v_ne_mps
        R = 2 * LASTS_S * SHARE * cov + GNSS_SIGMA_M**2 * np.eye(2)
        outcome = kalman.update(self._x, self._P, np.array((off.real, off.imag)), R, H, gate_sigma=GATE_SIGMA)
        if isinstance(outcome, Rejected):
            return False
        self._x, self._P = outcome.x, outcome.P
        return True

    def _judge(self, height_m: float, *, timed: bool) -> None:
        found_m, sigma_m = abs(self.estimate) * height_m, self.sigma * height_m
        if self.used:
            self._follow(height_m)
            return
        off_m, left_m = self._steady()
        agrees = self._squares - self._claimed_m2 <= AGREES_OFF_M**2 * self._n
        if self._n >= AGREED and found_m <= AGREES_M and agrees:
            self._agreed_to_m = HIGHER * height_m
        steady = left_m <= STEADY_SHARE * off_m
        left_over_m = unclaimed_m(found_m, self._claimed_m2 / self._n, self._way_m / apart_m(height_m))
        likely = steady and self._n >= FEWEST and found_m >= USE_M and abs(self.estimate) <= LARGEST
        if likely and timed and sigma_m <= min(USE_SIGMA_M, found_m / USE_SIGMAS):
            self.used, self.doubt = self.estimate, 2 * self.sigma
        elif likely and left_over_m >= DOUBT_M:
            self.doubt = left_over_m / height_m
        elif left_over_m <= AGREES_M or not steady:
            self.doubt = 0.0

    def _follow(self, height_m: float) -> None:
        """What is taken off becomes what it is by now, until that is well known."""
        sigma_m = self.sigma * height_m
        if abs(self.estimate - self.used) * height_m > max(FOLLOW_M, sigma_m) and abs(self.estimate) <= LARGEST:
            self.used = self.estimate
        self.doubt = 2 * self.sigma
        if sigma_m <= FOLLOW_M:
            self._agreed_to_m = HIGHER * height_m

    def _steady(self) -> tuple[float, float]:
        """Metres: the offset that goes round with the heading and fits all fixes best, and what is left of them beyond what they
        claim, rms."""
        n, turned = self._n, abs(self._turned)
        fits_m2 = turned**2 / self._heights / n
        claimed_m2 = min(self._claimed_m2 / n, MOST_NOISE**2 * fits_m2)
        return math.sqrt(fits_m2), math.sqrt(max(0.0, self._squares / n - fits_m2 - claimed_m2))

    @property
    def _shown_again(self) -> bool:
        """Whether fixes of a later time, over other ground, show most of it, too."""
        if self._later < AGAIN:
            return False
        all_of_it, later = self._turned / self._heights, self._again_turned / self._again_heights
        return (later * all_of_it.conjugate()).real >= (1 - STEADY_SHARE) * abs(all_of_it) ** 2

    def _notices(self, height_m: float) -> list[Command]:
        kind, share = ("known", self.used) if self.used else ("doubted", self.estimate)
        off_m = abs(share) * height_m if self.used else self._steady()[0]
        if self.doubt == 0 or kind in self._told or (kind == "doubted" and not (off_m >= TELL_M and self._shown_again)):
            return []
        self._told |= {kind, "doubted"}
        along = abs(share.real) >= abs(share.imag)
        way = ("ahead" if share.real > 0 else "back") if along else ("right" if share.imag > 0 else "left")
        what = {"known": "cx/cy_px, mount, lever?", "doubted": "aim, delay, or map?" if along else "camera's aim, or map?"}
        data = (("ahead", share.real), ("right", share.imag), ("sigma", self.sigma))
        return [Notice(Severity.WARNING, f"visloc: fixes {off_m:.0f} m {way}: {what[kind]}", to_operator=True, data=data)]
