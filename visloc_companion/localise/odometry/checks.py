"""When there is no answer, and why."""

from __future__ import annotations

import math

import numpy as np

from visloc_companion.errors import Reason
from visloc_companion.geo.camera import R_FRD_CAM
from visloc_companion.geo.se3 import R_from_quat
from visloc_companion.localise.frame import check_pixels
from visloc_companion.localise.odometry.base import FlowSettings, Sight, Surface
from visloc_companion.localise.odometry.follow import Followed
from visloc_companion.localise.odometry.keyframe import Keyframe
from visloc_companion.localise.odometry.picture import Picture, plane_homography, through
from visloc_companion.localise.odometry.solve import Motion
from visloc_companion.localise.structure.sharpness import blur_px
from visloc_companion.localise.structure.tracks import corners_of
from visloc_companion.types import CameraModel, FloatArray

Refused = tuple[Reason, str]
MOST_TURN_SIGMAS = 5.0
STILL_PX, STILL_SHARE = 1.0, 0.4


def refused(
    sight: Sight, surface: Surface | None, model: CameraModel, limits: FlowSettings, newest_ns: int | None
) -> Refused | None:
    """What is wrong with a frame and what came with it, before anything is followed."""
    why = _of_input(sight, surface)
    if why is not None:
        return why
    if newest_ns is not None and sight.t_ns <= newest_ns:
        return Reason.IMPLAUSIBLE_TIME, "the frame is not newer than the last one"
    if float((R_from_quat(sight.q_ned_frd) @ R_FRD_CAM)[2, 2]) < math.cos(limits.max_tilt_rad):
        return Reason.HORIZON_IN_VIEW, f"tilted by more than {math.degrees(limits.max_tilt_rad):.0f} degrees"
    if surface is None and sight.height_m > limits.max_height_m:
        return (
            Reason.BAD_INPUT,
            f"the height above the surface is {sight.height_m:.0f} m, {limits.max_height_m:.0f} m is the most",
        )
    if surface is None and sight.height_m < limits.min_height_m:
        return Reason.TOO_LOW, f"{sight.height_m:.0f} m above the surface"
    return check_pixels(sight.pixels, model)


def _of_input(sight: Sight, surface: Surface | None) -> Refused | None:
    """Numbers that are missing or impossible."""
    if surface is None:
        asked: tuple[float, ...] = (sight.sigma_height_m, sight.height_m)
    else:
        asked = (sight.sigma_up_m, sight.sigma_place_m, *sight.place_ne_m)
        if not np.isfinite(surface.up_m).any():
            return Reason.OUTSIDE_MAP, "the surface that was given has no heights"
    if not all(math.isfinite(n) for n in (*sight.q_ned_frd, sight.sigma_tilt_rad, sight.sigma_yaw_rad, sight.up_m, *asked)):
        return Reason.BAD_INPUT, "attitude, altitude, height or place, or one of their sigmas, is not finite"
    if min(sight.sigma_tilt_rad, sight.sigma_yaw_rad, sight.sigma_up_m, sight.sigma_height_m, sight.sigma_place_m) < 0:
        return Reason.BAD_INPUT, "a sigma is negative"
    if abs(math.hypot(*sight.q_ned_frd) - 1.0) > 1e-3:
        return Reason.BAD_INPUT, "the attitude is not a unit quaternion"
    return None


def why_lost(sight: Sight, picture: Picture, followed: Followed, sought: int, limits: FlowSettings) -> Refused:
    """Why hardly a corner was found again."""
    if followed.overlap < limits.min_overlap:
        return Reason.LOW_OVERLAP, f"{100 * followed.overlap:.0f} % of the keyframe is in view"
    return _of_picture(sight, picture, limits) or (
        Reason.TOO_FEW_FEATURES,
        f"{len(followed.number)} of {sought} corners of the keyframe are found again in a sharp picture",
    )


def why_no_ground(
    key: Keyframe, picture: Picture, R_ned_cam: FloatArray, d_ned_m: FloatArray, followed: Followed, limits: FlowSettings
) -> Refused | None:
    """Why what was followed to a frame about `d_ned_m` away is not the ground, or None."""
    base = float(np.hypot(d_ned_m[0], d_ned_m[1])) / key.height_m
    if followed.unlike > limits.max_unlike + limits.unlike_by_base * base:
        return Reason.MOVING_SURFACE, f"what was found differs by {followed.unlike:.0f} grey levels: it changes as waves do"
    was = key.corners[followed.number]
    now = followed.xy * np.array([picture.K[0, 0], picture.K[1, 1]]) + picture.K[:2, 2]
    turned = through(plane_homography(picture.K, key.R_ned_cam, R_ned_cam, np.zeros(3), key.height_m), was)
    still = float((np.hypot(*(now - was).T) < STILL_PX).mean())
    if still > STILL_SHARE and float(np.median(np.hypot(*(turned - was).T))) > 3 * STILL_PX:
        return Reason.INCONSISTENT_WITH_PRIOR, "the picture stands still while the camera turns: dirt on the lens"
    return None


def why_unsure(motion: Motion, sight: Sight, picture: Picture, height_m: float, limits: FlowSettings) -> Refused | None:
    """Why a motion is not believed, or None."""
    if motion.scatter_px > limits.max_scatter_px:
        return _of_picture(sight, picture, limits) or (
            Reason.BLOCKS_DISAGREE,
            f"the tracks scatter by {motion.scatter_px:.1f} px about one motion",
        )
    fitting, share = int(motion.fits.sum()), float(motion.fits.mean())
    if fitting < limits.min_tracks or share < limits.min_inlier_share:
        return _of_picture(sight, picture, limits) or (
            Reason.BLOCKS_DISAGREE,
            f"{fitting} of {len(motion.fits)} tracks fit one motion",
        )
    if float(np.abs(motion.turn_rad).max()) > MOST_TURN_SIGMAS * limits.sigma_turn_rad:
        return Reason.INCONSISTENT_WITH_PRIOR, "the picture turned otherwise than the autopilot says"
    own = (motion.covariance - motion.shared)[:2, :2]
    sigma = math.sqrt(max(float(np.linalg.eigvalsh(own)[-1]), 0.0))
    if sigma > limits.max_sigma_share * height_m:
        return Reason.LOW_TEXTURE, f"the tracks leave {sigma:.1f} m open"
    return None


def _of_picture(sight: Sight, picture: Picture, limits: FlowSettings) -> Refused | None:
    blur = blur_px(picture.grey)
    if blur > limits.max_blur_px:
        return Reason.BLURRED, f"smeared by {blur:.1f} px"
    corners = len(corners_of(picture.grey, picture.seen, limits.corner_spacing_px))
    if corners < limits.min_corners:
        return Reason.LOW_TEXTURE, f"{corners} corners, {limits.min_corners} are needed"
    return None
