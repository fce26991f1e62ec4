"""Which frames make stereo: a middle frame and its partners, and further ones where more ground was overflown. Chosen from poses
and height alone."""

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
SHARED_TOO = 0.1
"""What ground that another partner of the first star sees as well is worth, of what new ground is."""
ENOUGH_SHARE = 0.75
"""Of the largest preferred base: beyond it heights gain little, and crowns look too different to be matched."""
TURNED_RAD = math.radians(3.0)
"""Frames of one place that differ by more than this were turned, not merely held."""
LEAST_NEW = 0.08
"""Share of a frame's ground that a further star has to add."""


@dataclass(frozen=True, slots=True)
class Star:
    """A frame and those that are matched with it, by number, with what they have in common.

    The first partner of a further star is the hub of the star that it goes on from: the two share that base, and so one scale.
    """

    hub: int
    partners: tuple[int, ...]
    overlap: tuple[float, ...]
    base_to_height: tuple[float, ...]

    def of(self, wanted: Sequence[bool]) -> Star:
        """With these of its partners alone."""
        kept = [k for k, want in enumerate(wanted) if want]
        ratio = tuple(self.base_to_height[k] for k in kept)
        return Star(self.hub, tuple(self.partners[k] for k in kept), tuple(self.overlap[k] for k in kept), ratio)


@dataclass(frozen=True, slots=True, eq=False)
class _Pair:
    overlap: float
    base_to_height: float
    seen: NDArray[np.bool_]
    worth: float


Pairs = dict[tuple[int, int], _Pair]


def choose(frames: Sequence[PosedFrame], model: CameraModel, settings: StereoSettings) -> tuple[Star, ...] | NoCloud:
    """The frame whose partners cover most of it at good angles, then stars that go on from there over new ground.

    Refuses hovering, turning on the spot and too little overlap.
    """
    number = range(len(frames))
    pairs = {(i, j): _pair(frames, i, j, model, settings) for i in number for j in number if i != j}
    best: tuple[float, Star] | None = None
    for hub in number:
        total, chosen = _partners(pairs, hub, settings.max_partners, np.zeros(GRID * GRID, np.bool_), SHARED_TOO)
        if chosen and (best is None or total > best[0] + 1e-9):
            best = total, _star(pairs, hub, chosen)
    if best is None:
        return _refusal(frames, list(pairs.values()), settings)
    stars = [best[1]]
    while len(stars) < settings.max_stars:
        further = _further(frames, pairs, stars, model, settings)
        if further is None:
            break
        stars.append(further)
    return tuple(stars)


def _star(pairs: Pairs, hub: int, partners: list[int]) -> Star:
    taken = [pairs[hub, j] for j in partners]
    return Star(hub, tuple(partners), tuple(p.overlap for p in taken), tuple(p.base_to_height for p in taken))


def _partners(pairs: Pairs, hub: int, most: int, covered: NDArray[np.bool_], shared: float) -> tuple[float, list[int]]:
    """What the partners of a hub add to what is `covered` of its ground (GRID²,), weighed by their worth, and these partners.

    `shared`: how much ground that is covered already is worth.
    """
    usable = {j: pair for (i, j), pair in pairs.items() if i == hub and pair.worth > 0}
    chosen: list[int] = []
    covered, total = covered.copy(), 0.0
    while usable and len(chosen) < most:
        gain = {j: p.worth * (shared * p.overlap + float((p.seen & ~covered).mean())) for j, p in usable.items()}
        j = max(gain, key=lambda k: (gain[k], -k))
        if gain[j] <= 0:
            break
        total += gain[j]
        covered |= usable.pop(j).seen
        chosen.append(j)
    return total, chosen


def _further(
    frames: Sequence[PosedFrame], pairs: Pairs, stars: list[Star], model: CameraModel, settings: StereoSettings
) -> Star | None:
    """The partner of a star that, as a hub itself, adds most ground that no star has; None where all add little."""
    hubs = {star.hub for star in stars}
    best: tuple[float, Star] | None = None
    for star in stars:
        for hub in star.partners:
            if hub in hubs or pairs[hub, star.hub].worth <= 0:
                continue
            ground = ground_under(frames[hub], model)
            covered = np.logical_or.reduce([_covered(ground, frames, pairs_of, model) for pairs_of in stars])
            total, chosen = _partners(pairs, hub, settings.max_partners - 1, covered, 0.0)
            if total > max(LEAST_NEW, best[0] if best else 0.0):
                best = total, _star(pairs, hub, [star.hub, *chosen])
    return best[1] if best else None


def _covered(ground: FloatArray, frames: Sequence[PosedFrame], star: Star, model: CameraModel) -> NDArray[np.bool_]:
    """Which points (N, 3) the hub of a star and one of its partners see."""
    by_partner = np.logical_or.reduce([_inside(ground, frames[j], model) for j in star.partners])
    return np.asarray(by_partner & _inside(ground, frames[star.hub], model), dtype=np.bool_)


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
