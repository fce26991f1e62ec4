"""What else than a shift may explain a series: causes that are told with their probability and what they add to each difference.

A sequential test (shift.py) weighs "shifted since then" against "all is well". Where something healthy may look like a shift, the
second becomes a mixture: nothing happened, or one of these causes did, each as probable as it is told to be. So no more evidence
comes together than the improbability of the likeliest cause that explains it as well. Of each cause two sums are kept, as of the
starts of shifts (shift.py); its size is Gaussian. What was measured of its size elsewhere is in the sums from the beginning, but
makes no cause likelier than it is told to be.
"""

from __future__ import annotations

import math
from collections.abc import Hashable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

ComplexArray = NDArray[np.complex128]

MOST = 256
COUNTS = 1e-3
"""A cause that is told no more adds nothing from then on; it is kept while it has this share of what explains the series."""


class Cause(NamedTuple):
    """A cause, what it was told as before (its past is that one's), the natural logarithm of its probability, and what a unit of
    it adds to the newest difference; a measurement of its size, and the inverse of that one's variance per component."""

    key: Hashable
    before: Hashable | None
    log_probability: float
    adds: float
    size: complex = 0j
    known: float = 0.0


class OtherCauses:
    """K causes: the response of the test's n states to a unit of each, its two sums, and the logarithm of by how much what was
    measured of its size would make it likelier (K, n + 3)."""

    def __init__(self, states: int, sizes: Sequence[float], components: int) -> None:
        self._n, self._var, self._components = states, np.array(sizes) ** 2, components
        self._keys: dict[Hashable, int] = {}
        self._sums: ComplexArray = np.zeros((0, states + 3), dtype=complex)
        self._log_probability = np.zeros(0)

    def decay(self, decay: NDArray[np.float64]) -> None:
        """The states (n,) decay."""
        self._sums[:, : self._n] *= decay

    def sum_up(self, told: Sequence[Cause], nu: complex, h: ComplexArray, gain: ComplexArray, s_var: float) -> None:
        """Take a difference's innovation, its row h (n,) of the states, the states' gain (n,) and the innovation's variance."""
        if not told and not self._keys:
            return
        self._choose(told)
        adds, n = np.zeros(len(self._keys)), self._n
        adds[[self._keys[each.key] for each in told]] = [each.adds for each in told]
        signature = adds - self._sums[:, :n] @ h
        self._sums[:, :n] += signature[:, None] * gain
        self._sums[:, n] += (signature.real**2 + signature.imag**2) / s_var
        self._sums[:, n + 1] += signature.conj() * (nu / s_var)

    def log_explained(self) -> float:
        """Natural logarithm of by how much likelier the series is with these causes than with none of them; at least 0."""
        return _log_sum(self._log_weights()) if self._keys else 0.0

    def _log_weights(self) -> NDArray[np.float64]:
        """(K,) logarithm of probability times likelihood ratio."""
        sums = self._sums
        return np.asarray(self._log_ratio(sums) - sums[:, self._n + 2].real + self._log_probability)

    def _log_ratio(self, sums: ComplexArray) -> NDArray[np.float64]:
        """(K,) logarithm of the likelihood ratios, averaged over sizes."""
        A, b = sums[:, self._n].real[:, None], sums[:, self._n + 1][:, None]
        spread = 1 + A * self._var
        log_ratio = 0.5 * ((b.real**2 + b.imag**2) * self._var / spread - self._components * np.log(spread))
        return np.asarray(np.logaddexp.reduce(log_ratio, axis=1) - math.log(len(self._var)))

    def _choose(self, told: Sequence[Cause]) -> None:
        """Those that are told, new ones with their past, and of the others those that count."""
        named, log_weights = {each.key for each in told}, self._log_weights()
        likely = (log_weights - _log_sum(log_weights) > math.log(COUNTS)).tolist()
        kept = [key for key, at in self._keys.items() if key not in named and likely[at]][-MOST:]
        past, begun = dict(self._keys), list[ComplexArray]()  # where the past of each stands: of new ones behind all others
        for each in told:
            if each.key not in past and each.before in past:
                past[each.key] = past[each.before]
            elif each.key not in past:
                past[each.key] = len(self._keys) + len(begun)
                begun.append(self._begun(each))
        keys = [*kept, *(each.key for each in told)]
        known, at = (np.array([past[key] for key in which], np.intp) for which in (kept, keys))
        self._log_probability = np.concatenate([self._log_probability[known], [each.log_probability for each in told]])
        self._sums = np.concatenate([self._sums, *begun])[at]
        self._keys = {key: k for k, key in enumerate(keys)}

    def _begun(self, cause: Cause) -> ComplexArray:
        row: ComplexArray = np.zeros((1, self._n + 3), dtype=complex)
        row[0, self._n], row[0, self._n + 1] = cause.known, cause.size * cause.known
        row[0, self._n + 2] = max(0.0, float(self._log_ratio(row)[0]))
        return row


def _log_sum(log_weights: NDArray[np.float64]) -> float:
    """Natural logarithm of the sum of 1 and K weights that are told by theirs."""
    return float(np.logaddexp.reduce(np.append(0.0, log_weights)))
