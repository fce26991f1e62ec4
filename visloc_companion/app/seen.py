"""What the status snapshot tells beside the navigator's Status: the newest of what was heard, and what the operator was told.

Fed with every event and command, live or from a journal (`visloc web --journal`), so that both give the same snapshot.
"""

from __future__ import annotations

import math
from collections import deque
from typing import Any

from visloc_companion.geo.se3 import euler_from_quat
from visloc_companion.types import Attitude, Command, Event, Fix, FrameRef, Gnss, LinkChanged, NoFix, Notice, Status

NOTICES, FIXES = 8, 16
SAME_NS = 5_000_000
"""A Status states the age of the last fix that was taken; the fix whose image is that old, to this, is the one."""
FRESH_NS = 2_000_000_000
"""An attitude older than this tells no heading any more."""


class Seen:
    """The newest of each kind; bounded, whatever comes."""

    def __init__(self) -> None:
        self._attitude: Attitude | None = None
        self._gnss: Gnss | None = None
        self._link: LinkChanged | None = None
        self._frame_ns: int | None = None
        self._answer: Fix | NoFix | None = None
        self._status: Status | None = None
        self._fixes: deque[tuple[int, str]] = deque(maxlen=FIXES)
        self._notices: deque[tuple[int, Notice]] = deque(maxlen=NOTICES)

    def event(self, event: Event) -> None:
        """Take what the navigator is given."""
        match event:
            case Attitude():
                self._attitude = event
            case Gnss(receiver=0):
                self._gnss = event
            case FrameRef():
                self._frame_ns = event.t_rx_ns
            case Fix():
                self._answer = event
                self._fixes.append((event.t_ns, event.method))
            case NoFix():
                self._answer = event
            case LinkChanged():
                self._link = event

    def command(self, now_ns: int, command: Command) -> None:
        """Take what it answers, and what the shell itself reports."""
        if isinstance(command, Status):
            self._status = command
        elif isinstance(command, Notice) and command.to_operator:
            self._notices.append((now_ns, command))

    def snapshot(self, now_ns: int) -> dict[str, Any]:
        """Plain JSON values; None stands for what was never heard. Ages: seconds since it arrived, of `fix` since its image."""
        return {
            "autopilot": self._autopilot(),
            "heading_deg": self._heading_deg(now_ns),
            "gnss": self._gnss_report(now_ns),
            "fix": self._taken_fix(),
            "answer": self._newest_answer(now_ns),
            "frame_age_s": None if self._frame_ns is None else _age_s(now_ns, self._frame_ns),
            "notices": [
                {"severity": notice.severity.value, "text": notice.text, "age_s": _age_s(now_ns, t_ns)}
                for t_ns, notice in reversed(self._notices)
            ],
        }

    def _autopilot(self) -> dict[str, Any] | None:
        link = self._link
        return None if link is None else {"kind": link.autopilot.value, "version": link.version, "armed": link.armed}

    def _heading_deg(self, now_ns: int) -> float | None:
        """Where the nose points, from true north clockwise."""
        if self._attitude is None or now_ns - self._attitude.t_rx_ns > FRESH_NS:
            return None
        return _finite(math.degrees(euler_from_quat(self._attitude.q_ned_frd)[2]) % 360.0)

    def _gnss_report(self, now_ns: int) -> dict[str, Any] | None:
        gnss = self._gnss
        if gnss is None:
            return None
        return {
            "lat_deg": _finite(gnss.place.lat_deg),
            "lon_deg": _finite(gnss.place.lon_deg),
            "fix_type": gnss.fix_type,
            "n_satellites": gnss.n_satellites,
            "h_acc_m": _finite(gnss.h_acc_m),
            "age_s": _age_s(now_ns, gnss.t_rx_ns),
        }

    def _taken_fix(self) -> dict[str, Any] | None:
        """Method of the fix that the position rests on, None where that is not known (or older than the last so many)."""
        status = self._status
        if status is None or status.age_of_fix_s is None or not math.isfinite(status.age_of_fix_s):
            return None
        taken_ns = status.t_ns - round(status.age_of_fix_s * 1e9)
        methods = [method for t_ns, method in self._fixes if abs(t_ns - taken_ns) <= SAME_NS]
        return {"method": methods[-1] if methods else None, "age_s": status.age_of_fix_s}

    def _newest_answer(self, now_ns: int) -> dict[str, Any] | None:
        """The localiser's newest answer, taken by the navigator or not; `reason` is of a NoFix."""
        answer = self._answer
        if answer is None:
            return None
        return {
            "method": answer.method,
            "reason": answer.reason.value if isinstance(answer, NoFix) else None,
            "elapsed_ms": _finite(answer.elapsed_ms),
            "age_s": _age_s(now_ns, answer.t_rx_ns),
        }


def _age_s(now_ns: int, t_ns: int) -> float:
    return round(max(0, now_ns - t_ns) / 1e9, 3)


def _finite(value: float | None) -> float | None:
    return value if value is not None and math.isfinite(value) else None
