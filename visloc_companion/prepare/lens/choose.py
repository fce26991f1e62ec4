"""Which of the distortion models fits a lens: each is fitted to some of the views and judged on the others."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from visloc_companion.adapters.camera.calibration import lens_model
from visloc_companion.config import parse_config
from visloc_companion.errors import ConfigError
from visloc_companion.prepare.lens.centre import IN_CENTRE, OffCentre, off_centre
from visloc_companion.prepare.lens.fit import NoFit, fit
from visloc_companion.prepare.lens.section import section
from visloc_companion.prepare.lens.view import Lens, View, placed, residuals_px
from visloc_companion.types import CameraModel, DistortionModel, FloatArray

MODELS: tuple[DistortionModel, ...] = ("brown_conrady", "fisheye", "rational")
"""The simplest first: frames of the first are looked at as they are, and the last has twice the coefficients of the second."""
FOLDS = 5
WORSE_SIGMAS, WORSE_SHARE = 2.0, 0.02
"""A simpler model is worse where the views say so by so many of their own sigmas, and its error is larger by such a share."""
TRIMMED = 0.2
"""Share of the views on either side that a comparison leaves out: one that alone reaches into a corner of the picture errs much
where it is held out, under the right model as well, for nothing tells that what the lens does there."""


@dataclass(frozen=True, slots=True, eq=False)
class Candidate:
    """A model fitted to all views, with the (V,) mean square, px², of each view's residuals (of both axes) under the lens that
    was fitted without it. `off_centre`: what the views tell of a lens out of centre, which the model cannot say; `why_not`: what
    forbids it, empty where nothing does; `without`: the lenses that were fitted without a fold of the views each."""

    kind: DistortionModel
    lens: Lens | None
    held_out_px2: FloatArray
    why_not: str = ""
    off_centre: OffCentre = IN_CENTRE
    without: tuple[CameraModel, ...] = ()

    @property
    def rms_px(self) -> float:
        """Of the views held out, over both axes; infinite without a lens."""
        return math.sqrt(float(np.mean(self.held_out_px2))) if len(self.held_out_px2) else math.inf


def candidates(
    kinds: Sequence[DistortionModel],
    views: Sequence[View],
    size_px: tuple[int, int],
    progress: Callable[[str], object],
    near: Mapping[DistortionModel, CameraModel],
) -> list[Candidate]:
    """Each model, fitted and judged; `near` has what the lens is about."""
    made = []
    for kind in kinds:
        progress(kind)
        made.append(_judged(kind, views, size_px, near.get(kind)))
    return made


def chosen(of: Sequence[Candidate]) -> Candidate | None:
    """The simplest that is not significantly worse than any other; None where every one is forbidden."""
    able = [each for each in of if not each.why_not]
    sound = (each for each in able if not any(is_worse(each, other) for other in able))
    return next(sound, min(able, key=lambda each: each.rms_px, default=None))


def is_worse(one: Candidate, other: Candidate) -> bool:
    """Whether one model errs more than another, or as much and for a lens out of centre has nothing, which the other has."""
    return errs_more(one, other) or (one.off_centre.sure and not other.off_centre.sure and not errs_more(other, one))


def errs_more(one: Candidate, other: Candidate) -> bool:
    """Whether most of the views tell that one model errs more than another: a paired comparison of trimmed means (Yuen 1974)."""
    more = np.sort(np.log(one.held_out_px2 / other.held_out_px2))
    out = int(TRIMMED * len(more))
    kept = more[out : len(more) - out]
    spread = float(np.std(np.clip(more, kept[0], kept[-1]), ddof=1)) * math.sqrt((len(more) - 1) / (len(kept) - 1))
    sigma = spread / math.sqrt(len(kept))
    return float(np.mean(kept)) > max(WORSE_SIGMAS * sigma, 2 * math.log1p(WORSE_SHARE))


def _judged(kind: DistortionModel, views: Sequence[View], size_px: tuple[int, int], near: CameraModel | None) -> Candidate:
    held_out = np.full(len(views), np.nan)
    without = []
    try:
        whole = fit(kind, views, size_px, near)
        for fold in range(FOLDS):
            rest = fit(kind, [view for k, view in enumerate(views) if k % FOLDS != fold], size_px, whole.model)
            without.append(rest.model)
            for k in range(fold, len(views), FOLDS):
                pose = placed(rest.model, whole.poses[k], views[k])
                held_out[k] = np.mean(np.square(residuals_px(rest.model, pose, views[k])))
        lens_model(parse_config({"camera": section(whole.model)}).camera)
    except NoFit as why:
        return Candidate(kind, None, np.zeros(0), str(why))
    except ConfigError as why:
        return Candidate(kind, whole, held_out, why.what)
    return Candidate(kind, whole, held_out, off_centre=off_centre(whole, views), without=tuple(without))
