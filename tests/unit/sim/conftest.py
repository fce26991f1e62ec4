"""A companion on the other end of the simulated autopilot's link, for the tests of the autopilot.

PX4's TIMESYNC converges only with `step_s=0.01`: with longer steps the round trip reaches 10 ms of simulated time.
"""

from __future__ import annotations

import math
import random
import struct
from collections import Counter, deque
from collections.abc import Callable, Mapping
from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from visloc_companion.geo.wgs84 import autopilot_ned_from_geo
from visloc_companion.sim.autopilot import BuiltInAutopilot
from visloc_companion.sim.faults import FaultSchedule
from visloc_companion.types import AutopilotKind, GeoPoint, Vec3

HOME = GeoPoint(47.3977, 8.5456, 488.0)
CLOCK_OFFSET_S = 100.0


def square(side_m: float, height_m: float) -> list[Vec3]:
    return [(0, 0, -height_m), (side_m, 0, -height_m), (side_m, side_m, -height_m), (0, side_m, -height_m)]


class Companion:
    """Flies an autopilot and sends it noisy true positions; keeps what it hears and the autopilot's error."""

    def __init__(
        self,
        kind: str = "ardupilot",
        vehicle: str = "copter",
        mission: list[Vec3] | None = None,
        speed_mps: float = 10.0,
        seed: int = 1,
        faults: FaultSchedule | None = None,
        rate_hz: float = 10.0,
        sigma_m: float = 1.0,
        latency_s: float = 0.1,
        variance_m2: Vec3 | None = None,
        parameters: Mapping[str, float] | None = None,
        sending: bool = True,
        step_s: float = 0.02,
        **more: Any,
    ) -> None:
        self.pilot = BuiltInAutopilot(
            AutopilotKind(kind), vehicle, HOME, mission or square(240, 40), speed_mps, seed, faults,
            wind_ned_mps=(3, 2.6, 0), parameters=parameters, **more,
        )  # fmt: skip
        self.rate_hz, self.sigma_m, self.latency_s = rate_hz, sigma_m, latency_s
        self.variance_m2 = variance_m2 or (sigma_m**2,) * 3
        self.sending, self.offset_m, self.reset_counter = sending, (0.0, 0.0), 0
        self.error_m: list[tuple[float, float]] = []
        self.texts: list[tuple[float, str]] = []
        self.heard: Counter[str] = Counter()
        self.last: dict[str, Any] = {}
        self.answers_timesync, self._step_s = True, step_s
        self._mav = mavlink.MAVLink(None, srcSystem=1, srcComponent=197)
        self._ears = mavlink.MAVLink(None)
        self._judge_s = 0.0
        self._rng, self._due_s, self._under_way = random.Random(seed), 0.0, deque[Any]()

    def send(self, message: Any) -> None:
        self.pilot.receive(message.pack(self._mav))
        self.listen()

    def command(self, number: int, param1: float, param2: float = 0.0) -> int:
        self.send(mavlink.MAVLink_command_long_message(1, 1, number, 0, param1, param2, 0, 0, 0, 0, 0))
        return int(self.last["COMMAND_ACK"].result)

    def set_px4_integer(self, name: str, value: int) -> None:
        field = struct.unpack("<f", struct.pack("<i", value))[0]
        self.send(mavlink.MAVLink_param_set_message(1, 1, name.encode(), field, mavlink.MAV_PARAM_TYPE_INT32))

    def listen(self) -> None:
        for message in self._ears.parse_buffer(self.pilot.outgoing()) or []:
            name = message.get_type()
            self.heard[name] += 1
            self.last[name] = message
            if name == "STATUSTEXT":
                self.texts.append((self.pilot.t_s, message.text))
            elif name == "TIMESYNC" and message.tc1 == 0 and self.answers_timesync:
                clock_ns = round((self.pilot.t_s + CLOCK_OFFSET_S) * 1e9)
                self.send(mavlink.MAVLink_timesync_message(clock_ns, message.ts1))

    def fly(self, duration_s: float, watch: Callable[[], None] | None = None) -> Companion:
        end_s = self.pilot.t_s + duration_s - 1e-6
        while self.pilot.t_s < end_s:
            self.pilot.step(self._step_s)
            self.listen()
            self._inject()
            if watch is not None:
                watch()
        return self

    def true_local(self) -> Vec3:
        return autopilot_ned_from_geo(self.pilot.kind, self.pilot.truth().place, self.pilot.flight.origin or HOME)

    def estimated_local(self) -> Vec3:
        f = self.pilot.flight.filter
        return f.north.p_now, f.east.p_now, f.down.p_now

    def _inject(self) -> None:
        now_s = self.pilot.t_s
        if now_s >= self._judge_s:
            self._judge_s = now_s + 0.05
            true, estimated = self.true_local(), self.estimated_local()
            self.error_m.append((now_s, math.hypot(estimated[0] - true[0], estimated[1] - true[1])))
        if self.sending and now_s >= self._due_s - 1e-9:
            true = self.true_local()
            self._due_s = max(self._due_s, now_s - 0.1) + 1 / self.rate_hz
            north, east = (true[i] + self._rng.gauss(0, self.sigma_m) + self.offset_m[i] for i in (0, 1))
            self._under_way.append((now_s + self.latency_s, now_s, north, east, true[2], self.reset_counter))
        while self._under_way and self._under_way[0][0] <= now_s + 1e-9:
            _, t_s, north, east, down, counter = self._under_way.popleft()
            covariance = [0.0] * 21
            covariance[0], covariance[6], covariance[11] = self.variance_m2
            covariance[15] = covariance[18] = covariance[20] = 0.01
            usec = round((t_s + CLOCK_OFFSET_S) * 1e6)
            self.send(mavlink.MAVLink_vision_position_estimate_message(usec, north, east, down, 0, 0, 0, covariance, counter))

    def rms_m(self, from_s: float) -> float:
        values = [e for t, e in self.error_m if t >= from_s]
        return math.sqrt(sum(e * e for e in values) / len(values))

    def max_m(self, from_s: float) -> float:
        return max(e for t, e in self.error_m if t >= from_s)

    def first_s(self, from_s: float, above_m: float) -> float:
        """Seconds after `from_s` at which the error first exceeded a bound."""
        return next(t for t, e in self.error_m if t >= from_s and e > above_m) - from_s


@pytest.fixture
def companion() -> type[Companion]:
    """The companion's class, to be built with the flight that a test needs."""
    return Companion
