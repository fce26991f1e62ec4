"""The position to a fraction of a cell: maximum likelihood of the one-sided mixture over position, height and what is uncertain.

Unknowns (10,): north, east, height offset, heading, and to the north and east each: tilt of the soundings, velocity and
acceleration error of the dead reckoning; all but the first three have the prior's Gaussian. Fisher scoring: the gradient is that
of the full mixture, the Hessian that of the points that are ground. The covariance is the cluster-robust one (White 1980; Liang &
Zeger 1986),

    A^-1 (sum over blocks g g') A^-1,

for errors of the model and crowns are alike over a block of ground: soundings beside each other do not count twice. The blocks
of a stretch are few, and a fit takes up what is alike over all of it: to their share comes, in full, what the errors that a model
is expected to have leave (correlation.py), of the size that is stated for it and no smaller one that the residuals pretend.

What is found so is judged, and settled under these errors themselves (settle.py).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree  # type: ignore[import-untyped]

from visloc_companion.localise.terrain.base import Kind, Soundings, TerrainPrior
from visloc_companion.localise.terrain.cells import Cells
from visloc_companion.localise.terrain.correlation import correlated_outer
from visloc_companion.localise.terrain.elevation import Terrain
from visloc_companion.localise.terrain.noise import HeightNoise, Parts, Stated, parts, refitted, told
from visloc_companion.localise.terrain.walked import Walked, walked
from visloc_companion.localise.terrain.whitening import Walk, Whitening, whitening
from visloc_companion.types import FloatArray

N_UNKNOWNS = 10
ROUNDS = 40
STEP_CELLS = 1.0
"""Longest step, cells of the window."""
DONE_M = 0.2
LEAST_GROUND = 0.05
"""Weight that a sounding keeps in the Hessian."""
SIGMA_BOUNDS = (0.5, 2.5)
"""Of the refitted sigma, as a multiple of the expected one."""
UNRESOLVED = 0.3
"""Share of the model's variance that is alike over no length (a cell of cells.py): what its own cells do not hold."""
STATED = 6.0
"""So many independent soundings the stated sigma counts as: itself it is known to 30 % (1 / sqrt(2 x 6))."""


@dataclass(frozen=True, slots=True, eq=False)
class Refined:
    """`unknowns` (10,) with covariance (10, 10); `log_likelihood` (of independent soundings, the unknowns' own
    included) and its `gain` on that of level ground; `ground` and `known`: share of soundings that are ground, and that lie on
    known model; `reliability` as `reliable_share`; the covariance's height is that of the mean over the soundings, which `walked`
    carries to a time. `by_drift` (2, 4): of the position by errors of the prior's drift, as in `TerrainFix`;
    `counted_alike_m2` (2, 2): what the position claims where soundings count alike, by which it is judged.
    """

    unknowns: FloatArray
    covariance: FloatArray
    noise: HeightNoise
    log_likelihood: float
    gain: float
    ground: float
    known: float
    reliability: float
    walked: Walked
    by_drift: FloatArray
    converged: bool
    counted_alike_m2: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Fitting:
    """What the fit is of: `block_m` is the side of a block, `temper` the share of soundings that is independent, `false_slope`
    the slope (metres a metre, per axis, 1-sigma) that the model's errors pretend; `cells` share them."""

    terrain: Terrain
    soundings: Soundings
    prior: TerrainPrior
    noise: HeightNoise
    block_m: float
    temper: float
    false_slope: float
    cells: Cells

    @property
    def few(self) -> float:
        """What linear propagation has too little of the variance: the unknowns are as many as some of the soundings that are
        independent of each other, so that they follow errors as well as ground (a beam: ten and twenty)."""
        return 1 + N_UNKNOWNS / max(self.temper * len(self.soundings.points_m), 1.0)

    @property
    def walk_m2_per_s(self) -> float:
        """What the navigation height walks along a line. Over a patch all soundings tell its mean: it takes seconds."""
        return self.prior.sigma_h_walk**2 if self.soundings.kind is Kind.PROFILE else 0.0


def refine(fitting: Fitting, start: FloatArray) -> Refined:
    """The likeliest unknowns near a start (10,)."""
    unknowns, noise = start.copy(), fitting.noise
    weight = prior_information(fitting.prior)
    converged = False
    for turn in range(ROUNDS):
        difference, J, known = linearised(fitting, unknowns)
        if turn in (2, 5, 9):
            noise = refitted(
                noise,
                difference[known],
                (SIGMA_BOUNDS[0] * fitting.noise.sigma_m, SIGMA_BOUNDS[1] * fitting.noise.sigma_m),
                stated=Stated(fitting.noise.sigma_m, STATED / fitting.temper),
            )
        p = parts(noise, difference)
        gradient = -fitting.temper * J.T @ (p.score * known) - weight @ unknowns
        step = np.linalg.solve(_information(J, p, noise, known, fitting.temper) + weight, gradient)
        far = float(np.hypot(step[0], step[1])) / (STEP_CELLS * fitting.terrain.cell_m)
        unknowns = unknowns + step / max(1.0, far)
        converged = turn > 9 and float(np.abs(step[:3]).max()) < DONE_M
        if converged:
            break
    return _result(fitting, unknowns, noise, weight, converged)


def expected_covariance(fitting: Fitting, start: FloatArray) -> FloatArray:
    """(3, 3) covariance of north, east, height that a match at such a place would claim if heights differ from the model as they
    are expected to: what there is to see, before looking."""
    _, J, known = linearised(fitting, start)
    noise, weight = fitting.noise, prior_information(fitting.prior)
    errors = errors_of(fitting, noise.sigma_m, np.full(len(J), 1 - noise.standing - noise.outliers), known)
    full, under_errors = errors.told(J)
    if fitting.soundings.kind is Kind.PROFILE:  # its cells are too few for anything to average out
        under_errors = full
    ones = np.ones(len(J))
    true = told(noise) * _without_false_slopes(full, fitting, float(ones @ errors.solved(ones)))
    return left(fitting, true, fitting.few * under_errors, weight)[0][:3, :3]


def errors_of(fitting: Fitting, sigma_m: float, ground: FloatArray, known: NDArray[np.bool_]) -> Whitening:
    """The errors of soundings that are ground with probabilities (N,), and lie on known model (N,)."""
    own_m2 = fitting.soundings.sigma_m**2
    of_model_m2 = max(sigma_m, fitting.noise.sigma_m) ** 2 - own_m2
    walk = Walk(fitting.soundings.age_s, fitting.walk_m2_per_s)
    return whitening(fitting.cells, (1 - UNRESOLVED) * of_model_m2, UNRESOLVED * of_model_m2, own_m2, walk, ground, known)


def _result(fitting: Fitting, unknowns: FloatArray, noise: HeightNoise, weight: FloatArray, converged: bool) -> Refined:
    difference, J, known = linearised(fitting, unknowns)
    p = parts(noise, difference)
    full = _information(J, p, noise, known, 1.0)
    spread, n_blocks = _spread(fitting, J * (p.score * known)[:, None])
    own = fitting.few * _under_errors(fitting, J, np.maximum(p.ground, LEAST_GROUND) * known, noise.sigma_m)
    reliability = reliable_share(fitting, unknowns, difference, p.ground * known)
    true = told(noise) * scaled(full, np.eye(2) * math.sqrt(max(reliability, LEAST_RELIABLE)))
    share = n_blocks / (n_blocks + PRIOR_BLOCKS)
    temper = fitting.temper
    covariance, inverse = left(fitting, temper * true, temper**2 * (share * spread + own), weight)
    covariance[2, 2] += STANDS * max(0.0, noise.sigma_m**2 - fitting.noise.sigma_m**2)
    density = temper * float(p.log_density[known].sum())
    of_sigma = Stated(fitting.noise.sigma_m, STATED).log_prior(noise.sigma_m)
    level = temper * _level_log_density(fitting, known)
    return Refined(
        unknowns,
        (covariance + covariance.T) / 2,
        noise,
        density - 0.5 * float(unknowns[3:] @ weight[3:, 3:] @ unknowns[3:]) + of_sigma,
        density - level,
        float(p.ground[known].mean()) if known.any() else 0.0,
        float(known.mean()),
        reliability,
        walked(J * (p.ground * known)[:, None] @ inverse[2], fitting.soundings.age_s),
        np.asarray(inverse[:2, 6:] @ weight[6:, 6:], dtype=np.float64),
        converged,
        covariance[:2, :2],
    )


PRIOR_BLOCKS = 36.0
"""From how many blocks on half of what they spread by counts."""
STANDS = 0.5
"""Share of the residuals' variance beyond the expected one that is the height's: low crowns taken for ground widen it and
lift the height by as much (training seeds 100 to 102 over real ground: error over sigma 1.3 without it, from 1 m² on)."""
NULL_ROUNDS = 12
SURE = 1e-6
"""1-sigma below which an unknown counts as known (keeps the information matrix solvable)."""
PAIRS_M = (40.0, 80.0)
MOST_OF_PAIRS, FEWEST_PAIRS = 800, 20
LEAST_RELIABLE = 0.02


def left(fitting: Fitting, information: FloatArray, errors: FloatArray, weight: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Covariance (10, 10) of the unknowns by what the soundings tell, the covariance of the gradient under their errors, and the
    prior's information; and the inverse that it rests on."""
    inverse = np.linalg.inv(information + weight + 1e-9 * np.eye(N_UNKNOWNS))
    covariance: FloatArray = inverse @ (errors + weight) @ inverse
    covariance[:2, :2] += np.eye(2) * fitting.prior.sigma_wander_m**2
    return covariance, np.asarray(inverse, dtype=np.float64)


def _under_errors(fitting: Fitting, J: FloatArray, w: FloatArray, sigma_m: float) -> FloatArray:
    """(10, 10) covariance of the gradient, with weights w (N,) over the squared sigma of the fit, under the errors that are
    expected, and no smaller ones than that sigma says: the soundings' own noise is independent, all else is alike nearby."""
    gradients = J * (w / sigma_m**2)[:, None]
    of_soundings = fitting.soundings.sigma_m**2
    alike = max(sigma_m, fitting.noise.sigma_m) ** 2 - of_soundings
    outer = correlated_outer(gradients, fitting.soundings.points_m[:, :2])
    return np.asarray(alike * outer + of_soundings * gradients.T @ gradients)


def _without_false_slopes(information: FloatArray, fitting: Fitting, weight: float) -> FloatArray:
    """Less what slopes that are errors of the model are expected to add; never below a thousandth in any direction."""
    values, vectors = np.linalg.eigh(information[:2, :2])
    values = np.maximum(values, 1e-12)
    kept = np.maximum(1 - weight * fitting.false_slope**2 / values, 1e-3)
    return scaled(information, (vectors * np.sqrt(kept)) @ vectors.T)


def scaled(information: FloatArray, by: FloatArray) -> FloatArray:
    """Information whose derivatives by north and east are multiplied by a symmetric (2, 2)."""
    every = np.eye(N_UNKNOWNS)
    every[:2, :2] = by
    return np.asarray(every @ information @ every)


def reliable_share(fitting: Fitting, unknowns: FloatArray, difference: FloatArray, weight: FloatArray) -> float:
    """Share of the model's slopes that the soundings confirm: 1 for a perfect model, 0 where its slopes are errors, or at another
    place. The regression of measured height differences between places PAIRS_M apart on the model's: its attenuation is that of
    errors in the variables (Fuller 1987), and curvature and information of the match are less by as much."""
    every = max(1, len(difference) // MOST_OF_PAIRS)
    pick = slice(None, None, every)
    at = placed(fitting.soundings, unknowns)[pick]
    tree = cKDTree(at)
    pairs = tree.query_pairs(PAIRS_M[1], output_type="ndarray")
    pairs = pairs[np.hypot(*(at[pairs[:, 0]] - at[pairs[:, 1]]).T) > PAIRS_M[0]]
    if len(pairs) < FEWEST_PAIRS:
        return 0.0
    model = fitting.terrain.heights(np.array(fitting.prior.p_ne_m) + unknowns[:2] + at)
    measured, w = model + difference[pick], weight[pick]
    of_model, of_measured = (values[pairs[:, 0]] - values[pairs[:, 1]] for values in (model, measured))
    both = w[pairs[:, 0]] * w[pairs[:, 1]]
    return float((both * of_model * of_measured).sum() / max(float((both * np.square(of_model)).sum()), 1e-9))


def _level_log_density(fitting: Fitting, known: NDArray[np.bool_]) -> float:
    """The soundings' log density if the ground were level: the same mixture about its likeliest level, of any width."""
    up = fitting.soundings.points_m[known, 2]
    if not len(up):
        return 0.0
    middle = float(np.percentile(up, 30))
    noise = HeightNoise(max(fitting.noise.sigma_m, float(np.std(up)) / 2))
    for _ in range(NULL_ROUNDS):
        noise = refitted(noise, up - middle, (SIGMA_BOUNDS[0] * fitting.noise.sigma_m, np.inf), 1)
        ground = parts(noise, up - middle).ground
        middle += float(ground @ (up - middle)) / max(float(ground.sum()), 1.0)
    return float(parts(noise, up - middle).log_density.sum())


def linearised(fitting: Fitting, unknowns: FloatArray) -> tuple[FloatArray, FloatArray, NDArray[np.bool_]]:
    """Measured minus model (N,), derivative of model minus measured by the unknowns (N, 10), and what is known (N,)."""
    points, beam, age = fitting.soundings.points_m, fitting.soundings.beams_m, fitting.soundings.age_s
    ne = placed(fitting.soundings, unknowns)
    at = np.array(fitting.prior.p_ne_m) + unknowns[:2] + ne
    model, slope = fitting.terrain.heights_and_slopes(at)
    tilt = beam[:, :2] @ unknowns[4:6]
    difference = fitting.prior.h_amsl_m + unknowns[2] + points[:, 2] + tilt - model
    by_yaw = slope[:, 1] * beam[:, 0] - slope[:, 0] * beam[:, 1]
    ones = np.ones(len(points))
    by_tilt = -beam[:, :2] - slope * beam[:, 2:]
    by_drift, by_acceleration = -slope * age[:, None], slope * np.square(age)[:, None] / 2
    J = np.column_stack([slope, -ones, by_yaw, by_tilt, by_drift, by_acceleration])
    return difference, J, fitting.terrain.knows(at)


def placed(soundings: Soundings, unknowns: FloatArray) -> FloatArray:
    """(N, 2) north, east of the soundings from the position after tilt, drift (a velocity error moves old ones back), heading."""
    c, s = np.cos(unknowns[3]), np.sin(unknowns[3])
    age, beam = soundings.age_s[:, None], soundings.beams_m
    track = soundings.points_m[:, :2] - beam[:, :2] - age * unknowns[6:8] + np.square(age) / 2 * unknowns[8:10]
    level = beam[:, :2] - beam[:, 2:] * unknowns[4:6]
    turned = np.column_stack([c * level[:, 0] - s * level[:, 1], s * level[:, 0] + c * level[:, 1]])
    return np.asarray(track + turned, dtype=np.float64)


def _information(J: FloatArray, p: Parts, noise: HeightNoise, known: NDArray[np.bool_], temper: float) -> FloatArray:
    w = np.maximum(p.ground, LEAST_GROUND) * known / noise.sigma_m**2
    return np.asarray(temper * (J.T * w) @ J)


def prior_information(prior: TerrainPrior) -> FloatArray:
    """(10, 10) of the unknowns beside position and height."""
    each = (prior.sigma_tilt_rad, prior.sigma_drift_mps, prior.sigma_drift_mps2)
    sigma = [prior.sigma_yaw_rad, *(s for s in each for _ in range(2))]
    return np.diag([0.0, 0.0, 0.0, *(1 / max(s, SURE) ** 2 for s in sigma)])


def _spread(fitting: Fitting, gradients: FloatArray) -> tuple[FloatArray, int]:
    """(10, 10) sum over blocks of the outer product of their gradients, for as many degrees of freedom, and the blocks."""
    cell = np.floor(fitting.soundings.points_m[:, :2] / fitting.block_m).astype(np.int64)
    _, block = np.unique(cell, axis=0, return_inverse=True)
    block = block.ravel()
    n = int(block.max()) + 1
    sums = np.column_stack([np.bincount(block, gradients[:, k], n) for k in range(N_UNKNOWNS)])
    sums -= sums.mean(0)
    return np.asarray(sums.T @ sums * (n / max(n - 3.0, 1.0)), dtype=np.float64), n
