"""From pictures of a board to a lens, with how sure it is and what it does not meet."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np

from visloc_companion.errors import CameraError
from visloc_companion.prepare.lens.agree import Scatter, scatter
from visloc_companion.prepare.lens.board import Board
from visloc_companion.prepare.lens.centre import OffCentre
from visloc_companion.prepare.lens.choose import MODELS, Candidate, candidates, chosen
from visloc_companion.prepare.lens.coverage import Coverage, coverage
from visloc_companion.prepare.lens.fit import folds
from visloc_companion.prepare.lens.flat import Warp, warp
from visloc_companion.prepare.lens.look import Looked, look_at
from visloc_companion.prepare.lens.pictures import Picture
from visloc_companion.prepare.lens.strays import without_strays
from visloc_companion.prepare.lens.sure import covariance
from visloc_companion.prepare.lens.unseen import Unseen, least_sure, ray_sigmas_px
from visloc_companion.prepare.lens.view import Lens, View, all_residuals_px
from visloc_companion.types import DistortionModel, FloatArray

LEAST_VIEWS = 6
"""With one fifth of the views held out five are left to fit a lens to."""
OUTLYING, OUTLYING_PX, MOST_OUTLYING = 3.0, 0.25, 0.2
"""A view that errs so many times as much as most, and by so much, was moving, or its sheet was bent; at most this share may."""


@dataclass(frozen=True, eq=False)
class Calibration:
    """`lens` is that of `candidate`, one of `judged`, on `views`; `covariance` as sure.covariance has it, with what the model
    cannot say of a lens out of centre (`off_centre`); `sheet` what the views tell of the sheet they show, `scatter` whether they
    agree on one lens."""

    board: Board
    looked: Looked
    views: list[View]
    outlying: dict[str, float]
    strays: int
    judged: list[Candidate]
    candidate: Candidate
    lens: Lens
    covariance: FloatArray
    sheet: Warp
    scatter: Scatter

    @property
    def off_centre(self) -> OffCentre:
        """What the views tell of a lens out of centre."""
        return self.candidate.off_centre

    @property
    def sigmas(self) -> dict[str, float]:
        """1-sigma, px, of fx, fy, cx and cy."""
        values = np.sqrt(np.diag(self.covariance)[:4])
        return dict(zip(("fx_px", "fy_px", "cx_px", "cy_px"), values.tolist(), strict=True))

    @property
    def numbers(self) -> list[tuple[str, float, float]]:
        """Name, value and 1-sigma, px, of fx, fy, cx and cy."""
        return [(key.removesuffix("_px"), getattr(self.lens.model, key), sigma) for key, sigma in self.sigmas.items()]

    @property
    def focal_share(self) -> float:
        """1-sigma of the focal length as a share of it, the larger of both axes': that of heights, too."""
        return max(self.sigmas["fx_px"] / self.lens.model.fx_px, self.sigmas["fy_px"] / self.lens.model.fy_px)

    @property
    def errors_px(self) -> FloatArray:
        """(V,) root mean square residual of each view, over both axes, when it had its part in the fit."""
        return _errors_px(self.lens, self.views)

    @property
    def tilts_deg(self) -> list[float]:
        """By how much the board leaned against the picture's plane in each view."""
        return [math.degrees(math.acos(min(1.0, abs(float(cv2.Rodrigues(pose[:3])[0][2, 2]))))) for pose in self.lens.poses]

    @property
    def coverage(self) -> Coverage:
        """Where in the picture the corners that were used lie."""
        pix = np.concatenate([view.pix for view in self.views])
        return coverage(pix, self.looked.size_px, self.looked.lit)

    @cached_property
    def ray_sigmas_px(self) -> FloatArray:
        """(down, across) as unseen.ray_sigmas_px has it."""
        return ray_sigmas_px(self.lens.model, self.candidate.without, self.views)

    @property
    def least_sure(self) -> Unseen | None:
        """Where rays are least sure, of the parts that show anything and in which no corner was seen; None without one."""
        return least_sure(self.ray_sigmas_px, self.coverage)

    @property
    def folds(self) -> bool:
        """Whether the lens folds before corners that were seen."""
        return folds(self.lens, self.views)


def calibrate(
    pictures: Iterable[Picture], board: Board, kinds: Sequence[DistortionModel] = MODELS, progress: Callable[[str], object] = str
) -> Calibration:
    """Raises CameraError where the pictures give no lens: the board is in none or few of them, views contradict each other, or no
    model fits."""
    looked = look_at(pictures, board)
    _require_enough(looked.views, looked, board)
    views, strays, near = without_strays(kinds, looked.views, looked.size_px)
    outlying: dict[str, float] = {}
    while True:
        _require_enough(views, looked, board)
        judged = candidates(kinds, views, looked.size_px, progress, near)
        odd = _odd(judged, views)
        if not odd:
            break
        outlying |= odd
        if len(outlying) > MOST_OUTLYING * len(looked.views):
            raise CameraError(
                f"{len(outlying)} of {len(looked.views)} views contradict the others (" + ", ".join(outlying) + ")",
                where=f"model {', '.join(kinds)}",
                remedy="hold camera and board still, lay the sheet on something flat; with one --model named, try auto",
            )
        views = [view for view in views if view.name not in odd]
    candidate = chosen(judged)
    if candidate is None or candidate.lens is None:
        why = "; ".join(f"{each.kind}: {each.why_not}" for each in judged)
        raise CameraError(f"no model fits: {why}", where=f"{len(views)} views", remedy=_MORE)
    lens = candidate.lens
    step = candidate.off_centre.step
    told = covariance(lens, views) + np.outer(step, step), warp(lens, views, board), scatter(lens, views)
    return Calibration(board, looked, views, outlying, strays, judged, candidate, lens, *told)


_MORE = "take about 25 pictures, the board tilted by 30 to 45° to all sides, some of them close, and some in every corner"


def _require_enough(views: list[View], looked: Looked, board: Board) -> None:
    if len(views) >= LEAST_VIEWS:
        return
    total = len(looked.views) + len(looked.left_out)
    reasons = "; ".join(f"{name} {why}" for name, why in list(looked.left_out.items())[:4])
    what = f"{len(views)} of {total} pictures can be used, {LEAST_VIEWS} are needed" + (f": {reasons}" if reasons else "")
    raise CameraError(what, where=board.name, remedy=_MORE)


def _odd(judged: list[Candidate], views: list[View]) -> dict[str, float]:
    """Views that err far more than most under the model that fits most of them best, with their error, px. They had their part in
    the fit: a good view of what no other shows errs much where it is held out."""
    errors = [_errors_px(each.lens, views) for each in judged if each.lens is not None]
    if not errors:
        return {}
    best = min(errors, key=lambda each: float(np.median(each)))
    limit = max(OUTLYING * float(np.median(best)), OUTLYING_PX)
    return {view.name: float(e) for view, e in zip(views, best, strict=True) if e > limit}


def _errors_px(lens: Lens, views: list[View]) -> FloatArray:
    """(V,) root mean square residual of each view, over both axes."""
    return np.sqrt([np.mean(np.square(off)) for off in all_residuals_px(lens, views)])
