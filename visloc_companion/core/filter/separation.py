"""Solutions that leave fixes out: where the vehicle would be if the last fixes were wrong matches, and how probable that is.

Solution separation (Brown & McBurney, "Self-contained GPS integrity check using maximum solution separation", 1988; Blanch et
al., "Baseline advanced RAIM user algorithm and possible improvements", 2015) over time and over votes. Every fix that the filter
takes founds up to three solutions that do without it:

* one takes no fix from then on (`EVERY`): the last n fixes are wrong, whatever gave them;
* one takes those of other methods only (the method's name): one vote is wrong for a while, the others are right;
* one takes all later fixes (`ONE`): that single fix was wrong.

`HELD` is none of them: it takes all fixes, and is what a trusted GNSS would have the filter be (by_gnss.py).

The first fix of a method is wrong with the probability that it claims, but no claim is believed below CLAIM_FLOOR. A later one
of the same method is wrong, too, with a probability of at least CORRELATION; another method fails for other reasons. What is
wrong by the same offset as long as the same ground is in view: alike.py. integrity.py makes the protection level of both.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import compress
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from visloc_companion.core.filter.propagation import ACCELERATION, H_POSITION, HEADING, N_STATES, POSITION, VELOCITY, Step
from visloc_companion.types import FloatArray

EVERY: Final = "*"
ONE: Final = ""
HELD: Final = "gnss"
CLAIM_FLOOR = 1e-3
"""1 of 974 accepted fixes of unseen ground was a wrong match (0 of 3,115 later): claims below that are not proven."""
CORRELATION = 0.5
"""Probability that the next fix of a method errs, too, in whatever way: an assumption, stated in docs/safety.md."""
NEGLIGIBLE = 1e-8
MAX_SOLUTIONS = 40
MERGED_SIGMA, MERGED_VARIANCE = 0.1, 1.1
"""A `ONE` that is nearer to the filter than this share of its sigma, with hardly more variance, says what the filter says."""


class Way(NamedTuple):
    """From when covariances P (K, 17, 17) were those of K solutions until now: F P F' + Q, all (17, 17), and `own` (3, K), what
    each has beyond that by its velocity's error (propagation.Step); None where none has. `near` (K, 49): of P that of the states
    by which the position goes on, which is asked for more often than all."""

    F: FloatArray
    Q: FloatArray
    own: FloatArray | None
    near: FloatArray

    def on(self, step: Step, Q: FloatArray, more_m2ps2: FloatArray | None) -> Way:
        """One step further, with noise Q (17, 17), and more variance (K,) of the velocity's error than that has."""
        own = None if self.own is None else step.own.dot(self.own)
        if more_m2ps2 is not None:
            more = step.own_more * more_m2ps2
            if own is not None:
                more += own
            own = more
        F = step.F
        noise = F.dot(self.Q).dot(F.T)
        noise += Q
        return Way(F.dot(self.F), noise, own, self.near)

    def gone(self, P: FloatArray) -> FloatArray:
        """The covariances now (K, 17, 17)."""
        after = _times(self.F @ P, np.ascontiguousarray(self.F.T))  # as it lies in memory F.T would take twice the time
        after += self.Q if self.own is None else (self.own.T.dot(OWN) + self.Q.ravel()).reshape(P.shape)
        return after

    def position_m2(self) -> FloatArray:
        """The position's part of the covariances now (4, K), row by row."""
        rows = self.F[POSITION].take(MOVING, 1)
        weights = rows[:, None, :, None] * rows[:, None, :]
        after: FloatArray = weights.reshape(4, -1).dot(self.near.T)
        after += self.Q[POSITION, POSITION].reshape(4, 1)
        if self.own is not None:
            after[::3] += self.own[0]
        return after


def _of_own() -> FloatArray:
    """(3, 225) where in a covariance the rows of Way.own have their places, on both axes."""
    where = np.zeros((3, N_STATES, N_STATES))
    for axis in range(2):
        p, v = POSITION.start + axis, VELOCITY.start + axis
        where[0, p, p] = where[1, p, v] = where[1, v, p] = where[2, v, v] = 1.0
    return where.reshape(3, -1)


OWN = _of_own()
MOVING = np.array([0, 1, *range(VELOCITY.start, ACCELERATION.stop), HEADING])
"""States by which the position goes on: itself, the errors of velocity, acceleration and heading."""
NEAR = (N_STATES * MOVING[:, None] + MOVING).ravel()


@dataclass(frozen=True, slots=True, eq=False)
class Solutions:
    """K solutions: means (K, n), covariances (K, n, n) of a filter's state, their probabilities (K,), and the time (K,) of the
    last fix that each rests on. `leaves`: what each goes on to leave out; `left`: the methods of what it left out.

    Those of the position filter are propagated far more often than their covariances are asked for: `then` are the covariances
    from which a `way` leads to now.
    """

    x: FloatArray
    then: FloatArray
    probability: FloatArray
    rested_ns: NDArray[np.int64]
    leaves: tuple[str, ...] = ()
    left: tuple[frozenset[str], ...] = ()
    way: Way | None = None

    def __len__(self) -> int:
        return len(self.leaves)

    @property
    def P(self) -> FloatArray:
        """Covariances (K, n, n), computed anew each time."""
        return self.then if self.way is None else self.way.gone(self.then)

    @property
    def position_m2(self) -> FloatArray:
        """The covariances of the first two states, the position (4, K), row by row."""
        if self.way is not None:
            return self.way.position_m2()
        return self.then[:, POSITION, POSITION].reshape(-1, 4).T


NONE = Solutions(np.zeros((0, N_STATES)), np.zeros((0, N_STATES, N_STATES)), np.zeros(0), np.zeros(0, np.int64))


def propagated(solutions: Solutions, step: Step, Q: FloatArray, more_m2ps2: FloatArray | None, moved: FloatArray) -> Solutions:
    """All solutions through x -> F x + moved (17,), with noise Q (17, 17) and more variance (K,) of the velocity's error."""
    x = solutions.x.dot(step.F.T)
    x += moved
    if solutions.way is not None:
        return _moved(solutions, x, solutions.then, solutions.way.on(step, Q, more_m2ps2))
    own = None if more_m2ps2 is None else step.own_more * more_m2ps2
    near = solutions.then.reshape(len(x), -1).take(NEAR, 1)
    return _moved(solutions, x, solutions.then, Way(step.F, Q, own, near))


def carried(solutions: Solutions, F: FloatArray, Q: FloatArray) -> Solutions:
    """All of them through x -> F x with noise Q, (17, 17), of states by which no position goes on."""
    if not len(solutions):
        return solutions
    x, way = solutions.x.dot(F.T), solutions.way
    if way is None:
        return _moved(solutions, x, F @ solutions.then @ F.T + Q)
    return _moved(solutions, x, solutions.then, way._replace(F=F.dot(way.F), Q=F.dot(way.Q).dot(F.T) + Q))


def widened(solutions: Solutions, more: FloatArray) -> Solutions:
    """With a covariance (17, 17) added to each."""
    if not len(solutions):
        return solutions
    way = solutions.way
    if way is None:
        return _moved(solutions, solutions.x, solutions.then + more)
    return _moved(solutions, solutions.x, solutions.then, way._replace(Q=way.Q + more))


def renewed(x: FloatArray, P: FloatArray, which: slice, variance: float) -> tuple[FloatArray, FloatArray]:
    """Means (..., 15) and covariances (..., 17, 17) with two states set to zero, of this variance and independent of the rest."""
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
    """With a measurement z (m,), R (m, m) of H x, H (m, n), m of 1 or 2, taken by some of them (K,), no gate.

    The last `n_considered` states keep mean and variance (kalman.update). `t_ns`: of a fix that they rest on from now on.
    """
    at = take.nonzero()[0]
    if not len(at):
        return solutions
    x, P = solutions.x.copy(), solutions.then.copy() if solutions.way is None else solutions.P
    if len(at) == len(take):
        _update(x, P, z, R, H, n_considered)
    else:  # those that leave a fix out are most of them
        some_x, some_P = x.take(at, 0), P.take(at, 0)
        _update(some_x, some_P, z, R, H, n_considered)
        x[at], P[at] = some_x, some_P
    rested = solutions.rested_ns if t_ns is None else np.where(take, t_ns, solutions.rested_ns)
    return Solutions(x, P, solutions.probability, rested, solutions.leaves, solutions.left)


def _update(x: FloatArray, P: FloatArray, z: FloatArray, R: FloatArray, H: FloatArray, n_considered: int) -> None:
    """Means (K, n) and covariances (K, n, n) with the measurement, in place.

    The innovations' covariances S are products of triangles, U' U (Cholesky). With V = U'^-1 H P, an update by the gain P H' S^-1
    makes them x + V' U'^-1 (z - H x) and P - V' V; what is only considered keeps its mean, and its rows among themselves.
    """
    (K, n), m = x.shape, len(z)
    learned = n - n_considered
    V, white = H.dot(P.reshape(-1, n).T).reshape(m, K, n), (z - x.dot(H.T)).T
    S = V.reshape(-1, n).dot(H.T).reshape(m, K, m)
    root = np.sqrt(S[0, :, 0] + R[0, 0])
    V[0] /= root[:, None]
    white[0] /= root
    if m == 2:
        along = (S[0, :, 1] + R[0, 1]) / root
        root = np.sqrt(S[1, :, 1] + R[1, 1] - along * along)
        V[1] -= along[:, None] * V[0]
        V[1] /= root[:, None]
        white[1] -= along * white[0]
        white[1] /= root
    V_learned = V[:, :, :learned]
    for moved in V_learned * white[:, :, None]:
        x[:, :learned] += moved
    P[:, :learned] -= np.ascontiguousarray(V_learned.transpose(1, 2, 0)) @ np.ascontiguousarray(V.transpose(1, 0, 2))
    P[:, learned:, :learned] = P[:, :learned, learned:].transpose(0, 2, 1)


def _times(P: FloatArray, A: FloatArray) -> FloatArray:
    """P (K, l, n) @ A (n, m) as one product of matrices: far cheaper than K small ones."""
    product: FloatArray = P.reshape(-1, P.shape[2]).dot(A)
    return product.reshape(*P.shape[:2], A.shape[1])


def _moved(solutions: Solutions, x: FloatArray, then: FloatArray, way: Way | None = None) -> Solutions:
    return Solutions(x, then, solutions.probability, solutions.rested_ns, solutions.leaves, solutions.left, way)


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
    leaving, again, known = _leave(solutions, method), max(p, CORRELATION), {method}
    factor = [
        1.0 if not leaves_it else again if method in left else p for leaves_it, left in zip(leaving, solutions.left, strict=True)
    ]
    left = tuple(
        [
            left | known if leaves_it and method not in left else left
            for leaves_it, left in zip(leaving, solutions.left, strict=True)
        ]
    )
    kinds = (EVERY, method, ONE) if among - known else (EVERY, ONE)
    less = Solutions(solutions.x, solutions.P, solutions.probability * factor, solutions.rested_ns, solutions.leaves, left)
    return _beside(less, before, kinds, p, frozenset(known), likely=True)


def beside(
    solutions: Solutions,
    state: tuple[FloatArray, FloatArray, int],
    kinds: tuple[str, ...],
    probability: float,
    left: frozenset[str],
) -> Solutions:
    """With one more for each kind (what it goes on to leave out), all with the same mean, covariance and time of the last fix
    (`state`), probability, and methods of what they left out."""
    return _beside(solutions, state, kinds, probability, left, likely=False)


def _beside(
    solutions: Solutions,
    state: tuple[FloatArray, FloatArray, int],
    kinds: tuple[str, ...],
    probability: float,
    left: frozenset[str],
    *,
    likely: bool,
) -> Solutions:
    """As `beside`; of all, those before and the new ones, only the `likely` ones."""
    (x, P, rested_ns), K = state, len(solutions)
    all_probability, all_rested_ns = np.empty(K + len(kinds)), np.empty(K + len(kinds), np.int64)
    all_probability[:K], all_probability[K:] = solutions.probability, probability
    all_rested_ns[:K], all_rested_ns[K:] = solutions.rested_ns, rested_ns
    all_leaves, all_left = (*solutions.leaves, *kinds), (*solutions.left, *[left] * len(kinds))
    keep = likeliest(all_probability) if likely else np.ones(len(all_leaves), np.bool_)
    at, kept = keep.nonzero()[0], keep.tolist()
    old, n_old = at[at < K], sum(kept[:K])
    all_x, all_P = np.empty((len(at), *x.shape)), np.empty((len(at), *P.shape))
    solutions.x.take(old, 0, all_x[:n_old], "clip")  # straight to its place; none is out of range
    solutions.P.take(old, 0, all_P[:n_old], "clip")
    all_x[n_old:], all_P[n_old:] = x, P
    left_by_each = tuple(compress(all_left, kept))
    return Solutions(all_x, all_P, all_probability[keep], all_rested_ns[keep], tuple(compress(all_leaves, kept)), left_by_each)


def leaving_out(solutions: Solutions, method: str) -> NDArray[np.bool_]:
    """(K,) which of them leave a fix of a method out."""
    return np.array(_leave(solutions, method), dtype=np.bool_)


def _leave(solutions: Solutions, method: str) -> list[bool]:
    which = (EVERY, method)
    return [leaves in which for leaves in solutions.leaves]


def likeliest(probability: FloatArray) -> NDArray[np.bool_]:
    """(K,) which of them are not negligible, at most the MAX_SOLUTIONS most probable ones."""
    keep = probability >= NEGLIGIBLE
    if np.count_nonzero(keep) > MAX_SOLUTIONS:
        keep[np.argsort(-probability, kind="stable")[MAX_SOLUTIONS:]] = False
    return keep


def apart(solutions: Solutions, x: FloatArray, P: FloatArray, H: FloatArray = H_POSITION) -> Solutions:
    """Without each `ONE` that says no more of H x, H (m, n), than the filter itself, x (n,) and P (n, n), does."""
    ones = np.array([k for k, leaves in enumerate(solutions.leaves) if leaves == ONE], np.intp)
    if not len(ones):
        return solutions
    weights = H.T.dot(H).ravel()  # the trace of H P H' is the sum of P with these
    variance = float(weights.dot(P.ravel()))
    off = (solutions.x.take(ones, 0) - x).dot(H.T)
    near = ones[np.add.reduce(off * off, 1) < MERGED_SIGMA**2 * variance]
    if not len(near):
        return solutions
    same = solutions.P.take(near, 0).reshape(len(near), -1).dot(weights) < MERGED_VARIANCE * variance
    keep = np.ones(len(solutions), np.bool_)
    keep[near] = ~same
    return chosen(solutions, keep)


def chosen(solutions: Solutions, keep: NDArray[np.bool_]) -> Solutions:
    """Some of them (K,)."""
    at, kept = keep.nonzero()[0], keep.tolist()
    if len(at) == len(kept):
        return solutions
    return Solutions(
        solutions.x.take(at, 0),
        solutions.P.take(at, 0),
        solutions.probability.take(at),
        solutions.rested_ns.take(at),
        tuple(compress(solutions.leaves, kept)),
        tuple(compress(solutions.left, kept)),
    )
