"""One lens and the poses of the board, fitted to the corners of several views."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace

import cv2
import numpy as np

from visloc_companion.geo.camera import pinhole_matrix
from visloc_companion.geo.lens import reach_tan
from visloc_companion.prepare.lens.bundle import cost, improved, poses_under
from visloc_companion.prepare.lens.view import Lens, View
from visloc_companion.types import DISTORTION_COEFFICIENTS, CameraModel, DistortionModel

FOCAL_SHARES = (1.0, 0.5, 1.8)
"""Of the picture's width: where a fit begins beside OpenCV's own beginning, from which it may end at less than the best (1 of 20
rational lenses)."""
FISHEYE_SHARES = (0.2, 0.25, 0.32, 0.4, 0.5, 0.65, 0.85, 1.1, 1.5, 2.2)
"""The same of an equidistant lens, whose view across is the inverse in radians: of 26 to 286 degrees."""
SAME_SHARE = 0.02
"""An error that is larger by no more than so is the same."""
_PLAIN = cv2.CALIB_FIX_K3 | cv2.CALIB_FIX_K6
"""Of a rational lens k3 and k6, which stand with the sixth power of the radius, are left at zero."""
_PLAIN_AT = (4, 7)
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
    begun: list[CameraModel | None] = [None, *(_straight(kind, size_px, share) for share in FOCAL_SHARES)]
    starts = begun if near is None else [near]
    if kind != "rational":
        return min(_ended(kind, views, size_px, starts, 0), key=lambda lens: cost(lens, views), default=None)
    best, plain = (
        min(_ended(kind, views, size_px, of, held), key=lambda lens: (folds(lens, views), cost(lens, views)), default=None)
        for of, held in ((starts, 0), ([start and _plain(start) for start in starts], _PLAIN))
    )
    return plain if best is None or (plain is not None and _is_as_good(plain, best, views)) else best


def _is_as_good(plain: Lens, best: Lens, views: Sequence[View]) -> bool:
    """Whether fewer coefficients do. With more than the corners tell, numerator and denominator have a root in common but for
    noise: a pole amid the picture that no residual shows, beyond which the lens has no rays."""
    if folds(plain, views) != folds(best, views):
        return folds(best, views)
    return cost(plain, views) <= (1 + SAME_SHARE) ** 2 * cost(best, views)


def folds(lens: Lens, views: Sequence[View]) -> bool:
    """Whether the lens folds back, or has a pole, before corners that were seen: rays further out are none for it."""
    at = np.concatenate([view.board_m @ cv2.Rodrigues(p[:3])[0].T + p[3:] for p, view in zip(lens.poses, views, strict=True)])
    return bool((np.hypot(at[:, 0], at[:, 1]) >= reach_tan(lens.model) * at[:, 2]).any())


def free_numbers(model: CameraModel) -> list[int]:
    """Which of fx, fy, cx, cy and the coefficients were fitted, by number."""
    plain = model.distortion_model == "rational" and not any(model.distortion[k] for k in _PLAIN_AT)
    return [k for k in range(4 + len(model.distortion)) if not (plain and k - 4 in _PLAIN_AT)]


def _plain(model: CameraModel) -> CameraModel:
    return replace(model, distortion=tuple(0.0 if k in _PLAIN_AT else value for k, value in enumerate(model.distortion)))


def _ended(
    kind: DistortionModel, views: Sequence[View], size_px: tuple[int, int], starts: Sequence[CameraModel | None], held: int
) -> list[Lens]:
    """The lenses, sound ones, that OpenCV's fit ends at from each of the starts; `held`: its flags for coefficients that stay."""
    found = []
    for start in starts:
        with suppress(cv2.error):
            found.append(_of_opencv(kind, views, size_px, start, held))
    return [lens for lens in found if _is_sound(lens)]


def _is_sound(lens: Lens) -> bool:
    model = lens.model
    numbers = [model.fx_px, model.fy_px, model.cx_px, model.cy_px, *model.distortion]
    return bool(np.isfinite(numbers).all() and np.isfinite(lens.poses).all() and min(numbers[:2]) > 1.0)


def _straight(kind: DistortionModel, size_px: tuple[int, int], focal_share: float) -> CameraModel:
    (width, height), focal_px = size_px, focal_share * size_px[0]
    none = (0.0,) * len(DISTORTION_COEFFICIENTS[kind])
    return CameraModel(width, height, focal_px, focal_px, (width - 1) / 2, (height - 1) / 2, none, kind)


def _of_opencv(
    kind: DistortionModel, views: Sequence[View], size_px: tuple[int, int], start: CameraModel | None, held: int
) -> Lens:
    guess, begun = (0, _straight(kind, size_px, 1.0)) if start is None else (cv2.CALIB_USE_INTRINSIC_GUESS, start)
    flags = guess | held | (cv2.CALIB_RATIONAL_MODEL if kind == "rational" else 0)
    board, pix = (
        [np.asarray(of, dtype=np.float32) for of in part] for part in zip(*((v.board_m, v.pix) for v in views), strict=True)
    )
    K, bent = pinhole_matrix(begun), np.array(begun.distortion)
    _, K_out, bent_out, turns, shifts = cv2.calibrateCamera(board, pix, size_px, K, bent, flags=flags, criteria=_STEPS)
    K, coefficients = np.asarray(K_out), tuple(float(k) for k in np.ravel(bent_out)[: len(begun.distortion)])
    width, height = size_px
    model = CameraModel(width, height, float(K[0, 0]), float(K[1, 1]), float(K[0, 2]), float(K[1, 2]), coefficients, kind)
    return Lens(model, np.array([np.ravel([turn, shift]) for turn, shift in zip(turns, shifts, strict=True)]))
