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

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from visloc_companion.core.filter.separation import CLAIM_FLOOR, believed, inverses, likeliest
from visloc_companion.types import FloatArray


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
        """By how much H x, H (m, n), is off, mean (K, m), and the covariance (K, m, m) of that beside the filter's own."""
        by = _seen(self, H)
        spread = by @ inverses(self.information)
        return (spread @ self.told[:, :, None])[:, :, 0], spread @ by.transpose(0, 2, 1)


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


def held(alike: Alike, H: FloatArray, gain: FloatArray) -> Alike:
    """After the filter took with this gain (n, l) a measurement of H x, H (l, n), that is not off by any of them."""
    if not len(alike):
        return alike
    by = alike.by.reshape(len(gain), -1)
    return _off_by(alike, by - gain.dot(H.dot(by)))


def measured(alike: Alike, innovation_m: FloatArray, S: FloatArray, H: FloatArray, gain: FloatArray) -> Alike:
    """After the filter took a measurement of H x, H (l, n), that no offset is in, with its innovation (l,), the covariance S
    (l, l) of that, and this gain (n, l): it tells what the filter has followed."""
    if not len(alike):
        return alike
    seen = _seen(alike, H)
    weighed = -seen.transpose(0, 2, 1) @ inverses(S[None])[0]
    after = held(alike, H, gain)
    return replace(after, information=alike.information - weighed @ seen, told=alike.told + weighed @ innovation_m)


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
    others = 1.0 if own.all() else _spoken_for(alike, fix, p)
    probability = alike.probability * np.where(own, fix.again, others)
    weight, after = inverses(fix.S[None])[0], held(alike, fix.H, fix.gain)
    unfollowed = (np.eye(len(weight)) - _seen(alike, fix.H)) * own[:, None, None]
    weighed = unfollowed.transpose(0, 2, 1) @ weight
    by, information = after.by + own[:, None] * fix.gain[:, None], alike.information + weighed @ unfollowed
    told = alike.told + weighed @ fix.innovation_m
    after = Alike(by, information, told, probability, alike.since_ns, alike.methods)
    if fix.again == 1.0 and bool((own & (probability >= p)).any()):
        return _likely(after)
    founded = Alike(
        np.concatenate([by, fix.gain[:, None]], 1),
        np.concatenate([information, weight[None]]),
        np.concatenate([told, (weight @ fix.innovation_m)[None]]),
        np.concatenate([probability, (p,)]),
        np.concatenate([alike.since_ns, np.array([fix.t_ns], np.int64)]),
        (*alike.methods, fix.method),
    )
    return _likely(founded)


def after_other(alike: Alike, position: Taken) -> Alike:
    """After a position that is no fix."""
    if not len(alike):
        return alike
    probability = alike.probability * _spoken_for(alike, position, CLAIM_FLOOR)
    return _likely(replace(held(alike, position.H, position.gain), probability=probability))


def until(alike: Alike, t_ns: int) -> Alike:
    """Those that were founded by a time: what came later is not in the filter any more."""
    return _chosen(alike, alike.since_ns <= t_ns)


def _off_by(alike: Alike, by: FloatArray) -> Alike:
    by = by.reshape(alike.by.shape)
    return Alike(by, alike.information, alike.told, alike.probability, alike.since_ns, alike.methods)


def _seen(alike: Alike, H: FloatArray) -> FloatArray:
    """(K, l, m) by how much H x, H (l, n), is off for each metre."""
    n, K, m = alike.by.shape
    return np.asarray(H.dot(alike.by.reshape(n, -1)).reshape(len(H), K, m).transpose(1, 0, 2))


def _spoken_for(alike: Alike, z: Taken, wrong: float) -> FloatArray:
    """(K,) by how much less likely a measurement is where the filter is off by each than where it is right: at least as its own
    probability of being wrong, at most 1. Where the filter is off, it lies at minus that."""
    off_m, spread_m2 = alike.off_m(z.H)
    there, det_there = _squared(z.innovation_m + off_m, z.S + spread_m2)
    here, det_here = _squared(z.innovation_m[None], z.S[None])
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
    since_ns = alike.since_ns[keep]
    return Alike(alike.by[:, keep], alike.information[keep], alike.told[keep], alike.probability[keep], since_ns, methods)
