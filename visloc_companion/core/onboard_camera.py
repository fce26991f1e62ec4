"""The camera in the vehicle: when its frames are taken (camera_time.py), how it is mounted (boresight.py) and tilted
(tilt_memory.py), all learned in flight, where (lever_arm.py), whether its lens is as calibrated (lens_watch.py), its picture
mirrored (mirror_watch.py) and its fixes as good as they claim (claim_watch.py), and where its pictures show the sun
(sun_memory.py)."""

from __future__ import annotations

from dataclasses import replace

from visloc_companion.core.attitude import AttitudeBuffer
from visloc_companion.core.boresight import Boresight
from visloc_companion.core.camera_time import CameraTime
from visloc_companion.core.claim_watch import ClaimWatch
from visloc_companion.core.lens_watch import LensWatch
from visloc_companion.core.lever_arm import LeverArm
from visloc_companion.core.mirror_watch import MirrorWatch, shown_by_none
from visloc_companion.core.sun_memory import SunMemory
from visloc_companion.core.terrain_aiding import METHOD as TERRAIN
from visloc_companion.core.tilt_memory import TiltMemory
from visloc_companion.core.timesync import ClockOffset
from visloc_companion.core.tracking import Tracker
from visloc_companion.geo import se3
from visloc_companion.types import Command, Fix, FrameRef, LocaliseRequest, NoFix, Quat, Sun, TiltPrior, Vec3

TIMED_S = 0.02
"""The mounting is learned only while frames are timed better than this: on the way, late is as tilted."""


class OnboardCamera:
    """Stands between frames and requests, and between answers and the filter."""

    def __init__(
        self,
        q_frd_cambody: Quat,
        mount_sigma_rad: float,
        lever_frd_m: Vec3,
        clock: ClockOffset,
        attitude: AttitudeBuffer,
        tracker: Tracker,
    ) -> None:
        self._time = CameraTime(clock, attitude)
        self._boresight, self._tilt = Boresight(q_frd_cambody), TiltMemory(mount_sigma_rad)
        self._lever, self._mirror = LeverArm(lever_frd_m, clock, attitude), MirrorWatch(clock, attitude)
        self._lens, self._claims, self._sun, self._tracker = LensWatch(), ClaimWatch(), SunMemory(), tracker

    @property
    def q_frd_cambody(self) -> Quat:
        """The mounting as it is known by now."""
        return self._boresight.q_frd_cambody

    def tilt(self, t_ns: int, q_ned_frd: Quat) -> TiltPrior | None:
        """What earlier fixes tell of the camera's tilt at a time, at an attitude of the vehicle."""
        return self._tilt.known(t_ns, q_ned_frd)

    def sun(self, t_ns: int) -> Sun | None:
        """Where earlier pictures show the sun at a time."""
        return self._sun.known(t_ns)

    def camera_ned_m(self, p_ned_m: Vec3, q_ned_frd: Quat) -> Vec3:
        """Where the camera is while the vehicle is at a place with an attitude."""
        return self._lever.camera_ned_m(p_ned_m, q_ned_frd)

    def of_vehicle(self, answer: Fix | NoFix) -> Fix | NoFix:
        """An answer about the camera, as one about the vehicle; a terrain's fix is that already. A mirrored picture shows
        nothing."""
        if answer.method == TERRAIN:
            return answer
        if self._mirror.mirrored:
            return shown_by_none(answer)
        return self._lever.of_vehicle(answer, self.q_frd_cambody)

    def asked_of_vehicle(self, request: LocaliseRequest) -> LocaliseRequest:
        """A request with the vehicle's place in its prior."""
        return replace(request, prior=self._lever.prior_of_vehicle(request.prior, self.q_frd_cambody))

    def on_frame(self, frame: FrameRef) -> FrameRef:
        """The frame with the time when it was taken."""
        return self._time.on_frame(frame)

    def asked(self, commands: list[Command]) -> list[Command]:
        """These commands, whose requests are kept in mind."""
        for command in commands:
            if isinstance(command, LocaliseRequest):
                self._boresight.on_request(command)
                q_ned_cambody = command.prior.q_ned_frd
                q_ned_frd = se3.quat_multiply(q_ned_cambody, se3.quat_inverse(self.q_frd_cambody))
                self._tilt.asked(command, q_ned_frd)
        return commands

    def on_answer(self, answer: Fix | NoFix) -> list[Command]:
        """Learn from how the camera turned; the filter has no part in it."""
        if isinstance(answer, Fix):
            self._mirror.recognised()
        if answer.turn is not None:
            told = self._mirror.on_turn(answer.turn, self.q_frd_cambody)
            if told:
                return told
            self._tilt.turned(answer.turn, answer.turn_since_kept)
        return self._time.on_turn(answer.turn, self.q_frd_cambody)

    def stated(self, fix: Fix) -> Fix:
        """The fix with what its time may be off by in its covariance."""
        state = None if fix.method == TERRAIN else self._tracker.at(fix.t_ns)
        return fix if state is None else self._time.stated(fix, state.v_ned_mps)

    def on_fix(self, fix: Fix, *, taken: bool, gnss_trusted: bool) -> list[Command]:
        """Learn from a fix, of the tilt where the filter took it, of the mounting beside a GNSS that is good."""
        height_m, state, belief = self._tracker.height_above_home_m, self._tracker.at(fix.t_ns), self._tracker.belief
        if height_m is None or state is None or belief is None:
            return []
        if taken:
            self._tilt.taken(fix, state.v_ned_mps[:2], height_m)
            if fix.sun is not None:
                self._sun.seen(fix.t_ns, fix.sun)
        told = [*self._lens.after(belief), *self._claims.after(belief)]
        if not gnss_trusted or self._time.sigma_s > TIMED_S:
            return told
        difference = self._tracker.gnss.minus(fix, state.v_ned_mps)
        if difference is None:
            return told
        used_rad = self._boresight.used_rad
        commands = self._boresight.on_fix(fix, difference, state.v_ned_mps, height_m)
        self._tilt.remounted(self._boresight.used_rad - used_rad)
        return [*told, *commands]
