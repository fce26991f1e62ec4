"""A pilot switches the position source as the daemon's texts ask for, in his own time (`injection.switch_source` is false)."""

from __future__ import annotations

from collections.abc import Callable

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from visloc_companion.adapters.mavlink.session import MavlinkSession
from visloc_companion.adapters.mavlink.settings import SessionSettings
from visloc_companion.core.navigator import Navigator
from visloc_companion.core.settings import CoreSettings, InjectionSettings
from visloc_companion.sim import faults
from visloc_companion.sim.autopilot import BuiltInAutopilot
from visloc_companion.sim.flight import ClosedLoopFlight, Eyes
from visloc_companion.types import AutopilotKind, GeoPoint, Notice

HOME = GeoPoint(59.3, 18.1, 40.0)
COURSE_NED_M = [(0.0, 0.0, -100.0), (400.0, 0.0, -100.0), (400.0, 400.0, -100.0), (0.0, 400.0, -100.0)]
JAM_S, FREE_S, END_S = 15.0, 20.0, 72.0
TO_VISION_S, TO_GNSS_S = 3.0, 20.0
SETS = {"VISION": 2, "GNSS": 1}


class Piloted(BuiltInAutopilot):
    """ArduPilot with a pilot who hurries to vision, and takes his time on the way back."""

    def __init__(self) -> None:
        self.switched: list[tuple[float, str]] = []
        self._ears = mavlink.MAVLink(None)
        self._to_do: list[tuple[float, str]] = []
        schedule = faults.jam(JAM_S, FREE_S)
        super().__init__(AutopilotKind.ARDUPILOT, "copter", HOME, COURSE_NED_M, 10.0, 1, schedule, (2.0, -1.0, 0.0))

    def receive(self, data: bytes) -> None:
        now_s = self.t_boot_ns * 1e-9
        for message in self._ears.parse_buffer(data) or []:
            if message.get_type() == "STATUSTEXT" and "set EKF position source to" in message.text:
                source = message.text.split()[-1]
                self._to_do.append((now_s + (TO_VISION_S if source == "VISION" else TO_GNSS_S), source))
        super().receive(data)
        for at_s, source in [each for each in self._to_do if each[0] <= now_s]:
            self._to_do.remove((at_s, source))
            self.switched.append((now_s, source))
            hand = mavlink.MAVLink(None, srcSystem=255, srcComponent=190)
            number = mavlink.MAV_CMD_SET_EKF_SOURCE_SET
            super().receive(hand.command_long_encode(1, 1, number, 0, SETS[source], 0, 0, 0, 0, 0, 0).pack(hand))


def test_positions_last_until_a_pilot_has_gone_back_to_gnss(oracle_eyes: Callable[..., Eyes]) -> None:
    pilot = Piloted()
    navigator = Navigator(CoreSettings(structure=False, injection=InjectionSettings(switch_source=False)))
    log = ClosedLoopFlight(pilot, navigator, MavlinkSession(SessionSettings()), oracle_eyes()).run(END_S)
    trusted_ns = [e.now_ns for e in log.entries if isinstance(e.command, Notice) and e.command.text == "visloc: GNSS trusted"]
    asked_ns = [e.now_ns for e in log.entries if isinstance(e.command, Notice) and e.command.text.endswith("source to GNSS")]
    assert asked_ns == trusted_ns[1:]
    assert [source for _, source in pilot.switched] == ["VISION", "GNSS"]
    assert log.failsafe is None
