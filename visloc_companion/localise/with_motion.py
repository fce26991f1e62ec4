"""A localiser whose answers also say how the camera moved since a frame before: odometry from the frames that it is asked about.

The compass may be off by degrees for minutes, which turns every displacement alike. A fix says by how much: what recent fixes
agree on is taken off the attitude that the odometry is given.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import replace
from statistics import median

import numpy as np

from visloc_companion.errors import OutsideMap
from visloc_companion.geo.se3 import R_from_quat, quat_multiply
from visloc_companion.localise.flow import FrameToFrame
from visloc_companion.localise.odometry.base import FlowSettings, Sight, Step, Surface
from visloc_companion.localise.plan import LocalFrame, local_frame
from visloc_companion.localise.pose import heading_and_tilt
from visloc_companion.protocols import Localiser, ReferenceMap
from visloc_companion.types import CameraModel, Fix, Image, LocaliseRequest, NoFix, Odometry, Quat, ReferencePatch

REACH_HEIGHTS = 1.6
"""Half side of the map's window in heights above the ground: what a camera sees that is tilted by 45 degrees, nearly."""
WINDOW_PX = 200
KEPT_SHARE = 0.4
"""A window serves as long as the camera stays within this share of its half side from its middle."""
HEADINGS = 5
HEADING_AGE_NS = 60_000_000_000
SURE = 0.01
LEARNED_YAW_SIGMA_RAD = math.radians(1.0)
"""1-sigma of the heading that recent fixes corrected."""


class WithMotion:
    """protocols.Localiser: asks another one and adds `motion` to its answer where the camera's motion is seen."""

    def __init__(self, localiser: Localiser, model: CameraModel, settings: FlowSettings | None = None) -> None:
        self._localiser = localiser
        self._flow = FrameToFrame(model, settings)
        self._window: tuple[ReferencePatch, float] | None = None
        self._headings: deque[tuple[int, float]] = deque(maxlen=HEADINGS)

    @property
    def method(self) -> str:
        """Name of the localiser that answers."""
        return self._localiser.method

    def localise(self, request: LocaliseRequest, pixels: Image, ref: ReferenceMap) -> Fix | NoFix:
        """The other localiser's answer, with the camera's motion."""
        found = self._localiser.localise(request, pixels, ref)
        if isinstance(found, Fix) and found.t_ns == request.frame.t_ns and found.probability_wrong <= SURE:
            heading, _ = heading_and_tilt(R_from_quat(found.q_ned_frd), R_from_quat(request.prior.q_ned_frd))
            self._headings.append((found.t_ns, heading))
        motion = self._motion(request, pixels, ref)
        return found if motion is None else replace(found, motion=motion)

    def _motion(self, request: LocaliseRequest, pixels: Image, ref: ReferenceMap) -> Odometry | None:
        prior = request.prior
        frame = local_frame(prior.place, ref)
        surface = self._surface(request, ref, frame)
        if surface is None:
            return None
        q_ned_frd, sigma_yaw_rad = self._attitude(request)
        (nn, ne), (_, ee) = prior.cov_ne_m2
        sight = Sight(
            pixels,
            request.frame.t_ns,
            q_ned_frd,
            prior.sigma_tilt_rad,
            sigma_yaw_rad,
            prior.place.h_amsl_m,
            prior.sigma_h_m,
            (0.0, 0.0),
            math.sqrt((nn + ee) / 2 + math.hypot((nn - ee) / 2, ne)),
        )
        step = self._flow.step(sight, surface)
        return step.odometry if isinstance(step, Step) else None

    def _attitude(self, request: LocaliseRequest) -> tuple[Quat, float]:
        """The prior's attitude without what recent fixes found wrong with its heading, and 1-sigma of what is left."""
        prior, now_ns = request.prior, request.frame.t_ns
        recent = [heading for t_ns, heading in self._headings if 0 <= now_ns - t_ns <= HEADING_AGE_NS]
        if len(recent) < HEADINGS:
            return prior.q_ned_frd, prior.sigma_yaw_rad
        half = median(recent) / 2
        turned = quat_multiply((math.cos(half), 0.0, 0.0, math.sin(half)), prior.q_ned_frd)
        return turned, min(prior.sigma_yaw_rad, LEARNED_YAW_SIGMA_RAD)

    def _surface(self, request: LocaliseRequest, ref: ReferenceMap, frame: LocalFrame) -> Surface | None:
        """The surface about the camera, about its believed place; None off the map."""
        at = np.array(frame.to_map(np.zeros(2)))
        if self._window is None or float(np.abs(at - _middle(self._window[0])).max()) > KEPT_SHARE * self._window[1]:
            try:
                self._window = _window(request, ref, at)
            except OutsideMap:
                self._window = None
        if self._window is None:
            return None
        patch = self._window[0]
        heights = np.where(patch.valid & np.isfinite(patch.dsm_amsl_m), patch.dsm_amsl_m, np.nan).astype(np.float32)
        return Surface(heights, frame.A_ne_pix(patch.T_map_pix))


def _window(request: LocaliseRequest, ref: ReferenceMap, at_map_m: np.ndarray) -> tuple[ReferencePatch, float] | None:
    """The map about a place, and its half side in metres. Raises OutsideMap."""
    centre = (float(at_map_m[0]), float(at_map_m[1]))
    below = ref.patch(centre, (3, 3), ref.gsd_m, 0.0).dsm_amsl_m
    known = below[np.isfinite(below)]
    if not len(known):
        return None
    half_m = REACH_HEIGHTS * max(10.0, request.prior.place.h_amsl_m - float(np.median(known)))
    gsd_m = max(ref.gsd_m, 2 * half_m / WINDOW_PX)
    side = math.ceil(2 * half_m / gsd_m) + 1
    return ref.patch(centre, (side, side), gsd_m, 0.0), half_m


def _middle(patch: ReferencePatch) -> np.ndarray:
    """Map coordinates of a window's middle."""
    height, width = patch.valid.shape
    return np.asarray(patch.T_map_pix @ np.array([(width - 1) / 2, (height - 1) / 2, 1.0]))
