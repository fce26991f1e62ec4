"""The half-pixel rule, in one place. `pix` has the centre of the top-left pixel at (0, 0); `ras` (GDAL) its corner."""

from __future__ import annotations

import numpy as np

from visloc_companion.types import FloatArray


def T_map_pix_from_gdal(transform: tuple[float, float, float, float, float, float]) -> FloatArray:
    """(2, 3) map-from-pix of an affine (a, b, c, d, e, f) that maps ras: x = a col + b row + c, y = d col + e row + f."""
    a, b, c, d, e, f = transform
    return np.array([[a, b, c + (a + b) / 2], [d, e, f + (d + e) / 2]])


def apply_affine(T: FloatArray, points: FloatArray) -> FloatArray:
    """(2, 3) affine applied to (..., 2) points."""
    return points @ T[:, :2].T + T[:, 2]


def invert_affine(T: FloatArray) -> FloatArray:
    """Inverse of a (2, 3) affine. Raises numpy.linalg.LinAlgError for a singular one."""
    inverse = np.linalg.inv(T[:, :2])
    return np.column_stack([inverse, -inverse @ T[:, 2]])


def compose_affine(T_a_b: FloatArray, T_b_c: FloatArray) -> FloatArray:
    """(2, 3) `T_a_c` of two affines."""
    return np.column_stack([T_a_b[:, :2] @ T_b_c[:, :2], T_a_b[:, :2] @ T_b_c[:, 2] + T_a_b[:, 2]])


def window_affine(
    center_map_m: tuple[float, float], size_px: tuple[int, int], J_map_ne: FloatArray, gsd_m: float, heading_rad: float
) -> FloatArray:
    """(2, 3) `T_map_pix` of a window about a centre.

    `J_map_ne` (2, 2) maps (north, east) metres to map units. With `heading_rad` the window's up axis points that much
    clockwise from true north; a caller that means grid north adds the convergence.
    """
    s, c = np.sin(heading_rad) * gsd_m, np.cos(heading_rad) * gsd_m
    ne_from_uv = np.array([[-s, -c], [c, -s]])
    linear = J_map_ne @ ne_from_uv
    centre_pix = np.array([(size_px[0] - 1) / 2, (size_px[1] - 1) / 2])
    return np.column_stack([linear, np.array(center_map_m) - linear @ centre_pix])


def sides_turn_rad(T_map_pix: FloatArray, J_map_ne: FloatArray) -> float:
    """How far a raster's sides are turned clockwise from north and east, -pi/4 to pi/4. `J_map_ne` as in `window_affine`."""
    north, east = np.linalg.solve(J_map_ne, T_map_pix[:, 0])
    return float(np.arctan2(east, north) + np.pi / 4) % (np.pi / 2) - np.pi / 4


def square_reach_m(
    T_map_pix: FloatArray, size_px: tuple[int, int], J_map_ne: FloatArray, at_map: FloatArray, turn_rad: float
) -> float:
    """Half the side, metres, of the largest square about a place (2,) that a raster of (width, height) pixels holds, with sides
    turned clockwise from north and east by `turn_rad`; negative beyond the raster. `J_map_ne` as in `window_affine`."""
    s, c = np.sin(turn_rad), np.cos(turn_rad)
    T_pix_map = invert_affine(T_map_pix)
    pix_per_m = np.abs(T_pix_map[:, :2] @ J_map_ne @ np.array([[c, -s], [s, c]])).sum(axis=1)
    at = apply_affine(T_pix_map, at_map)
    return float(np.min(np.minimum(at + 0.5, np.array(size_px) - 0.5 - at) / pix_per_m))
