"""A sequential test that notices when the mean of a series shifts, by a step or a ramp, at an unknown time.

The series is what two sources say of one quantity, differenced: GNSS minus vision (metres), GNSS minus odometry (metres a
second), GNSS height minus barometer. A value is a complex number, north + i east, or real where there is one component only.
Healthy differences are coloured, so a small Kalman filter models them: a constant, a slow and a quick Gauss-Markov part, a
complex factor times a known complex quantity (delay times velocity; errors of scale and heading times velocity), white noise.
Its innovations are white while nothing shifts. A shift that began at t0 leaves a known signature in them (Willsky and Jones
1976, "A generalized likelihood ratio approach to the detection and estimation of jumps in linear systems"), so each start t0
needs two sums only: A = sum |s|^2/S and b = sum s* nu/S, where s is the innovation that a unit shift causes. With a Gaussian
prior of 1-sigma w per component the likelihood ratio in closed form is (1 + A w^2)^(-d/2) exp(|b|^2 w^2 / (2 (1 + A w^2))) in d
components. Its average over sizes, summed over the starts (weighted by their seconds), is the Shiryaev-Roberts statistic R
(Roberts 1966; Pollak 1985): under the model the mean time between false alarms at R > exp(h) is at least exp(h) seconds, and R
times the rate of attacks a second is the posterior odds of one. What else may explain the series:
other_causes.py.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from visloc_companion.core.satellites.other_causes import Cause, OtherCauses

ComplexArray = NDArray[np.complex128]

FINE_S, MEDIUM_S, LONG_S = 32, 128, 512
"""Starts are kept one by one while younger than FINE_S, then every 4th until MEDIUM_S, then every 16th until LONG_S."""
MEDIUM_EVERY, COARSE_EVERY = 4, 16
"""Of starts about a second apart."""
FIRST_WEIGHT_S = 1e-3
TINY = 1e-12
MIN_LOG_R_OF_SHIFT = 5.0
"""Below this nothing that was learned is taken for a shift's work."""
CLIP_SIGMA = 4.0
"""A difference further out is weighed down to this distance, so that a single wrong one never decides."""
STATES = 4


@dataclass(frozen=True, slots=True)
class ShiftModel:
    """What is healthy, and which shifts are looked for; all 1-sigma per component.

    The constant and its random walk; the slow part and its correlation time; the correlation time of the quick part (whose
    variance comes with each difference); the factor and its random walk; steps (unit of the series) and ramps (unit a
    second). `max_constant` bounds the constant that is ever learned (infinity: unbounded); `components` is 1 or 2; `causes` are
    the sizes of what else may explain the series.
    """

    constant: float
    constant_walk_per_sqrt_s: float
    slow: float
    slow_s: float
    quick_s: float
    steps: tuple[float, ...]
    ramps: tuple[float, ...] = ()
    factor: float = 0.0
    factor_walk_per_sqrt_s: float = 0.0
    max_constant: float = math.inf
    components: int = 2
    causes: tuple[float, ...] = ()


@dataclass(frozen=True, slots=True)
class ShiftResult:
    """After a difference: its distance from what is healthy in sigma, and the natural logarithm of R (R in seconds)."""

    distance_sigma: float
    log_r: float


class ShiftTest:
    """The test of one series."""

    def __init__(
        self, model: ShiftModel, first_weight_s: float = FIRST_WEIGHT_S, first_ramp_weight_s: float | None = None
    ) -> None:
        self._model = model
        self._is_step = np.array([True] * bool(model.steps) + [False] * bool(model.ramps))[:, None]
        sizes = [s for s in (model.steps, model.ramps) if s]
        n = max(len(s) for s in sizes)
        self._var = np.array([[s[min(i, len(s) - 1)] ** 2 for i in range(n)] for s in sizes])[:, :, None]
        self._log_share = -math.log(self._var.size)
        self._x: ComplexArray = np.zeros(STATES, dtype=complex)
        self._P: ComplexArray = np.diag([model.constant**2, model.slow**2, 0.0, model.factor**2]).astype(complex)
        self._t_s: float | None = None
        self.forget(first_weight_s, first_ramp_weight_s)

    @property
    def healthy(self) -> complex:
        """The learned part of the difference that lasts: constant and slow."""
        return complex(self._x[0] + self._x[1])

    @property
    def log_r(self) -> float:
        """The statistic after the last difference; minus infinity at the beginning."""
        return self._log_r

    def forget(self, first_weight_s: float = FIRST_WEIGHT_S, first_ramp_weight_s: float | None = None) -> None:
        """Drop all starts; what was learned of the healthy difference stays. The next start weighs so many seconds, a ramp that
        begins there others where they are told: one that began long before is a step by then."""
        self._starts = np.zeros((4, 0))  # time, how long it is kept, log of the weight of a step, of a ramp
        self._sums: ComplexArray = np.zeros((len(self._is_step), 0, STATES + 2), dtype=complex)  # response of the states, A, b
        self._n, self._log_r = 0, -math.inf
        self._first_weights_s = first_weight_s, first_weight_s if first_ramp_weight_s is None else first_ramp_weight_s
        self._causes = OtherCauses(STATES, self._model.causes, self._model.components)

    def fork(self, first_weight_s: float = FIRST_WEIGHT_S) -> ShiftTest:
        """A test that begins anew from what was learned here, less what the likeliest shift has put into it."""
        other = copy.copy(self)
        other._x, other._P = self._x - self._likeliest_response(), self._P.copy()
        other.forget(first_weight_s)
        return other

    def summed(self, regressor: complex) -> None:
        """What the factor has made of a regressor is in the constant from now on: for a series that is a sum, in which another
        factor changes what comes next and not what was summed before. The next regressor begins at nothing again."""
        F = np.eye(STATES, dtype=complex)
        F[0, 3] = regressor
        self._x, self._P = F @ self._x, F @ self._P @ F.conj().T
        self._sums[..., 0] += regressor * self._sums[..., 3]

    def unlearn(self, var: float) -> None:
        """The constant is less well known by a variance per component: what it was learned from errs by more than was said."""
        self._P[0, 0] += var

    def _likeliest_response(self) -> ComplexArray:
        if self._log_r < MIN_LOG_R_OF_SHIFT:
            return np.zeros_like(self._x)
        weight = np.maximum(self._sums[..., STATES].real, TINY)
        shift = self._sums[..., STATES + 1] / weight
        at = np.unravel_index(int(np.argmax(np.abs(shift) ** 2 * weight)), shift.shape)
        return np.asarray(self._sums[at][:STATES] * shift[at])

    def update(
        self,
        t_s: float,
        difference: complex,
        white_var: float,
        quick_var: float,
        regressor: complex = 0j,
        causes: Sequence[Cause] = (),
    ) -> ShiftResult:
        """Take a difference at a time: variances per component of its white and its quick error; what the factor multiplies; what
        else may be in it."""
        dt_s = 0.0 if self._t_s is None else max(0.0, t_s - self._t_s)
        self._predict(dt_s, quick_var)
        self._add_start(t_s if self._t_s is None else self._t_s, dt_s)
        self._t_s = t_s
        h = np.array([1.0, 1.0, 1.0, regressor])
        p_h = self._P @ h.conj()
        s_var = float((h @ p_h).real) + white_var
        nu = difference - complex(h @ self._x)
        distance = abs(nu) / math.sqrt(s_var)
        if distance > CLIP_SIGMA:
            s_var *= (distance / CLIP_SIGMA) ** 2
        self._sum_up(t_s, nu, h, p_h / s_var, s_var)
        self._causes.sum_up(causes, nu, h, p_h / s_var, s_var)
        self._learn(nu, p_h, s_var)
        self._log_r = self._statistic() - self._causes.log_explained()
        return ShiftResult(distance, self._log_r)

    def _predict(self, dt_s: float, quick_var: float) -> None:
        model = self._model
        slow, quick = math.exp(-dt_s / model.slow_s), 0.0 if self._t_s is None else math.exp(-dt_s / model.quick_s)
        decay = np.array([1.0, slow, quick, 1.0])
        self._x = self._x * decay
        self._sums[..., :STATES] *= decay
        self._causes.decay(decay)
        self._P = self._P * decay * decay[:, None]
        self._P[0, 0] += model.constant_walk_per_sqrt_s**2 * dt_s
        self._P[1, 1] += model.slow**2 * (1 - slow**2)
        self._P[2, 2] += quick_var * (1 - quick**2)
        self._P[3, 3] += model.factor_walk_per_sqrt_s**2 * dt_s

    def _add_start(self, start_s: float, dt_s: float) -> None:
        keep = start_s - self._starts[0] < self._starts[1]
        if np.count_nonzero(keep) < len(keep):
            self._starts, self._sums = self._starts[:, keep], self._sums[:, keep]
        every = next((n for n in (COARSE_EVERY, MEDIUM_EVERY) if dt_s >= n), 1)
        self._n += -self._n % every  # where differences are rare, a start stands for as long as one that is kept of many
        usual_s = max(dt_s, FIRST_WEIGHT_S)
        step_s, ramp_s = self._first_weights_s if self._n == 0 else (usual_s, usual_s)
        none = np.zeros((len(self._is_step), 1, STATES + 2), dtype=complex)
        start = np.array([[start_s], [_kept_s(self._n)], [math.log(step_s)], [math.log(ramp_s)]])
        self._starts = np.concatenate((self._starts, start), axis=1)
        self._sums = np.concatenate((self._sums, none), axis=1)
        self._n += 1

    def _sum_up(self, t_s: float, nu: complex, h: ComplexArray, gain: ComplexArray, s_var: float) -> None:
        signature = np.where(self._is_step, 1.0, t_s - self._starts[0]) - self._sums[..., :STATES] @ h
        self._sums[..., :STATES] += signature[..., None] * gain
        self._sums[..., STATES] += (signature.real**2 + signature.imag**2) / s_var
        self._sums[..., STATES + 1] += signature.conj() * (nu / s_var)

    def _learn(self, nu: complex, p_h: ComplexArray, s_var: float) -> None:
        self._x = self._x + p_h * (nu / s_var)
        self._P = self._P - p_h[:, None] * (p_h.conj() / s_var)
        if abs(self._x[0]) > self._model.max_constant:
            self._x[0] *= self._model.max_constant / abs(self._x[0])

    def _statistic(self) -> float:
        """log of the sum over kinds, sizes and starts of the likelihood ratios, (kinds, sizes, starts) at once."""
        b = self._sums[..., STATES + 1]
        b_2 = (b.real**2 + b.imag**2)[:, None, :]
        log_weight = np.where(self._is_step, self._starts[2], self._starts[3])[:, None, :]
        spread = 1 + self._sums[:, None, :, STATES].real * self._var
        log_ratio = 0.5 * (b_2 * self._var / spread - self._model.components * np.log(spread)) + log_weight
        top = float(log_ratio.max())
        return top + math.log(float(np.exp(log_ratio - top).sum())) + self._log_share


def _kept_s(number: int) -> int:
    """For how long a start is kept, by how many there were before it."""
    if number % COARSE_EVERY == 0:
        return LONG_S
    return MEDIUM_S if number % MEDIUM_EVERY == 0 else FINE_S
