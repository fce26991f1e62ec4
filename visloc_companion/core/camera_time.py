"""When frames were taken: the offset between the camera's stamps and the autopilot's clock, learned in flight, and what remains.

Frames that bear their arrival only are put on an even clock (frame_clock.py) and moved by the offset that turns show
(time_offset.py) as soon as it is known to SURE_S. In a flight that never turns it stays unknown, and the covariance of fixes says
so. Frames with a time of their own stay as they are; if turns contradict it, the operator is told.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import replace

from visloc_companion.core.attitude import AttitudeBuffer
from visloc_companion.core.frame_clock import FrameClock
from visloc_companion.core.remembered import remember
from visloc_companion.core.time_offset import LATE_S, REACH_NS, Offset, TimeOffset
from visloc_companion.core.timesync import ClockOffset
from visloc_companion.types import Command, Fix, FrameRef, Notice, Quat, Severity, Turn, Vec3

SURE_S = 0.010
"""An offset is used once its 1-sigma is below this."""
FOLLOW_S = 0.003
"""A later estimate replaces the one in use when it differs by more than this and by half of its sigma."""
LARGEST_S = 0.5
UNKNOWN_S = 0.05
"""1-sigma of the stamps while nothing is known of their offset."""
WRONG_STAMP_S = 0.04
"""Stamps of the camera's own are contradicted beyond this."""
ASK_AFTER_NS = 90_000_000_000
"""An offset that is unknown for so long is told to the operator."""
FRAMES_KEPT, TURNS_KEPT = 64, 8


class CameraTime:
    """`on_frame` gives each frame the time when it was taken; `on_turn` learns from what answers say.

    `learns` False: the camera does not turn with the vehicle, and turns of its pictures tell nothing of the autopilot's clock.
    """

    def __init__(self, clock: ClockOffset, attitude: AttitudeBuffer, *, learns: bool = True) -> None:
        self._clock, self._attitude, self._learns = clock, attitude, learns
        self._even = FrameClock()
        self._offset, self._far = TimeOffset(), TimeOffset(LATE_S)
        self._wrong_s = 0.0
        self._lag_ns: int | None = None
        self._by_arrival = False
        self._used: Offset | None = None
        self._frame_sigma_s = 0.0
        self._stamps: dict[int, int] = {}
        self._waiting: deque[tuple[Turn, tuple[int, int]]] = deque(maxlen=TURNS_KEPT)
        self._told = self._asked_to_turn = False
        self._since_ns: int | None = None

    @property
    def estimate(self) -> Offset:
        """What turns say so far; its sigma is large while none have been seen."""
        return self._offset.best()

    @property
    def wrong(self) -> bool:
        """Whether the operator was told that frames come at other times than they bear."""
        return self._told

    @property
    def sigma_s(self) -> float:
        """1-sigma of the time of frames as they are given out: zero for the camera's own stamps, unless turns contradict them."""
        if not self._by_arrival or self._wrong_s > 0:
            return self._wrong_s
        return math.hypot(UNKNOWN_S if self._used is None else self._used.sigma_s, self._frame_sigma_s)

    def on_frame(self, frame: FrameRef) -> FrameRef:
        """The frame with the time when it was taken."""
        lag_ns = frame.t_rx_ns - frame.t_ns
        self._by_arrival = frame.t_boot_ns is None and lag_ns == self._lag_ns
        self._lag_ns = lag_ns
        taken_ns = stamp_ns = frame.t_ns
        if frame.t_boot_ns is not None:
            taken_ns = stamp_ns = self._clock.shell_ns(frame.t_boot_ns, frame.t_ns)
        elif self._by_arrival:
            self._since_ns = frame.t_ns if self._since_ns is None else self._since_ns
            even = self._even.on_arrival(frame.t_ns, frame.frame_id)
            stamp_ns, self._frame_sigma_s = even.t_ns, even.sigma_s
            taken_ns = stamp_ns + (0 if self._used is None else round(self._used.offset_s * 1e9))
        remember(self._stamps, taken_ns, stamp_ns, FRAMES_KEPT)
        return frame if taken_ns == frame.t_ns else replace(frame, t_ns=taken_ns)

    def on_turn(self, turn: Turn | None, q_frd_cambody: Quat) -> list[Command]:
        """Learn from the turn between two frames that an answer bears; those whose attitudes are to come wait for them."""
        if not self._learns:
            return []
        if turn is not None and turn.t_from_ns in self._stamps and turn.t_to_ns in self._stamps:
            self._waiting.append((turn, (self._stamps[turn.t_from_ns], self._stamps[turn.t_to_ns])))
        learned = False
        newest_ns = self._attitude.newest_boot_ns()
        while self._waiting and newest_ns is not None:
            waits, stamps = self._waiting[0]
            first_ns, last_ns = (self._clock.boot_ns(t_ns) for t_ns in stamps)
            if first_ns is None or last_ns is None or last_ns + REACH_NS > newest_ns:
                break
            self._waiting.popleft()
            sigma_s = self._frame_sigma_s if self._by_arrival else 0.0
            for offset in (self._offset, self._far):
                learned |= offset.add(waits, (first_ns, last_ns), sigma_s, self._attitude, q_frd_cambody)
        return [*(self._judged() if learned else []), *self._still_unknown()]

    def stated(self, fix: Fix, v_ned_mps: Vec3) -> Fix:
        """The fix with what its time may be off by in its covariance, along the velocity."""
        sigma_s = self.sigma_s
        if sigma_s == 0.0:
            return fix
        north, east = v_ned_mps[0] * sigma_s, v_ned_mps[1] * sigma_s
        (nn, ne), (en, ee) = fix.cov_ne_m2
        return replace(fix, cov_ne_m2=((nn + north * north, ne + north * east), (en + north * east, ee + east * east)))

    def _judged(self) -> list[Command]:
        far = self._far.best()
        if far.sigma_s <= SURE_S and abs(far.offset_s) > LARGEST_S:
            return self._complaint(far)
        best = self._offset.best()
        if best.sigma_s > SURE_S:
            return []
        if abs(best.offset_s) > LARGEST_S or not self._by_arrival:
            return self._complaint(best)
        first, self._wrong_s = self._used is None, 0.0
        if self._used is not None and abs(best.offset_s - self._used.offset_s) < max(FOLLOW_S, best.sigma_s / 2):
            self._used = replace(self._used, sigma_s=best.sigma_s)
            return []
        self._used = best
        data = (("offset_s", best.offset_s), ("sigma_s", best.sigma_s))
        return [Notice(Severity.INFO, "camera's delay found", data=data)] if first else []

    def _still_unknown(self) -> list[Command]:
        """Once: the flight has not turned enough to tell when frames are taken."""
        if (
            not self._by_arrival
            or self._used is not None
            or self._asked_to_turn
            or self._told
            or not self._stamps
            or self._since_ns is None
        ):
            return []
        self._asked_to_turn = next(reversed(self._stamps.values())) - self._since_ns > ASK_AFTER_NS
        text = "visloc: camera delay unknown, fly some turns"
        return [Notice(Severity.NOTICE, text, to_operator=True)] if self._asked_to_turn else []

    def _complaint(self, best: Offset) -> list[Command]:
        """Once: an offset that is too large to be used, or stamps of the camera's own that are wrong."""
        right = not self._by_arrival and abs(best.offset_s) <= WRONG_STAMP_S
        self._wrong_s = 0.0 if right else abs(best.offset_s)
        if self._told or right:
            return []
        self._told = True
        late_ms = -1e3 * best.offset_s
        text = f"visloc: camera frames {abs(late_ms):.0f} ms too {'late' if late_ms > 0 else 'early'}"
        return [Notice(Severity.WARNING, text, to_operator=True)]
