"""A guess of a frame's pose, and the prior that it narrows: what was known better than the guess stays as it was."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from visloc_companion.geo.camera import R_FRD_CAM
from visloc_companion.geo.se3 import R_from_quat, quat_from_R
from visloc_companion.geo.wgs84 import ned_from_geo
from visloc_companion.localise.candidates.attitude_search import Candidate
from visloc_companion.localise.local_frame import LocalFrame
from visloc_companion.localise.plan import turned
from visloc_companion.localise.pose import heading_and_tilt, heading_from
from visloc_companion.protocols import ReferenceMap
from visloc_companion.types import Fix, GeoPoint, PosePrior, Quat

LEAST_RAD, LEAST_M = math.radians(0.5), 1.0
"""No prior is held to be surer than that of angles, and of the height, when an answer is compared with it."""


@dataclass(frozen=True, slots=True)
class Guess:
    """Place and attitude of the camera's body, height above the ground and side of the footprint (m)."""

    place: GeoPoint
    q_ned_frd: Quat
    agl_m: float
    side_m: float


@dataclass(frozen=True, slots=True)
class Spread:
    """What a guess leaves open (1-sigma): place as a share of the footprint's side, height as one of that above ground."""

    place_share: float
    height_share: float
    yaw_rad: float
    tilt_rad: float


FROM_SEARCH = Spread(0.12, 0.06, math.radians(6.0), math.radians(9.0))
FROM_ANSWER = Spread(0.05, 0.03, math.radians(3.0), math.radians(6.0))


def guess_of_candidate(candidate: Candidate, frame: LocalFrame, ref: ReferenceMap) -> Guess:
    """The guess of a search."""
    lat, lon = ref.to_geo(*frame.to_map(candidate.pose.p_ned_m[:2]))
    place = GeoPoint(float(lat), float(lon), -float(candidate.pose.p_ned_m[2]))
    return Guess(place, quat_from_R(candidate.pose.R_ned_cam @ R_FRD_CAM.T), candidate.agl_m, candidate.side_m)


def guess_of_fix(fix: Fix, side_m: float, ground_up_m: float) -> Guess:
    """The guess that an answer is for the next one."""
    return Guess(fix.place, fix.q_ned_frd, max(1.0, fix.place.h_amsl_m - ground_up_m), side_m)


def narrowed(prior: PosePrior, guess: Guess, known: Spread) -> PosePrior:
    """The prior about a guess. Height and tilt that the prior knows better are the prior's own."""
    variance = (known.place_share * guess.side_m) ** 2
    sigma_h_m = known.height_share * guess.agl_m
    h_amsl_m = guess.place.h_amsl_m
    if prior.sigma_h_m < sigma_h_m:
        sigma_h_m, h_amsl_m = prior.sigma_h_m, prior.place.h_amsl_m
    return replace(
        prior,
        place=replace(guess.place, h_amsl_m=h_amsl_m),
        q_ned_frd=_attitude(prior, guess, known),
        cov_ne_m2=((variance, 0.0), (0.0, variance)),
        sigma_h_m=sigma_h_m,
        sigma_yaw_rad=min(prior.sigma_yaw_rad, known.yaw_rad),
        sigma_tilt_rad=min(prior.sigma_tilt_rad, known.tilt_rad),
        within_m=None,
    )


def prior_sigmas(fix: Fix, prior: PosePrior) -> float:
    """How far an answer is from a prior, in 1-sigma: the largest of place, height, heading and tilt."""
    north, east, down = ned_from_geo(fix.place, prior.place)
    offset = np.array([north, east])
    place = math.sqrt(float(offset @ np.linalg.solve(np.array(prior.cov_ne_m2) + np.eye(2), offset)))
    heading, tilt = heading_and_tilt(R_from_quat(fix.q_ned_frd), R_from_quat(prior.q_ned_frd))
    return max(
        place,
        abs(down) / max(prior.sigma_h_m, LEAST_M),
        abs(heading) / max(prior.sigma_yaw_rad, LEAST_RAD),
        float(np.linalg.norm(tilt)) / max(prior.sigma_tilt_rad, LEAST_RAD),
    )


def _attitude(prior: PosePrior, guess: Guess, known: Spread) -> Quat:
    """The guess's attitude; where the prior knows the tilt better, the prior's, turned to the guess's heading."""
    if prior.sigma_tilt_rad > known.tilt_rad:
        return guess.q_ned_frd
    R_guess, R_prior = R_from_quat(guess.q_ned_frd), R_from_quat(prior.q_ned_frd)
    heading = heading_from(R_guess, R_prior)
    return quat_from_R(turned(R_prior, heading))
