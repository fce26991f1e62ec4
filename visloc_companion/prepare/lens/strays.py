"""Corners that were found beside themselves: where a marker is seen so flat that the search for a corner ends at another."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace

import numpy as np

from visloc_companion.prepare.lens.fit import NoFit, fit
from visloc_companion.prepare.lens.view import Lens, View, all_residuals_px
from visloc_companion.types import CameraModel, DistortionModel, FloatArray

ASTRAY = 6.0
"""Times the median of its own view: seven sigmas of what errs at random. A view that was shaken is odd as a whole."""
CLOSE = 1.2
_ROUNDS = 3


Models = dict[DistortionModel, CameraModel]


def without_strays(
    kinds: Sequence[DistortionModel], views: Sequence[View], size_px: tuple[int, int]
) -> tuple[list[View], int, Models]:
    """The views without corners astray under a model that fits most of them, how many these were, and what was fitted."""
    left, total = list(views), 0
    models: Models = {}
    for _ in range(_ROUNDS):
        close = _close(kinds, left, size_px, models)
        if not close:
            break
        kept = [np.all([errors[k] <= ASTRAY * np.median(errors[k]) for errors in close], axis=0) for k in range(len(left))]
        strays = sum(int((~each).sum()) for each in kept)
        if not strays:
            break
        total += strays
        left = [
            replace(view, ids=view.ids[each], board_m=view.board_m[each], pix=view.pix[each])
            for view, each in zip(left, kept, strict=True)
        ]
    return left, total, models


def _close(
    kinds: Sequence[DistortionModel], views: Sequence[View], size_px: tuple[int, int], models: Models
) -> list[list[FloatArray]]:
    """By how many pixels each corner (N,) of each view errs, under each of the models that fit most corners about as well as any:
    one with more coefficients bends towards a stray at the rim. `models` are what to begin from, and become what is found."""
    found = []
    for kind in kinds:
        with suppress(NoFit):
            lens = fit(kind, views, size_px, models.get(kind))
            models[kind] = lens.model
            found.append(_errors_px(lens, views))
    medians = [float(np.median(np.concatenate(errors))) for errors in found]
    return [errors for errors, median in zip(found, medians, strict=True) if median <= CLOSE * min(medians)]


def _errors_px(lens: Lens, views: Sequence[View]) -> list[FloatArray]:
    return [np.hypot(*off.T) for off in all_residuals_px(lens, views)]
