"""What if fixes have been wrong by the same offset since one of them? Then the filter that follows them is off by that offset.

Over the same ground a wrong match is found again, with the same offset (votes.py). No solution that leaves these fixes out is
needed to say where the vehicle is then: the filter's place moves as the vehicle does, and is off by what the first few of them
moved it. So each fix over other ground founds one offset, known as well as the filter's place was before it, with the probability
that it was wrong. The next fixes of its method say nothing against it over the same ground, and little while the vehicle goes on.
A fix of another method speaks for or against it by where it lies, but is itself wrong with a probability of its own. What errs
each in its own way is left to separation.py.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from visloc_companion.core.filter.separation import CLAIM_FLOOR, believed, likeliest
from visloc_companion.types import FloatArray

SETTLES = 6
"""After so many fixes over the same ground a filter has followed them; what it corrects later is its own drift."""


@dataclass(frozen=True, slots=True, eq=False)
class Alike:
    """K offsets (filter minus truth): means (K, m) and covariances (K, m, m) in metres, their probabilities (K,), when they were
    founded (K,), by how many fixes each was moved (K,), and the methods whose fixes they are."""

    off_m: FloatArray
    cov_m2: FloatArray
    probability: FloatArray
    since_ns: NDArray[np.int64]
    n_fixes: NDArray[np.int64]
    methods: tuple[str, ...] = ()

    def __len__(self) -> int:
        return len(self.methods)


class Taken(NamedTuple):
    """A fix that the filter took: its time, method, claim of being wrong, and the probability that it errs with the last one of
    its method; how far it lay from the filter (m,) and the covariance (m, m) of that; by what it moved the filter (m,), and the
    covariance (m, m) of the filter's place before."""

    t_ns: int
    method: str
    claimed: float
    again: float
    off_m: FloatArray
    S: FloatArray
    moved_m: FloatArray
    P: FloatArray


NONE = Alike(np.zeros((0, 2)), np.zeros((0, 2, 2)), np.zeros(0), np.zeros(0, np.int64), np.zeros(0, np.int64))


def after_fix(alike: Alike, fix: Taken) -> Alike:
    """After a fix that the filter took."""
    p = believed(fix.claimed)
    own = np.array([each == fix.method for each in alike.methods], dtype=np.bool_)
    others = 1.0 if own.all() else _spoken_for(alike, fix.off_m, fix.S, p)
    probability = alike.probability * np.where(own, fix.again, others)
    moved = own & (alike.n_fixes < SETTLES)
    off_m, n_fixes = alike.off_m + moved[:, None] * fix.moved_m, alike.n_fixes + moved
    if fix.again == 1.0 and bool((own & (probability >= p)).any()):
        return _likely(Alike(off_m, alike.cov_m2, probability, alike.since_ns, n_fixes, alike.methods))
    founded = Alike(
        np.concatenate([off_m, fix.moved_m[None]]),
        np.concatenate([alike.cov_m2, fix.P[None]]),
        np.concatenate([probability, (p,)]),
        np.concatenate([alike.since_ns, np.array([fix.t_ns], np.int64)]),
        np.concatenate([n_fixes, np.ones(1, np.int64)]),
        (*alike.methods, fix.method),
    )
    return _likely(founded)


def after_other(alike: Alike, off_m: FloatArray, S: FloatArray) -> Alike:
    """After a position that is no fix, which lay `off_m` (m,) from the filter, S (m, m) the covariance of that."""
    if not len(alike):
        return alike
    return _likely(replace(alike, probability=alike.probability * _spoken_for(alike, off_m, S, CLAIM_FLOOR)))


def until(alike: Alike, t_ns: int) -> Alike:
    """Those that were founded by a time: what came later is not in the filter any more."""
    return _chosen(alike, alike.since_ns <= t_ns)


def _spoken_for(alike: Alike, off_m: FloatArray, S: FloatArray, wrong: float) -> FloatArray:
    """(K,) by how much less likely a measurement is where the filter is off by each than where it is right: at least as its own
    probability of being wrong, at most 1. Where the filter is off, it lies at minus that."""
    there, det_there = _squared(off_m + alike.off_m, S + alike.cov_m2)
    here, det_here = _squared(off_m[None], S[None])
    ratio = np.exp((here - there) / 2) * np.sqrt(det_here / det_there)
    return np.asarray(np.minimum(np.maximum(ratio, wrong), 1.0))


def _squared(off_m: FloatArray, S: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Normalised squares (K,) of offsets (K, m) with covariances S (K, m, m), m of 1 or 2, and the determinants (K,) of these."""
    if off_m.shape[1] == 1:
        return off_m[:, 0] ** 2 / S[:, 0, 0], S[:, 0, 0]
    (a, b), aa, ab, bb = off_m.T, S[:, 0, 0], S[:, 0, 1], S[:, 1, 1]
    det = aa * bb - ab * ab
    return (bb * a * a - 2 * ab * a * b + aa * b * b) / det, det


def _likely(alike: Alike) -> Alike:
    return _chosen(alike, likeliest(alike.probability))


def _chosen(alike: Alike, keep: NDArray[np.bool_]) -> Alike:
    if keep.all():
        return alike
    methods = tuple(each for each, kept in zip(alike.methods, keep.tolist(), strict=True) if kept)
    return Alike(
        alike.off_m[keep], alike.cov_m2[keep], alike.probability[keep], alike.since_ns[keep], alike.n_fixes[keep], methods
    )
