"""Kalman prediction and update, stateless and checked: the one room that imports filterpy.

filterpy's textbook update turns a singular innovation covariance or a NaN measurement into a NaN state without raising;
here everything is checked first, so that a caller gets a finite, symmetric, positive definite answer, a `Rejected`, or a
ValueError for what can only be a mistake in the program (wrong shapes, a broken prior).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from filterpy.kalman import update as _update
from scipy.linalg.lapack import dpotrf  # type: ignore[import-untyped]

from visloc_companion.errors import Reason
from visloc_companion.types import FloatArray, Rejected


@dataclass(frozen=True, slots=True, eq=False)
class Updated:
    """Posterior mean (n,) and covariance (n, n), the normalised innovation squared that the gate saw; the innovation (m,), and
    the covariance (m, m) of it without the measurement's own."""

    x: FloatArray
    P: FloatArray
    nis: float
    innovation: FloatArray
    seen: FloatArray


def predict(x: FloatArray, P: FloatArray, F: FloatArray, Q: FloatArray, step: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Mean (n,) and covariance (n, n) after `x -> F x + step` with process noise Q. Raises ValueError for bad operands."""
    n = len(x)
    if not (P.shape == F.shape == Q.shape == (n, n) and step.shape == (n,)):
        raise ValueError(f"predict: shapes x {x.shape} P {P.shape} F {F.shape} Q {Q.shape} step {step.shape} do not fit")
    return _checked(np.dot(F, x) + step, np.dot(np.dot(F, P), F.T) + Q, "predict")


def update(
    x: FloatArray,
    P: FloatArray,
    z: FloatArray,
    R: FloatArray,
    H: FloatArray,
    *,
    gate_sigma: float = math.inf,
    gate_extra_m2: float = 0.0,
    n_considered: int = 0,
) -> Updated | Rejected:
    """Take a measurement z (m,) with covariance R (m, m) of H x.

    Beyond `gate_sigma` (Mahalanobis distance, with `gate_extra_m2` added to the diagonal for errors that R leaves out) the
    answer is Rejected(GATED); a non-finite measurement, an R that is not positive definite, or one so flat beside P that rounding
    leaves nothing positive definite is Rejected(NOT_FINITE). The last `n_considered` states keep their mean and variance
    (Schmidt's consider filter): their uncertainty counts, but the measurement does not move them. Joseph form throughout. Raises
    ValueError for shapes that do not fit and a broken prior.
    """
    n, m = len(x), len(z)
    if not (P.shape == (n, n) and R.shape == (m, m) and H.shape == (m, n)):
        raise ValueError(f"update: shapes x {x.shape} P {P.shape} z {z.shape} R {R.shape} H {H.shape} do not fit")
    if not (math.isfinite(z.dot(z)) and _is_positive_definite(R if m == 2 else (R + R.T) / 2)):
        return Rejected(Reason.NOT_FINITE, 0.0)
    innovation, HP = z - H.dot(x), H.dot(P)
    seen = HP.dot(H.T)
    S = seen + R
    nis = _normalised(innovation, S, gate_extra_m2)
    if not nis <= gate_sigma * gate_sigma:
        return Rejected(Reason.GATED, nis)
    if n_considered == 0:
        x1, P1 = _update(x, P, z, R, H)
    else:
        K = _gain(S, HP, n_considered)
        keep = _identity(n) - K.dot(H)
        x1, P1 = x + K.dot(innovation), keep.dot(P).dot(keep.T)
        P1 += K.dot(R).dot(K.T)
    P1 = P1 + P1.T
    P1 /= 2
    if math.isfinite(x1.dot(x1)) and _is_positive_definite(P1):
        return Updated(x1, P1, nis, innovation, seen)
    _checked(x, P, "update")
    return Rejected(Reason.NOT_FINITE, nis)


def gain(P: FloatArray, R: FloatArray, H: FloatArray, n_considered: int = 0) -> FloatArray:
    """(n, m) what `update` multiplies the innovation of such a measurement by."""
    HP = H.dot(P)
    return _gain(HP.dot(H.T) + R, HP, n_considered)


def _gain(S: FloatArray, HP: FloatArray, n_considered: int) -> FloatArray:
    K: FloatArray = inverse(S).dot(HP).T
    K[len(K) - n_considered :] = 0.0
    return K


def _normalised(innovation: FloatArray, S: FloatArray, extra: float) -> float:
    """innovation' (S + extra I)^-1 innovation; most measurements are pairs."""
    if len(innovation) != 2:
        return float(innovation @ np.linalg.solve(S + extra * np.eye(len(innovation)), innovation))
    (a, b), ((aa, ab), (_, bb)) = innovation.tolist(), S.tolist()
    aa, bb = aa + extra, bb + extra
    return float((bb * a * a - 2 * ab * a * b + aa * b * b) / (aa * bb - ab * ab))


@lru_cache(maxsize=8)
def _identity(n: int) -> FloatArray:
    return np.eye(n)


def inverse(S: FloatArray) -> FloatArray:
    """Of a positive definite matrix; most measurements are pairs."""
    if len(S) != 2:
        return np.asarray(np.linalg.inv(S), dtype=np.float64)
    (aa, ab), (ba, bb) = S.tolist()
    return np.asarray(np.array([[bb, -ab], [-ba, aa]]) / (aa * bb - ab * ba))


def _checked(x: FloatArray, P: FloatArray, where: str) -> tuple[FloatArray, FloatArray]:
    P = (P + P.T) / 2
    if not (math.isfinite(np.vdot(x, x)) and _is_positive_definite(P)):
        raise ValueError(f"{where}: the prior was not finite and positive definite")
    return x, P


def _is_positive_definite(matrix: FloatArray) -> bool:
    """Of a symmetric matrix, or of a pair's symmetric part. Finite, too: a NaN ends Cholesky's decomposition, an infinity stays
    in its factor, whose squares sum to the trace."""
    if len(matrix) == 2:
        (aa, ab), (ba, bb) = matrix.tolist()
        ab = (ab + ba) / 2
        return bool(0 < aa < math.inf and 0 < bb - ab / aa * ab < math.inf)
    factor, failed_at = dpotrf(matrix, lower=True)
    return failed_at == 0 and math.isfinite(np.vdot(factor, factor))
