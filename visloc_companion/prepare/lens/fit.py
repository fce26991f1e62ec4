"""One lens and the poses of the board, fitted to the corners of several views."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress

import cv2
import numpy as np

from visloc_companion.geo.camera import pinhole_matrix
from visloc_companion.prepare.lens.bundle import cost, improved, poses_under
from visloc_companion.prepare.lens.view import Lens, View
from visloc_companion.types import DISTORTION_COEFFICIENTS, CameraModel, DistortionModel

FOCAL_SHARES = (1.0, 0.5, 1.8)
"""Of the picture's width: where a fit begins beside OpenCV's own beginning, from which it may end at less than the best (1 of 20
rational lenses)."""
FISHEYE_SHARES = (0.2, 0.25, 0.32, 0.4, 0.5, 0.65, 0.85, 1.1, 1.5, 2.2)
"""The same of an equidistant lens, whose view across is the inverse in radians: of 26 to 286 degrees."""
_STEPS = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 200, 1e-10)


class NoFit(Exception):
    """The corners determine no such lens."""


def fit(kind: DistortionModel, views: Sequence[View], size_px: tuple[int, int], near: CameraModel | None = None) -> Lens:
    """The lens of least squared residuals; sooner found with one `near` it. Raises NoFit where none is found."""
    lens = _fisheye(views, size_px, near) if kind == "fisheye" else _perspective(kind, views, size_px, near)
    if lens is None:
        raise NoFit(f"no {kind} lens is found for these views")
    return lens


def _fisheye(views: Sequence[View], size_px: tuple[int, int], near: CameraModel | None) -> Lens | None:
    starts = [near] if near is not None else [_straight("fisheye", size_px, share) for share in FISHEYE_SHARES]
    begun = [Lens(start, poses) for start in starts if (poses := poses_under(start, views)) is not None]
    if not begun:
        return None
    lens = improved(min(begun, key=lambda each: cost(each, views)), views)
    return lens if _is_sound(lens) else None


def _perspective(kind: DistortionModel, views: Sequence[View], size_px: tuple[int, int], near: CameraModel | None) -> Lens | None:
    begun = [None, *(_straight(kind, size_px, share) for share in FOCAL_SHARES)]
    found = []
    for start in [near] if near is not None else begun:
        with suppress(cv2.error):
            found.append(_of_opencv(kind, views, size_px, start))
    return min((lens for lens in found if _is_sound(lens)), key=lambda lens: cost(lens, views), default=None)


def _is_sound(lens: Lens) -> bool:
    model = lens.model
    numbers = [model.fx_px, model.fy_px, model.cx_px, model.cy_px, *model.distortion]
    return bool(np.isfinite(numbers).all() and np.isfinite(lens.poses).all() and min(numbers[:2]) > 1.0)


def _straight(kind: DistortionModel, size_px: tuple[int, int], focal_share: float) -> CameraModel:
    (width, height), focal_px = size_px, focal_share * size_px[0]
    none = (0.0,) * len(DISTORTION_COEFFICIENTS[kind])
    return CameraModel(width, height, focal_px, focal_px, (width - 1) / 2, (height - 1) / 2, none, kind)


def _of_opencv(kind: DistortionModel, views: Sequence[View], size_px: tuple[int, int], start: CameraModel | None) -> Lens:
    guess, begun = (0, _straight(kind, size_px, 1.0)) if start is None else (cv2.CALIB_USE_INTRINSIC_GUESS, start)
    flags = guess | (cv2.CALIB_RATIONAL_MODEL if kind == "rational" else 0)
    board, pix = (
        [np.asarray(of, dtype=np.float32) for of in part] for part in zip(*((v.board_m, v.pix) for v in views), strict=True)
    )
    K, bent = pinhole_matrix(begun), np.array(begun.distortion)
    _, K_out, bent_out, turns, shifts = cv2.calibrateCamera(board, pix, size_px, K, bent, flags=flags, criteria=_STEPS)
    K, coefficients = np.asarray(K_out), tuple(float(k) for k in np.ravel(bent_out)[: len(begun.distortion)])
    width, height = size_px
    model = CameraModel(width, height, float(K[0, 0]), float(K[1, 1]), float(K[0, 2]), float(K[1, 2]), coefficients, kind)
    return Lens(model, np.array([np.ravel([turn, shift]) for turn, shift in zip(turns, shifts, strict=True)]))
