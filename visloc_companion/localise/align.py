"""Inverse-compositional Lucas-Kanade over the camera's pose, with the map's features as the template.

The frame rectified with a pose p shows F(x) = rho T(x + D(x) delta), where T are the map's features, delta the correction of
the pose and D (2 x 6) the displacement that it causes on the ground. Gradients, steepest-descent images G = grad T D and the
products of both belong to the map alone and are made once, about the pose where a descent starts (Baker & Matthews 2004): a
step only multiplies the frame's features with them and adds up under the weight of both masks, which changes with the pose. The
products are kept for each pixel, the limit of keeping their sums by blocks (Baker, Gross & Matthews 2003, section 3.4).
rho, the gain between two dates, is solved for with delta, as in the enhanced correlation coefficient (Evangelidis & Psarakis
2008): without it a faint likeness shrinks the picture.

Where the surface model is coarse, D has columns for the heights of the ground's cells as well (open_ground.py): ground that is
higher is seen as from a camera that much lower.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np

from visloc_companion.localise.features.base import Float32Array
from visloc_companion.localise.mapped.open_ground import OpenGround
from visloc_companion.localise.ortho_rectify import CameraPose, MapGrid, nadir_offsets
from visloc_companion.types import FloatArray

TEMPLATE_SIGMA_PX = 1.0
DENSE_PIXELS = 20000
"""Larger windows are aligned on every other pixel of every other row: the features are smoother than that."""
RUN_PX = 512
"""Pixels that are added up in single precision."""
_UPPER = np.triu_indices(7)
UP = 2
"""The camera's height among the six unknowns."""
_OF_UP = np.array([k for k, pair in enumerate(zip(*_UPPER, strict=True)) if UP in pair])
"""Its products with them and with the template."""


@dataclass(frozen=True, slots=True, eq=False)
class Descent:
    """The map's side of the alignment: smoothed features, their gradients per metre north and east (H, W, C).

    `products` (6, H, W) are sums over the channels: north², north east, east² of the gradients, both times the features, and the
    features' square. `stride`: the arrays hold every so manieth row and column of the window that they were made from.
    """

    template: Float32Array
    d_north: Float32Array
    d_east: Float32Array
    products: Float32Array
    stride: int = 1

    def every(self, stride: int) -> Descent:
        """Every `stride`-th row and column of it."""
        at = (slice(None, None, stride),) * 2
        template, d_north, d_east = (a[at] for a in (self.template, self.d_north, self.d_east))
        return Descent(template, d_north, d_east, self.products[:, *at], self.stride * stride)


@dataclass(frozen=True, slots=True, eq=False)
class MapSums:
    """The map's side of the alignment about one pose, for P pixels: every `stride`-th of each axis of `descent`, row by row.

    `north`, `east` (6, P): displacements of the six unknowns; `d_north`, `d_east`, `template` (C, P) as the descent's, which is
    at that stride; `products` (28, P): those of the six steepest-descent images and the template, summed over the channels, the
    upper triangle of (7, 7).
    """

    descent: Descent
    north: Float32Array
    east: Float32Array
    d_north: Float32Array
    d_east: Float32Array
    template: Float32Array
    products: Float32Array
    stride: int


@dataclass(frozen=True, slots=True, eq=False)
class Step:
    """One Gauss-Newton step: `delta` (6,) metres north, east, up and radians about north, east, down; its normal equations'
    matrix scaled to information (6, 6); correlation before the step; number of pixels used; the ground after the step, where it
    is open, and by how much (N, 6) its heights are lower for each unit of the pose. `gain` and `noise`: the frame's features over
    the map's, and the variance of one independent measurement of them, with which the information was scaled."""

    delta: FloatArray
    information: FloatArray
    score: float
    n_pixels: float
    gain: float
    noise: float
    ground: OpenGround | None = None
    by_pose_m: FloatArray | None = None


def prepare(grid: MapGrid, stride: int = 1) -> Descent:
    """Gradients of the map's features with respect to metres north and east, at every `stride`-th row and column."""
    full = smoothed(grid.features)
    du, dv = (cv2.Sobel(full, cv2.CV_32F, *axes, ksize=3, scale=1 / 8)[::stride, ::stride] for axes in ((1, 0), (0, 1)))
    template = np.ascontiguousarray(full[::stride, ::stride])
    J = np.linalg.inv(grid.A_ne_pix[:, :2]).astype(np.float32)  # pix per metre: columns north, east
    north, east = du * J[0, 0] + dv * J[1, 0], du * J[0, 1] + dv * J[1, 1]
    pairs = ((north, north), (north, east), (east, east), (north, template), (east, template), (template, template))
    return Descent(template, north, east, np.stack([_over_channels(a, b) for a, b in pairs]), stride)


def smoothed(features: Float32Array) -> Float32Array:
    """Features low-passed for a wider basin of convergence."""
    return np.asarray(cv2.GaussianBlur(features, (0, 0), TEMPLATE_SIGMA_PX), dtype=np.float32)


def displacements(grid: MapGrid, pose: CameraPose, stride: int = 1) -> tuple[Float32Array, Float32Array]:
    """(6, H, W) each: metres north and east by which what is seen moves per unit of (north, east, up, w_n, w_e, w_d).

    Rotations are about the NED axes, applied on the left of the attitude.
    """
    height, width = grid.weight.shape
    n, e = nadir_offsets(grid.A_ne_pix, pose.p_ned_m, (width, height))
    n, e = n[::stride, ::stride], e[::stride, ::stride]
    z = np.maximum(np.float32(-pose.p_ned_m[2]) - grid.surface_up_m[::stride, ::stride], np.float32(1.0))
    one, zero = np.ones_like(z), np.zeros_like(z)
    north = np.stack([one, zero, n / z, -n * e / z, z + n * n / z, -e])
    east = np.stack([zero, one, e / z, -z - e * e / z, n * e / z, n])
    return np.asarray(north, dtype=np.float32), np.asarray(east, dtype=np.float32)


def map_sums(descent: Descent, grid: MapGrid, pose: CameraPose) -> MapSums:
    """The map's side about a pose. It serves while the pose moves by little against the height above ground."""
    stride = 2 if grid.weight.size > DENSE_PIXELS else 1
    thin = descent.every(stride)
    north, east = (a.reshape(6, -1) for a in displacements(grid, pose, stride))
    d_north, d_east, template = (planes(a) for a in (thin.d_north, thin.d_east, thin.template))
    return MapSums(thin, north, east, d_north, d_east, template, _products(north, east, thin.products.reshape(6, -1)), stride)


def gauss_newton_step(
    sums: MapSums,
    frame: Float32Array,
    weight: Float32Array,
    prior_information: FloatArray,
    prior_pull: FloatArray,
    correlated_px: float,
    ground: OpenGround | None = None,
) -> Step:
    """One step from the rectified frame's smoothed features (H, W, C) and the weight (H, W) of both masks.

    `prior_information` (6, 6) and `prior_pull` (6,) are a Gaussian prior's normal equations at this pose.
    `correlated_px`: neighbouring pixels that carry one independent measurement. `ground`: heights that are solved for as well,
    by which the surface that `sums` and the frame were made with is raised.
    """
    stride, channels, map_side = sums.stride, frame.shape[2], sums.descent
    w, F = weight[::stride, ::stride].ravel(), planes(frame[::stride, ::stride])
    f_n, f_e, f_t, f_f = (np.einsum("cp,cp->p", F, a) * w for a in (sums.d_north, sums.d_east, sums.template, F))
    M = np.zeros((7, 7))
    M[_UPPER] = _summed(sums.products, w)
    M = M + np.triu(M, 1).T
    pull = _summed(sums.north, f_n) + _summed(sums.east, f_e)
    ft, ff, n_pixels = (float(a.sum(dtype=np.float64)) for a in (f_t, f_f, w))
    tt = float(M[6, 6])
    rho = max(ft / max(tt, 1e-9), 0.05)
    residual_2, residual_t = max(0.0, ff / rho**2 - 2 * ft / rho + tt), ft / rho - tt
    noise = max(residual_2 / max(n_pixels * channels, 1.0), 1e-6) * correlated_px / map_side.stride**2
    if ground is not None:
        M, pull = _with_heights(ground, sums, w, (f_n, f_e), M, pull)
    g_t = M[:-1, -1]
    information = (M[:-1, :-1] - np.outer(g_t, g_t) / max(tt, 1e-9)) / noise
    b = (pull / rho - g_t - g_t * (residual_t / max(tt, 1e-9))) / noise
    by_pose_m, raised_m = np.zeros((0, 6)), np.zeros(0)
    if ground is not None:
        information, b, by_pose_m, raised_m = _heights_solved(ground, information, b)
    total = information + prior_information
    damping = np.diag(np.diag(total)) * 1e-6 + np.eye(6) * 1e-9
    delta = np.linalg.solve(total + damping, b + prior_pull)
    after = None if ground is None else ground.raised(raised_m - by_pose_m @ delta)
    score, heights = ft / max(math.sqrt(tt * ff), 1e-9), None if ground is None else by_pose_m
    return Step(delta, information, score, n_pixels, rho, noise, after, heights)


def _with_heights(
    ground: OpenGround,
    sums: MapSums,
    weight: Float32Array,
    by_frame: tuple[Float32Array, Float32Array],
    M: FloatArray,
    pull: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """Products (7 + N, 7 + N) and pull (6 + N,) with N heights between the pose's six and the template, from those without.

    `by_frame`: gradients north and east times the frame, under the weight (P,) each.
    """
    own = -ground.summed(sums.products[_OF_UP], weight, sums.stride)  # (N, 7): with the six and the template
    by_height = np.stack([sums.north[UP] * by_frame[0] + sums.east[UP] * by_frame[1]])
    seen = ground.summed(by_height, np.ones_like(weight), sums.stride)
    n = len(own)
    of_pose, heights = np.r_[0:6, 6 + n], slice(6, 6 + n)
    joined = np.zeros((7 + n, 7 + n))
    joined[np.ix_(of_pose, of_pose)] = M
    joined[heights, of_pose], joined[of_pose, heights] = own, own.T
    joined[heights, heights] = np.diag(-own[:, UP])
    return joined, np.concatenate([pull, -seen[:, 0]])


def _heights_solved(
    ground: OpenGround, information: FloatArray, b: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Information (6, 6) and right side (6,) of the pose alone, by how much (N, 6) the heights are lower for each unit of its
    step, and the heights (N,) without one."""
    own, shared = information[6:, 6:] + ground.information, information[6:, :6]
    towards = b[6:] - ground.information @ ground.raised_m
    solved = np.asarray(np.linalg.solve(own, np.column_stack([shared, towards])), dtype=np.float64)
    by_pose_m, step_m = solved[:, :6], solved[:, 6]
    alone = np.asarray(information[:6, :6] - shared.T @ by_pose_m, dtype=np.float64)
    return alone, b[:6] - shared.T @ step_m, by_pose_m, ground.raised_m + step_m


def moved(pose: CameraPose, delta: FloatArray) -> CameraPose:
    """The pose after a correction (north, east, up, rotation about north, east, down)."""
    p = pose.p_ned_m + np.array([delta[0], delta[1], -delta[2]])
    R = cv2.Rodrigues(np.asarray(delta[3:6], dtype=np.float64))[0]
    return CameraPose(p, R @ pose.R_ned_cam)


def _summed(images: Float32Array, weight: Float32Array) -> FloatArray:
    """(K,) sums of images (K, P) under a weight (P,): by runs in single precision, the runs in double."""
    whole = len(weight) // RUN_PX * RUN_PX
    runs = np.einsum("krp,rp->kr", images[:, :whole].reshape(len(images), -1, RUN_PX), weight[:whole].reshape(-1, RUN_PX))
    rest = np.einsum("kp,p->k", images[:, whole:], weight[whole:])
    return np.asarray(runs.sum(1, dtype=np.float64) + rest, dtype=np.float64)


def _products(north: Float32Array, east: Float32Array, sums: Float32Array) -> Float32Array:
    """(28, P) products of G = d_north north + d_east east and T, from displacements (6, P) and a descent's products (6, P)."""
    nn, ne, ee, nt, et, tt = sums
    by_north, by_east = north * nn + east * ne, north * ne + east * ee
    with_template = north * nt + east * et
    found = np.empty((28, north.shape[1]), np.float32)
    row = 0
    for i in range(6):
        found[row : row + 6 - i] = north[i:] * by_north[i] + east[i:] * by_east[i]
        found[row + 6 - i] = with_template[i]
        row += 7 - i
    found[row] = tt
    return found


def planes(image: Float32Array) -> Float32Array:
    """(C, P) pixels row by row, a plane for each channel, of an image (H, W, C)."""
    return np.ascontiguousarray(np.moveaxis(image, -1, 0)).reshape(image.shape[2], -1)


def _over_channels(a: Float32Array, b: Float32Array) -> Float32Array:
    """(H, W) sum over the channels of a product of (H, W, C) arrays."""
    return np.asarray(cv2.transform(a * b, np.ones((1, a.shape[2]), np.float32)), dtype=np.float32)
