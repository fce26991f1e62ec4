"""The camera's and the worker's part of a flight when something is wrong with them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise

import pytest

from visloc_companion.adapters.mavlink.session import MavlinkSession
from visloc_companion.adapters.mavlink.settings import SessionSettings
from visloc_companion.core.navigator import Navigator
from visloc_companion.core.settings import CoreSettings
from visloc_companion.errors import Reason
from visloc_companion.sim import faults
from visloc_companion.sim.autopilot import BuiltInAutopilot
from visloc_companion.sim.faults import FaultSchedule
from visloc_companion.sim.faults.schedule import Fault
from visloc_companion.sim.flight import CLOCK_OFFSET_NS, ClosedLoopFlight, Eyes, FlightLog
from visloc_companion.types import (
    Attitude,
    AutopilotKind,
    Fix,
    FrameRef,
    GeoPoint,
    Injection,
    LocaliseRequest,
    NoFix,
    Notice,
    WorkerState,
)

HOME = GeoPoint(47.4, 8.55, 480.0)
LOOP_NED_M = ((0.0, 0.0, -100.0), (200.0, 0.0, -100.0), (200.0, 200.0, -100.0))
MakeEyes = Callable[..., Eyes]


def fly(schedule: FaultSchedule, duration_s: float, eyes: Eyes) -> FlightLog:
    pilot = BuiltInAutopilot(AutopilotKind.ARDUPILOT, "copter", HOME, LOOP_NED_M, 10.0, 1, schedule, (2.0, -1.0, 0.0))
    flight = ClosedLoopFlight(pilot, Navigator(CoreSettings(structure=False)), MavlinkSession(SessionSettings()), eyes)
    return flight.run(duration_s)


def test_late_frames_keep_their_stamps_and_overtake_each_other(oracle_eyes: MakeEyes) -> None:
    log = fly(faults.these(faults.FramesLate(0.0, 0.1, 0.8)), 8.0, oracle_eyes())
    frames = [(entry.now_ns, entry.event) for entry in log.entries if isinstance(entry.event, FrameRef)]
    late_s = [(frame.t_rx_ns - frame.t_ns) / 1e9 for _, frame in frames]
    assert all(now_ns == frame.t_rx_ns for now_ns, frame in frames)
    assert min(late_s) >= 0.1
    assert 0.5 < max(late_s) < 0.95
    assert any(b.frame_id < a.frame_id for (_, a), (_, b) in pairwise(frames))
    assert all(frame.t_boot_ns is not None and frame.t_ns - frame.t_boot_ns == CLOCK_OFFSET_NS for _, frame in frames)


def test_frames_of_a_fast_camera_may_be_late_by_seconds(oracle_eyes: MakeEyes) -> None:
    """A frame that arrived after 50 others had been exposed ended the flight: nobody knew its view any more."""
    log = fly(faults.these(faults.FramesLate(0.0, 2.0, 1.0)), 8.0, replace(oracle_eyes(), rate_hz=30.0))
    asked = [entry.command.frame for entry in log.entries if isinstance(entry.command, LocaliseRequest)]
    assert [frame for frame in asked if frame.t_rx_ns - frame.t_ns > 2_500_000_000]


def test_a_worker_that_dies_answers_nothing_and_comes_back_with_an_empty_memory(oracle_eyes: MakeEyes) -> None:
    eyes, opened = oracle_eyes(misses=0.0), []

    def reopen() -> object:
        opened.append(1)
        return oracle_eyes(misses=0.0).localiser

    log = fly(faults.these(faults.WorkerCrash(4.0, 2.0)), 9.0, replace(eyes, reopen=reopen))
    events = [entry.event for entry in log.entries]
    states = [(event.up, round((event.t_rx_ns - CLOCK_OFFSET_NS) / 1e9, 1)) for event in events if isinstance(event, WorkerState)]
    assert states == [(False, 4.0), (True, 6.0)]
    assert opened == [1]
    answers = {event.request_id: event for event in events if isinstance(event, Fix | NoFix)}
    asked = [entry.command.request_id for entry in log.entries if isinstance(entry.command, LocaliseRequest)]
    assert set(asked[:-2]) <= set(answers), "every question but the last has an answer"
    fixed_s = [(fix.t_rx_ns - CLOCK_OFFSET_NS) / 1e9 for fix in answers.values() if isinstance(fix, Fix)]
    assert not [t for t in fixed_s if 4.0 <= t < 6.0]
    assert [t for t in fixed_s if t > 6.0]
    assert {answer.reason for answer in answers.values() if isinstance(answer, NoFix)} <= {Reason.WORKER_DIED}


def test_nothing_passes_a_link_that_is_down(oracle_eyes: MakeEyes) -> None:
    log = fly(faults.these(faults.LinkGap(4.0, 5.5)), 8.0, oracle_eyes())
    heard_s = [(entry.now_ns - CLOCK_OFFSET_NS) / 1e9 for entry in log.entries if isinstance(entry.event, Attitude)]
    assert not [t for t in heard_s if 4.02 <= t < 5.5]
    assert [t for t in heard_s if t > 5.6]


def test_the_autopilots_clock_steps_and_the_companions_does_not(oracle_eyes: MakeEyes) -> None:
    log = fly(faults.these(faults.AutopilotClockStep(4.0, 3.0)), 8.0, oracle_eyes())
    stamps = [(entry.now_ns, entry.event.t_boot_ns) for entry in log.entries if isinstance(entry.event, Attitude)]
    steps_s = {round((b[1] - a[1] - (b[0] - a[0])) / 1e9, 1) for a, b in pairwise(stamps)}
    assert steps_s == {0.0, 3.0}
    times = [entry.now_ns for entry in log.entries]
    assert times == sorted(times)
    assert len(log.truth) == 81


def test_the_companions_clock_steps_and_truth_keeps_to_it(oracle_eyes: MakeEyes) -> None:
    ahead = fly(faults.these(faults.CompanionClockStep(4.0, 1.5)), 8.0, oracle_eyes())
    assert max(b.now_ns - a.now_ns for a, b in pairwise(ahead.entries)) > 1_490_000_000
    back = fly(faults.these(faults.CompanionClockStep(4.0, -1.0)), 8.0, oracle_eyes())
    assert min(b.now_ns - a.now_ns for a, b in pairwise(back.entries)) <= -980_000_000
    for log in (ahead, back):
        times = [sample.t_ns for sample in log.truth]
        assert times == sorted(set(times))


@pytest.mark.parametrize(
    ("fault", "told"),
    [
        (faults.CompanionClockStep(6.0, 1.5), ["visloc: companion clock stepped +1.5 s"]),
        (faults.CompanionClockStep(6.0, 7.0), ["visloc: companion clock stepped +7.0 s"]),
        (faults.AutopilotClockStep(12.0, -8.0), ["visloc: autopilot clock stepped -8.0 s"]),
        (faults.AutopilotClockStep(6.0, -3.0), ["visloc: clocks stepped apart by 3.0 s"]),
        (faults.AutopilotClockStep(6.0, 8.0), ["visloc: clocks stepped apart by 8.0 s"]),
    ],
)
def test_the_operator_reads_whose_clock_stepped_where_that_is_known(oracle_eyes: MakeEyes, fault: Fault, told: list[str]) -> None:
    """A companion that stood still for 8 s (suspended) looks as an autopilot does that went ahead."""
    log = fly(faults.these(fault), 16.0, oracle_eyes())
    notices = [entry.command.text for entry in log.entries if isinstance(entry.command, Notice)]
    assert [text for text in notices if "clock" in text] == told


def test_compass_and_barometer_mislead_the_autopilot_itself() -> None:
    """A heading that is wrong by 20 degrees and a height that is wrong by 20 m reach what it sends and how it flies."""
    wrong = faults.these(faults.CompassError(1.0, 0.35, 1.0), faults.BaroDrift(1.0, 20.0, 20.0))
    pilots = [
        BuiltInAutopilot(AutopilotKind.ARDUPILOT, "copter", HOME, LOOP_NED_M, 10.0, 1, schedule)
        for schedule in (FaultSchedule(), wrong)
    ]
    for pilot in pilots:
        pilot.step(40.0)
    headings = [pilot.flight.attitude.yaw_error_rad for pilot in pilots]
    assert headings[1] - headings[0] == 0.35
    heights = [pilot.truth().place.h_amsl_m for pilot in pilots]
    assert 15.0 < heights[0] - heights[1] < 22.0, "it sinks by what its barometer rises"
    believed = [pilot.estimate() for pilot in pilots]
    assert believed[0] is not None
    assert believed[1] is not None
    assert abs(believed[0].h_amsl_m - believed[1].h_amsl_m) < 3.0


def test_injections_go_on_where_frames_are_late(oracle_eyes: MakeEyes) -> None:
    log = fly(faults.jam(2.0) + faults.these(faults.FramesLate(0.0, 0.1, 0.6)), 9.0, oracle_eyes())
    assert len([entry for entry in log.entries if isinstance(entry.command, Injection)]) > 30
