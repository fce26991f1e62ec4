"""The camera in the vehicle: when its frames are taken (camera_time.py), how it is mounted (boresight.py) and tilted
(tilt_memory.py), where it looks (aim.py), all learned in flight, where it is (lever_arm.py), whether its lens is as calibrated
(lens_watch.py), its picture mirrored (mirror_watch.py) or kept level (level_watch.py), its mounting right (mount_watch.py), its
fixes as good as they claim (claim_watch.py) and as high as GNSS (fix_height_watch.py), whether it zoomed (zoom_watch.py), and
where its pictures show the sun (sun_memory.py).

What carries it is the airframe or a gimbal (gimbal.py). Mounting and tilt are those against what carries it, in either case. Its
time is learned on the airframe only: a gimbal's word comes late by an unknown time itself."""

from __future__ import annotations

from dataclasses import replace

from visloc_companion.core.attitude import AttitudeBuffer
from visloc_companion.core.camera.aim import SURE, Aim
from visloc_companion.core.camera.boresight import Boresight
from visloc_companion.core.camera.camera_time import CameraTime
from visloc_companion.core.camera.distortion_watch import DistortionWatch
from visloc_companion.core.camera.fix_height_watch import FixHeightWatch
from visloc_companion.core.camera.gimbal import Gimbal
from visloc_companion.core.camera.gimbal_watch import GimbalWatch
from visloc_companion.core.camera.lens_watch import LensSwings, LensWatch
from visloc_companion.core.camera.level_watch import LevelWatch
from visloc_companion.core.camera.lever_arm import LeverArm
from visloc_companion.core.camera.mirror_watch import MirrorWatch, shown_by_none
from visloc_companion.core.camera.mount_watch import MountWatch
from visloc_companion.core.camera.sun_memory import SunMemory
from visloc_companion.core.camera.tilt_memory import TiltMemory
from visloc_companion.core.camera.unseen_zoom import doubted
from visloc_companion.core.camera.zoom_ramp import ZoomRamp
from visloc_companion.core.camera.zoom_watch import ZoomWatch
from visloc_companion.core.filter.claim_watch import ClaimWatch
from visloc_companion.core.filter.lasting import BY_SHAPE
from visloc_companion.core.terrain.terrain_aiding import METHOD as TERRAIN
from visloc_companion.core.timesync import ClockOffset
from visloc_companion.core.tracking import Tracker
from visloc_companion.geo import se3, wgs84
from visloc_companion.types import (
    Command,
    Fix,
    FrameRef,
    GimbalAttitude,
    LocaliseRequest,
    NavState,
    NoFix,
    Odometry,
    Quat,
    Sun,
    TiltPrior,
    Turn,
    Vec2,
    Vec3,
)

TIMED_S = 0.02
"""The mounting is learned only while frames are timed better than this: on the way, late is as tilted."""


class OnboardCamera:
    """Stands between frames and requests, and between answers and the filter. `mounting_rad`: 1-sigma, on each axis, of the
    mounting in what the fix claims that was stated last, 0 where that is not known."""

    def __init__(
        self,
        q_frd_cambody: Quat,
        mount_sigma_rad: float,
        lever_frd_m: Vec3,
        clock: ClockOffset,
        attitude: AttitudeBuffer,
        tracker: Tracker,
        gimbal: Gimbal | None = None,
    ) -> None:
        self._clock, self._attitude, self._gimbal, self._gimbal_watch = clock, attitude, gimbal, GimbalWatch()
        self._time = CameraTime(clock, attitude, learns=gimbal is None)
        self._configured, self._mount_sigma_rad = q_frd_cambody, mount_sigma_rad
        self._boresight, self._tilt = Boresight(q_frd_cambody), TiltMemory(mount_sigma_rad)
        self._lever, self._mirror = LeverArm(lever_frd_m, clock, attitude), MirrorWatch(clock, gimbal or attitude)
        self._mount = MountWatch(clock, gimbal or attitude, q_frd_cambody)
        self._lens, self._claims, self._sun, self._tracker = LensWatch(), ClaimWatch(), SunMemory(), tracker
        self._swings = LensSwings()
        self._heights, self._distortion = FixHeightWatch(), DistortionWatch(clock, gimbal or attitude)
        self._level, self.zoom, self._aim = LevelWatch(clock, attitude), ZoomWatch(), Aim()
        self.ramp, self.mounting_rad = ZoomRamp(tracker, self.zoom), 0.0

    @property
    def q_carrier_cambody(self) -> Quat:
        """The mounting on what carries the camera, as it is known by now."""
        return self._boresight.q_frd_cambody

    @property
    def set_up_wrong(self) -> bool:
        """Whether the pictures show another mounting or lens than the configured one: nothing of them is to be used."""
        return self._mount.wrong or self._distortion.wrong

    @property
    def keeps_level(self) -> bool:
        """Whether pictures do not tilt with the vehicle now: nothing of them is to be used until they do."""
        return self._level.wrong

    @property
    def level_until_ns(self) -> int:
        """Until when pictures surely tilted with the vehicle, before they were found not to."""
        return self._level.right_until_ns

    @property
    def mistimed(self) -> bool:
        """Whether the operator was told that frames come at other times than they bear."""
        return self._time.wrong

    @property
    def retimed_s(self) -> float:
        """By how much later than they bear frames are taken, as far as the operator was told."""
        return 0.0 if self._time.told_s is None else self._time.told_s

    @property
    def aimed(self) -> bool:
        """Whether something is taken off fixes, because the camera looks beside where it should."""
        return self._aim.used != 0

    @property
    def sigma_yaw_rad(self) -> float:
        """1-sigma of the yaw of what carries the camera, beside the autopilot's heading."""
        return 0.0 if self._gimbal is None else self._gimbal.sigma_yaw_rad

    def on_gimbal(self, event: GimbalAttitude, now_ns: int) -> None:
        """A gimbal says where it points."""
        if self._gimbal is not None and self._gimbal.on_attitude(event):
            self._gimbal_watch.heard(now_ns)

    def check(self, now_ns: int, *, heard: bool, needed: bool) -> list[Command]:
        """What is to be said of the gimbal at a Tick (gimbal_watch.GimbalWatch.check)."""
        return [] if self._gimbal is None else self._gimbal_watch.check(now_ns, heard=heard, needed=needed)

    def carrier(self, t_boot_ns: int, q_ned_frd: Quat, now_ns: int) -> Quat | None:
        """Attitude of what carries the camera while the vehicle's is `q_ned_frd`; None where a gimbal makes a frame useless."""
        if self._gimbal is None:
            return q_ned_frd
        reason = self._gimbal.refusal(t_boot_ns, self.q_carrier_cambody)
        self._gimbal_watch.judged(reason, now_ns, t_boot_ns)
        return None if reason is not None else self._gimbal.at(t_boot_ns)

    def rate_radps(self, t_boot_ns: int, span_ns: int) -> Vec3 | None:
        """Mean rates of the camera's body about its own axes over a span about a time, None where they are not known."""
        carrier = self._attitude.rate_frd_radps if self._gimbal is None else self._gimbal.rate_radps
        rate = carrier(t_boot_ns, span_ns)
        return None if rate is None else se3.rotate(se3.quat_inverse(self.q_carrier_cambody), rate)

    def _q_frd_cambody(self, t_ns: int) -> Quat:
        """The camera in the vehicle at a time; while a gimbal's is not known, as if it looked straight down."""
        t_boot_ns = None if self._gimbal is None else self._clock.boot_ns(t_ns)
        if self._gimbal is None or t_boot_ns is None:
            return self.q_carrier_cambody
        q_ned_frd, q_ned_carrier = self._attitude.at(t_boot_ns), self._gimbal.at(t_boot_ns)
        if q_ned_frd is None or q_ned_carrier is None:
            return self.q_carrier_cambody
        q_frd_carrier = se3.quat_multiply(se3.quat_inverse(q_ned_frd), q_ned_carrier)
        return se3.quat_multiply(q_frd_carrier, self.q_carrier_cambody)

    def tilt(self, t_ns: int, q_ned_carrier: Quat) -> TiltPrior | None:
        """What earlier fixes tell of the camera's tilt at a time, at an attitude of what carries it."""
        return self._tilt.known(t_ns, q_ned_carrier)

    def sun(self, t_ns: int) -> Sun | None:
        """Where earlier pictures show the sun at a time."""
        return self._sun.known(t_ns)

    def camera_ned_m(self, p_ned_m: Vec3, q_ned_frd: Quat) -> Vec3:
        """Where the camera is while the vehicle is at a place with an attitude."""
        return self._lever.camera_ned_m(p_ned_m, q_ned_frd)

    def of_vehicle(self, answer: Fix | NoFix) -> Fix | NoFix:
        """An answer about the camera, as one about the vehicle; a terrain's fix is that already. A mirrored picture shows
        nothing, nor does a camera that is mounted otherwise than configured."""
        if answer.method == TERRAIN:
            return answer
        unusable = self._unusable(answer)
        if unusable is not None:
            return shown_by_none(answer, unusable)
        answer = self._doubted(self._alike(answer))
        self._lever.aim_m, self._lever.doubted_m = self._aim.used * self._height_m, self._aim.doubt * self._height_m
        if self._level.wrong:
            return replace(shown_by_none(answer, "the picture does not tilt with the vehicle"), turn=answer.turn)
        return self._lever.of_vehicle(answer, self._q_frd_cambody(answer.t_ns))

    @property
    def _height_m(self) -> float:
        return self._tracker.height_above_home_m or 0.0

    def _unusable(self, answer: Fix | NoFix) -> str | None:
        if self._mirror.mirrored:
            return "the picture is mirrored"
        if self._mount.wrong:
            return "the camera is mounted otherwise than configured"
        if self._distortion.wrong:
            return "the lens bends the picture otherwise than configured"
        return "the frame was taken at another time than was believed" if self._time.outdated(answer.t_ns) else None

    def _alike(self, answer: Fix | NoFix) -> Fix | NoFix:
        """The answer without motions and turns between frames whose times were found otherwise meanwhile."""

        def alike(part: Odometry | Turn | None) -> bool:
            return part is None or self._time.alike(part.t_from_ns, part.t_to_ns)

        if alike(answer.motion) and alike(answer.turn) and alike(answer.turn_since_kept):
            return answer
        return replace(
            answer,
            motion=answer.motion if alike(answer.motion) else None,
            turn=answer.turn if alike(answer.turn) else None,
            turn_since_kept=answer.turn_since_kept if alike(answer.turn_since_kept) else None,
        )

    def _doubted(self, answer: Fix | NoFix) -> Fix | NoFix:
        """The answer with what a zoom that nobody sees may make of its motion."""
        share = self._tracker.zoom_share = self.ramp.unseen.share_in(answer)
        return answer if answer.motion is None or share == 0 else replace(answer, motion=doubted(answer.motion, share))

    def asked_of_vehicle(self, request: LocaliseRequest) -> LocaliseRequest:
        """A request with the vehicle's place in its prior."""
        q_frd_cambody = self._q_frd_cambody(request.frame.t_ns)
        prior = self._lever.prior_of_vehicle(request.prior, q_frd_cambody)
        return request if prior is request.prior else replace(request, prior=prior)

    def on_frame(self, frame: FrameRef) -> FrameRef:
        """The frame with the time when it was taken."""
        return self._time.on_frame(frame)

    def asked(self, commands: list[Command]) -> list[Command]:
        """These commands, whose requests are kept in mind."""
        for command in commands:
            if isinstance(command, LocaliseRequest):
                self._boresight.on_request(command)
                q_ned_cambody = command.prior.q_ned_frd
                q_ned_carrier = se3.quat_multiply(q_ned_cambody, se3.quat_inverse(self.q_carrier_cambody))
                self._tilt.asked(command, q_ned_carrier)
        return commands

    def on_answer(self, answer: Fix | NoFix) -> list[Command]:
        """Learn from how the camera turned; the filter has no part in it."""
        if isinstance(answer, Fix):
            self._mirror.recognised()
            self._mount.recognised()
            self._level.recognised()
        if answer.turn is not None and self._gimbal is None:
            told = self._level.on_turn(answer.turn, self.q_carrier_cambody)
            if told or self._level.wrong:
                return told
        if answer.turn is not None:
            told = self._mirror.on_turn(answer.turn, self.q_carrier_cambody) or self._mount.on_turn(answer.turn)
            told = told or self._bent(answer.turn)
            if told:
                return told
            self._tilt.turned(answer.turn, answer.turn_since_kept)
        retimed_s = self.retimed_s
        told = self._time.on_turn(answer.turn, self.q_carrier_cambody)
        if self.retimed_s != retimed_s:
            self._mount_anew()
            doubted, self._aim = max(abs(self._aim.used), self._aim.doubt), Aim()
            self._tracker.doubt_aim(doubted, doubted)  # until GNSS tells anew
        return told

    def _bent(self, turn: Turn) -> list[Command]:
        velocity, height_m = self._tracker.velocity, self._tracker.height_above_home_m
        if velocity is None or height_m is None:
            return []
        told = self._distortion.on_turn(turn, self.q_carrier_cambody, velocity.v_ned_mps, height_m)
        self._tracker.doubt_bend(self._distortion.bend)
        return told

    def stated(self, fix: Fix, state: NavState | None) -> Fix:
        """The fix as it is with what earlier ones tell of its tilt, and with what its time and that tilt may be off by in its
        covariance; `state`: the filter's at that time."""
        self.mounting_rad = 0.0
        per_focal_ne_m = self.ramp.stated(fix)
        if per_focal_ne_m is not fix.per_focal_ne_m:
            fix = replace(fix, per_focal_ne_m=per_focal_ne_m)
        if state is None or fix.method == TERRAIN:
            return fix
        if fix.method not in BY_SHAPE:
            told = self._tilt.told(fix, state.v_ned_mps[:2], self._height_m)
            self.mounting_rad = told.mounting_rad
            fix = _turned(_with_more(fix, told.more_rad2 * self._height_m**2), told.turn_ne_rad, self._height_m)
        return self._time.stated(fix, state.v_ned_mps)

    def on_fix(self, fix: Fix, *, taken: bool, gnss_trusted: bool) -> list[Command]:
        """Learn from a fix, of the tilt where the filter took it, of the mounting beside a GNSS that is good."""
        height_m, state, belief = self._tracker.height_above_home_m, self._tracker.at(fix.t_ns), self._tracker.belief
        if height_m is None or state is None or belief is None:
            return []
        if taken:
            self._tilt.taken(fix, state.v_ned_mps[:2], height_m)
            if fix.per_focal_ne_m != (0.0, 0.0):
                self._swings.on_fix(fix.t_ns, fix.per_focal_ne_m, self._heading_rad(fix), height_m)
            if fix.sun is not None:
                self._sun.seen(fix.t_ns, fix.sun)
        told = [*self._lens.after(belief, self._swings.sigma_share), *self._claims.after(belief)]
        gnss = self._tracker.gnss
        if taken and gnss_trusted and self.zoom.factor == 1.0 and gnss.newest is not None and gnss.newest_ns is not None:
            told += self._heights_beside(fix, gnss.newest.h_amsl_m, height_m)
        difference = gnss.minus(fix, state.v_ned_mps) if gnss_trusted else None
        told += self.ramp.on_fix(fix, height_m, difference, taken=taken)
        if difference is None or self.ramp.doubting:
            return told
        if taken:
            told += self._aimed(fix, difference, state.v_ned_mps, height_m)
        if self._time.sigma_s > TIMED_S:
            return told
        used_rad = self._boresight.used_rad
        commands = self._boresight.on_fix(fix, difference, state.v_ned_mps, height_m)
        self._tilt.remounted(self._boresight.used_rad - used_rad)
        return [*told, *commands]

    def _heights_beside(self, fix: Fix, gnss_amsl_m: float, height_m: float) -> list[Command]:
        """Doubt the lens for as long as heights of fixes beside those of GNSS show that."""
        told, tracker = self._heights.on_fix(fix, gnss_amsl_m, height_m), self._tracker
        if abs(self._heights.longer_share) > abs(tracker.longer_share):
            tracker.doubt_lens(fix, self._heights.longer_share, lasts=True)
        elif self._heights.longer_share == 0 and tracker.lens_doubt_lasts and not self.ramp.doubting:
            tracker.know_lens(0.0, lasts=False)
        return told

    def _aimed(self, fix: Fix, gnss_minus_fix_m: Vec2, v_ned_mps: Vec3, height_m: float) -> list[Command]:
        """Learn where the camera looks beside where it should, while nothing else of the picture is in doubt."""
        tracker, timed = self._tracker, self._time.sigma_s <= TIMED_S
        if self._gimbal is not None or self.zoom.factor != 1.0 or tracker.longer_share or tracker.alike.lens_bend:
            return []
        if fix.probability_wrong > SURE:
            return []
        heading = self._heading_rad(fix)
        off_ne_m = (-gnss_minus_fix_m[0], -gnss_minus_fix_m[1])
        used = self._aim.used
        told = self._aim.on_fix(fix.t_ns, off_ne_m, fix.cov_ne_m2, heading, v_ned_mps[:2], height_m, timed=timed)
        tracker.doubt_aim(max(abs(self._aim.used), self._aim.doubt), self._aim.doubt)
        if self._aim.used and not used:
            self._mount_anew()
        return told

    def _heading_rad(self, fix: Fix) -> float:
        """Of what carries the camera."""
        return se3.euler_from_quat(se3.quat_multiply(fix.q_ned_frd, se3.quat_inverse(self.q_carrier_cambody)))[2]

    def _mount_anew(self) -> None:
        """What fixes taught of mounting and tilt was of another time or place."""
        self._boresight, self._tilt = Boresight(self._configured), TiltMemory(self._mount_sigma_rad)


def _with_more(fix: Fix, more_m2: float) -> Fix:
    """The fix with so much more variance on each axis."""
    if more_m2 == 0:
        return fix
    (nn, ne), (en, ee) = fix.cov_ne_m2
    return replace(fix, cov_ne_m2=((nn + more_m2, ne), (en, ee + more_m2)))


def _turned(fix: Fix, turn_ne_rad: Vec2, height_m: float) -> Fix:
    """The fix turned by a small rotation about north and east around the ground that it looks at, so far below it."""
    if turn_ne_rad == (0.0, 0.0):
        return fix
    north, east = turn_ne_rad
    place = wgs84.geo_from_ned((-height_m * east, height_m * north, 0.0), fix.place)
    return replace(fix, place=place, q_ned_frd=se3.quat_multiply(se3.quat_from_vector((north, east, 0.0)), fix.q_ned_frd))
