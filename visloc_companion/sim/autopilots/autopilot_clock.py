"""How the two autopilots turn the time stamps of a companion into their own time (autopilot facts, 1.3 and 2.3)."""

from __future__ import annotations

import math

MAX_LAG_S, REBASE_AFTER = 0.5, 100


class JitterCorrection:
    """ArduPilot's AP_RTC/JitterCorrection: removes jitter, never the constant latency. One for all messages of a link."""

    def __init__(self) -> None:
        self._offset_s = math.inf
        self._min_sample_s = math.inf
        self._count = 0

    def correct(self, remote_s: float, local_s: float) -> float:
        """The local time at which a message stamped `remote_s` would have arrived without jitter."""
        difference = local_s - remote_s
        self._offset_s = min(self._offset_s, difference)
        corrected = remote_s + self._offset_s
        if local_s - corrected > MAX_LAG_S:
            corrected = local_s - MAX_LAG_S
            self._offset_s = corrected - remote_s
        self._min_sample_s = min(self._min_sample_s, difference)
        self._count += 1
        if self._count >= REBASE_AFTER:
            self._offset_s, self._min_sample_s, self._count = self._min_sample_s, math.inf, 0
        return corrected


class Px4Timesync:
    """PX4's Timesync: converged after 500 accepted replies, each with a round trip below 10 ms; > 10 bad ones start anew."""

    WINDOW, MAX_RTT_S, MAX_DEVIATION_S, MAX_BAD, GAIN = 500, 0.010, 0.100, 10, 0.05

    def __init__(self) -> None:
        self._accepted = self._bad = 0
        self._offset_s = 0.0

    @property
    def converged(self) -> bool:
        """Whether stamps are converted."""
        return self._accepted >= self.WINDOW

    def reply(self, sent_s: float, remote_s: float, now_s: float) -> None:
        """Take a reply to our request of `sent_s` that carries the companion's clock."""
        offset = (sent_s + now_s) / 2 - remote_s
        deviates = self._accepted > 0 and abs(offset - self._offset_s) > self.MAX_DEVIATION_S
        if now_s - sent_s >= self.MAX_RTT_S or deviates:
            self._bad += 1
            if self._bad > self.MAX_BAD:
                self._accepted = self._bad = 0
            return
        self._bad = 0
        share = max(self.GAIN, 1.0 / (self._accepted + 1))
        self._offset_s += share * (offset - self._offset_s)
        self._accepted += 1

    def convert(self, remote_s: float, now_s: float) -> float:
        """The stamp on our clock: converted where converged (never in the future), else the time of arrival."""
        return min(remote_s + self._offset_s, now_s) if self.converged else now_s
