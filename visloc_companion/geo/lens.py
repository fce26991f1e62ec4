"""How far from the optical axis a lens shows a ray: radial profiles of the distortion models that OpenCV calibrates.

A radius r is the tangent of the angle off the axis. Brown-Conrady and the rational model multiply it by a polynomial, or by the
quotient of two, of r²; the fisheye model (Kannala and Brandt 2006, equidistant) replaces it by a polynomial of the angle.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import TypeVar

import numpy as np
from numpy.polynomial import Polynomial

from visloc_companion.types import CameraModel, FloatArray

_R2 = TypeVar("_R2", float, FloatArray)
_NEXT_TO_POLE = 1 - 1e-9


def radial_factor(model: CameraModel, r2: FloatArray) -> FloatArray:
    """(N,) factor on radii with these squares."""
    if model.distortion_model == "fisheye":
        r = np.sqrt(r2)
        angle = np.arctan(r)
        return np.where(r > 1e-9, angle * _in_angle(model, angle * angle) / np.maximum(r, 1e-9), 1.0)
    if model.distortion_model == "rational":
        return np.asarray(_numerator(model, r2) / _denominator(model, r2), dtype=np.float64)
    return _numerator(model, r2)


def radial_slope(model: CameraModel, r2: FloatArray) -> FloatArray:
    """(N,) derivative of the distorted radius by the radius, at radii with these squares."""
    if model.distortion_model == "fisheye":
        a2 = np.arctan(np.sqrt(r2)) ** 2
        k1, k2, k3, k4 = model.distortion
        return np.asarray((1 + a2 * (3 * k1 + a2 * (5 * k2 + a2 * (7 * k3 + a2 * 9 * k4)))) / (1 + r2), dtype=np.float64)
    k1, k2, k3 = _polynomial(model)
    if model.distortion_model == "rational":
        k4, k5, k6 = model.distortion[5:]
        n, d = _numerator(model, r2), _denominator(model, r2)
        dn, dd = k1 + r2 * (2 * k2 + r2 * 3 * k3), k4 + r2 * (2 * k5 + r2 * 3 * k6)
        return np.asarray((n * d + 2 * r2 * (dn * d - n * dd)) / (d * d), dtype=np.float64)
    return np.asarray(1 + r2 * (3 * k1 + r2 * (5 * k2 + r2 * 7 * k3)), dtype=np.float64)


@lru_cache(maxsize=16)
def reach_tan(model: CameraModel) -> float:
    """Tangent of the angle off the optical axis beyond which the radial distortion folds back and shows what lies further in a
    second time; infinite where it never does."""
    if model.distortion_model == "fisheye":
        angle = math.sqrt(_first_positive([k * n for k, n in zip(model.distortion[::-1], (9, 7, 5, 3), strict=True)] + [1.0]))
        return math.tan(angle) if angle < math.pi / 2 else math.inf
    k1, k2, k3 = _polynomial(model)
    if model.distortion_model == "rational":
        n, d = Polynomial([1.0, k1, k2, k3]), Polynomial([1.0, *model.distortion[5:]])
        slope = n * d + Polynomial([0.0, 2.0]) * (n.deriv() * d - n * d.deriv())
        turning, pole = (_first_positive(of.coef[::-1].tolist()) for of in (slope, d))
        return math.sqrt(min(turning, pole * _NEXT_TO_POLE))
    return math.sqrt(_first_positive([7 * k3, 5 * k2, 3 * k1, 1.0]))


def tangential(model: CameraModel, xy: FloatArray) -> FloatArray:
    """(N, 2) what a lens out of centre adds."""
    if model.distortion_model == "fisheye":
        return np.zeros_like(xy)
    p1, p2 = model.distortion[2:4]
    x, y = xy[:, 0], xy[:, 1]
    r2 = x * x + y * y
    return np.column_stack([2 * p1 * x * y + p2 * (r2 + 2 * x * x), p1 * (r2 + 2 * y * y) + 2 * p2 * x * y])


def is_bent(model: CameraModel) -> bool:
    """Whether rays and pixels are related otherwise than by a pinhole."""
    return model.distortion_model == "fisheye" or any(model.distortion)


def is_off_centre(model: CameraModel) -> bool:
    """Whether the lens adds anything across the radius."""
    return model.distortion_model != "fisheye" and any(model.distortion[2:4])


def _polynomial(model: CameraModel) -> tuple[float, float, float]:
    k1, k2, _, _, k3 = model.distortion[:5]
    return k1, k2, k3


def _numerator(model: CameraModel, r2: _R2) -> _R2:
    k1, k2, k3 = _polynomial(model)
    return 1 + r2 * (k1 + r2 * (k2 + r2 * k3))


def _denominator(model: CameraModel, r2: _R2) -> _R2:
    k4, k5, k6 = model.distortion[5:]
    return 1 + r2 * (k4 + r2 * (k5 + r2 * k6))


def _in_angle(model: CameraModel, a2: FloatArray) -> FloatArray:
    k1, k2, k3, k4 = model.distortion
    return np.asarray(1 + a2 * (k1 + a2 * (k2 + a2 * (k3 + a2 * k4))), dtype=np.float64)


def _first_positive(coefficients: list[float]) -> float:
    """The smallest positive real root of a polynomial, highest power first; infinite where there is none."""
    roots = np.roots(coefficients)
    positive = roots.real[(np.abs(roots.imag) < 1e-9) & (roots.real > 0)]
    return float(positive.min()) if len(positive) else math.inf
