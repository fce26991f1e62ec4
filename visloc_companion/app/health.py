"""Health of the daemon's parts: the watchdog beat goes out only while all of them beat.

A part beats when the code that serves it makes progress: the link while its connection is seen to, the camera on
a frame or on an orderly attempt to open it again, the worker while it answers or is being restarted, the tick on each tick. So
an unplugged camera in flight does not restart a daemon that still dead-reckons, and a part that hangs does.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import IntFlag

from visloc_companion.types import Mode, Status, Verdict

_NS_PER_S = 1_000_000_000


class Sensor(IntFlag):
    """Bits of SYS_STATUS.onboard_control_sensors_health (MAV_SYS_STATUS_SENSOR), as far as the daemon can judge them."""

    GNSS = 0x20
    VISION_POSITION = 0x80
    LOGGING = 0x1000000


def sensor_health(status: Status, *, recording: bool) -> Sensor:
    """What is healthy: GNSS that is trusted, a position from fixes within the alert limits, the record of the flight."""
    sees = status.mode in (Mode.AIDING, Mode.SHADOW) and status.age_of_fix_s is not None and status.available
    gnss = Sensor.GNSS if status.verdict is Verdict.OK else Sensor(0)
    vision = Sensor.VISION_POSITION if sees else Sensor(0)
    return gnss | vision | (Sensor.LOGGING if recording else Sensor(0))


@dataclass
class Health:
    """Times of the last beats on the shell's clock, and the metric of the tick's time grid."""

    limits_s: dict[str, float]
    """Parts that must beat, and the longest pause that each may make."""
    cycle_slips: int = 0
    ticks: int = 0
    _last_ns: dict[str, int] = field(default_factory=dict)

    def start(self, now_ns: int) -> None:
        """Every part has just been started."""
        self._last_ns = dict.fromkeys(self.limits_s, now_ns)

    def beat(self, part: str, now_ns: int) -> None:
        """A part made progress. A part without a limit is not watched."""
        if part in self.limits_s:
            self._last_ns[part] = max(now_ns, self._last_ns.get(part, now_ns))

    def tick(self, now_ns: int, slipped: int) -> None:
        """The tick came; so many ticks of the time grid were missed before it."""
        self.ticks += 1
        self.cycle_slips += slipped
        self.beat("tick", now_ns)

    def late(self, now_ns: int) -> list[str]:
        """Parts that have not beaten within their limits."""
        never = now_ns - 2**62
        return [part for part, limit in self.limits_s.items() if now_ns - self._last_ns.get(part, never) > limit * _NS_PER_S]

    def ages_s(self, now_ns: int) -> dict[str, float]:
        """Seconds since the last beat of each part."""
        return {part: (now_ns - last) / _NS_PER_S for part, last in self._last_ns.items()}
