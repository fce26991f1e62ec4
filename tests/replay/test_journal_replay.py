"""A flight is recorded in one process and replayed in another: the same bytes come out, and edits change what they should."""

from __future__ import annotations

import itertools
import math
import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from visloc_companion.app.journal import Entry, read_journal
from visloc_companion.app.replay import (
    command_lines,
    compare_with_recording,
    journal_settings,
    recorded_commands,
    replay_entries,
)
from visloc_companion.app.settings import core_settings
from visloc_companion.config import parse_config
from visloc_companion.core.navigator import Navigator
from visloc_companion.types import (
    Attitude,
    AutopilotKind,
    Command,
    EstimatorStatus,
    Event,
    Fix,
    FrameRef,
    GeoPoint,
    Gnss,
    Injection,
    LinkChanged,
    LocaliseRequest,
    LocalPose,
    Mode,
    OriginChanged,
    PriorPose,
    Status,
    Tick,
    TimesyncSample,
)

MS = 1_000_000
HOME = GeoPoint(47.0, 8.0, 600.0)
CONFIGURATION = {"injection": {"policy": "when_unreliable"}, "localiser": {"max_rate_hz": 2.0}, "seed": 9}
JAM_MS, END_MS, BOOT_MS, FIX_DELAY_MS = 20_000, 40_000, 5_000, 230


def place_at(t_ms: int, right_m: float = 0.0) -> GeoPoint:
    """North at 10 m/s, 120 m above home."""
    east = right_m / (111_319.5 * math.cos(math.radians(HOME.lat_deg)))
    return GeoPoint(HOME.lat_deg + 0.01 * t_ms / 111_194.9, HOME.lon_deg + east, HOME.h_amsl_m + 120.0)


def telemetry(t_ms: int, rng: np.random.Generator) -> Iterator[Event]:
    """What an autopilot says in these 20 ms."""
    t, boot, north_m = t_ms * MS, (t_ms - BOOT_MS) * MS, 0.01 * t_ms
    yield Attitude(t, boot, (math.cos(0.01), math.sin(0.01), 0.0, 0.0), tuple(rng.normal(0, 0.01, 3).tolist()))  # type: ignore[arg-type]
    if t_ms % 100 == 0:
        yield PriorPose(t, boot, place_at(t_ms), (10.0, 0.0, 0.0), 120.0)
        yield LocalPose(t, boot, (north_m, 0.0, -120.0), (10.0, 0.0, 0.0))
    if t_ms % 200 == 0:
        jammed = t_ms >= JAM_MS
        yield Gnss(
            t, boot, 1 if jammed else 3, 3 if jammed else 14, place_at(t_ms), None if jammed else 0.9, 1.2, (10.0, 0.0, 0.0)
        )
    if t_ms % 500 == 0:
        yield EstimatorStatus(t, 0.1, 0.1, 0.1, True, False, None)
        yield TimesyncSample(t, t - 3 * MS, boot - 1 * MS)


@cache
def flight() -> tuple[Entry, ...]:
    """The whole flight as the daemon would journal it."""
    rng = np.random.default_rng(4)
    navigator = Navigator(core_settings(parse_config(CONFIGURATION)))
    entries: list[Entry] = []
    due: list[tuple[int, Fix]] = []

    def take(event: Event, now_ns: int) -> None:
        entries.append(Entry(now_ns, event, None))
        for command in navigator.on(event, now_ns):
            entries.append(Entry(now_ns, None, command))
            if isinstance(command, LocaliseRequest):
                due.append((now_ns + FIX_DELAY_MS * MS, answer(command)))

    def answer(request: LocaliseRequest) -> Fix:
        t_ns, noise = request.frame.t_ns, rng.normal(0, 1.0, 2)
        truth = place_at(t_ns // MS, float(noise[1]))
        place = replace(truth, lat_deg=truth.lat_deg + float(noise[0]) / 111_194.9)
        q = (math.cos(0.01), math.sin(0.01), 0.0, 0.0)
        cov = ((1.0, 0.0), (0.0, 1.0))
        return Fix(t_ns, t_ns, request.request_id, request.frame.frame_id, "fake", place, q, cov, 1.0, 0.01, 1e-3, 200.0)

    take(LinkChanged(0, True, AutopilotKind.ARDUPILOT, "4.6.3", 1), 0)
    take(OriginChanged(1, HOME), 1)
    for t_ms in range(BOOT_MS, END_MS, 20):
        now_ns = t_ms * MS + 1
        for event in telemetry(t_ms, rng):
            take(event, now_ns)
        if t_ms % 400 == 0:
            take(FrameRef(now_ns, now_ns - 40 * MS, t_ms, (t_ms // 400) % 3, 640, 480, 1), now_ns)
        for _, fix in [item for item in due if item[0] <= now_ns]:
            take(replace(fix, t_rx_ns=now_ns), now_ns)
        due[:] = [item for item in due if item[0] > now_ns]
        if t_ms % 100 == 0:
            take(Tick(now_ns), now_ns)
    return tuple(entries)


@pytest.fixture
def journal(recorded: Callable[..., Path]) -> Path:
    return recorded(flight(), CONFIGURATION)


def statuses(commands: list[tuple[int, Command]]) -> list[Status]:
    return [command for _, command in commands if isinstance(command, Status)]


REPLAY = """
import sys
from pathlib import Path
from visloc_companion.app.journal import read_journal
from visloc_companion.app.replay import command_lines, journal_settings, replay_entries
path = Path(sys.argv[1])
for line in command_lines(replay_entries(read_journal(path), journal_settings(path))):
    sys.stdout.write(line + "\\n")
"""


def test_another_process_gives_the_same_bytes(journal: Path) -> None:
    """Expected: SHADOW, then AIDING after the jam; more than 150 injections; identical in every byte."""
    entries = list(read_journal(journal, salvage=False))
    assert tuple(entries) == flight()
    recorded = recorded_commands(entries)
    assert len([1 for _, command in recorded if isinstance(command, Injection)]) > 150
    assert {Mode.SHADOW, Mode.AIDING} <= {status.mode for status in statuses(recorded)}
    for seed in ("1", "2"):
        environment = {**os.environ, "PYTHONHASHSEED": seed}
        done = subprocess.run(
            [sys.executable, "-c", REPLAY, str(journal)], capture_output=True, check=True, timeout=100, env=environment
        )
        assert done.stdout == "".join(line + "\n" for line in command_lines(recorded)).encode()


def test_the_comparison_says_where_a_replay_differs(journal: Path, tmp_path: Path) -> None:
    """Expected: no difference; with another configuration in the header a difference at the first dependent command."""
    same = compare_with_recording(journal)
    assert (same.first_difference, same.n_recorded) == (None, same.n_replayed)
    other = replace(journal_settings(journal), seed=10)
    entries = list(read_journal(journal))
    lines = list(command_lines(replay_entries(entries, other)))
    wanted = list(command_lines(recorded_commands(entries)))
    first = next(n for n, (a, b) in enumerate(zip(lines, wanted, strict=False)) if a != b)
    assert '"LocaliseRequest"' in wanted[first]


def test_a_cut_journal_replays_as_far_as_it_goes(journal: Path, tmp_path: Path) -> None:
    """Expected: everything up to the cut is identical."""
    data = journal.read_bytes()
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(data[: len(data) * 2 // 3])
    comparison = compare_with_recording(cut)
    assert comparison.first_difference is None
    assert 0 < comparison.n_compared < len(recorded_commands(flight()))


def test_without_fixes_after_the_jam_it_dead_reckons() -> None:
    """An edit of the recording: the camera stops at 25 s. Expected: DEAD_RECKONING at the end, growing uncertainty."""
    edited = [entry for entry in flight() if not (isinstance(entry.event, Fix) and entry.now_ns > 25_000 * MS)]
    found = statuses(replay_entries(edited, core_settings(parse_config(CONFIGURATION))))
    assert found[-1].mode is Mode.DEAD_RECKONING
    sigmas = [status.cov_ne_m2[0][0] for status in found if status.t_ns > 28_000 * MS]
    assert sigmas[-1] > sigmas[0]
    assert all(b >= a for a, b in itertools.pairwise(sigmas))
