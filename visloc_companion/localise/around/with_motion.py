"""A localiser whose answers also say how the camera moved since a frame before: odometry from the frames that it is asked about.

The reported heading may be off by degrees, which turns every displacement alike. A fix says by how much: what recent fixes agree
on, carried on by what pictures show of turns since (odometry/true_heading.py), turns the displacement back.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from visloc_companion.errors import OutsideMap
from visloc_companion.geo.se3 import R_from_quat
from visloc_companion.localise.asking import Asking
from visloc_companion.localise.flow import FrameToFrame
from visloc_companion.localise.local_frame import LocalFrame, local_frame
from visloc_companion.localise.odometry.base import FlowSettings, Sight, Step, Surface
from visloc_companion.localise.odometry.surface_window import SurfaceWindow
from visloc_companion.localise.odometry.true_heading import TrueHeading
from visloc_companion.localise.pose import heading_from
from visloc_companion.localise.ranged import fits, fits_height, is_plane
from visloc_companion.protocols import Localiser, ReferenceMap
from visloc_companion.types import CameraModel, Fix, FloatArray, Image, LocaliseRequest, NoFix, Odometry, PosePrior

GROUND_SIGMA_M, GROUND_SLOPE = 5.0, 0.03
"""1-sigma of the ground's height where the map ends or has none: relief, and how it goes on from where it was known last."""
SURE = 0.01


class WithMotion(Asking):
    """protocols.Localiser: asks another one and adds `motion` to its answer where the camera's motion is seen."""

    def __init__(
        self,
        localiser: Localiser,
        model: CameraModel,
        settings: FlowSettings | None = None,
        window: SurfaceWindow | None = None,
        heading: TrueHeading | None = None,
    ) -> None:
        super().__init__(localiser)
        self._flow = FrameToFrame(model, settings)
        self._window = window or SurfaceWindow()
        self._ground: tuple[FloatArray, float] | None = None
        self._heading = heading or TrueHeading()

    def localise(self, request: LocaliseRequest, pixels: Image, ref: ReferenceMap) -> Fix | NoFix:
        """The other localiser's answer, with the camera's motion."""
        found = self._localiser.localise(request, pixels, ref)
        if isinstance(found, Fix) and found.t_ns == request.frame.t_ns and found.probability_wrong <= SURE:
            turn_rad = heading_from(R_from_quat(found.q_ned_frd), R_from_quat(request.prior.q_ned_frd))
            self._heading.found(found.t_ns, turn_rad)
        motion = self._motion(request, pixels, ref)
        return found if motion is None else replace(found, motion=motion)

    def _motion(self, request: LocaliseRequest, pixels: Image, ref: ReferenceMap) -> Odometry | None:
        prior = request.believed
        try:
            frame = local_frame(prior.place, ref)
        except OutsideMap:
            return None
        surface = self._surface(prior, ref, frame)
        (nn, ne), (_, ee) = prior.cov_ne_m2
        sigma_place_m = math.sqrt((nn + ee) / 2 + math.hypot((nn - ee) / 2, ne))
        beam = request.beam
        if beam is not None and surface is not None:
            about = prior.place.h_amsl_m, prior.sigma_h_m, sigma_place_m, prior.sigma_tilt_rad
            beam = beam if fits(beam, *about, surface) else None
            surface = None if beam is not None and is_plane(surface) else surface
        height_m, sigma_height_m = self._above_last_ground(prior, frame) if surface is None else (math.nan, math.inf)
        beam_ne_m = (0.0, 0.0)
        if beam is not None and not fits_height(beam, height_m, sigma_height_m):
            beam = None
        if beam is not None:
            north, east, height_m = beam.end_ned_m
            sigma_height_m, beam_ne_m = beam.sigma_m, (north, east)
        if surface is None and not math.isfinite(sigma_height_m):
            return None
        sight = Sight(
            pixels,
            request.frame.t_ns,
            prior.q_ned_frd,
            prior.sigma_tilt_rad,
            prior.sigma_yaw_rad,
            prior.place.h_amsl_m,
            prior.sigma_h_m,
            (0.0, 0.0),
            sigma_place_m,
            height_m,
            sigma_height_m,
            beam is not None,
            beam_ne_m,
            up_added_m=prior.height_offset_m,
        )
        step = self._flow.step(sight, surface)
        return self._turned(step.odometry) if isinstance(step, Step) else None

    def _turned(self, seen: Odometry) -> Odometry:
        """A displacement turned by what recent fixes found wrong with the heading.

        The displacement, not the attitude that the odometry is given: that must not change while it follows a keyframe. The
        keyframe's heading, for how the camera turned since is solved for with the displacement.
        """
        heading = self._heading.at(seen.t_from_ns, seen.t_to_ns)
        if heading is None:
            return seen
        c, s = math.cos(heading.turn_rad), math.sin(heading.turn_rad)
        turn = np.array([[c, -s], [s, c]])
        north, east, down = seen.displacement_ned_m
        sigma = min(seen.sigma_heading_rad, heading.sigma_rad)
        across = np.array([-east, north])
        known = (seen.sigma_heading_rad**2 - sigma**2) * np.outer(across, across)
        cov = turn @ (np.array(seen.cov_ne_m2) - known) @ turn.T
        n, e = (turn @ np.array([north, east])).tolist()
        focal_n, focal_e = (turn @ np.array(seen.per_focal_ne_m)).tolist()
        return replace(
            seen,
            displacement_ned_m=(n, e, down),
            cov_ne_m2=((float(cov[0, 0]), float(cov[0, 1])), (float(cov[0, 1]), float(cov[1, 1]))),
            sigma_heading_rad=sigma,
            per_focal_ne_m=(focal_n, focal_e),
        )

    def _above_last_ground(self, prior: PosePrior, frame: LocalFrame) -> tuple[float, float]:
        """Height over the ground as it was known last, and its 1-sigma; NaN and infinity where it never was."""
        if self._ground is None:
            return math.nan, math.inf
        place_map, ground_amsl_m = self._ground
        away_m = float(np.linalg.norm(np.linalg.solve(frame.J_map_ne, place_map - frame.origin_map)))
        sigma_m = math.hypot(prior.sigma_h_m, GROUND_SIGMA_M, GROUND_SLOPE * away_m)
        return prior.place.h_amsl_m - ground_amsl_m, sigma_m

    def _surface(self, prior: PosePrior, ref: ReferenceMap, frame: LocalFrame) -> Surface | None:
        """The surface about the camera, about its believed place; None off the map."""
        surface = self._window.about(prior.place.h_amsl_m, ref, frame)
        if surface is not None:
            self._ground = np.array(frame.to_map(np.zeros(2))), self._window.ground_amsl_m
        return surface
