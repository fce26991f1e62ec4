"""The closed loop in simulated time: what arrives when, and what is carried out."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise
from typing import TypeVar

import numpy as np
import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from visloc_companion.adapters.mavlink.session import MavlinkSession
from visloc_companion.adapters.mavlink.settings import SessionSettings
from visloc_companion.core.navigator import Navigator
from visloc_companion.core.settings import CoreSettings, InjectionSettings
from visloc_companion.geo.wgs84 import distance_m, ned_from_geo
from visloc_companion.sim import faults
from visloc_companion.sim.autopilot import BuiltInAutopilot
from visloc_companion.sim.faults import FaultSchedule
from visloc_companion.sim.flight import CLOCK_OFFSET_NS, LINK_DELAY_NS, ClosedLoopFlight, Eyes, FlightLog, OperatorEntry
from visloc_companion.types import (
    AutopilotKind,
    Fix,
    FrameRef,
    GeoPoint,
    Injection,
    LinkChanged,
    NoFix,
    OperatorFix,
    OriginChanged,
    SourceSwitched,
    Tick,
    TimesyncSample,
)

HOME = GeoPoint(47.4, 8.55, 480.0)
LOOP_NED_M = ((0.0, 0.0, -100.0), (200.0, 0.0, -100.0), (200.0, 200.0, -100.0))
MakeEyes = Callable[..., Eyes]
T = TypeVar("T")


class Overheard(BuiltInAutopilot):
    """Notes the round trip of every TIMESYNC that it asked for, on its own clock, and which messages it received."""

    def __init__(self, kind: AutopilotKind, schedule: FaultSchedule | None = None) -> None:
        self.round_trips_s: list[float] = []
        self.heard: set[str] = set()
        self._ears = mavlink.MAVLink(None)
        super().__init__(kind, "copter", HOME, LOOP_NED_M, 10.0, 1, schedule or FaultSchedule(), (2.0, -1.0, 0.0))

    def receive(self, data: bytes) -> None:
        for message in self._ears.parse_buffer(data) or []:
            self.heard.add(message.get_type())
            if message.get_type() == "TIMESYNC" and message.tc1 != 0:
                self.round_trips_s.append((self.t_boot_ns - message.ts1) / 1e9)
        super().receive(data)


def fly(pilot: BuiltInAutopilot, duration_s: float, eyes: Eyes, operator: OperatorEntry | None = None) -> FlightLog:
    navigator = Navigator(CoreSettings(structure=False, injection=InjectionSettings(switch_source=True)))
    return ClosedLoopFlight(pilot, navigator, MavlinkSession(SessionSettings()), eyes, operator=operator).run(duration_s)


def events_of(log: FlightLog, kind: type[T]) -> list[T]:
    return [entry.event for entry in log.entries if isinstance(entry.event, kind)]


def test_px4_can_believe_our_clock(oracle_eyes: MakeEyes) -> None:
    """PX4 takes 500 exchanges below 10 ms in a row before it converts our stamps."""
    pilot = Overheard(AutopilotKind.PX4)
    fly(pilot, 56.0, oracle_eyes())
    assert len(pilot.round_trips_s) > 500
    assert max(pilot.round_trips_s) < 0.010


@pytest.mark.parametrize("kind", [AutopilotKind.ARDUPILOT, AutopilotKind.PX4], ids=str)
def test_our_own_clock_exchange_finds_the_offset(kind: AutopilotKind, oracle_eyes: MakeEyes) -> None:
    """The navigator's clock is not the autopilot's boot clock; half of each round trip gives their difference to 2 ms."""
    log = fly(Overheard(kind), 5.0, oracle_eyes())
    samples = events_of(log, TimesyncSample)
    assert len(samples) > 10
    for sample in samples:
        assert 0 < sample.t_rx_ns - sample.t_sent_ns <= 4 * LINK_DELAY_NS
        offset_ns = (sample.t_rx_ns + sample.t_sent_ns) / 2 - sample.t_remote_ns
        assert offset_ns == pytest.approx(CLOCK_OFFSET_NS, abs=2e6)


def test_time_never_goes_back_and_ticks_come_at_their_rate(oracle_eyes: MakeEyes) -> None:
    log = fly(Overheard(AutopilotKind.ARDUPILOT), 6.0, oracle_eyes())
    times_ns = [entry.now_ns for entry in log.entries]
    assert times_ns == sorted(times_ns)
    ticks_ns = [tick.t_rx_ns for tick in events_of(log, Tick)]
    assert {b - a for a, b in pairwise(ticks_ns)} == {100_000_000}
    assert len(ticks_ns) == 60
    exposed_ns = [frame.t_ns for frame in events_of(log, FrameRef)]
    assert {b - a for a, b in pairwise(exposed_ns)} == {250_000_000}


def test_frames_are_stamped_where_they_were_taken(oracle_eyes: MakeEyes) -> None:
    """With an oracle without noise every fix lies on the true path at the frame's time, and arrives 0.15 s after the request."""
    log = fly(Overheard(AutopilotKind.ARDUPILOT), 12.0, oracle_eyes(sigma_m=0.01, misses=0.0))
    frames = {frame.frame_id: frame for frame in events_of(log, FrameRef)}
    fixes = events_of(log, Fix)
    assert len(fixes) > 30
    true_ns = np.array([sample.t_ns for sample in log.truth])
    for fix in fixes:
        frame = frames[fix.frame_id]
        assert frame.t_boot_ns is not None
        assert frame.t_ns - frame.t_boot_ns == CLOCK_OFFSET_NS
        assert 0.15e9 <= fix.t_rx_ns - frame.t_rx_ns < 0.3e9
        k = int(np.searchsorted(true_ns, frame.t_ns))
        assert distance_m(fix.place, log.truth[k].place) < 1.5, "at most 0.1 s of flight"


def test_only_frames_that_are_asked_for_are_rendered(oracle_eyes: MakeEyes) -> None:
    eyes = oracle_eyes(misses=1.0)
    log = fly(Overheard(AutopilotKind.ARDUPILOT), 6.0, eyes)
    assert eyes.camera.rendered == [answer.frame_id for answer in events_of(log, NoFix)]  # type: ignore[attr-defined]
    assert 0 < len(events_of(log, NoFix)) < len(events_of(log, FrameRef))


def test_a_silent_camera_sends_nothing_and_goes_on_at_its_rate(oracle_eyes: MakeEyes) -> None:
    log = fly(Overheard(AutopilotKind.ARDUPILOT, faults.camera_silence(2.0, 4.0)), 6.0, oracle_eyes())
    times_s = [frame.t_boot_ns / 1e9 for frame in events_of(log, FrameRef) if frame.t_boot_ns is not None]
    assert not [t_s for t_s in times_s if 2.0 <= t_s < 4.0]
    gaps_s = [b - a for a, b in pairwise(times_s)]
    assert min(gaps_s) == pytest.approx(0.25)
    assert sorted(gaps_s)[-2] == pytest.approx(0.25)
    assert max(gaps_s) > 2.0


def test_a_frozen_camera_repeats_its_last_view(oracle_eyes: MakeEyes) -> None:
    """The frames have new numbers and times, and the very same pixels, which the navigator does not ask about again."""
    eyes = oracle_eyes(misses=0.0)
    log = fly(Overheard(AutopilotKind.ARDUPILOT, faults.camera_freeze(3.0, 4.0)), 6.0, eyes)
    frames = events_of(log, FrameRef)
    seen = [frame.checksum for frame in frames]
    (repeated,) = {checksum for checksum in seen if seen.count(checksum) > 1}
    assert seen.count(repeated) in {4, 5}
    assert len({frame.frame_id for frame in frames}) == len(frames)
    rendered = eyes.camera.rendered  # type: ignore[attr-defined]
    assert rendered.count(repeated) <= 1


def test_injections_reach_the_autopilot_and_the_source_is_switched(oracle_eyes: MakeEyes) -> None:
    pilot = Overheard(AutopilotKind.ARDUPILOT, faults.jam(3.0))
    log = fly(pilot, 10.0, oracle_eyes())
    assert {"VISION_POSITION_ESTIMATE", "HEARTBEAT", "COMMAND_LONG", "STATUSTEXT"} <= pilot.heard
    assert [entry for entry in log.entries if isinstance(entry.command, Injection)]
    assert all(switched.accepted for switched in events_of(log, SourceSwitched))
    assert pilot.source == "external"
    assert log.failsafe is None


def test_the_operator_sets_the_origin_before_the_position(oracle_eyes: MakeEyes) -> None:
    pilot = Overheard(AutopilotKind.PX4, faults.no_gnss())
    log = fly(pilot, 8.0, oracle_eyes(), OperatorEntry(1.0, (9.0, -7.0, 0.0), 15.0))
    origins, entered = events_of(log, OriginChanged), events_of(log, OperatorFix)
    assert [fix.sigma_m for fix in entered] == [15.0]
    for told, t_ns in ((origins[0].origin, origins[0].t_rx_ns), (entered[0].place, entered[0].t_rx_ns)):
        true = min(log.truth, key=lambda sample: abs(sample.t_ns - t_ns)).place
        assert ned_from_geo(told, true)[:2] == pytest.approx((9.0, -7.0), abs=1.0)
    assert origins[0].t_rx_ns < entered[0].t_rx_ns
    assert log.truth[-1].believed is not None


def test_without_a_navigator_only_the_truth_is_kept() -> None:
    told: list[float] = []
    pilot = Overheard(AutopilotKind.PX4)
    log = ClosedLoopFlight(pilot, None, None, None).run(3.0, told.append)
    assert log.entries == []
    assert pilot.heard == set()
    assert told == [0.0, 1.0, 2.0]
    assert log.duration_s == 3.0
    assert pilot.outgoing() == b"", "what the autopilot sent meanwhile is not kept"
    off_m = [sample.off_m for sample in log.truth]
    assert len(off_m) == 31
    assert all(off is not None and off < 5.0 for off in off_m), "with GNSS it knows where it is"


def test_an_unhelped_vehicle_is_put_down_by_its_failsafe() -> None:
    log = ClosedLoopFlight(Overheard(AutopilotKind.PX4, faults.jam(2.0)), None, None, None).run(20.0)
    assert log.failsafe is not None
    assert "land" in log.failsafe


def test_the_link_is_found_with_the_autopilots_kind(oracle_eyes: MakeEyes) -> None:
    links = events_of(fly(Overheard(AutopilotKind.PX4), 2.0, oracle_eyes()), LinkChanged)
    assert links[0].up
    assert links[0].autopilot is AutopilotKind.PX4
