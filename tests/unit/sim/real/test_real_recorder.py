"""What is sampled, and when, from the messages of a real simulator."""

from __future__ import annotations

from pathlib import Path

import pytest

from visloc_companion.adapters.mavlink.dialect import mav
from visloc_companion.geo.wgs84 import distance_m, geo_from_ned
from visloc_companion.sim.real.ardupilot import ArduPilot
from visloc_companion.sim.real.clock import EPOCH_NS, SlavedClock
from visloc_companion.sim.real.pilot import HOME, Truth
from visloc_companion.sim.real.record import COLUMNS, RealLog, write_csv
from visloc_companion.sim.real.recorder import Recorder, moved
from visloc_companion.sim.real.station import Station
from visloc_companion.types import EkfSource, Injection, OriginChanged, SourceSwitched, TimesyncSample

LEVEL = (1.0, 0.0, 0.0, 0.0)


@pytest.fixture
def recorder() -> Recorder:
    pilot, clock = ArduPilot(False, Path("none.parm")), SlavedClock()
    made = Recorder(pilot, clock, RealLog())
    made.station = Station(pilot.station_url, clock, made.hear)
    made.event(0, OriginChanged(0, HOME))
    return made


def tell(recorder: Recorder, message: object) -> None:
    station = recorder.station
    assert station is not None
    station.last[message.get_type()] = message  # type: ignore[attr-defined]
    recorder.hear(message)


def sim_state(north_m: float, vn: float) -> object:
    place = geo_from_ned((north_m, 0.0, 0.0), HOME)
    where = round(place.lat_deg * 1e7), round(place.lon_deg * 1e7)
    zero = (0.0,) * 9
    return mav.MAVLink_sim_state_message(*LEVEL, *zero, 0, 0, 548.0, 0, 0, vn, 0, 0, *where)


def local(t_ms: int, north_m: float) -> object:
    return mav.MAVLink_local_position_ned_message(t_ms, north_m, 0.0, -60.0, 10.0, 0.0, 0.0)


def test_truth_and_estimate_are_of_the_same_instant(recorder: Recorder) -> None:
    tell(recorder, mav.MAVLink_attitude_quaternion_message(1000, *LEVEL, 0, 0, 0))
    tell(recorder, sim_state(100.0, 10.0))
    tell(recorder, local(1020, 100.5))
    sample = recorder.log.samples[-1]
    assert sample.t_s == pytest.approx(1.02)
    assert sample.true_p_ned_m[0] == pytest.approx(100.2, abs=0.3)  # 20 ms later, and ArduPilot's metres
    assert sample.estimate_p_ned_m == (100.5, 0.0, -60.0)
    assert recorder.clock.now_ns() == EPOCH_NS + 1_020_000_000


def test_what_is_read_late_is_judged_at_its_own_time(recorder: Recorder) -> None:
    recorder.overhear(mav.MAVLink_attitude_quaternion_message(2200, *LEVEL, 0, 0, 0))  # the daemon's link, read first
    tell(recorder, mav.MAVLink_attitude_quaternion_message(1000, *LEVEL, 0, 0, 0))
    tell(recorder, sim_state(100.0, 15.0))
    tell(recorder, local(1020, 100.0))
    sample = recorder.log.samples[-1]
    assert sample.t_s == pytest.approx(1.02)
    assert sample.true_p_ned_m[0] == pytest.approx(100.3, abs=0.3)  # not 18 m on, where the vehicle is by now


def test_an_autopilot_that_falls_silent_has_no_estimate(recorder: Recorder) -> None:
    tell(recorder, sim_state(0.0, 0.0))
    tell(recorder, local(1000, 0.0))
    for t_ms in (1100, 1200, 1300, 1400):
        tell(recorder, mav.MAVLink_attitude_quaternion_message(t_ms, *LEVEL, 0, 0, 0))
        tell(recorder, sim_state(0.0, 0.0))
    assert [sample.estimate_p_ned_m is None for sample in recorder.log.samples] == [False, True]
    assert recorder.log.samples[-1].t_s == pytest.approx(1.4)


def test_round_trips_are_kept_with_the_time_of_their_answer(recorder: Recorder) -> None:
    tell(recorder, mav.MAVLink_attitude_quaternion_message(2000, *LEVEL, 0, 0, 0))
    recorder.event(0, TimesyncSample(1_620_000_000, 1_000_000_000, 1_300_000_000))
    assert recorder.log.round_trips == [(2.0, pytest.approx(0.62))]


def test_the_phase_is_what_the_autopilot_confirmed(recorder: Recorder, tmp_path: Path) -> None:
    tell(recorder, sim_state(0.0, 0.0))
    tell(recorder, local(1000, 0.0))
    recorder.event(0, SourceSwitched(0, EkfSource.VISION, False, "refused"))
    recorder.command(0, Injection(0, (3.0, 4.0, -60.0), HOME, LEVEL, ((1.0, 0.0), (0.0, 1.0)), 3.0, 0.1, 0))
    tell(recorder, local(1050, 0.0))
    recorder.event(0, SourceSwitched(0, EkfSource.VISION, True))
    tell(recorder, local(1100, 0.0))
    assert [(s.phase, s.injected_p_ned_m) for s in recorder.log.samples] == [
        ("gnss", None),
        ("gnss", (3.0, 4.0, -60.0)),
        ("vision", (3.0, 4.0, -60.0)),
    ]
    write_csv(recorder.log.samples, tmp_path / "samples.csv")
    rows = (tmp_path / "samples.csv").read_text(encoding="utf-8").splitlines()
    assert rows[0].split(",") == list(COLUMNS)
    assert all(len(row.split(",")) == len(COLUMNS) for row in rows)


def test_a_failsafe_counts_from_the_begin_of_the_circuit(recorder: Recorder) -> None:
    tell(recorder, mav.MAVLink_statustext_message(4, b"EKF Failsafe"))
    recorder.mark("begun")
    tell(recorder, mav.MAVLink_statustext_message(4, b"EKF Failsafe"))
    assert [text for _, text in recorder.log.failsafes] == ["EKF Failsafe"]
    assert recorder.failed


def test_truth_moves_with_its_velocity() -> None:
    later = moved(Truth(HOME, (30.0, 40.0, 0.0), LEVEL), 0.1)
    assert distance_m(later.place, HOME) == pytest.approx(5.0, abs=1e-3)
