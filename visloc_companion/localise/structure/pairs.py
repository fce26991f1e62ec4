"""Which frames make stereo: a middle frame and its partners, chosen from poses and height alone."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from visloc_companion.errors import Reason
from visloc_companion.geo.camera import project, unproject
from visloc_companion.localise.structure.base import NoCloud, PosedFrame, StereoSettings
from visloc_companion.localise.structure.view import FARTHEST
from visloc_companion.types import CameraModel, FloatArray

GRID = 24
"""The ground under a frame is sampled by so many points each way."""
ENOUGH_SHARE = 0.75
"""Of the largest preferred base: beyond it heights gain little, and crowns look too different to be matched."""
TURNED_RAD = math.radians(3.0)
"""Frames of one place that differ by more than this were turned, not merely held."""


@dataclass(frozen=True, slots=True)
class Star:
    """A frame and those that are matched with it, by number, with what they have in common."""

    hub: int
    partners: tuple[int, ...]
    overlap: tuple[float, ...]
    base_to_height: tuple[float, ...]


@dataclass(frozen=True, slots=True, eq=False)
class _Pair:
    overlap: float
    base_to_height: float
    seen: NDArray[np.bool_]
    worth: float


def choose(frames: Sequence[PosedFrame], model: CameraModel, settings: StereoSettings) -> Star | NoCloud:
    """The frame whose partners cover most of it at good angles. Refuses hovering, turning on the spot and too little overlap."""
    pairs = {(i, j): _pair(frames, i, j, model, settings) for i in range(len(frames)) for j in range(len(frames)) if i != j}
    best: tuple[float, Star] | None = None
    for hub in range(len(frames)):
        usable = {j: pairs[hub, j] for j in range(len(frames)) if j != hub and pairs[hub, j].worth > 0}
        chosen: list[int] = []
        covered, total = np.zeros(GRID * GRID, np.bool_), 0.0
        while usable and len(chosen) < settings.max_partners:
            gain = {j: p.worth * (0.1 * p.overlap + float((p.seen & ~covered).mean())) for j, p in usable.items()}
            j = max(gain, key=lambda k: (gain[k], -k))
            total += gain[j]
            covered |= usable.pop(j).seen
            chosen.append(j)
        if chosen and (best is None or total > best[0] + 1e-9):
            taken = [pairs[hub, j] for j in chosen]
            star = Star(hub, tuple(chosen), tuple(p.overlap for p in taken), tuple(p.base_to_height for p in taken))
            best = total, star
    return best[1] if best else _refusal(frames, list(pairs.values()), settings)


def _pair(frames: Sequence[PosedFrame], i: int, j: int, model: CameraModel, settings: StereoSettings) -> _Pair:
    a, b = frames[i], frames[j]
    ground = ground_under(a, model)
    inside = _inside(ground, b, model)
    overlap = float(inside.mean())
    ratio = float(np.hypot(*(b.T_local_cam[:2, 3] - a.T_local_cam[:2, 3]))) / a.height_m
    if overlap < settings.min_overlap or not settings.base_to_height[0] <= ratio <= settings.max_base_to_height:
        return _Pair(overlap, ratio, inside, 0.0)
    low, high = settings.overlap
    beyond = max(0.0, ratio / settings.base_to_height[1] - 1, overlap / high - 1, low / overlap - 1)
    wide = ENOUGH_SHARE * settings.base_to_height[1]
    return _Pair(overlap, ratio, inside, math.sqrt(min(1.0, ratio / wide)) / (1 + 2 * beyond))


def ground_under(frame: PosedFrame, model: CameraModel) -> FloatArray:
    """(GRID², 3) where a grid over the frame meets the level plane `height_m` below it; flat rays are cut short."""
    u, v = np.linspace(0, model.width_px - 1, GRID), np.linspace(0, model.height_px - 1, GRID)
    pix = np.stack(np.meshgrid(u, v), -1).reshape(-1, 2)
    d = unproject(model, pix) @ frame.T_local_cam[:3, :3].T
    descent = np.maximum(-d[:, 2], np.hypot(d[:, 0], d[:, 1]) / FARTHEST)
    horizontal = frame.T_local_cam[:2, 3] + d[:, :2] / descent[:, None] * frame.height_m
    return np.column_stack([horizontal, np.full(len(d), frame.T_local_cam[2, 3] - frame.height_m)])


def _inside(points: FloatArray, frame: PosedFrame, model: CameraModel) -> NDArray[np.bool_]:
    """Which points a frame sees. Points far outside its field are left out before the lens's polynomial can fold them back."""
    cam = (points - frame.T_local_cam[:3, 3]) @ frame.T_local_cam[:3, :3]
    corners = unproject(model, np.array([[0.0, 0.0], [model.width_px - 1.0, model.height_px - 1.0]]))
    limit = 1.1 * np.abs(corners[:, :2]).max(0)
    near = (cam[:, 2] > 1e-6) & (np.abs(cam[:, :2]) <= limit * np.maximum(cam[:, 2:3], 0)).all(1)
    pix = project(model, cam)
    size = np.array([model.width_px - 1, model.height_px - 1])
    with np.errstate(invalid="ignore"):
        return np.asarray(near & (pix >= 0).all(1) & (pix <= size).all(1), dtype=np.bool_)


def _refusal(frames: Sequence[PosedFrame], pairs: list[_Pair], settings: StereoSettings) -> NoCloud:
    widest = max(p.base_to_height for p in pairs)
    most = max((p.overlap for p in pairs if p.base_to_height >= settings.base_to_height[0]), default=0.0)
    evidence = (("base_to_height", widest), ("overlap", most))
    if widest < settings.base_to_height[0]:
        R = [f.T_local_cam[:3, :3] for f in frames]
        turned = max(math.acos(float(np.clip((np.trace(a.T @ b) - 1) / 2, -1, 1))) for a in R for b in R)
        if turned > TURNED_RAD:
            return NoCloud(Reason.NO_PARALLAX, f"rotation only: {math.degrees(turned):.0f}° on a base of {widest:.3f}", evidence)
        return NoCloud(Reason.NO_BASELINE, f"hover: base is {widest:.3f} of the height", evidence)
    return NoCloud(Reason.LOW_OVERLAP, f"no pair overlaps by {settings.min_overlap:.0%} on a usable base", evidence)
