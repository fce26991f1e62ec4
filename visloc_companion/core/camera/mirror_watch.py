"""Tells a picture that is mirrored, by a driver's setting or a mirror in the optics: in it the ground turns the wrong way round.

About the axis that the camera looks along, a mirrored picture turns by as much as the camera did, and against it, whichever side
is swapped; any mounting angle leaves that turn as it is. Stamps that are late take it for an earlier turn, so only turns count
that have gone on for half a second. Faster than some 20 degrees a second nothing is found again in a mirrored picture.
"""

from __future__ import annotations

import math
from dataclasses import replace

from visloc_companion.core.attitude import AttitudeBuffer
from visloc_companion.core.camera.gimbal import Gimbal, camera_turn
from visloc_companion.core.timesync import ClockOffset
from visloc_companion.errors import Reason
from visloc_companion.geo import se3
from visloc_companion.types import Command, Fix, NoFix, Notice, Quat, Severity, Turn

LEAST_TURN_RAD = math.radians(1.0)
"""Smaller turns between two frames say little beside their errors."""
EARLIER_NS = (250_000_000, 500_000_000)
LEAST_EARLIER = 0.5
"""Of a turn that counts, so much was turned as well if its frames were taken that much earlier."""
TURNED_RAD, FEWEST = math.radians(45.0), 10
"""So much has to have been turned, either way, between so many pairs of frames."""
AGAINST = -0.7
"""Of the reported turns, least squares: -1 of a mirrored picture, +1 of a right one."""


class MirrorWatch:
    """Adds up turns about the camera's axis, as they are seen and as what carries the camera is reported to have turned."""

    def __init__(self, clock: ClockOffset, attitude: AttitudeBuffer | Gimbal) -> None:
        self._clock, self._attitude = clock, attitude
        self.mirrored = False
        self.recognised()

    def recognised(self) -> None:
        """A place was found in the picture, which none is in a mirrored one: begin anew."""
        self._n, self._turned_rad, self._both, self._own = 0, 0.0, 0.0, 0.0

    def on_turn(self, turn: Turn, q_carrier_cambody: Quat) -> list[Command]:
        """Take a turn of the camera's body; says once that the picture is mirrored."""
        first_ns, last_ns = self._clock.boot_ns(turn.t_from_ns), self._clock.boot_ns(turn.t_to_ns)
        if self.mirrored or first_ns is None or last_ns is None:
            return []
        reported_rad = self._about_axis_rad(first_ns, last_ns, q_carrier_cambody)
        if reported_rad is None or abs(reported_rad) < LEAST_TURN_RAD:
            return []
        for earlier_ns in EARLIER_NS:
            earlier_rad = self._about_axis_rad(first_ns - earlier_ns, last_ns - earlier_ns, q_carrier_cambody)
            if earlier_rad is None or earlier_rad / reported_rad < LEAST_EARLIER:
                return []
        self._n += 1
        self._turned_rad += abs(reported_rad)
        self._both += reported_rad * se3.vector_from_quat(turn.q_from_to)[2]
        self._own += reported_rad**2
        if self._n < FEWEST or self._turned_rad < TURNED_RAD or self._both > AGAINST * self._own:
            return []
        self.mirrored = True
        data = (("seen_of_reported", self._both / self._own), ("turned_deg", math.degrees(self._turned_rad)))
        return [Notice(Severity.WARNING, "visloc: picture is mirrored, NOT USED", to_operator=True, data=data)]

    def _about_axis_rad(self, first_ns: int, last_ns: int, q_carrier_cambody: Quat) -> float | None:
        """How the camera turned about the axis that it looks along, by the autopilot's attitudes; None where one is not known."""
        turn_rad = camera_turn(self._attitude, q_carrier_cambody, first_ns, last_ns)
        return None if turn_rad is None else turn_rad[2]


def shown_by_none(answer: Fix | NoFix, why: str) -> NoFix:
    """The answer without whatever such a picture said of place, motion and turn; a refusal keeps its reason."""
    if isinstance(answer, NoFix):
        return replace(answer, motion=None, turn=None, turn_since_kept=None, open_places=(), zoomed=None)
    asked = answer.request_id, answer.frame_id, answer.method
    return NoFix(answer.t_rx_ns, answer.t_ns, *asked, Reason.BAD_FRAME, answer.elapsed_ms, why)
