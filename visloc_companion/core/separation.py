"""Solutions that leave fixes out: where the vehicle would be if the last fixes were wrong matches, and how probable that is.

Solution separation (Brown & McBurney, "Self-contained GPS integrity check using maximum solution separation", 1988; Blanch et
al., "Baseline advanced RAIM user algorithm and possible improvements", 2015) over time and over votes. Every fix that the filter
takes founds up to three solutions that do without it:

* one takes no fix from then on (`EVERY`): the last n fixes are wrong, whatever gave them;
* one takes those of other methods only (the method's name): one vote is wrong for a while, the others are right;
* one takes all later fixes (`ONE`): that single fix was wrong.

The first fix of a method is wrong with the probability that it claims, but no claim is believed below CLAIM_FLOOR. A later one
of the same method is wrong, too, with a probability of at least CORRELATION; another method fails for other reasons. What is
wrong by the same offset as long as the same ground is in view: alike.py. integrity.py makes the protection level of both.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import compress
from typing import Final

import numpy as np
from numpy.typing import NDArray

from visloc_companion.core.propagation import H_POSITION, N_STATES, POSITION
from visloc_companion.types import FloatArray

EVERY: Final = "*"
ONE: Final = ""
CLAIM_FLOOR = 1e-3
"""1 of 974 accepted fixes of unseen ground was a wrong match (0 of 3,115 later): claims below that are not proven."""
CORRELATION = 0.5
"""Probability that the next fix of a method errs, too, in whatever way: an assumption, stated in docs/safety.md."""
NEGLIGIBLE = 1e-8
MAX_SOLUTIONS = 40
MERGED_SIGMA, MERGED_VARIANCE = 0.1, 1.1
"""A `ONE` that is nearer to the filter than this share of its sigma, with hardly more variance, says what the filter says."""


@dataclass(frozen=True, slots=True, eq=False)
class Solutions:
    """K solutions: means (K, n), covariances (K, n, n) of a filter's state, their probabilities (K,), and the time (K,) of the
    last fix that each rests on. `leaves`: what each goes on to leave out; `left`: the methods of what it left out."""

    x: FloatArray
    P: FloatArray
    probability: FloatArray
    rested_ns: NDArray[np.int64]
    leaves: tuple[str, ...] = ()
    left: tuple[frozenset[str], ...] = ()

    def __len__(self) -> int:
        return len(self.leaves)


NONE = Solutions(np.zeros((0, N_STATES)), np.zeros((0, N_STATES, N_STATES)), np.zeros(0), np.zeros(0, np.int64))


def propagated(solutions: Solutions, F: FloatArray, Q: FloatArray, step: FloatArray) -> Solutions:
    """All solutions through x -> F x + step with process noise Q (K, 15, 15)."""
    if not len(solutions):
        return solutions
    F_T = np.ascontiguousarray(F.T)  # as it lies in memory F.T would take twice the time
    P = _times(F @ solutions.P, F_T)
    P += Q
    return _moved(solutions, solutions.x @ F_T + step, P)


def widened(solutions: Solutions, more: FloatArray) -> Solutions:
    """With a covariance (15, 15) added to each."""
    return _moved(solutions, solutions.x, solutions.P + more) if len(solutions) else solutions


def renewed(x: FloatArray, P: FloatArray, which: slice, variance: float) -> tuple[FloatArray, FloatArray]:
    """Means (..., 15) and covariances (..., 15, 15) with two states set to zero, of this variance and independent of the rest."""
    x, P = x.copy(), P.copy()
    x[..., which] = 0.0
    P[..., which, :] = P[..., :, which] = 0.0
    P[..., which, which] = variance * np.eye(2)
    return x, P


def shifted(solutions: Solutions, shift_ne_m: FloatArray) -> Solutions:
    """With positions (2,) moved, as an origin is."""
    if not len(solutions):
        return solutions
    x = solutions.x.copy()
    x[:, POSITION] += shift_ne_m
    return replace(solutions, x=x)


def updated(
    solutions: Solutions,
    z: FloatArray,
    R: FloatArray,
    H: FloatArray,
    *,
    take: NDArray[np.bool_],
    n_considered: int,
    t_ns: int | None = None,
) -> Solutions:
    """With a measurement z (m,), R (m, m) of H x, H (m, n), taken by some of them (K,), Joseph's form, no gate.

    The last `n_considered` states keep mean and variance (kalman.update). `t_ns`: of a fix that they rest on from now on.
    """
    at = take.nonzero()[0]
    if not len(at):
        return solutions
    if len(at) == len(take):
        x, P = _updated(solutions.x, solutions.P, z, R, H, n_considered)
    else:  # those that leave a fix out are most of them
        x, P = solutions.x.copy(), solutions.P.copy()
        x[at], P[at] = _updated(x.take(at, 0), P.take(at, 0), z, R, H, n_considered)
    rested = solutions.rested_ns if t_ns is None else np.where(take, t_ns, solutions.rested_ns)
    return Solutions(x, P, solutions.probability, rested, solutions.leaves, solutions.left)


def _updated(
    x: FloatArray, P: FloatArray, z: FloatArray, R: FloatArray, H: FloatArray, n_considered: int
) -> tuple[FloatArray, FloatArray]:
    PHt = _times(P, H.T)
    gain = PHt @ np.linalg.inv(H @ PHt + R)
    if n_considered:
        gain[:, H.shape[1] - n_considered :] = 0.0
    gain_T, innovation = gain.transpose(0, 2, 1), z - x @ H.T
    left = P - gain @ PHt.transpose(0, 2, 1)  # (I - K H) P
    left += (gain @ R - _times(left, H.T)) @ gain_T  # times (I - K H)', and K R K'
    symmetric = left + left.transpose(0, 2, 1)
    symmetric /= 2
    return x + (gain @ innovation[:, :, None])[:, :, 0], symmetric


def _times(P: FloatArray, A: FloatArray) -> FloatArray:
    """P (K, n, n) @ A (n, m) as one product of matrices: far cheaper than K small ones."""
    n = P.shape[1]
    return (P.reshape(-1, n) @ A).reshape(len(P), n, A.shape[1])


def _moved(solutions: Solutions, x: FloatArray, P: FloatArray) -> Solutions:
    return Solutions(x, P, solutions.probability, solutions.rested_ns, solutions.leaves, solutions.left)


def believed(claimed: float) -> float:
    """The probability of being wrong that is believed of a fix that claims one."""
    return min(1.0, max(claimed, CLAIM_FLOOR))


def without_fix(
    solutions: Solutions, method: str, claimed: float, before: tuple[FloatArray, FloatArray, int], among: frozenset[str]
) -> Solutions:
    """After a fix that the filter took: those that leave it out are less probable for it, and new ones are founded.

    `before`: mean, covariance of the filter before the fix, and the time of the last fix that it rested on. `among`: methods of
    the filter's recent fixes; a vote of its own is left out only where there is another.
    """
    p = believed(claimed)
    leaving = leaving_out(solutions, method)
    factor = [
        1.0 if not leaves_it else max(p, CORRELATION) if method in left else p
        for leaves_it, left in zip(leaving, solutions.left, strict=True)
    ]
    left = tuple(left | {method} if leaves_it else left for leaves_it, left in zip(leaving, solutions.left, strict=True))
    kinds = (EVERY, method, ONE) if among - {method} else (EVERY, ONE)
    less = Solutions(solutions.x, solutions.P, solutions.probability * factor, solutions.rested_ns, solutions.leaves, left)
    return likely(beside(less, before, kinds, p, frozenset({method})))


def beside(
    solutions: Solutions,
    state: tuple[FloatArray, FloatArray, int],
    kinds: tuple[str, ...],
    probability: float,
    left: frozenset[str],
) -> Solutions:
    """With one more for each kind (what it goes on to leave out), all with the same mean, covariance and time of the last fix
    (`state`), probability, and methods of what they left out."""
    x, P, rested_ns = state
    n = len(kinds)
    return Solutions(
        np.concatenate([solutions.x, *[x[None]] * n]),
        np.concatenate([solutions.P, *[P[None]] * n]),
        np.concatenate([solutions.probability, np.full(n, probability)]),
        np.concatenate([solutions.rested_ns, np.full(n, rested_ns, np.int64)]),
        (*solutions.leaves, *kinds),
        (*solutions.left, *([left] * n)),
    )


def leaving_out(solutions: Solutions, method: str) -> NDArray[np.bool_]:
    """(K,) which of them leave a fix of a method out."""
    return np.array([leaves in (EVERY, method) for leaves in solutions.leaves], dtype=np.bool_)


def likely(solutions: Solutions) -> Solutions:
    """Without those of negligible probability, and never more than MAX_SOLUTIONS: the most probable ones."""
    return chosen(solutions, likeliest(solutions.probability))


def likeliest(probability: FloatArray) -> NDArray[np.bool_]:
    """(K,) which of them are not negligible, at most the MAX_SOLUTIONS most probable ones."""
    keep = probability >= NEGLIGIBLE
    if int(keep.sum()) > MAX_SOLUTIONS:
        keep[np.argsort(-probability, kind="stable")[MAX_SOLUTIONS:]] = False
    return keep


def apart(solutions: Solutions, x: FloatArray, P: FloatArray, H: FloatArray = H_POSITION) -> Solutions:
    """Without each `ONE` that says no more of H x, H (m, n), than the filter itself, x (n,) and P (n, n), does."""
    ones = np.array([k for k, leaves in enumerate(solutions.leaves) if leaves == ONE], np.intp)
    if not len(ones):
        return solutions
    variance = float((H @ P @ H.T).trace())
    near = ones[np.square((solutions.x.take(ones, 0) - x) @ H.T).sum(1) < MERGED_SIGMA**2 * variance]
    if not len(near):
        return solutions
    same = (H @ solutions.P.take(near, 0) * H).sum((1, 2)) < MERGED_VARIANCE * variance
    keep = np.ones(len(solutions), np.bool_)
    keep[near] = ~same
    return chosen(solutions, keep)


def chosen(solutions: Solutions, keep: NDArray[np.bool_]) -> Solutions:
    """Some of them (K,)."""
    if keep.all():
        return solutions
    at, kept = np.flatnonzero(keep), keep.tolist()
    return Solutions(
        solutions.x.take(at, 0),
        solutions.P.take(at, 0),
        solutions.probability.take(at),
        solutions.rested_ns.take(at),
        tuple(compress(solutions.leaves, kept)),
        tuple(compress(solutions.left, kept)),
    )
