"""How sure a lens is where no corner of the board was seen: there nothing but the model says what it does.

The lenses that were fitted without a fifth of the views each tell (the jackknife over groups): by how much they show a ray beside
each other is what the fit does not know. Propagated in one step, as `sure` has it, a rational lens says nothing here: its
coefficients hang together so closely that the step leaves what is near the lens.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from visloc_companion.geo.camera import project, unproject
from visloc_companion.prepare.lens.coverage import Coverage, part_of
from visloc_companion.prepare.lens.look import CELLS
from visloc_companion.prepare.lens.view import View
from visloc_companion.types import CameraModel, FloatArray

_FOLDED_PX = 0.01
"""A ray that comes back so far beside its pixel is none: the lens folds before it."""


@dataclass(frozen=True, slots=True)
class Unseen:
    """A part of the picture that holds no corner of the board, by name, and the 1-sigma of the rays there, px, over both axes."""

    part: str
    sigma_px: float


def least_sure(sigmas_px: FloatArray, cells: Coverage) -> Unseen | None:
    """Of `ray_sigmas_px` the largest, of cells that show anything and hold no corner."""
    asked = np.where(cells.lit & (cells.counts == 0), sigmas_px, -1.0)
    row, column = np.unravel_index(int(np.argmax(asked)), asked.shape)
    return Unseen(part_of(int(row), int(column)), float(asked[row, column])) if asked[row, column] >= 0 else None


def cell_ends_pix(model: CameraModel) -> FloatArray:
    """(down * across, 2) of look.CELLS, row by row: the pixel of each that lies farthest from the principal point."""
    across, down = CELLS
    ends_u, ends_v = (np.arange(n + 1) * size / n - 0.5 for n, size in ((across, model.width_px), (down, model.height_px)))
    u, v = (
        np.where(np.abs(ends[:-1] - middle) > np.abs(ends[1:] - middle), ends[:-1], ends[1:])
        for ends, middle in ((ends_u, model.cx_px), (ends_v, model.cy_px))
    )
    return np.stack(np.meshgrid(u, v), axis=-1).reshape(-1, 2)


def ray_sigmas_px(model: CameraModel, without: Sequence[CameraModel], views: Sequence[View]) -> FloatArray:
    """(down, across) 1-sigma, px over both axes, of the rays at the far ends of look.CELLS; infinite where the lens folds before.

    `without` are the lenses fitted without one group of the views each. All are turned onto each other where corners were seen:
    how the camera looks is learned in flight.
    """
    across, down = CELLS
    places, seen = cell_ends_pix(model), np.concatenate([view.pix for view in views])
    shown = np.array([_shown(other, model, seen, places) for other in without])
    apart = shown - shown.mean(axis=0)
    sigmas = np.sqrt((len(without) - 1) / len(without) * np.square(apart).sum(axis=(0, 2)))
    return np.where(_has_rays(model, places) & np.isfinite(sigmas), sigmas, np.inf).reshape(down, across)


def _shown(other: CameraModel, model: CameraModel, seen: FloatArray, places: FloatArray) -> FloatArray:
    """(N, 2) `pix` at which another lens shows the rays of these places, turned so that both agree where corners were seen; NaN
    where it has no rays."""
    theirs, ours = _unit(unproject(other, seen)), _unit(unproject(model, seen))
    U, _, Vt = np.linalg.svd(theirs.T @ ours)
    pix = project(other, unproject(model, places) @ (U @ Vt).T)
    return np.where(_has_rays(other, pix)[:, None], pix, np.nan)


def _has_rays(model: CameraModel, pix: FloatArray) -> NDArray[np.bool_]:
    """(N,) whether a lens shows the ray of a pixel there again, and has one: none of NaN."""
    finite = np.where(np.isfinite(pix), pix, (model.cx_px, model.cy_px))
    return np.asarray(np.hypot(*(project(model, unproject(model, finite)) - pix).T) < _FOLDED_PX)


def _unit(rays: FloatArray) -> FloatArray:
    return np.asarray(rays / np.linalg.norm(rays, axis=1)[:, None], dtype=np.float64)
