"""Similarities p_reference = T [p_source, 1] as (4, 4) arrays: composed about a point, and taken apart."""

from __future__ import annotations

import math

import numpy as np

from visloc_companion.types import FloatArray

ORIGIN_STEP_M = 1000.0
"""Clouds are registered about the reference's middle, rounded to this: clouds about zero stay as they are to the bit."""


def moved(T: FloatArray, points_m: FloatArray) -> FloatArray:
    """(N, 3) or (3,) points after the similarity."""
    return np.asarray(points_m @ T[:3, :3].T + T[:3, 3], dtype=np.float64)


def about(centre_m: FloatArray, yaw_rad: float, scale: float, shift_m: FloatArray) -> FloatArray:
    """(4, 4) Turn about up and scale about a centre, then shift."""
    c, s = math.cos(yaw_rad), math.sin(yaw_rad)
    linear = scale * np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    return with_linear(linear, centre_m, centre_m + shift_m)


def with_linear(linear: FloatArray, from_m: FloatArray, to_m: FloatArray) -> FloatArray:
    """(4, 4) Similarity of a linear part that takes one point to another."""
    T = np.eye(4)
    T[:3, :3] = linear
    T[:3, 3] = to_m - linear @ from_m
    return T


def from_origin(T: FloatArray, origin_m: FloatArray) -> FloatArray:
    """(4, 4) Similarity of points from one that holds for the points less (3,) an origin, on both sides."""
    found = T.copy()
    found[:3, 3] += origin_m - T[:3, :3] @ origin_m
    return found


def near_origin_m(points_m: FloatArray) -> FloatArray:
    """(3,) The middle of points (N, 3), rounded to ORIGIN_STEP_M."""
    return np.asarray(np.rint(points_m.mean(axis=0) / ORIGIN_STEP_M) * ORIGIN_STEP_M, dtype=np.float64)


def turned(tilt_x: float, tilt_y: float, yaw: float) -> FloatArray:
    """(3, 3) rotation by a rotation vector (radians), by Rodrigues' formula."""
    angle = math.sqrt(tilt_x**2 + tilt_y**2 + yaw**2)
    skew = np.array([[0.0, -yaw, tilt_y], [yaw, 0.0, -tilt_x], [-tilt_y, tilt_x, 0.0]])
    if angle < 1e-12:
        return np.asarray(np.eye(3) + skew, dtype=np.float64)
    rotation = np.eye(3) + math.sin(angle) / angle * skew + (1 - math.cos(angle)) / angle**2 * (skew @ skew)
    return np.asarray(rotation, dtype=np.float64)


def yaw_of(T: FloatArray) -> float:
    """Heading (radians) by which a similarity turns about up."""
    return math.atan2(T[1, 0] - T[0, 1], T[0, 0] + T[1, 1])


def scale_of(T: FloatArray) -> float:
    """Scale of a similarity."""
    return float(np.cbrt(np.linalg.det(T[:3, :3])))


def tilt_of(T: FloatArray) -> tuple[float, float]:
    """Tilt (radians) about the reference's horizontal axes: where the source's up points, for small tilts."""
    up = T[:3, 2] / scale_of(T)
    return float(-up[1]), float(up[0])
