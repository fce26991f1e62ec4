"""An old flight with new answers."""

from __future__ import annotations

import weakref
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from visloc_companion.app.journal import Entry, JournalHeader, JournalWriter, read_frames, read_journal
from visloc_companion.app.rerun import RecordedFrames, recorded_latency_ns, rerun
from visloc_companion.core.settings import CoreSettings, InjectionSettings
from visloc_companion.errors import Reason
from visloc_companion.types import (
    Attitude,
    AutopilotKind,
    Fix,
    FrameRef,
    GeoPoint,
    Gnss,
    Image,
    Injection,
    InjectionPolicy,
    LinkChanged,
    LocaliseRequest,
    LocalPose,
    NoFix,
    OriginChanged,
    PriorPose,
    Status,
    Tick,
    WorkerState,
)

MS = 1_000_000
HOME = GeoPoint(47.0, 8.0, 600.0)
HIGH = GeoPoint(47.0, 8.0, 700.0)
SETTINGS = CoreSettings(injection=InjectionSettings(policy=InjectionPolicy.ALWAYS), max_rate_hz=5.0)


def flight() -> Iterator[Entry]:
    """Ten seconds of hovering; in flight every frame was answered by NO_MATCH, 300 ms late."""
    first = [LinkChanged(0, True, AutopilotKind.ARDUPILOT, "4.6", 1), OriginChanged(0, HOME)]
    yield from (Entry(1, event, None) for event in first)
    for t_ms in range(100, 10_000, 50):
        t = t_ms * MS
        yield Entry(t, Attitude(t, t, (1.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0)), None)
        yield Entry(t, PriorPose(t, t, HIGH, (0.0, 0.0, 0.0), 100.0), None)
        yield Entry(t, LocalPose(t, t, (0.0, 0.0, -100.0), (0.0, 0.0, 0.0)), None)
        yield Entry(t, Gnss(t, t, 3, 15, HIGH, 1.0, 1.0, (0.0, 0.0, 0.0)), None)
        if t_ms % 500 == 0:
            frame = FrameRef(t, t - 20 * MS, t_ms // 500, 0, 16, 12, 1)
            yield Entry(t, frame, None)
            yield Entry(t, None, LocaliseRequest(t_ms // 500, frame, None, 1))  # type: ignore[arg-type]
        if t_ms % 500 == 300 and t_ms > 500:
            yield Entry(t, NoFix(t, t - 320 * MS, t_ms // 500, t_ms // 500, "old", Reason.NO_MATCH, 300.0), None)
        if t_ms % 100 == 0:
            yield Entry(t, Tick(t), None)


def frames() -> Iterator[tuple[int, Image]]:
    for n in range(1, 20):
        if n != 6:
            yield n, np.full((12, 16), n, np.uint8)


def right(request: LocaliseRequest, pixels: Image) -> Fix:
    """The truth; asks that the pixels are those of the frame."""
    assert (pixels == request.frame.frame_id).all()
    cov = ((0.5, 0.0), (0.0, 0.5))
    frame, q = request.frame, (1.0, 0.0, 0.0, 0.0)
    return Fix(0, frame.t_ns, request.request_id, frame.frame_id, "new", HIGH, q, cov, 0.5, 0.01, 1e-4, 1.0)


def test_new_answers_make_a_new_flight() -> None:
    old = list(flight())
    latency_ns = recorded_latency_ns(old)
    assert latency_ns == 300 * MS
    new = list(rerun(old, RecordedFrames(frames()), right, SETTINGS, latency_ns))
    fixes = [entry.event for entry in new if isinstance(entry.event, Fix)]
    missing = [entry.event for entry in new if isinstance(entry.event, NoFix)]
    assert len(fixes) > 12
    assert {fix.method for fix in fixes} == {"new"}
    assert [(answer.frame_id, answer.reason) for answer in missing] == [(6, Reason.BAD_FRAME)]
    asked = {entry.command.request_id: entry.now_ns for entry in new if isinstance(entry.command, LocaliseRequest)}
    assert all(fix.t_rx_ns == asked[fix.request_id] + latency_ns for fix in fixes)
    assert [entry.now_ns for entry in new] == sorted(entry.now_ns for entry in new)
    assert any(isinstance(entry.command, Injection) for entry in new)
    last = [entry.command for entry in new if isinstance(entry.command, Status)][-1]
    assert last.age_of_fix_s is not None
    assert last.age_of_fix_s < 1.0


def test_the_same_again_is_the_same() -> None:
    runs = [list(rerun(flight(), RecordedFrames(frames()), right, SETTINGS)) for _ in range(2)]
    assert runs[0] == runs[1]


def test_a_flight_without_answers_has_the_default_latency() -> None:
    assert recorded_latency_ns([]) == 200 * MS


def test_frames_from_a_journal_come_in_any_recent_order(tmp_path: Path) -> None:
    writer = JournalWriter.create(tmp_path, JournalHeader({}), max_bytes=10**7)
    for n, pixels in frames():
        writer.wait(100)
        writer.frame(n, FrameRef(n, n, n, 0, 16, 12, 1), pixels)
    writer.close()
    assert writer.path is not None
    assert list(read_journal(writer.path)) == []
    store = RecordedFrames(read_frames(writer.path))
    for n in (3, 2, 7, 6, 1, 19, 5, 99):
        found = store.get(n)
        if n in (6, 99):
            assert found is None
        else:
            assert found is not None
            assert (found == n).all()


def test_a_worker_that_died_in_flight_answers_now() -> None:
    old = list(flight())
    died = [Entry(e.now_ns, WorkerState(e.now_ns, False, 4, "died"), None) for e in old if isinstance(e.event, Tick)][20]
    at = next(k for k, entry in enumerate(old) if entry.now_ns > died.now_ns)
    answered = [
        sum(isinstance(entry.event, Fix) for entry in rerun(entries, RecordedFrames(frames()), right, SETTINGS))
        for entries in (old, [*old[:at], died, *old[at:]])
    ]
    assert answered[1] == answered[0] > 10


def test_large_frames_are_kept_in_bounded_memory() -> None:
    """64 of 12 MP in colour were 2.3 GB."""
    shape, alive = (3000, 4000, 3), list[weakref.ref[Image]]()

    def large() -> Iterator[tuple[int, Image]]:
        for n in range(1, 41):
            pixels = np.zeros(shape, np.uint8)
            alive.append(weakref.ref(pixels))
            yield n, pixels

    store = RecordedFrames(large())
    assert store.get(40) is not None
    kept = sum(ref() is not None for ref in alive)
    assert 8 <= kept <= 2**29 // (3000 * 4000 * 3) + 1
    assert store.get(40 - 8) is not None
    assert store.get(1) is None


def test_frames_beyond_the_bound_are_kept_where_they_are_few() -> None:
    shape = (12_000, 12_000)
    store = RecordedFrames((n, np.zeros(shape, np.uint8)) for n in range(1, 11))
    assert store.get(10) is not None
    assert [store.get(n) is not None for n in (2, 3, 10)] == [False, True, True]
