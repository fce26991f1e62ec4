"""A flight with a gimballed camera is recorded and replayed: the same bytes, and other ones where the gimbal points elsewhere."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import pytest

from visloc_companion.app.journal import Entry, read_journal
from visloc_companion.app.replay import command_lines, compare_with_recording, journal_settings, replay_entries
from visloc_companion.app.settings import core_settings
from visloc_companion.config import parse_config
from visloc_companion.core.navigator import Navigator
from visloc_companion.errors import Reason
from visloc_companion.geo import se3
from visloc_companion.types import (
    Attitude,
    AutopilotKind,
    Event,
    FrameRef,
    GeoPoint,
    GimbalAttitude,
    GimbalFrame,
    Gnss,
    LinkChanged,
    LocaliseRequest,
    NoFix,
    OriginChanged,
    PriorPose,
    Tick,
)

MS = 1_000_000
HOME = GeoPoint(47.0, 8.0, 600.0)
ABOVE = replace(HOME, h_amsl_m=720.0)
CONFIGURATION = {"camera": {"mount": "gimbal", "mount_pitch_deg": 5.0}, "localiser": {"max_rate_hz": 4.0, "structure": False}}
END_MS, BOOT_MS, SILENT_MS = 16_000, 2_000, (8_000, 13_000)


def said(t_ms: int) -> Iterator[Event]:
    """What autopilot and gimbal say in these 20 ms; the gimbal nods and is silent for five seconds."""
    t, boot = t_ms * MS, (t_ms - BOOT_MS) * MS
    yield Attitude(t, boot, se3.quat_from_euler(0.1, -0.05, 0.002 * t_ms), (0.0, 0.0, 2.0))
    if t_ms % 40 == 0 and not SILENT_MS[0] <= t_ms < SILENT_MS[1]:
        pitch = -math.pi / 2 + 0.2 * math.sin(t_ms / 3000)
        yield GimbalAttitude(t, boot, 1, se3.quat_from_euler(0.0, pitch, 0.01), GimbalFrame.HEADING)
    if t_ms % 100 == 0:
        yield PriorPose(t, boot, ABOVE, (0.0, 0.0, 0.0), 120.0)
        yield Gnss(t, boot, 3, 14, ABOVE, 0.9, 1.2, (0.0, 0.0, 0.0))
        yield FrameRef(t, t - 30 * MS, t_ms, 0, 640, 480, 1, checksum=t_ms)
        yield Tick(t)


def flown() -> list[Entry]:
    navigator, entries = Navigator(core_settings(parse_config(CONFIGURATION))), []

    def take(event: Event, now_ns: int) -> None:
        entries.append(Entry(now_ns, event, None))
        for command in navigator.on(event, now_ns):
            entries.append(Entry(now_ns, None, command))
            if isinstance(command, LocaliseRequest):
                asked, frame = command.request_id, command.frame
                take(NoFix(now_ns, frame.t_ns, asked, frame.frame_id, "fake", Reason.NO_MATCH, 1.0), now_ns)

    take(LinkChanged(0, True, AutopilotKind.ARDUPILOT, "4.7.0", 1), 0)
    take(OriginChanged(1, HOME), 1)
    for t_ms in range(BOOT_MS, END_MS, 20):
        for event in said(t_ms):
            take(event, t_ms * MS + 1)
    return entries


@pytest.fixture
def journal(recorded: Callable[..., Path]) -> Path:
    return recorded(flown(), CONFIGURATION)


def test_it_is_replayed_as_it_was(journal: Path) -> None:
    """Expected: requests but for the silence, one warning of it, no difference in any byte."""
    same = compare_with_recording(journal)
    assert (same.first_difference, same.n_recorded) == (None, same.n_replayed)
    entries = list(read_journal(journal))
    asked_ms = [e.command.frame.t_ns // MS for e in entries if isinstance(e.command, LocaliseRequest)]
    assert len(asked_ms) > 20
    assert not [t_ms for t_ms in asked_ms if SILENT_MS[0] + 100 < t_ms < SILENT_MS[1]]


def test_where_the_gimbal_points_is_what_is_asked_with(journal: Path) -> None:
    """Expected: with every word of the gimbal 3 degrees higher, the first request differs, and by that."""
    entries, up = list(read_journal(journal)), se3.quat_from_euler(0.0, math.radians(3.0), 0.0)
    moved = [
        replace(e, event=replace(e.event, q_frame_gimbal=se3.quat_multiply(e.event.q_frame_gimbal, up)))
        if isinstance(e.event, GimbalAttitude)
        else e
        for e in entries
    ]
    first, second = (
        next(command for _, command in replay_entries(some, journal_settings(journal)) if isinstance(command, LocaliseRequest))
        for some in (entries, moved)
    )
    assert math.degrees(se3.angle_between(first.prior.q_ned_frd, second.prior.q_ned_frd)) == pytest.approx(3.0, abs=1e-6)
    assert list(command_lines(replay_entries(entries, journal_settings(journal)))) != list(
        command_lines(replay_entries(moved, journal_settings(journal)))
    )
