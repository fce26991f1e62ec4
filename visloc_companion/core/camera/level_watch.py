"""Tells a picture that does not tilt with the vehicle: electronic stabilisation is on, or a gimbal that nobody configured.

Its turns about the level axes are then next to nothing while the autopilot says that the vehicle swings: 0.03 degrees between
two frames for 1 degree, where a camera on the airframe shows 1.0 +- 0.1. Neither GNSS nor the map has a part in it. Stabilisation
may be switched on and off in flight; the camera is used again when its pictures have turned with the vehicle for as long.
"""

from __future__ import annotations

import math
from collections import deque

import numpy as np

from visloc_companion.core.attitude import AttitudeBuffer
from visloc_companion.core.camera.gimbal import camera_turn
from visloc_companion.core.timesync import ClockOffset
from visloc_companion.geo import se3
from visloc_companion.types import Command, FloatArray, Notice, Quat, Severity, Turn

LEAST_TURN_RAD, MOST_TURN_RAD = math.radians(0.4), math.radians(25.0)
"""About the level axes: smaller ones are told apart from none by too little, larger ones are seldom followed right."""
FEWEST, LEAST_RMS_RAD = 8, math.radians(0.6)
"""Turns in a row, and their size: pictures that come late are still in one turn by chance, not in so many."""
STILL, EACH_STILL = 0.2, 0.5
"""What is seen of them, rms over rms, and of each."""
UNSEEN_NS = 10_000_000_000
"""Before the first of them pictures may have kept level for so long: turns that were too small, or fixes by chance, hid it."""
FOLLOWS = 0.4
"""What a turn may be off by, as a share, where the picture follows again."""


class LevelWatch:
    """`on_turn` takes what answers say; `wrong`: the operator was told, and nothing of the camera is to be used;
    `right_until_ns`: until when pictures surely tilted with the vehicle, before."""

    def __init__(self, clock: ClockOffset, attitude: AttitudeBuffer) -> None:
        self._clock, self._attitude = clock, attitude
        self.wrong, self.right_until_ns = False, 0
        self._turns: deque[FloatArray] = deque(maxlen=FEWEST)
        self._since_ns: deque[int] = deque(maxlen=FEWEST)

    def recognised(self) -> None:
        """A place was found in the picture, which is seldom possible so: the oldest turn is left out."""
        if self._turns and not self.wrong:
            self._turns.popleft()
            self._since_ns.popleft()

    def on_turn(self, turn: Turn, q_carrier_cambody: Quat) -> list[Command]:
        """Take a turn of the camera's body; says that the picture keeps level, and that it does so no more."""
        first_ns, last_ns = self._clock.boot_ns(turn.t_from_ns), self._clock.boot_ns(turn.t_to_ns)
        if first_ns is None or last_ns is None:
            return []
        reported = camera_turn(self._attitude, q_carrier_cambody, first_ns, last_ns)
        if reported is None or not LEAST_TURN_RAD <= math.hypot(*reported[:2]) <= MOST_TURN_RAD:
            return []
        self._turns.append(np.array([reported[:2], se3.vector_from_quat(turn.q_from_to)[:2]]))
        self._since_ns.append(turn.t_from_ns)
        if len(self._turns) < FEWEST:
            return []
        turns = np.array(self._turns)
        told = self._follows(turns) if self.wrong else self._keeps_level(turns)
        if told:
            self._turns.clear()
            self._since_ns.clear()
        return told

    def _keeps_level(self, turns: FloatArray) -> list[Command]:
        (reported, seen), (of_reported, of_seen) = np.linalg.norm(turns, axis=2).T, np.sqrt((turns**2).sum(2).mean(0))
        if of_reported < LEAST_RMS_RAD or of_seen > STILL * of_reported or (seen > EACH_STILL * reported).any():
            return []
        self.wrong, self.right_until_ns = True, self._since_ns[0] - UNSEEN_NS
        data = (("seen_of_turns", float(of_seen / of_reported)), ("rms_deg", math.degrees(of_reported)))
        return [Notice(Severity.WARNING, "visloc: picture keeps level: EIS, gimbal? unused", to_operator=True, data=data)]

    def _follows(self, turns: FloatArray) -> list[Command]:
        off = np.linalg.norm(turns[:, 1] - turns[:, 0], axis=1)
        if (off > FOLLOWS * np.linalg.norm(turns[:, 0], axis=1)).any():
            return []
        self.wrong = False
        return [Notice(Severity.NOTICE, "visloc: picture tilts with the vehicle again", to_operator=True)]
