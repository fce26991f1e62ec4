"""When frames were taken: the offset between the camera's stamps and the autopilot's clock, learned in flight, and what remains.

Frames that bear their arrival only are put on an even clock (frame_clock.py) and moved by the offset that turns show
(time_offset.py) as soon as it is known to SURE_S. In a flight that never turns it stays unknown, and the covariance of fixes says
so. Frames with a time of their own stay as they are until turns contradict it; then they are moved, too. An offset that no
ordinary camera has is told, with what mends it.

Neither position, nor GNSS, wind or heading has a part in it: turns are compared about the camera's own axes. What may make it
wrong is a delay that jumps. Turns show that within seconds; where the clock of the frames jumps, the offset is doubted at once,
and whoever flies straight ahead from then on has it in the claim of each fix.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import replace

from visloc_companion.core.attitude import AttitudeBuffer
from visloc_companion.core.camera.frame_clock import FrameClock
from visloc_companion.core.camera.time_offset import LATE_S, REACH_NS, Offset, TimeOffset
from visloc_companion.core.remembered import remember
from visloc_companion.core.timesync import ClockOffset
from visloc_companion.types import Command, Fix, FrameRef, Notice, Quat, Severity, Turn, Vec3

SURE_S = 0.010
"""An offset is used once its 1-sigma is below this."""
FOLLOW_S = 0.003
"""A later estimate replaces the one in use when it differs by more than this and by half of its sigma."""
LARGEST_S = 0.5
"""What lies beyond is looked for among the late ones, told, and known to a frame's period at best: a buffer that holds one more
looks like a frame that was lost."""
UNKNOWN_S = 0.05
"""1-sigma of the stamps while nothing is known of their offset."""
WRONG_STAMP_S = 0.04
"""Stamps of the camera's own are contradicted beyond this."""
LASTS_TURNS, SAME_SIGMAS = 12, 2.0
"""So many turns after each other have to contradict them, with offsets that agree within so many sigmas."""
CLEAR_SIGMAS = 10.0
"""Stamps that are off by so many sigmas more than that are contradicted before the offset is as sure as others have to be."""
LEAST_FITS = 0.6
"""Of recent turns an offset has to explain so many before frames are moved by one that no ordinary camera has. In simulated
flights it was 0.79 to 1 with right cameras and 0.70 with a lens that is 10 % off; with cameras that are mounted 30 degrees off
and more, or frames later than is looked for, at most 0.37."""
TELL_AGAIN_S = 0.1
"""An offset that was told and is now another by so much is told again."""
SAME_S = 0.04
"""Frames whose offsets differ by more than this are not compared with each other."""
ASK_AFTER_NS = 90_000_000_000
"""An offset that is unknown for so long is told to the operator."""
FRAMES_KEPT, TURNS_KEPT = 64, 8


class CameraTime:
    """`on_frame` gives each frame the time when it was taken; `on_turn` learns from what answers say.

    `told_s`: the offset that was told to the operator last, None before any.
    `learns` False: the camera does not turn with the vehicle, and turns of its pictures tell nothing of the autopilot's clock.
    """

    def __init__(self, clock: ClockOffset, attitude: AttitudeBuffer, *, learns: bool = True) -> None:
        self._clock, self._attitude, self._learns = clock, attitude, learns
        self._even, self._own = FrameClock(), FrameClock()
        self._offset, self._far = TimeOffset(), TimeOffset(LATE_S)
        self._lag_ns: int | None = None
        self._by_arrival = False
        self._used: Offset | None = None
        self._frame_sigma_s = 0.0
        self._stamps: dict[int, int] = {}
        self._waiting: deque[tuple[Turn, tuple[int, int]]] = deque(maxlen=TURNS_KEPT)
        self._contradicted: tuple[Offset, int] | None = None
        self.told_s: float | None = None
        self._asked_to_turn = False
        self._since_ns: int | None = None

    @property
    def estimate(self) -> Offset:
        """What turns say so far; its sigma is large while none have been seen."""
        return self._offset.best()

    @property
    def wrong(self) -> bool:
        """Whether the operator was told that frames come at other times than they bear."""
        return self.told_s is not None

    @property
    def sigma_s(self) -> float:
        """1-sigma of the time of frames as they are given out: zero for the camera's own stamps, unless turns contradict them."""
        if self._used is None:
            return math.hypot(UNKNOWN_S, self._frame_sigma_s) if self._by_arrival else 0.0
        far = self._by_arrival and abs(self._used.offset_s) > LARGEST_S
        period_s = self._even.period_s if far else 0.0
        return math.hypot(self._used.sigma_s, self._frame_sigma_s if self._by_arrival else 0.0, period_s)

    def on_frame(self, frame: FrameRef) -> FrameRef:
        """The frame with the time when it was taken."""
        lag_ns = frame.t_rx_ns - frame.t_ns
        self._by_arrival = frame.t_boot_ns is None and lag_ns == self._lag_ns
        self._lag_ns = lag_ns
        stamp_ns = frame.t_ns if frame.t_boot_ns is None else self._clock.shell_ns(frame.t_boot_ns, frame.t_ns)
        clock = self._even if self._by_arrival else self._own
        jumps = clock.jumps
        even = clock.on_arrival(stamp_ns, frame.frame_id)
        if self._by_arrival:
            self._since_ns = frame.t_ns if self._since_ns is None else self._since_ns
            stamp_ns, self._frame_sigma_s = even.t_ns, even.sigma_s
        if clock.jumps != jumps and self._used is not None:
            self._doubt(self._used)
        offset_ns = 0 if self._used is None else round(self._used.offset_s * 1e9)
        taken_ns = stamp_ns + offset_ns
        remember(self._stamps, taken_ns, stamp_ns, FRAMES_KEPT)
        if frame.t_boot_ns is not None and offset_ns:
            frame = replace(frame, t_boot_ns=frame.t_boot_ns + offset_ns)  # by which its attitude is looked up
        return frame if taken_ns == frame.t_ns else replace(frame, t_ns=taken_ns)

    def _doubt(self, used: Offset) -> None:
        """The clock of the frames has jumped, and with it perhaps their delay: turns have to show it anew."""
        self._used = replace(used, sigma_s=max(used.sigma_s, UNKNOWN_S, abs(used.offset_s)))
        self._offset, self._far = TimeOffset(), TimeOffset(LATE_S)

    def alike(self, t_from_ns: int, t_to_ns: int) -> bool:
        """Whether two frames had the same offset taken off; also where that is not known any more."""
        ends = [t_ns - self._stamps[t_ns] for t_ns in (t_from_ns, t_to_ns) if t_ns in self._stamps]
        return len(ends) < 2 or abs(ends[1] - ends[0]) <= SAME_S * 1e9

    def outdated(self, t_ns: int) -> bool:
        """Whether a frame has another offset taken off than frames have by now, which is told."""
        used_ns = 0.0 if self._used is None else self._used.offset_s * 1e9
        return self.wrong and t_ns in self._stamps and abs(t_ns - self._stamps[t_ns] - used_ns) > SAME_S * 1e9

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
        best, far = self._offset.best(), self._far.best()
        if far.sigma_s <= SURE_S and abs(far.offset_s) > LARGEST_S:
            best = far
        if best.sigma_s > self._sure_s(best.offset_s):
            self._contradicted = None
            return []
        ordinary = self._by_arrival and abs(best.offset_s) <= LARGEST_S and not self.wrong
        if not ordinary and best.fits < LEAST_FITS:
            return []
        if not self._by_arrival and not self._contradict(best):
            return []
        first, used = self._used is None, self._used
        if used is not None and abs(best.offset_s - used.offset_s) < max(FOLLOW_S, best.sigma_s / 2):
            self._used = replace(used, sigma_s=best.sigma_s)
            return []
        self._used = best
        if not ordinary:
            return self._told(best)
        data = (("offset_s", best.offset_s), ("sigma_s", best.sigma_s))
        return [Notice(Severity.INFO, "camera's delay found", data=data)] if first else []

    def _sure_s(self, offset_s: float) -> float:
        """Largest 1-sigma with which an offset is used."""
        return SURE_S if self._by_arrival else max(SURE_S, (abs(offset_s) - WRONG_STAMP_S) / CLEAR_SIGMAS)

    def _contradict(self, best: Offset) -> bool:
        """Whether turns contradict the camera's own stamps, for long enough and alike; where they do not, stamps stay."""
        if abs(best.offset_s) <= WRONG_STAMP_S:
            self._used = self._contradicted = None
            return False
        since, turns = self._contradicted or (best, 0)
        if abs(best.offset_s - since.offset_s) > SAME_SIGMAS * max(best.sigma_s, since.sigma_s):
            since, turns = best, 0
        self._contradicted = since, turns + 1
        return turns + 1 >= LASTS_TURNS

    def _still_unknown(self) -> list[Command]:
        """Once: the flight has not turned enough to tell when frames are taken."""
        if not self._by_arrival or self._used is not None or self._asked_to_turn or not self._stamps or self._since_ns is None:
            return []
        self._asked_to_turn = next(reversed(self._stamps.values())) - self._since_ns > ASK_AFTER_NS
        text = "visloc: camera delay unknown, fly some turns"
        return [Notice(Severity.NOTICE, text, to_operator=True)] if self._asked_to_turn else []

    def _told(self, used: Offset) -> list[Command]:
        """Once, and again where it has become another: an offset that no ordinary camera has, or stamps of its own that are
        wrong."""
        if self.told_s is not None and abs(used.offset_s - self.told_s) < TELL_AGAIN_S:
            return []
        self.told_s = used.offset_s
        late_s, way = -used.offset_s, "late" if used.offset_s < 0 else "early"
        latency_s = late_s + (self._lag_ns or 0) * 1e-9
        text = (
            f"visloc: frames {way}, corrected: latency_s = {latency_s:.2f}"
            if self._by_arrival and latency_s > 0
            else f"visloc: frame stamps {abs(1e3 * late_s):.0f} ms {way}, corrected"
        )
        data = (("late_s", late_s), ("sigma_s", used.sigma_s))
        return [Notice(Severity.WARNING, text, to_operator=True, data=data)]
