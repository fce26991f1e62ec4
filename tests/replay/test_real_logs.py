"""Every real log through the navigator: verdicts and dead reckoning come out, nothing crashes, healthy GNSS is not blamed."""

from __future__ import annotations

import functools
import itertools
import math
from pathlib import Path

import numpy as np
import pytest

from visloc_companion.adapters.logs.open import open_log
from visloc_companion.adapters.logs.recording import Recording
from visloc_companion.core.settings import CoreSettings
from visloc_companion.evaluate.flight import replay_recording
from visloc_companion.evaluate.metrics import alarms_s, flight_summary
from visloc_companion.evaluate.record import FlightRecord, from_entries
from visloc_companion.types import Attitude, AutopilotKind, EstimatorStatus, Gnss, LinkChanged, LocalPose, PriorPose

pytestmark = pytest.mark.shared

PROBATION_S, SILENCE_S, START_S = 20.0, 2.0, 5.0


@functools.cache
def replayed(path: Path) -> tuple[Recording, FlightRecord]:
    recording = open_log(path)
    record = from_entries(replay_recording(recording.events, CoreSettings()), t0_ns=recording.events[0][0])
    return recording, record


@pytest.fixture
def flown(request: pytest.FixtureRequest, shared_data: Path) -> tuple[Recording, FlightRecord]:
    return replayed(shared_data / "logs" / request.param)


def log(*names: str) -> pytest.MarkDecorator:
    return pytest.mark.parametrize("flown", names, indirect=True, ids=[name.split(".")[0] for name in names])


def counts(recording: Recording) -> dict[type, int]:
    kinds = (Attitude, PriorPose, LocalPose, Gnss, EstimatorStatus)
    return {kind: sum(isinstance(event, kind) for _, event in recording.events) for kind in kinds}


def silences_s(recording: Recording) -> list[tuple[float, float]]:
    """Stretches (s since the start) in which the receiver sent nothing for longer than the monitor allows."""
    start_ns = recording.events[0][0]
    times = [(t_ns - start_ns) / 1e9 for t_ns, event in recording.events if isinstance(event, Gnss)]
    return [(a, b) for a, b in itertools.pairwise(times) if b - a > SILENCE_S]


def bad_epochs(record: FlightRecord, unhealthy_s: list[tuple[float, float]]) -> list[float]:
    """Times at which the verdict is not OK although the receiver was healthy."""
    healthy = record.t_s > START_S
    for start, end in unhealthy_s:
        healthy &= (record.t_s < start) | (record.t_s > end + PROBATION_S + 1.0)
    return [float(t) for t in record.t_s[healthy & ~record.while_verdict("ok")]]


ALL = (
    "copter_real_2015.tlog",
    "quadplane_sitl_2018.tlog",
    "plane_bench_nofix_2018.tlog",
    "copter_real_2014.bin",
    "px4_vtol_bench.ulg",
)


@log(*ALL)
def test_every_log_gives_verdicts_and_a_summary(flown: tuple[Recording, FlightRecord]) -> None:
    recording, record = flown
    assert len(record.t_s) == pytest.approx(recording.duration_s * 10, rel=0.01, abs=2)
    assert set(record.verdicts) <= {"ok", "suspect", "denied"}
    assert all(math.isfinite(level) or math.isnan(level) for level in record.protection_level_m)
    summary = flight_summary(record)
    assert summary["n_frames"] == summary["injected"]["n"] == 0
    assert np.all(np.diff([t_ns for t_ns, _ in recording.events]) >= 0)


@log("copter_real_2015.tlog")
def test_the_radio_log_has_every_message_that_its_readme_counts(flown: tuple[Recording, FlightRecord]) -> None:
    recording, _ = flown
    found = counts(recording)
    assert (found[Attitude], found[Gnss], found[LocalPose], found[EstimatorStatus]) == (2829, 2858, 1161, 2824)
    assert recording.losses.garbage_pieces in (1314, 1315)
    assert recording.losses.reboots == 1


@log("copter_real_2015.tlog")
def test_the_real_copter_is_denied_until_it_has_a_fix_and_then_trusted(flown: tuple[Recording, FlightRecord]) -> None:
    """No fix at first, a reboot with 18 s of silence; after probation nothing is held against its GNSS, in flight above all."""
    recording, record = flown
    healthy_from_s = 138.4  # its satellites are too few until then
    assert set(np.array(record.verdicts)[record.t_s < healthy_from_s]) == {"denied"}
    assert bad_epochs(record, [(0.0, 119.0), *silences_s(recording)]) == []
    armed = [event.t_rx_ns for _, event in recording.events if isinstance(event, LinkChanged) and event.armed]
    first_armed_s = (armed[0] - recording.events[0][0]) / 1e9
    assert all(t_s < first_armed_s for t_s in alarms_s(record))


@log("copter_real_2014.bin")
def test_the_dataflash_flight_is_trusted_throughout_and_tracked(flown: tuple[Recording, FlightRecord]) -> None:
    recording, record = flown
    assert recording.kind is AutopilotKind.ARDUPILOT
    assert bad_epochs(record, []) == []
    known = np.isfinite(record.estimate_ned_m[:, 0])
    assert known.mean() > 0.9
    apart = record.estimate_ned_m[:, :2] - record.gnss.at(record.t_s)[:, :2]
    assert np.nanmedian(np.hypot(*apart[known].T)) < 3.0


@log("quadplane_sitl_2018.tlog")
def test_the_simulated_flight_is_blamed_only_where_the_link_was_silent(flown: tuple[Recording, FlightRecord]) -> None:
    recording, record = flown
    assert recording.losses.reboots == 0, "its boot time goes back by 1.4 s once, where the ground station connects again"
    unhealthy = silences_s(recording)
    assert 1 <= len(unhealthy) <= 4
    assert bad_epochs(record, unhealthy) == []
    assert record.while_verdict("ok").sum() > 0.5 * len(record.t_s)


@log("plane_bench_nofix_2018.tlog")
def test_a_bench_without_fix_is_denied_and_never_gets_a_position(flown: tuple[Recording, FlightRecord]) -> None:
    recording, record = flown
    assert set(record.verdicts) == {"denied"}
    assert np.isnan(record.estimate_ned_m).all()
    assert set(record.modes) == {"waiting"}
    assert counts(recording)[PriorPose] == 0, "latitude and longitude of zero mean nothing"
    assert {event.fix_type < 3 for _, event in recording.events if isinstance(event, Gnss)} == {True}


@log("px4_vtol_bench.ulg")
def test_the_px4_bench_is_trusted_without_a_position(flown: tuple[Recording, FlightRecord]) -> None:
    recording, record = flown
    assert recording.kind is AutopilotKind.PX4
    assert record.verdicts[-1] == "ok"
    assert alarms_s(record) == []
    assert np.isnan(record.estimate_ned_m).all()


def test_dead_reckoning_through_a_cut_of_gnss_stays_near_the_truth(shared_data: Path) -> None:
    """A fault made by editing a recording: the receiver of the simulated flight loses its fix for 30 s at up to 20 m/s."""
    recording = open_log(shared_data / "logs" / "quadplane_sitl_2018.tlog")
    start_ns = recording.events[0][0]
    cut = (45.0, 75.0)
    events = [
        (t_ns, event)
        for t_ns, event in recording.events
        if not (isinstance(event, Gnss) and cut[0] < (t_ns - start_ns) / 1e9 < cut[1])
    ]
    record = from_entries(replay_recording(events, CoreSettings()), t0_ns=start_ns)
    inside = (record.t_s > cut[0] + SILENCE_S + 0.5) & (record.t_s < cut[1])
    assert set(np.array(record.verdicts)[inside]) == {"denied"}
    true_track = replayed(recording.path)[1].gnss
    apart = (record.estimate_ned_m - true_track.at(record.t_s) - (record.gnss.p_ned_m[0] - true_track.p_ned_m[0]))[inside, :2]
    error_m = np.hypot(*apart.T)
    assert np.isfinite(error_m).mean() > 0.9
    assert np.nanmax(error_m) < 25.0
    assert np.nanmean(error_m > 4 * record.sigma_m[inside]) == 0.0


@log("copter_real_2014.bin")
def test_a_replay_repeats_exactly(flown: tuple[Recording, FlightRecord]) -> None:
    recording, _ = flown
    early = recording.events[:4000]
    assert list(replay_recording(early, CoreSettings())) == list(replay_recording(early, CoreSettings()))
