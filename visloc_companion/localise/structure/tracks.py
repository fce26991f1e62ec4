"""Corners of a middle frame found again in its partners: pyramidal Lucas-Kanade there and back, on level views.

Every frame is drawn as a level camera with one heading would see it (view.py), level ground as large as in the middle frame, so
that tilt, heading and a climb are gone and what is left is parallax; corners are the best of each cell (Shi & Tomasi 1994),
followed by Lucas-Kanade (Bouguet 2001).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from visloc_companion.localise.structure.base import PosedFrame, StereoSettings
from visloc_companion.localise.structure.contrast import as_bytes, evened
from visloc_companion.localise.structure.pairs import Star
from visloc_companion.localise.structure.view import View, level_axes, view_of
from visloc_companion.types import CameraModel, FloatArray, Image

WINDOW_PX = 31
SMOOTHING_PX = 1.0
LEVELS = 4
RETURN_PX = 0.5
"""A corner that does not come back to within this was not the same one."""
LEAST_EIGENVALUE = 2e-4
"""Of the gradient's products (grey levels of 0..1, OpenCV's scaling): below, a corner is sensor noise."""
BORDER_PX = 12
LEAST_DEPTH, MOST_ENLARGED = 0.1, 2.0
"""Of a frame's height over the hub's: less is none, and pictures are enlarged or reduced by no more, as they grow with it."""


@dataclass(frozen=True, slots=True, eq=False)
class Tracks:
    """Corners as rays: `frame` (O,) 0 for the hub and k + 1 for its k-th partner, `point` (O,) number of the corner, `xy` (O, 2)
    normalised image coordinates in that frame's `cam`. `corners` is how many were looked for, `frames` how many there are."""

    frame: NDArray[np.intp]
    point: NDArray[np.intp]
    xy: FloatArray
    corners: int
    frames: int

    def of(self, frame: int) -> tuple[NDArray[np.intp], FloatArray]:
        """Corner numbers and coordinates of one frame."""
        mine = self.frame == frame
        return self.point[mine], self.xy[mine]


def follow(
    frames: Sequence[PosedFrame], greys: Mapping[int, Image], star: Star, model: CameraModel, settings: StereoSettings
) -> Tracks:
    """Tracks of the hub's corners in its partners. `greys` are these frames in grey, by number."""
    hub = frames[star.hub]
    axes = level_axes(_heading(hub.T_local_cam))
    numbers = (star.hub, *star.partners)
    shifts = {i: axes.T @ (hub.T_local_cam[:3, 3] - frames[i].T_local_cam[:3, 3]) / hub.height_m for i in numbers}
    enlarged = {i: min(max(_depth(shift), 1 / MOST_ENLARGED), MOST_ENLARGED) for i, shift in shifts.items()}
    views = {i: view_of(model, frames[i].T_local_cam[:3, :3], axes, enlarged[i]) for i in shifts}
    size = (max(v.size[0] for v in views.values()), max(v.size[1] for v in views.values()))
    views = {i: replace(v, size=size) for i, v in views.items()}  # Lucas-Kanade wants pictures of one size
    view = views[star.hub]
    picture, seen = _drawn(view, hub, greys[star.hub], model)
    corners = corners_of(picture, seen, settings.corner_spacing_px)
    parts: list[tuple[NDArray[np.intp], NDArray[np.intp], FloatArray]] = []
    for k, number in enumerate(star.partners):
        other = frames[number]
        other_view = views[number]
        other_picture, other_seen = _drawn(other_view, other, greys[number], model)
        start = view.rays(corners)[:, :2] + shifts[number][:2]
        start_pix = other_view.pixels(np.column_stack([start, np.full(len(start), _depth(shifts[number]))]))
        candidates = np.flatnonzero(_within(start_pix, other_seen))
        kept, found, _ = lucas_kanade(picture, other_picture, corners[candidates], start_pix[candidates])
        number_of = candidates[kept]
        inside = _within(found, other_seen)
        number_of, found = number_of[inside], found[inside]
        parts.append((np.full(len(found), k + 1), number_of, _normalised(other_view, other.T_local_cam, found)))
    used = np.unique(np.concatenate([number for _, number, _ in parts]))
    parts.insert(0, (np.zeros(len(used), np.intp), used, _normalised(view, hub.T_local_cam, corners[used])))
    frame = np.concatenate([part[0] for part in parts]).astype(np.intp)
    point = np.searchsorted(used, np.concatenate([part[1] for part in parts])).astype(np.intp)
    return Tracks(frame, point, np.concatenate([part[2] for part in parts]), len(corners), 1 + len(star.partners))


def joined(parts: Sequence[Tracks], numbers: Sequence[Sequence[int]]) -> Tracks:
    """Tracks of several stars as one: `numbers` says, for each of them, which of all frames its frames are."""
    first = np.cumsum([0, *(int(part.point.max()) + 1 for part in parts)])
    frame = np.concatenate([np.array(number, np.intp)[part.frame] for part, number in zip(parts, numbers, strict=True)])
    point = np.concatenate([part.point + offset for part, offset in zip(parts, first[:-1], strict=True)]).astype(np.intp)
    frames = 1 + max(max(number) for number in numbers)
    return Tracks(frame, point, np.concatenate([part.xy for part in parts]), sum(part.corners for part in parts), frames)


def _depth(shift: FloatArray) -> float:
    """How far the hub's level ground lies below a frame, by the hub's height."""
    return max(LEAST_DEPTH, 1.0 + float(shift[2]))


def _heading(T_local_cam: FloatArray) -> FloatArray:
    right = T_local_cam[:3, 0] * np.array([1.0, 1.0, 0.0])
    return right if np.linalg.norm(right) > 0.1 else np.array([1.0, 0.0, 0.0])


def _drawn(view: View, frame: PosedFrame, grey: Image, model: CameraModel) -> tuple[Image, NDArray[np.bool_]]:
    picture, seen = view.render(grey, model, frame.T_local_cam[:3, :3])
    smooth = np.asarray(cv2.GaussianBlur(picture, (0, 0), SMOOTHING_PX), dtype=np.uint8)
    inner = cv2.erode(seen.astype(np.uint8), np.ones((2 * BORDER_PX + 1,) * 2, np.uint8), borderValue=0) > 0
    return as_bytes(evened(smooth)), inner


def corners_of(picture: Image, seen: NDArray[np.bool_], spacing: int) -> FloatArray:
    """(N, 2) the best corner of each cell of `spacing` pixels."""
    strength = cv2.cornerMinEigenVal(picture, 5) * np.where(seen, np.float32(1), np.float32(0))
    h, w = (n // spacing * spacing for n in strength.shape)
    blocks = strength[:h, :w].reshape(h // spacing, spacing, w // spacing, spacing).swapaxes(1, 2)
    cells = blocks.reshape(h // spacing, w // spacing, spacing * spacing)
    at, best = cells.argmax(2), cells.max(2)
    row, column = np.nonzero(best > LEAST_EIGENVALUE)
    inner = at[row, column]
    return np.column_stack([column * spacing + inner % spacing, row * spacing + inner // spacing]).astype(np.float64)


def lucas_kanade(
    a: Image, b: Image, at: FloatArray, start: FloatArray, window_px: int = WINDOW_PX, levels: int = LEVELS
) -> tuple[NDArray[np.bool_], FloatArray, FloatArray]:
    """Which corners (N, 2) of `a` come back when followed to `b` and back from `start` (N, 2), where these are in `b`, and by how
    many grey levels their windows differ (mean)."""
    if not len(at):
        return np.zeros(0, np.bool_), np.zeros((0, 2)), np.zeros(0)
    options = {"winSize": (window_px, window_px), "maxLevel": levels, "flags": cv2.OPTFLOW_USE_INITIAL_FLOW}
    here = np.ascontiguousarray(at[:, None], dtype=np.float32)
    there, forth, unlike = cv2.calcOpticalFlowPyrLK(a, b, here, start[:, None].astype(np.float32), **options)  # type: ignore[call-overload]
    again, back, _ = cv2.calcOpticalFlowPyrLK(b, a, there, here.copy(), **options)  # type: ignore[call-overload]
    returned = np.hypot(*(again - here)[:, 0].T) < RETURN_PX
    kept = np.asarray(returned & (forth.ravel() > 0) & (back.ravel() > 0), dtype=np.bool_)
    return kept, np.asarray(there[kept, 0], dtype=np.float64), np.asarray(unlike.ravel()[kept], dtype=np.float64)


def _within(pix: FloatArray, seen: NDArray[np.bool_]) -> NDArray[np.bool_]:
    at = np.round(pix).astype(int)
    inside = (at >= 0).all(1) & (at[:, 0] < seen.shape[1]) & (at[:, 1] < seen.shape[0])
    at = np.where(inside[:, None], at, 0)
    return np.asarray(inside & seen[at[:, 1], at[:, 0]], dtype=np.bool_)


def _normalised(view: View, T_local_cam: FloatArray, pix: FloatArray) -> FloatArray:
    d = view.rays(pix) @ view.R_local_view.T @ T_local_cam[:3, :3]
    return np.asarray(d[:, :2] / d[:, 2:3], dtype=np.float64)
