"""What if fixes have been wrong by the same offset since one of them? Then the filter that follows them is off by what that does.

Over the same ground a wrong match is found again, with the same offset (votes.py). So each fix over other ground founds one
offset, with the probability that it was wrong. The filter is linear: each of its states is off by so much for each metre of the
offset (`by`), which goes on as any error of the filter does. Fixes that begin to be off move the velocity as well, and by that
the filter goes on, so it is off by another amount than they moved its place by. How large the offset is, innovations tell: that
of a fix is off by the offset less what the filter has followed of it, that of odometry by what the filter has followed (Willsky &
Jones, "A generalized likelihood ratio approach to the detection and estimation of jumps in linear systems", 1976). So where the
vehicle is, and how well that is known, is exact, if fixes were right before and are off by one offset since.

The next fixes of its method say nothing against it over the same ground, and little while the vehicle goes on. A fix of another
method speaks for or against it by where it lies, but is itself wrong with a probability of its own, so it does not tell how large
the offset is. What errs each in its own way is left to separation.py.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import compress
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from visloc_companion.core import kalman
from visloc_companion.core.filter.separation import CLAIM_FLOOR, believed, likeliest
from visloc_companion.types import FloatArray

UNIT = np.eye(2)


@dataclass(frozen=True, slots=True, eq=False)
class Alike:
    """K offsets of fixes of m coordinates: what each metre makes the filter's n states be off by, filter minus truth, `by`
    (n, K, m); what innovations have told of each, the information (K, m, m), 1/m², and that times the mean, `told` (K, m), 1/m;
    their probabilities (K,), when they were founded (K,), and the methods whose fixes they are."""

    by: FloatArray
    information: FloatArray
    told: FloatArray
    probability: FloatArray
    since_ns: NDArray[np.int64]
    methods: tuple[str, ...] = ()

    def __len__(self) -> int:
        return len(self.methods)

    def off_m(self, H: FloatArray) -> tuple[FloatArray, FloatArray]:
        """By how much H x, H (l, n), l of 1 or 2, is off, mean (l, K), and of that beside the filter's own the variances and the
        covariance (3, K): of the first, the last, and of both.

        The information is a product of triangles, U' U (Cholesky), and what is seen of one, divided by U, has unit variance.
        """
        return _off_m(self, _seen(self, H))


class Taken(NamedTuple):
    """A fix that the filter took: its time, method, claim of being wrong, and the probability that it errs with the last one of
    its method; the innovation (m,), its covariance S (m, m), what of the filter's states it is of, H (m, n), and the gain
    (n, m) with which they took it."""

    t_ns: int
    method: str
    claimed: float
    again: float
    innovation_m: FloatArray
    S: FloatArray
    H: FloatArray
    gain: FloatArray


def none(n: int, m: int) -> Alike:
    """No offset of m coordinates, of a filter of n states."""
    return Alike(np.zeros((n, 0, m)), np.zeros((0, m, m)), np.zeros((0, m)), np.zeros(0), np.zeros(0, np.int64))


def carried(alike: Alike, F: FloatArray) -> Alike:
    """With the filter's states carried on by F (n, n)."""
    return _off_by(alike, F.dot(alike.by.reshape(len(F), -1))) if len(alike) else alike


def measured(alike: Alike, innovation_m: FloatArray, S: FloatArray, H: FloatArray, gain: FloatArray) -> Alike:
    """After the filter took a measurement of H x, H (l, n), that no offset is in, with its innovation (l,), the covariance S
    (l, l) of that, and this gain (n, l): it tells what the filter has followed."""
    if not len(alike):
        return alike
    seen = _seen(alike, H)
    told, information = _told(alike, -seen, kalman.inverse(S), innovation_m)
    by = _taken(alike, seen, gain)
    return Alike(by, information, told, alike.probability, alike.since_ns, alike.methods)


def renewed(alike: Alike, which: slice) -> Alike:
    """With states of the filter that stand for something else from now on."""
    if not len(alike):
        return alike
    by = alike.by.copy()
    by[which] = 0.0
    return _off_by(alike, by)


def after_fix(alike: Alike, fix: Taken) -> Alike:
    """After a fix that the filter took."""
    p = believed(fix.claimed)
    own = np.array([each == fix.method for each in alike.methods], dtype=np.bool_)
    seen = _seen(alike, fix.H)
    others = 1.0 if own.all() else _spoken_for(alike, seen, fix, p)
    probability = alike.probability * np.where(own, fix.again, others)
    weight = kalman.inverse(fix.S)
    unfollowed = (UNIT[: len(weight), None, : len(weight)] - seen) * own[:, None]
    told, information = _told(alike, unfollowed, weight, fix.innovation_m)
    by = _taken(alike, seen, fix.gain) + own[:, None] * fix.gain[:, None]
    after = Alike(by, information, told, probability, alike.since_ns, alike.methods)
    if fix.again == 1.0 and bool((own & (probability >= p)).any()):
        return _likely(after)
    return _likely(_founded(after, fix, weight, p))


def _founded(alike: Alike, fix: Taken, weight: FloatArray, probability: float) -> Alike:
    """With one more, that began with a fix, of which the innovation tells with this inverse covariance (m, m)."""
    K, (n, m) = len(alike), fix.gain.shape
    by, information, told = np.empty((n, K + 1, m)), np.empty((K + 1, m, m)), np.empty((K + 1, m))
    probabilities, since_ns = np.empty(K + 1), np.empty(K + 1, np.int64)
    by[:, :K], information[:K], told[:K] = alike.by, alike.information, alike.told
    by[:, K], information[K], told[K] = fix.gain, weight, weight.dot(fix.innovation_m)
    probabilities[:K], probabilities[K] = alike.probability, probability
    since_ns[:K], since_ns[K] = alike.since_ns, fix.t_ns
    return Alike(by, information, told, probabilities, since_ns, (*alike.methods, fix.method))


def after_other(alike: Alike, position: Taken) -> Alike:
    """After a position that is no fix."""
    if not len(alike):
        return alike
    seen = _seen(alike, position.H)
    probability = alike.probability * _spoken_for(alike, seen, position, CLAIM_FLOOR)
    by = _taken(alike, seen, position.gain)
    return _likely(Alike(by, alike.information, alike.told, probability, alike.since_ns, alike.methods))


def until(alike: Alike, t_ns: int) -> Alike:
    """Those that were founded by a time: what came later is not in the filter any more."""
    return _chosen(alike, alike.since_ns <= t_ns)


def _off_by(alike: Alike, by: FloatArray) -> Alike:
    by = by.reshape(alike.by.shape)
    return Alike(by, alike.information, alike.told, alike.probability, alike.since_ns, alike.methods)


def _seen(alike: Alike, H: FloatArray) -> FloatArray:
    """(l, K, m) by how much H x, H (l, n), is off for each metre."""
    n, K, m = alike.by.shape
    seen: FloatArray = H.dot(alike.by.reshape(n, -1))
    return seen.reshape(len(H), K, m)


def _taken(alike: Alike, seen: FloatArray, gain: FloatArray) -> FloatArray:
    """(n, K, m) what each metre makes the filter be off by after it took with this gain (n, l) what of it is `seen` (l, K, m)."""
    by: FloatArray = alike.by - gain.dot(seen.reshape(len(seen), -1)).reshape(alike.by.shape)
    return by


def _told(alike: Alike, in_it: FloatArray, weight: FloatArray, innovation_m: FloatArray) -> tuple[FloatArray, FloatArray]:
    """What innovations (K, m) have told of each, and the information (K, m, m), after one (l,), of this inverse covariance (l,
    l), of which each metre makes `in_it` (l, K, m)."""
    rows, K, m = in_it.shape
    weighed = weight.dot(in_it.reshape(rows, -1))
    told = innovation_m.dot(weighed).reshape(K, m)
    told += alike.told
    products = weighed.reshape(rows, K, m, 1) * in_it[:, :, None]
    information = alike.information + products[0]
    for more in products[1:]:
        information += more
    return told, information


def _off_m(alike: Alike, seen: FloatArray) -> tuple[FloatArray, FloatArray]:
    """As Alike.off_m, of what is `seen` (l, K, m) of each metre."""
    (n_rows, K, m), information = seen.shape, alike.information
    white = np.empty((m, n_rows + 1, K))
    white[:, :n_rows], white[:, n_rows] = seen.transpose(2, 0, 1), alike.told.T
    root = np.sqrt(information[:, 0, 0])
    white[0] /= root
    if m == 2:
        along = information[:, 0, 1] / root
        white[1] -= along * white[0]
        white[1] /= np.sqrt(information[:, 1, 1] - along * along)
    rows, told = white[:, :n_rows], white[:, n_rows:]
    spread = np.empty((3, K))
    spread[:2], spread[2] = _summed(rows * rows), _summed(rows[:, 0] * rows[:, -1])
    return _summed(rows * told), spread


def _summed(terms: FloatArray) -> FloatArray:
    """The sum over the first axis, of one or two."""
    return np.asarray(terms[0] if len(terms) == 1 else terms[0] + terms[1])


def _spoken_for(alike: Alike, seen: FloatArray, z: Taken, wrong: float) -> FloatArray:
    """(K,) by how much less likely a measurement is where the filter is off by each than where it is right: at least as its own
    probability of being wrong, at most 1. Where the filter is off, it lies at minus that."""
    off_m, spread_m2 = _off_m(alike, seen)
    S = np.array((z.S[0, 0], z.S[-1, -1], z.S[0, -1]))[:, None]
    off_m += z.innovation_m[:, None]
    spread_m2 += S
    more = _surprise(off_m, spread_m2) - _surprise(z.innovation_m[:, None], S)
    more *= -0.5
    return np.minimum(np.maximum(np.exp(more, out=more), wrong, out=more), 1.0, out=more)


def _surprise(off_m: FloatArray, S: FloatArray) -> FloatArray:
    """Normalised squares (K,) of offsets (l, K), l of 1 or 2, with variances and covariance S (3, K) (Alike.off_m), with the
    logarithms of the determinants of these."""
    first_m2, last_m2, both_m2 = S
    if len(off_m) == 1:
        return np.asarray(off_m[0] ** 2 / first_m2 + np.log(first_m2))
    first, last = off_m
    along = both_m2 / first_m2
    rest_m2, rest = last_m2 - along * both_m2, last - along * first
    return np.asarray(first * first / first_m2 + rest * rest / rest_m2 + np.log(first_m2 * rest_m2))


def _likely(alike: Alike) -> Alike:
    return _chosen(alike, likeliest(alike.probability))


def _chosen(alike: Alike, keep: NDArray[np.bool_]) -> Alike:
    at, kept = keep.nonzero()[0], keep.tolist()
    if len(at) == len(kept):
        return alike
    methods = tuple(compress(alike.methods, kept))
    told, probability, since_ns = alike.told.take(at, 0), alike.probability.take(at), alike.since_ns.take(at)
    return Alike(alike.by.take(at, 1), alike.information.take(at, 0), told, probability, since_ns, methods)
