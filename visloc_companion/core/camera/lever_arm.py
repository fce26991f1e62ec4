"""Between the camera's position, which localisers speak of, and the vehicle's (its IMU), which everybody else speaks of."""

from __future__ import annotations

import cmath
from dataclasses import replace

from visloc_companion.core.attitude import AttitudeBuffer
from visloc_companion.core.timesync import ClockOffset
from visloc_companion.geo import se3, wgs84
from visloc_companion.types import Fix, GeoPoint, NoFix, Odometry, OpenPlace, PosePrior, Quat, Vec3

SWUNG_ALIKE = 2.0
"""Neighbouring motions of a turn err alike by a doubted aim, where their covariances add up as independent ones: for four."""


class LeverArm:
    """`lever_frd_m`: the camera in the vehicle's body, metres forward, right and down of the IMU. `aim_m`: how far beside the
    camera its answers lie, because it looks elsewhere (aim.py), metres forward and right, level, as a complex number;
    `doubted_m`: how far beyond that they may lie."""

    def __init__(self, lever_frd_m: Vec3, clock: ClockOffset, attitude: AttitudeBuffer) -> None:
        self._lever_frd_m, self._clock, self._attitude = lever_frd_m, clock, attitude
        self.aim_m, self.doubted_m = 0j, 0.0

    def camera_ned_m(self, p_ned_m: Vec3, q_ned_frd: Quat) -> Vec3:
        """Where the camera is while the vehicle is at a place with an attitude."""
        return se3.plus(p_ned_m, self._arm_ned_m(q_ned_frd))

    def place_of_vehicle(self, place: GeoPoint, q_ned_cambody: Quat, q_frd_cambody: Quat) -> GeoPoint:
        """Where the vehicle is while the camera's body is at a place with an attitude."""
        q_ned_frd = se3.quat_multiply(q_ned_cambody, se3.quat_inverse(q_frd_cambody))
        return wgs84.geo_from_ned(_back(self._arm_ned_m(q_ned_frd)), place)

    def of_vehicle(self, answer: Fix | NoFix, q_frd_cambody: Quat) -> Fix | NoFix:
        """The answer about the vehicle; the fix's own attitude turns the lever. Motion whose attitudes are not known stays."""
        if self._nothing:
            return answer
        motion = None if answer.motion is None else self._moved(answer.motion)
        if isinstance(answer, NoFix):
            zoomed = None if answer.zoomed is None else self._fix_of_vehicle(answer.zoomed, q_frd_cambody)
            return replace(answer, motion=motion, open_places=self._places_of_vehicle(answer), zoomed=zoomed)
        return replace(self._fix_of_vehicle(answer, q_frd_cambody), motion=motion)

    def _fix_of_vehicle(self, fix: Fix, q_frd_cambody: Quat) -> Fix:
        return replace(fix, place=self.place_of_vehicle(fix.place, fix.q_ned_frd, q_frd_cambody))

    def prior_of_vehicle(self, prior: PosePrior, q_frd_cambody: Quat) -> PosePrior:
        """A prior of the camera as one of the vehicle's place."""
        if self._nothing:
            return prior
        return replace(prior, place=self.place_of_vehicle(prior.place, prior.q_ned_frd, q_frd_cambody))

    def _places_of_vehicle(self, answer: NoFix) -> tuple[OpenPlace, ...]:
        """The open places of the camera as those of the vehicle; none where its attitude then is not known."""
        q_ned_frd = self._attitude_at(answer.t_ns)
        if q_ned_frd is None:
            return ()
        back_ned_m = _back(self._arm_ned_m(q_ned_frd))
        return tuple(replace(each, place=wgs84.geo_from_ned(back_ned_m, each.place)) for each in answer.open_places)

    def _moved(self, motion: Odometry) -> Odometry:
        """What the camera moved only because the vehicle turned is no motion of the vehicle."""
        before, after = self._attitude_at(motion.t_from_ns), self._attitude_at(motion.t_to_ns)
        if before is None or after is None:
            return motion
        swung_back = se3.plus(self._arm_ned_m(before), _back(self._arm_ned_m(after)))
        (nn, ne), (en, ee) = motion.cov_ne_m2
        turned_rad = abs(_heading(after) - _heading(before))
        more_m2 = (SWUNG_ALIKE * self.doubted_m * turned_rad) ** 2
        cov = ((nn + more_m2, ne), (en, ee + more_m2))
        return replace(motion, displacement_ned_m=se3.plus(motion.displacement_ned_m, swung_back), cov_ne_m2=cov)

    @property
    def _nothing(self) -> bool:
        return not (any(self._lever_frd_m) or self.aim_m or self.doubted_m)

    def _arm_ned_m(self, q_ned_frd: Quat) -> Vec3:
        """From the vehicle to where its answers lie."""
        lever_ned_m = se3.rotate(q_ned_frd, self._lever_frd_m)
        if not self.aim_m:
            return lever_ned_m
        aim = self.aim_m * _heading(q_ned_frd)
        return se3.plus(lever_ned_m, (aim.real, aim.imag, 0.0))

    def _attitude_at(self, t_ns: int) -> Quat | None:
        t_boot_ns = self._clock.boot_ns(t_ns)
        return None if t_boot_ns is None else self._attitude.at(t_boot_ns)


def _heading(q_ned_frd: Quat) -> complex:
    """Where the nose points: north + i east, of length 1."""
    return cmath.rect(1.0, se3.euler_from_quat(q_ned_frd)[2])


def _back(ned_m: Vec3) -> Vec3:
    return -ned_m[0], -ned_m[1], -ned_m[2]
