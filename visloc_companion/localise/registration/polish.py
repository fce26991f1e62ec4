"""The last steps of a refinement: the relief of the differences themselves, free of what has changed.

A relief is what stands out of a local mean; what was felled or built, or is a hole in one cloud alone, bends that mean for metres
around. Here the mean is taken away from the differences of height of the cells that both clouds know, by their weights: a change
loses its weight and with it its pull on its neighbours. The slopes that a step is computed from lose their mean in the same way,
so that the step is that of generalised least squares under differences that are alike over 8 m (Aitken 1936).

A difference counts in their robust deviation by its slope: on a lawn with a few trees that of all cells is the lawn's, beside
which every edge of a crown, which alone says where things are, would look like a change.

The edges of what stands may all lie farther out in one cloud than in the other: stereo smears roofs over its window, a cell
beside ground that is hidden is all roof, crowns grow. A camera sees the edges that look towards it and not the ground behind the
others, and then such edges look like another scale. So how much farther out they lie, everywhere, beside holes, and in a cloud
made from pictures where they look away from the middle, are unknowns as well.

A step's weights come from its differences: what a wrong scale puts beside its place would count as changed, and the scale stay.
So the first steps give weight to larger differences (graduated non-convexity: Blake and Zisserman 1987).

A cell counts by its trust (consensus.py): where nothing resembles the reference, nothing is measured; the deviation is that of
the cells that count.

The covariance is the one of clusters (Liang and Zeger 1986): what the cells of a block pull together counts once.
"""

from __future__ import annotations

import cv2
import numpy as np

from visloc_companion.localise.features.base import Mask
from visloc_companion.localise.registration.base import RegistrationPrior
from visloc_companion.localise.registration.height_map import HIGH_PASS_M
from visloc_companion.localise.registration.refine import (
    ALIKE,
    SMALL_STEP_M,
    TINY,
    Refined,
    differences,
    levelled,
    prior_of_placing,
    robust,
    stepped,
)
from visloc_companion.localise.registration.surfaces import SourceCells, Surface
from visloc_companion.types import FloatArray

STEPS = 8
CLUSTER_M = 8.0
WIDE = (3.0, 2.5, 2.0, 1.5)
"""By how much wider the weights of the first steps are."""
FITTED = 6
"""Parameters: east, north, heading, scale; how much farther out edges lie in the reference, everywhere and beside holes. One more
where the prior says that edges which look away from the middle may."""
SIGMA_EDGE_M = 0.5
"""1-sigma of each of these two. With 0.2 m such edges still look like scale in part, 2 m are hardly better (ray-cast houses)."""
HOLE_CELLS = 2
"""Cells up to so far from an unknown one have a share of their smoothing there."""


def polish(
    source: SourceCells, surface: Surface, refined: Refined, prior: RegistrationPrior, trust: FloatArray
) -> Refined | None:
    """Refined on the differences' relief; None where too few cells lie on the reference. `trust` (N,) of each cell, 0 to 1."""
    T, bowl_m = refined.T, refined.bowl_m
    weight, holes = np.ones(len(source.points_m)), _beside_holes(source)
    edge_sigmas_m = [SIGMA_EDGE_M, SIGMA_EDGE_M] + [prior.sigma_far_edge_m] * (prior.sigma_far_edge_m > 0)
    for step_number in range(STEPS + 1):
        last, wide = step_number == STEPS, WIDE[step_number] if step_number < len(WIDE) else 1.0
        level = levelled(source, surface, T, bowl_m, prior, not last)
        if level is None:
            return None
        T, bowl_m = level.T, level.bowl_m
        used, residual, jacobian = differences(source, surface, T, bowl_m)
        edges = -np.hypot(jacobian[:, 0], jacobian[:, 1])
        away = np.minimum((jacobian[:, :2] * _outwards(source, used, T)).sum(1), 0.0)
        farther = np.column_stack([edges, edges * holes[used], away])[:, : len(edge_sigmas_m)]
        values = np.column_stack([residual, jacobian, farther])
        values -= _local_mean(source, values, used, weight[used], surface.heights.cell_m)
        residual, jacobian = values[:, 0], values[:, 1:]
        counts = np.hypot(jacobian[:, 0], jacobian[:, 1]) * trust[used]
        sigma, weight[used] = robust(residual, prior.sigma_growth_m, counts, wide)
        usual = max(float(counts @ trust[used]) / max(float(counts.sum()), TINY), TINY)
        weighted = jacobian * (weight[used] * trust[used] / (ALIKE * usual * sigma**2))[:, None]
        precision, wish = prior_of_placing(T, prior)
        precision, wish = np.append(precision, np.power(edge_sigmas_m, -2.0)), np.append(wish, np.zeros(len(edge_sigmas_m)))
        bread = np.linalg.inv(weighted.T @ jacobian + np.diag(precision + TINY))
        step = bread @ (precision * wish - weighted.T @ residual)
        small = max(abs(step[0]), abs(step[1]), abs(level.up_m)) < SMALL_STEP_M
        if last or (small and wide == 1):
            unexplained = residual + jacobian[:, 4:] @ step[4:]
            placed = bread + bread @ _meat(source, used, weighted * unexplained[:, None], weighted * jacobian) @ bread
            raised = level.raised
            return Refined(T, bowl_m, np.asarray(placed[:4, :4], dtype=np.float64), raised.covariance(), raised.sigma_m)
        T = stepped(T, source.centre_m, np.array([step[0], step[1], 0]), (0.0, 0.0, float(step[2])), float(step[3]))
    return None


def _local_mean(source: SourceCells, values: FloatArray, used: Mask, weight: FloatArray, cell_m: float) -> FloatArray:
    """(n, K) Gaussian mean of the values of the cells used, about each of them, by their weights."""
    rows, cols = source.rows[used], source.cols[used]
    image = np.zeros((*source.shape, values.shape[1] + 1), np.float32)
    image[rows, cols, 0] = weight
    image[rows, cols, 1:] = values * weight[:, None]
    blurred = cv2.GaussianBlur(image, (0, 0), HIGH_PASS_M / cell_m, borderType=cv2.BORDER_CONSTANT)[rows, cols]
    return np.asarray(blurred[:, 1:] / np.maximum(blurred[:, :1], 1e-6), dtype=np.float64)


def _outwards(source: SourceCells, used: Mask, T: FloatArray) -> FloatArray:
    """(n, 2) direction of the cells used from the source's middle, after T; nearly nothing beside it."""
    out = (source.points_m[used, :2] - source.centre_m[:2]) @ T[:2, :2].T
    return np.asarray(out / np.maximum(np.hypot(out[:, 0], out[:, 1]), 1.0)[:, None], dtype=np.float64)


def _beside_holes(source: SourceCells) -> FloatArray:
    """(N,) 1 for cells within HOLE_CELLS of one that is not known, else 0."""
    known = np.zeros(source.shape, np.uint8)
    known[source.rows, source.cols] = 1
    inner = cv2.erode(known, np.ones((2 * HOLE_CELLS + 1,) * 2, np.uint8), borderType=cv2.BORDER_CONSTANT, borderValue=0)
    return np.asarray(1 - inner[source.rows, source.cols], dtype=np.float64)


def _meat(source: SourceCells, used: Mask, pulls: FloatArray, informs: FloatArray) -> FloatArray:
    """(K, K) sum over blocks of the square of what their cells pull (n, K), enlarged for few blocks.

    Few are those that hold most of what the cells inform (n, K) of the place (Kish's effective number): they fit themselves.
    """
    block = np.floor(source.points_m[used, :2] / CLUSTER_M).astype(np.int64)
    block -= block.min(0)
    index = block[:, 0] * (int(block[:, 1].max()) + 1) + block[:, 1]
    pulled = np.column_stack([np.bincount(index, pull) for pull in pulls.T])
    informed = np.bincount(index, informs[:, 0] + informs[:, 1])
    number = float(informed.sum() ** 2 / max(float(informed @ informed), 1e-30))
    return np.asarray(pulled.T @ pulled * (number / max(number - FITTED - (pulls.shape[1] > FITTED), 1.0)), dtype=np.float64)
