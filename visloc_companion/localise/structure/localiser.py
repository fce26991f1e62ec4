"""The structure localiser: motion stereo of the last frames, registered to the map's shape, then the camera's pose by PnP.

It looks at no colour of the map, so it fails for other reasons than the image localisers do. Its answer is for the latest frame
that the cloud was made from, which may be an earlier one than the request's.
"""

from __future__ import annotations

import math

import numpy as np

from visloc_companion.core.covariance import largest_sigma_m
from visloc_companion.core.filter.propagation import ODOMETRY_HEADING_SIGMA_RAD
from visloc_companion.errors import MapError, OutsideMap, Reason
from visloc_companion.geo.camera import R_FRD_CAM
from visloc_companion.geo.se3 import R_from_quat
from visloc_companion.geo.wgs84 import ned_from_geo
from visloc_companion.localise.answer import Stopwatch, fix, no_fix
from visloc_companion.localise.frame import check_pixels
from visloc_companion.localise.plan import SearchPlan, planned
from visloc_companion.localise.pose import PriorTerm
from visloc_companion.localise.registration.base import NotRegistered, Registered, RegistrationMethod, RegistrationPrior
from visloc_companion.localise.settings import LocaliserSettings
from visloc_companion.localise.structure.base import LocalCloud, NoCloud, StereoSettings
from visloc_companion.localise.structure.claims import judged
from visloc_companion.localise.structure.cloud import local_cloud
from visloc_companion.localise.structure.history import FrameHistory, Seen, posed
from visloc_companion.localise.structure.registered_pose import pose_from_registration
from visloc_companion.protocols import ReferenceMap, ShapeMap
from visloc_companion.types import CameraModel, Fix, GeoPoint, Image, LocaliseRequest, NoFix, PosePrior

METHOD = "structure"
FEWEST_FRAMES = 2
REACH_SIGMAS = 3.0
MARGIN_M = 10.0
MOST_REFERENCE_POINTS = 800_000
"""All of a circle of 160 m: a plantation that was thinned to two thirds comes out 1.5 m lower on the mean (maps/cloud_tiles)."""
SIGMA_FAR_EDGE_M = 0.5
"""Roofs reach 0.5 to 0.8 m farther out in stereo clouds where the camera does not see the ground behind them, and hardly where it
sees the wall (ray-cast houses, pixels of 0.4 m)."""
SURFACE_SHARE = 0.04
"""The surface below the camera is known to this share of the height above it: where the prior's error puts it, in another season
(seeds below 100 of benchmarks/structure_chain.py)."""
STEREO = StereoSettings(cell_m=0.5, min_completeness=0.05, max_sigma_share=0.01)
"""Points are no closer than the map's shape is known. Thin and noisy clouds (snow) go on: the registration is judged."""


class StructureLocaliser:
    """protocols.Localiser over several frames: `remember` each of them, and ask now and then.

    `register` is to answer whatever it finds (largest probability of being wrong 1): its answers are judged here.
    """

    method = METHOD

    def __init__(self, model: CameraModel, settings: LocaliserSettings, register: RegistrationMethod) -> None:
        self._model, self._settings, self._register = model, settings, register
        self._history = FrameHistory()
        self._stereo = STEREO

    def remember(self, request: LocaliseRequest, pixels: Image, ref: ReferenceMap) -> None:
        """Keep a frame for the clouds of later requests, if it shows anything: one that does not would have all of them refused,
        and one that does would have to give way to it."""
        if check_pixels(pixels, self._model) is not None:
            return
        place = request.prior.place
        try:
            surface = ref.height_amsl_m(*ref.to_map(place.lat_deg, place.lon_deg))
        except OutsideMap:  # where the map's CRS has no coordinates at all
            return
        height = place.h_amsl_m - surface
        if math.isfinite(height) and height > self._settings.min_height_m:
            self._history.add(request, pixels, height)

    def localise(self, request: LocaliseRequest, pixels: Image, ref: ReferenceMap) -> Fix | NoFix:
        """The pose of the latest frame of the cloud, or why there is none. `remember` must have had the frame."""
        watch = Stopwatch()
        if not isinstance(ref, ShapeMap):
            return no_fix(request, METHOD, watch, (Reason.BAD_INPUT, "the map has no shape to compare with"))
        plan = planned(request.prior, pixels, self._model, ref, self._settings, watch)
        if not isinstance(plan, SearchPlan):
            return no_fix(request, METHOD, watch, plan)
        lowest_amsl_m = plan.ground_up_m + self._settings.min_height_m  # those below looked at other ground, which lies lower
        seen = tuple(one for one in self._history.frames() if one.prior.place.h_amsl_m >= lowest_amsl_m)
        cloud = self._cloud(seen, plan, request.prior)
        if isinstance(cloud, NoCloud):
            return no_fix(request, METHOD, watch, (cloud.reason, cloud.detail), dict(cloud.evidence))
        registered = self._registered(cloud, plan, request, ref, watch)
        if not isinstance(registered, Registered):
            evidence = dict(cloud.evidence) | dict(registered.evidence)
            return no_fix(request, METHOD, watch, (registered.reason, registered.detail), evidence)
        return self._answer(request, seen[cloud.reference], cloud, registered, plan, ref, watch)

    def _cloud(self, seen: tuple[Seen, ...], plan: SearchPlan, prior: PosePrior) -> LocalCloud | NoCloud:
        """East, north of the plan's origin, up from the sea, as the priors have it."""
        if len(seen) < FEWEST_FRAMES:
            return NoCloud(Reason.NO_PARALLAX, "too few frames yet")
        sigma = math.hypot(prior.sigma_h_m, SURFACE_SHARE * plan.agl_m)
        return local_cloud(posed(seen, plan.frame.origin, plan.ground_up_m, sigma), self._model, self._stereo)

    def _registered(
        self, cloud: LocalCloud, plan: SearchPlan, request: LocaliseRequest, ref: ShapeMap, watch: Stopwatch
    ) -> Registered | NotRegistered | NoCloud:
        """The cloud's place in the map's upper surface, taken from wherever it may lie."""
        low, high = cloud.points_m[:, :2].min(0), cloud.points_m[:, :2].max(0)
        reach = min(REACH_SIGMAS * largest_sigma_m(request.prior.cov_ne_m2), self._settings.max_search_radius_m)
        radius = float(np.hypot(*(high - low))) / 2 + reach + MARGIN_M
        try:
            with watch:
                reference = ref.cloud_around(plan.frame.to_map((low + high)[::-1] / 2), radius, MOST_REFERENCE_POINTS)
        except (OutsideMap, MapError) as why:
            return NoCloud(Reason.OUTSIDE_MAP, why.what)
        found = self._register(cloud.points_m, reference + np.append((low + high) / 2, 0.0), _prior(cloud, request.prior))
        return judged(found, self._settings.max_probability_wrong) if isinstance(found, Registered) else found

    def _answer(
        self,
        request: LocaliseRequest,
        seen: Seen,
        cloud: LocalCloud,
        registered: Registered,
        plan: SearchPlan,
        ref: ReferenceMap,
        watch: Stopwatch,
    ) -> Fix | NoFix:
        """A fix at the time of the frame that the cloud's pixels are of."""
        evidence = dict(cloud.evidence) | dict(registered.evidence)
        pose = pose_from_registration(cloud, registered, self._model, _attitude(seen, plan.frame.origin))
        if isinstance(pose, NoCloud):
            return no_fix(request, METHOD, watch, (pose.reason, pose.detail), evidence)
        of_frame = LocaliseRequest(request.request_id, seen.request.frame, seen.prior, request.seed)
        sigma, p = self._settings.map_sigma_m, registered.probability_wrong
        return fix(of_frame, METHOD, watch, plan, ref, pose.pose, pose.covariance, p, sigma, evidence)


def _prior(cloud: LocalCloud, prior: PosePrior) -> RegistrationPrior:
    """How far the cloud may lie from where the frames' priors put it. Its heading is that of the way between its frames."""
    return RegistrationPrior(
        max(largest_sigma_m(prior.cov_ne_m2), 1.0),
        prior.sigma_h_m,
        math.hypot(cloud.sigma_yaw_rad, min(ODOMETRY_HEADING_SIGMA_RAD, prior.sigma_yaw_rad)),
        math.hypot(cloud.sigma_tilt_rad, prior.sigma_tilt_rad),
        cloud.sigma_scale,
        gaussian=True,
        sigma_far_edge_m=SIGMA_FAR_EDGE_M,
    )


def _attitude(seen: Seen, origin: GeoPoint) -> PriorTerm:
    """The autopilot's attitude and height of a frame; heights of `origin`'s frame are above the sea."""
    prior = seen.prior
    up = -ned_from_geo(prior.place, origin)[2]
    R = R_from_quat(prior.q_ned_frd) @ R_FRD_CAM
    return PriorTerm(R, prior.sigma_tilt_rad, prior.sigma_yaw_rad, up, prior.sigma_h_m)
