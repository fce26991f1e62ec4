"""The gimbal that carries the camera: where it points when a frame is taken, from what it says and the vehicle's attitude.

What it says counts from the vehicle's axes, from its heading or from north. It is interpolated as it is said, and put together
with the vehicle's attitude at the frame's own time: a servo on the airframe shakes with it, a stabilised gimbal does not, and
both turn with the heading.

`at` gives the attitude of a body that is level while the gimbal points straight down (it looks along its down axis, the gimbal's
upper side forward): what the airframe is to a camera that is fixed to it.
"""

from __future__ import annotations

import math

from visloc_companion.core.attitude import MAX_GAP_S, AttitudeBuffer
from visloc_companion.core.settings import GimbalSettings
from visloc_companion.core.timesync import ClockOffset
from visloc_companion.errors import Reason
from visloc_companion.geo import se3
from visloc_companion.types import GimbalAttitude, GimbalFrame, Quat, Vec3

Q_GIMBAL_BODY: Quat = se3.quat_from_euler(0.0, math.pi / 2, 0.0)
"""Of the body that looks along its down axis, in the gimbal's own axes, which points along the forward one."""
FORWARD: Vec3 = (1.0, 0.0, 0.0)
DOWN: Vec3 = (0.0, 0.0, 1.0)
STILL_NS = 100_000_000
MOST_TURN_RADPS = math.radians(15.0)
"""Where it points may change so fast, over STILL_NS before a frame: gimbals say it some 50 ms late, and 0.75 degrees is less than
is claimed of their tilt. Frames of a faster one are not used."""
LEAST_DOWN = math.cos(math.radians(45.0))
"""Beyond 45 degrees from straight down the localisers are not measured."""
MAX_STAMP_ERROR_NS = 1_000_000_000
"""An autopilot's stamp that is further than this from its arrival is not its own clock's but was passed on from the gimbal."""


class Gimbal:
    """Takes what gimbals say; of several one is listened to (`settings.gimbal_id`)."""

    def __init__(self, settings: GimbalSettings, clock: ClockOffset, attitude: AttitudeBuffer) -> None:
        self._settings, self._clock, self._vehicle = settings, clock, attitude
        self.clear()

    def clear(self) -> None:
        """Forget everything (a clock stepped)."""
        self._own_clock = ClockOffset()
        self._said = AttitudeBuffer()
        self._frame: GimbalFrame | None = None
        self._source: tuple[int, bool] | None = None
        self._last: tuple[int, Quat] | None = None

    @property
    def sigma_yaw_rad(self) -> float:
        """1-sigma of what it says of its yaw."""
        return self._settings.sigma_yaw_rad

    def on_attitude(self, event: GimbalAttitude) -> bool:
        """Take what a gimbal says; whether it is of use: the right gimbal, in working order, and later than the last."""
        if event.failed or not self._is_listened_to(event):
            return False
        frame = self._settings.frame or event.frame
        if frame is not self._frame:
            self._frame, self._said, self._last = frame, AttitudeBuffer(), None
        t_boot_ns = self._boot_ns(event)
        if t_boot_ns is None:
            return False
        rate = self._rate(t_boot_ns, event.q_frame_gimbal)
        if self._said.add(t_boot_ns, event.q_frame_gimbal, rate) is not None:
            return False
        self._last = t_boot_ns, event.q_frame_gimbal
        return True

    def at(self, t_boot_ns: int) -> Quat | None:
        """`q_ned_body` at a time, or None where neither it nor the vehicle said enough."""
        q_frame_gimbal, q_ned_frd = self._said.at(t_boot_ns), self._vehicle.at(t_boot_ns)
        if q_frame_gimbal is None or q_ned_frd is None:
            return None
        q_ned_gimbal = se3.quat_multiply(_ned_from(self._frame, q_ned_frd), q_frame_gimbal)
        return se3.quat_multiply(q_ned_gimbal, Q_GIMBAL_BODY)

    def rate_radps(self, t_boot_ns: int, span_ns: int) -> Vec3 | None:
        """Mean rates of that body about its own axes over a span about a time, or None where they are not known."""
        before, after = self.at(t_boot_ns - span_ns // 2), self.at(t_boot_ns + span_ns // 2)
        return None if before is None or after is None else se3.body_rates(before, after, span_ns * 1e-9)

    def refusal(self, t_boot_ns: int, q_body_cambody: Quat) -> Reason | None:
        """Why a frame of that time is not used, None for one that is; `q_body_cambody`: the camera on the gimbal."""
        q_ned_body, now, before = self.at(t_boot_ns), self._said.at(t_boot_ns), self._said.at(t_boot_ns - STILL_NS)
        if q_ned_body is None or now is None or before is None:
            return Reason.NO_GIMBAL_ATTITUDE
        moved = math.dist(se3.rotate(now, FORWARD), se3.rotate(before, FORWARD))
        if moved > MOST_TURN_RADPS * STILL_NS * 1e-9:
            return Reason.GIMBAL_TURNING
        looks = se3.rotate(se3.quat_multiply(q_ned_body, q_body_cambody), DOWN)
        return Reason.HORIZON_IN_VIEW if looks[2] < LEAST_DOWN else None

    def _is_listened_to(self, event: GimbalAttitude) -> bool:
        """Without a number it is the first that is heard, but rather one of the autopilot's, which comes as often as we ask."""
        of_autopilot = event.t_own_ns is None
        if self._settings.gimbal_id:
            return event.gimbal_id == self._settings.gimbal_id
        if self._source is None or (of_autopilot and not self._source[1]):
            self._source = event.gimbal_id, of_autopilot
            self._said, self._last = AttitudeBuffer(), None
        return self._source == (event.gimbal_id, of_autopilot)

    def _boot_ns(self, event: GimbalAttitude) -> int | None:
        """Its time on the autopilot's clock. A gimbal's own clock is compared by arrivals; without any time it is now."""
        own_ns = event.t_own_ns
        if own_ns is None:
            if abs(self._clock.shell_ns(event.t_boot_ns, event.t_rx_ns) - event.t_rx_ns) <= MAX_STAMP_ERROR_NS:
                return event.t_boot_ns
            own_ns = event.t_boot_ns
        if own_ns == 0:
            return self._clock.boot_ns(event.t_rx_ns)
        if self._own_clock.on_arrival(event.t_rx_ns, own_ns) is not None:
            self._said, self._last = AttitudeBuffer(), None
        return self._clock.boot_ns(self._own_clock.shell_ns(own_ns, event.t_rx_ns))

    def _rate(self, t_boot_ns: int, q_frame_gimbal: Quat) -> Vec3:
        """How it turned since the last time, about its own axes: few state it."""
        since_s = 0.0 if self._last is None else (t_boot_ns - self._last[0]) * 1e-9
        if self._last is None or not 0 < since_s <= MAX_GAP_S:
            return (0.0, 0.0, 0.0)
        return se3.body_rates(self._last[1], q_frame_gimbal, since_s)


def _ned_from(frame: GimbalFrame | None, q_ned_frd: Quat) -> Quat:
    """Attitude of what a gimbal's attitude counts from."""
    if frame is GimbalFrame.AIRFRAME:
        return q_ned_frd
    if frame is GimbalFrame.NORTH:
        return (1.0, 0.0, 0.0, 0.0)
    return se3.quat_from_euler(0.0, 0.0, se3.euler_from_quat(q_ned_frd)[2])


def camera_turn(carrier: AttitudeBuffer | Gimbal, q_carrier_cambody: Quat, first_ns: int, last_ns: int) -> Vec3 | None:
    """How a camera on what carries it turned between two boot times, a rotation vector (rad) about the axes of its body, by the
    attitudes that were told; None where one is not known."""
    before, after = carrier.at(first_ns), carrier.at(last_ns)
    if before is None or after is None:
        return None
    start, end = (se3.quat_multiply(q, q_carrier_cambody) for q in (before, after))
    return se3.vector_from_quat(se3.quat_multiply(se3.quat_inverse(start), end))
