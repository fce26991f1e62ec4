"""A keyframe's corners found again in another frame, which is drawn as the keyframe's camera would have seen it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from visloc_companion.localise.odometry.below import descends
from visloc_companion.localise.odometry.keyframe import Keyframe, seen_at
from visloc_companion.localise.odometry.picture import Picture, plane_homography, shift_between, through, warped
from visloc_companion.localise.structure.tracks import lucas_kanade
from visloc_companion.types import FloatArray

WINDOW_PX = 21
LEVELS = 3


@dataclass(frozen=True, slots=True, eq=False)
class Followed:
    """Numbers of the corners that were found again, normalised coordinates (M, 2) in the frame, the share of the keyframe's
    corners that should be in view, and by how many grey levels of the evened pictures what was found differs (median)."""

    number: NDArray[np.intp]
    xy: FloatArray
    overlap: float
    unlike: float


def follow(key: Keyframe, picture: Picture, R_ned_cam: FloatArray, d_ned_m: FloatArray, least_overlap: float) -> Followed:
    """The keyframe's corners in a frame that is about `d_ned_m` away from it. With little in view nothing is looked for."""
    H = plane_homography(key.picture.K, key.R_ned_cam, R_ned_cam, d_ned_m, key.height_m)
    there = seen_at(picture, R_ned_cam, key.ground.at_ned_m - d_ned_m)
    size = np.array(key.picture.size)
    in_view = ((there >= 0) & (there < size)).all(1)
    overlap = float(in_view.mean())
    if overlap < least_overlap:
        return Followed(np.zeros(0, np.intp), np.zeros((0, 2)), overlap, 0.0)
    drawn, seen = warped(picture, H)
    start = through(np.asarray(np.linalg.inv(H), dtype=np.float64), there)
    at = np.flatnonzero(in_view & _inside(start, size))
    kept, found, unlike = lucas_kanade(key.picture.grey, drawn, key.corners[at], start[at], WINDOW_PX, LEVELS)
    pix = np.round(found).astype(int)
    good = _inside(found, size - 0.5)
    good[good] = seen[pix[good, 1], pix[good, 0]]
    differs = float(np.median(unlike)) if len(unlike) else 0.0
    return Followed(at[kept][good], picture.normalised(through(H, found[good])), overlap, differs)


def first_guess(key: Keyframe, picture: Picture, R_ned_cam: FloatArray, d_ned_m: FloatArray) -> FloatArray | None:
    """(3,) displacement by the whole picture's shift against what `d_ned_m` would make; None where nothing stands out."""
    H = plane_homography(key.picture.K, key.R_ned_cam, R_ned_cam, d_ned_m, key.height_m)
    shift = shift_between(key.picture.grey, warped(picture, H)[0])
    if shift is None:
        return None
    middle = np.array(key.picture.size) / 2.0
    rays = key.picture.rays(np.vstack([middle, middle + shift])) @ key.R_ned_cam.T
    if not descends(rays).all():
        return None
    on_plane_m = rays * (key.height_m / rays[:, 2:3])
    return np.asarray(d_ned_m + on_plane_m[0] - on_plane_m[1], dtype=np.float64)


def _inside(pix: FloatArray, size: FloatArray | NDArray[np.intp]) -> NDArray[np.bool_]:
    return np.asarray(((pix >= 0) & (pix < size)).all(1), dtype=np.bool_)
