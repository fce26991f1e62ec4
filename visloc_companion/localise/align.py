"""Inverse-compositional Lucas-Kanade over the camera's pose, with the map's features as the template.

The frame rectified with a pose p shows F(x) = rho T(x + D(x) delta), where T are the map's features, delta the correction of
the pose and D (2 x 6) the displacement that it causes on the ground. Gradients, steepest-descent images G = grad T D and the
sums of their products over blocks belong to the map alone and are made once, about the pose where a descent starts (Baker &
Matthews 2004; by blocks: Baker, Gross & Matthews 2003, section 3.4): a step only multiplies the frame's features with them.
rho, the gain between two dates, is solved for with delta, as in the enhanced correlation coefficient (Evangelidis & Psarakis
2008): without it a faint likeness shrinks the picture.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from visloc_companion.localise.features.base import Float32Array
from visloc_companion.localise.ortho_rectify import CameraPose, MapGrid, nadir_offsets
from visloc_companion.types import FloatArray

TEMPLATE_SIGMA_PX = 1.0
DENSE_PIXELS = 20000
"""Larger windows are aligned on every other pixel of every other row: the features are smoother than that."""
BLOCK_PX = 8
"""Side of the blocks that the map's sums are kept for; those that the frame fills in part are summed anew."""


@dataclass(frozen=True, slots=True, eq=False)
class Descent:
    """The map's side of the alignment: smoothed features, their gradients per metre north and east (H, W, C)."""

    template: Float32Array
    d_north: Float32Array
    d_east: Float32Array


@dataclass(frozen=True, slots=True, eq=False)
class BlockSums:
    """The map's side of the alignment about one pose, by blocks of P = BLOCK_PX^2 pixels, every `stride`-th of each axis.

    `images` (B, P, C, 7): steepest-descent images of the six unknowns, then the template; `whole` (B, 7, 7): their products
    summed over whole blocks.
    """

    images: Float32Array
    whole: FloatArray
    stride: int


@dataclass(frozen=True, slots=True, eq=False)
class Step:
    """One Gauss-Newton step: `delta` (6,) metres north, east, up and radians about north, east, down; its normal equations'
    matrix scaled to information (6, 6); correlation before the step; number of pixels used."""

    delta: FloatArray
    information: FloatArray
    score: float
    n_pixels: float


def prepare(grid: MapGrid) -> Descent:
    """Gradients of the map's features with respect to metres north and east."""
    template = smoothed(grid.features)
    du = cv2.Sobel(template, cv2.CV_32F, 1, 0, ksize=3, scale=1 / 8)
    dv = cv2.Sobel(template, cv2.CV_32F, 0, 1, ksize=3, scale=1 / 8)
    J = np.linalg.inv(grid.A_ne_pix[:, :2]).astype(np.float32)  # pix per metre: columns north, east
    return Descent(template, du * J[0, 0] + dv * J[1, 0], du * J[0, 1] + dv * J[1, 1])


def smoothed(features: Float32Array) -> Float32Array:
    """Features low-passed for a wider basin of convergence."""
    return np.asarray(cv2.GaussianBlur(features, (0, 0), TEMPLATE_SIGMA_PX), dtype=np.float32)


def displacements(grid: MapGrid, pose: CameraPose, stride: int = 1) -> tuple[FloatArray, FloatArray]:
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
    return north, east


def block_sums(descent: Descent, grid: MapGrid, pose: CameraPose) -> BlockSums:
    """The map's side about a pose. It serves while the pose moves by little against the height above ground."""
    stride = 2 if grid.weight.size > DENSE_PIXELS else 1
    T, d_north, d_east = (a[::stride, ::stride] for a in (descent.template, descent.d_north, descent.d_east))
    north, east = displacements(grid, pose, stride)
    images = np.empty((*T.shape, 7), dtype=np.float32)
    for k in range(6):
        np.multiply(north[k][..., None], d_north, out=images[..., k])
        images[..., k] += east[k][..., None] * d_east
    images[..., 6] = T
    blocks = _blocks(images.reshape(*T.shape[:2], -1)).reshape(-1, BLOCK_PX**2, T.shape[2], 7)
    flat = blocks.reshape(len(blocks), -1, 7)
    return BlockSums(blocks, np.asarray(flat.transpose(0, 2, 1) @ flat, dtype=np.float64), stride)


def gauss_newton_step(
    sums: BlockSums,
    frame: Float32Array,
    weight: Float32Array,
    prior_information: FloatArray,
    prior_pull: FloatArray,
    correlated_px: float,
) -> Step:
    """One step from the rectified frame's smoothed features (H, W, C) and the weight (H, W) of both masks.

    `prior_information` (6, 6) and `prior_pull` (6,) are a Gaussian prior's normal equations at this pose.
    `correlated_px`: neighbouring pixels that carry one independent measurement.
    """
    stride, channels = sums.stride, frame.shape[2]
    w = _blocks(weight[::stride, ::stride, None])
    seen = np.flatnonzero(w.max((1, 2)) > 0)
    w = w[seen]
    F = _blocks(frame[::stride, ::stride])[seen]
    weighted = F * w
    M = _products(sums, seen, w).sum(0)
    v = (weighted.reshape(len(seen), 1, -1) @ sums.images[seen].reshape(len(seen), -1, 7)).sum((0, 1), dtype=np.float64)
    ff, n_pixels = float(np.sum(weighted * F, dtype=np.float64)), float(w.sum(dtype=np.float64))
    g_t, ft, tt = M[:6, 6], float(v[6]), float(M[6, 6])
    rho = max(ft / max(tt, 1e-9), 0.05)
    residual_2, residual_t = ff / rho**2 - 2 * ft / rho + tt, ft / rho - tt
    H = M[:6, :6] - np.outer(g_t, g_t) / max(tt, 1e-9)
    b = v[:6] / rho - g_t - g_t * (residual_t / max(tt, 1e-9))
    noise = max(residual_2 / max(n_pixels * channels, 1.0), 1e-6) * correlated_px / stride**2
    information = H / noise
    total = information + prior_information
    damping = np.diag(np.diag(total)) * 1e-6 + np.eye(6) * 1e-9
    delta = np.linalg.solve(total + damping, b / noise + prior_pull)
    return Step(delta, information, ft / max(math.sqrt(tt * ff), 1e-9), n_pixels)


def moved(pose: CameraPose, delta: FloatArray) -> CameraPose:
    """The pose after a correction (north, east, up, rotation about north, east, down)."""
    p = pose.p_ned_m + np.array([delta[0], delta[1], -delta[2]])
    R = cv2.Rodrigues(np.asarray(delta[3:6], dtype=np.float64))[0]
    return CameraPose(p, R @ pose.R_ned_cam)


def rotation_between(R_from: FloatArray, R_to: FloatArray) -> FloatArray:
    """(3,) rotation vector w with R_to = exp(w) R_from."""
    return np.asarray(cv2.Rodrigues(R_to @ R_from.T)[0].ravel(), dtype=np.float64)


def _products(sums: BlockSums, seen: NDArray[np.intp], weight: Float32Array) -> FloatArray:
    """(N, 7, 7) weighted sums of products over the blocks `seen` (N,) under a weight (N, P, 1)."""
    products = sums.whole[seen]
    cut = np.flatnonzero(weight.min((1, 2)) < 1)
    if len(cut):
        images = sums.images[seen[cut]]
        weighted = (images * weight[cut][..., None]).reshape(len(cut), -1, 7)
        products[cut] = weighted.transpose(0, 2, 1) @ images.reshape(len(cut), -1, 7)
    return products


def _blocks(image: Float32Array) -> Float32Array:
    """(B, P, K) blocks of an image (H, W, K), zero beyond its border."""
    height, width = (-(-side // BLOCK_PX) for side in image.shape[:2])
    if (height * BLOCK_PX, width * BLOCK_PX) != image.shape[:2]:
        whole = np.zeros((height * BLOCK_PX, width * BLOCK_PX, image.shape[2]), dtype=np.float32)
        whole[: image.shape[0], : image.shape[1]] = image
        image = whole
    tiles = image.reshape(height, BLOCK_PX, width, BLOCK_PX, -1).swapaxes(1, 2)
    return np.ascontiguousarray(tiles).reshape(height * width, BLOCK_PX**2, -1)
