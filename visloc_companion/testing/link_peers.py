"""The two peers of the link contract that come with the package: behind a wire, and inside the fake link."""

from __future__ import annotations

from dataclasses import dataclass

from visloc_companion.adapters.mavlink.dialect import mav
from visloc_companion.testing.fake_autopilot import FakeAutopilot
from visloc_companion.testing.fake_link import FakeLink
from visloc_companion.types import Attitude, AutopilotKind, EkfSource, GeoPoint, Vec3

_NO_CORE = 255


@dataclass(slots=True)
class WirePeer:
    """`contract_link.LinkPeer` of a fake autopilot that speaks MAVLink."""

    autopilot: FakeAutopilot

    def set_origin(self, origin: GeoPoint) -> None:
        """See LinkPeer."""
        self.autopilot.origin = origin

    def say_attitude(self) -> None:
        """See LinkPeer."""
        self.autopilot.send(mav.MAVLink_attitude_message(1000, 0.0, 0.0, 0.5, 0.0, 0.0, 0.0))

    def grant(self, *, streams: bool, switches: bool) -> None:
        """See LinkPeer."""
        self.autopilot.behaviour.deny_above_hz = float("inf") if streams else 0.0
        self.autopilot.behaviour.answers_switch = mav.MAV_RESULT_ACCEPTED if switches else mav.MAV_RESULT_DENIED

    def set_silent(self, silent: bool) -> None:
        """See LinkPeer."""
        self.autopilot.behaviour.silent = silent

    def source(self) -> EkfSource:
        """See LinkPeer."""
        px4 = self.autopilot.kind is AutopilotKind.PX4
        vision = self.autopilot.params["EKF2_GPS_CTRL"] == 0 if px4 else self.autopilot.source_set == 2
        return EkfSource.VISION if vision else EkfSource.GNSS

    def poses(self) -> list[tuple[Vec3, int]]:
        """See LinkPeer."""
        return [((pose.x, pose.y, pose.z), pose.reset_counter) for pose in self.autopilot.poses]

    def texts(self) -> list[str]:
        """See LinkPeer."""
        return self.autopilot.texts

    def told(self) -> dict[str, float]:
        """See LinkPeer."""
        named = [message for message in self.autopilot.told if message.get_type() != "ONBOARD_COMPUTER_STATUS"]
        loads = [message for message in self.autopilot.told if message not in named]
        cores = {"cores": sum(percent != _NO_CORE for percent in loads[-1].cpu_cores)} if loads else {}
        return {message.name: message.value for message in named} | cores


@dataclass(slots=True)
class FakePeer:
    """`contract_link.LinkPeer` of a FakeLink."""

    link: FakeLink

    def set_origin(self, origin: GeoPoint) -> None:
        """See LinkPeer."""
        self.link.set_origin(origin)

    def say_attitude(self) -> None:
        """See LinkPeer."""
        self.link.feed(Attitude(self.link.clock.now_ns(), 1_000_000_000, (1.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0)))

    def grant(self, *, streams: bool, switches: bool) -> None:
        """See LinkPeer."""
        self.link.grants_streams, self.link.grants_switches = streams, switches

    def set_silent(self, silent: bool) -> None:
        """See LinkPeer."""
        self.link.set_up(not silent)

    def source(self) -> EkfSource:
        """See LinkPeer."""
        return self.link.source

    def poses(self) -> list[tuple[Vec3, int]]:
        """See LinkPeer."""
        return [(injection.p_ned_m, injection.reset_counter) for injection in self.link.injections]

    def texts(self) -> list[str]:
        """See LinkPeer."""
        said = [notice.text for notice in self.link.notices]
        return [text for i, text in enumerate(said) if i == 0 or said[i - 1] != text]

    def told(self) -> dict[str, float]:
        """See LinkPeer."""
        loads = [report.load for report in self.link.reports if report.load is not None]
        cores = {"cores": len(loads[-1].cores)} if loads else {}
        return {name: value for report in self.link.reports for name, value in report.values} | cores
