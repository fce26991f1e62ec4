from __future__ import annotations

from collections import Counter
from dataclasses import dataclass

import numpy as np
import pytest

from visloc_companion.core.settings import CoreSettings, NavigatorSettings
from visloc_companion.evaluate.flight import ANSWER_DELAY_S, RecordedEyes, replay_recording
from visloc_companion.evaluate.record import from_entries
from visloc_companion.geo.wgs84 import geo_from_ned
from visloc_companion.testing.fake_localiser import FakeLocaliser
from visloc_companion.testing.fake_map import AnalyticMap
from visloc_companion.types import (
    Attitude,
    AutopilotKind,
    CameraModel,
    Event,
    Fix,
    FrameRef,
    GeoPoint,
    Gnss,
    Image,
    LinkChanged,
    LocaliseRequest,
    NoFix,
    OriginChanged,
    PriorPose,
    Quat,
    Status,
    Tick,
)

ORIGIN = GeoPoint(47.4, 8.55, 488.0)
LEVEL: Quat = (1.0, 0.0, 0.0, 0.0)
S_NS = 1_000_000_000
T0_NS = 60 * S_NS
MODEL = CameraModel(64, 48, 50.0, 50.0, 31.5, 23.5)


def truth(t_ns: int) -> tuple[GeoPoint, Quat]:
    """North at 5 m/s, 80 m up."""
    return geo_from_ned((5.0 * (t_ns - T0_NS) / S_NS, 0.0, -80.0), ORIGIN), LEVEL


def telemetry(duration_s: float, gnss_until_s: float) -> list[tuple[int, Event]]:
    events: list[tuple[int, Event]] = [
        (T0_NS, LinkChanged(T0_NS, True, AutopilotKind.ARDUPILOT, "4.5.7", 1, True)),
        (T0_NS, OriginChanged(T0_NS, ORIGIN)),
    ]
    for k in range(round(duration_s * 10)):
        t_ns = T0_NS + k * S_NS // 10
        place = truth(t_ns)[0]
        events.append((t_ns, Attitude(t_ns, t_ns, LEVEL, (0.0, 0.0, 0.0))))
        if k % 2 == 0:
            events.append((t_ns, PriorPose(t_ns, t_ns, place, (5.0, 0.0, 0.0), 80.0)))
            kind = 3 if k / 10 < gnss_until_s else 1
            events.append((t_ns, Gnss(t_ns, t_ns, kind, 14 if kind == 3 else 2, place, 1.0, 1.5, (5.0, 0.0, 0.0))))
    return events


@dataclass(frozen=True)
class MadeFrames:
    """Frames every 0.4 s on a clock of their own; number 7 cannot be decoded, number 8 has another size."""

    t_us: tuple[int, ...]

    def pixels(self, number: int) -> Image | None:
        if number == 7:
            return None
        return np.zeros((60 if number == 8 else 48, 64, 3), np.uint8)


def eyes(duration_s: float) -> tuple[RecordedEyes, FakeLocaliser]:
    localiser = FakeLocaliser(truth, sigma_m=0.4)
    frames = MadeFrames(tuple(range(0, round(duration_s * 1e6), 400_000)))
    return RecordedEyes(frames, T0_NS, MODEL, localiser, AnalyticMap(ORIGIN)), localiser


def test_ticks_come_at_the_configured_rate_and_in_order() -> None:
    settings = CoreSettings(navigator=NavigatorSettings(output_rate_hz=20.0))
    entries = list(replay_recording(telemetry(5.0, 99.0), settings))
    times = [entry.now_ns for entry in entries]
    assert times == sorted(times)
    ticks = [entry.now_ns for entry in entries if isinstance(entry.event, Tick)]
    assert set(np.diff(ticks)) == {S_NS // 20}
    assert sum(isinstance(entry.command, Status) for entry in entries) == len(ticks)


def test_a_long_gap_is_not_filled_with_ticks() -> None:
    early = telemetry(2.0, 99.0)
    late = [(T0_NS + 7200 * S_NS, Attitude(T0_NS + 7200 * S_NS, T0_NS + 7200 * S_NS, LEVEL, (0.0, 0.0, 0.0)))]
    entries = list(replay_recording([*early, *late], CoreSettings()))
    assert 600 <= sum(isinstance(entry.event, Tick) for entry in entries) <= 640
    assert list(replay_recording([], CoreSettings())) == []


def test_frames_are_localised_in_line_and_carry_the_flight_through_jamming() -> None:
    seeing, localiser = eyes(40.0)
    entries = list(replay_recording(telemetry(40.0, 20.0), CoreSettings(), eyes=seeing))
    truth_rows = [_Row(T0_NS + k * S_NS // 10, truth(T0_NS + k * S_NS // 10)[0]) for k in range(400)]
    record = from_entries(entries, truth_rows, t0_ns=T0_NS)
    assert record.n_frames == 100
    assert len(record.fixes) > 80
    assert len(localiser.requests) == len(record.fixes)
    late = record.t_s > 25
    assert set(np.array(record.verdicts)[late]) == {"denied"}
    assert set(np.array(record.modes)[late]) == {"aiding"}
    assert np.nanmax(record.error_m[late]) < 2.0
    assert len(record.injection_t_s) > 100
    reasons = Counter(refusal.reason for refusal in record.refusals)
    assert reasons == {"bad_frame": 2}
    assert seeing.unusable == {"cannot be decoded": 1, "64 x 60 px, calibrated for 64 x 48": 1}


@dataclass(frozen=True)
class _Row:
    t_ns: int
    place: GeoPoint


def test_answers_arrive_after_a_fixed_delay() -> None:
    seeing, _ = eyes(10.0)
    entries = list(replay_recording(telemetry(10.0, 99.0), CoreSettings(), eyes=seeing))
    asked = {e.command.request_id: e.now_ns for e in entries if isinstance(e.command, LocaliseRequest)}
    answered = {e.event.request_id: e.now_ns for e in entries if isinstance(e.event, Fix | NoFix)}
    assert len(answered) > 15
    assert {round((answered[k] - asked[k]) / S_NS, 6) for k in answered} == {ANSWER_DELAY_S}
    details = [e.event.detail for e in entries if isinstance(e.event, NoFix)]
    assert details == ["cannot be decoded", "64 x 60 px, calibrated for 64 x 48"]


def test_a_replay_with_frames_repeats_exactly() -> None:
    first, second = (list(replay_recording(telemetry(12.0, 6.0), CoreSettings(), eyes=eyes(12.0)[0])) for _ in range(2))
    assert first == second


def test_frames_outside_of_the_telemetry_are_left_out() -> None:
    seeing, _ = eyes(60.0)
    entries = list(replay_recording(telemetry(4.0, 99.0), CoreSettings(), eyes=seeing))
    assert sum(isinstance(entry.event, FrameRef) for entry in entries) == 10


def test_progress_and_pace_are_told() -> None:
    told: list[float] = []
    paced: list[int] = []
    list(replay_recording(telemetry(5.0, 99.0), CoreSettings(), on_progress=told.append, pace=paced.append))
    assert told == pytest.approx([0, 1, 2, 3, 4], abs=0.2)
    assert paced == sorted(paced)
    assert paced[0] == T0_NS
