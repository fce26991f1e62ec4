"""The frames that were asked about lately: what motion stereo is made from in flight."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from visloc_companion.geo.camera import R_FRD_CAM
from visloc_companion.geo.se3 import R_from_quat
from visloc_companion.geo.wgs84 import distance_m, ned_from_geo
from visloc_companion.localise.pose import LEAST_SIGMA
from visloc_companion.localise.structure.base import PosedFrame
from visloc_companion.localise.structure.registered_pose import NED_ENU
from visloc_companion.types import FloatArray, GeoPoint, Image, LocaliseRequest, PosePrior

MOST_FRAMES = 8
MAX_AGE_NS = 12_000_000_000
SPACING = 0.12
"""Frames are kept this share of the height apart: eight of them see twice the ground of one, and the second gives a base."""
SIGMA_RELATIVE_M = 0.5
"""1-sigma of each axis of a prior's place relative to that of a moment before, where its variance stayed as it was."""


@dataclass(frozen=True, slots=True, eq=False)
class Seen:
    """A frame with the request that it came with."""

    request: LocaliseRequest
    pixels: Image

    @property
    def prior(self) -> PosePrior:
        """Where it was believed to be taken."""
        return self.request.prior


class FrameHistory:
    """Frames in the order taken, each far enough from the one before; the newest is always there."""

    def __init__(self) -> None:
        self._seen: list[Seen] = []

    def add(self, request: LocaliseRequest, pixels: Image, height_m: float) -> None:
        """Remember a frame (its pixels are copied); one with an earlier time than the last starts anew."""
        t_ns = request.frame.t_ns
        if self._seen and t_ns <= self._seen[-1].request.frame.t_ns:
            self._seen.clear()
        near = SPACING * height_m
        if len(self._seen) > 1 and distance_m(self._seen[-1].prior.place, self._seen[-2].prior.place) < near:
            self._seen.pop()
        self._seen.append(Seen(request, pixels.copy()))
        self._seen = [seen for seen in self._seen if t_ns - seen.request.frame.t_ns <= MAX_AGE_NS][-MOST_FRAMES:]

    def frames(self) -> tuple[Seen, ...]:
        """The oldest first."""
        return tuple(self._seen)


def posed(seen: Sequence[Seen], origin: GeoPoint, surface_amsl_m: float, sigma_height_m: float) -> list[PosedFrame]:
    """Frames in east, north, up about `origin` (its height counts as zero), each as high above the surface as it was then: a
    vehicle may climb between them."""
    sigma_m = relative_sigma_m([s.prior for s in seen])
    return [
        PosedFrame(
            s.pixels,
            _pose(s.prior, origin),
            sigma_m,
            max(s.prior.sigma_tilt_rad, LEAST_SIGMA),
            max(s.prior.sigma_yaw_rad, LEAST_SIGMA),
            s.prior.place.h_amsl_m - surface_amsl_m,
            sigma_height_m,
        )
        for s in seen
    ]


def _pose(prior: PosePrior, origin: GeoPoint) -> FloatArray:
    T = np.eye(4)
    T[:3, :3] = NED_ENU.T @ R_from_quat(prior.q_ned_frd) @ R_FRD_CAM
    T[:3, 3] = NED_ENU.T @ np.array(ned_from_geo(prior.place, origin))
    return T


def relative_sigma_m(priors: Sequence[PosePrior]) -> float:
    """1-sigma of each axis of a place relative to those of the other frames.

    Between two frames a filter's variance grows by what it lost, and shrinks by the mean square of what a measurement corrected:
    an error that all of them share changes neither.
    """
    variance = [prior.cov_ne_m2[0][0] + prior.cov_ne_m2[1][1] for prior in priors]
    return math.sqrt(SIGMA_RELATIVE_M**2 + sum(abs(after - before) for before, after in pairwise(variance)))
