"""A journal as a source: the daemon's shape, the flight's pace, its notices, and again from the beginning."""

from __future__ import annotations

import asyncio
from pathlib import Path

import pytest

from visloc_companion.app.journal import JournalHeader, JournalWriter
from visloc_companion.errors import JournalError
from visloc_companion.types import (
    Attitude,
    AutopilotKind,
    Fix,
    FrameRef,
    GeoPoint,
    Injection,
    LinkChanged,
    Mode,
    Notice,
    Severity,
    Status,
    Verdict,
)
from visloc_companion.web import condition
from visloc_companion.web.heard import Heard
from visloc_companion.web.recording import REST_S, Recording
from visloc_companion.web.view import view_of

T0_NS, STEP_NS, N = 7_000_000_000, 100_000_000, 100
EAST = (0.7071067811865476, 0.0, 0.0, 0.7071067811865476)
PLACE = GeoPoint(47.4, 8.55, 588.0)


def status(t_ns: int, mode: Mode, fix_age_s: float | None) -> Status:
    cov = ((1.0, 0.0), (0.0, 1.0))
    return Status(t_ns, mode, Verdict.SUSPECT, ("silence",), PLACE, (5.0, 0.0, 0.0), cov, 1.0, 8.0, fix_age_s, True, 0)


def flight(writer: JournalWriter) -> None:
    writer.event(T0_NS, LinkChanged(T0_NS, True, AutopilotKind.PX4, "1.16.0", 1, True))
    for k in range(N):
        t_ns = T0_NS + k * STEP_NS
        writer.event(t_ns, Attitude(t_ns, t_ns, EAST, (0.0, 0.0, 0.0)))
        if k == 20:
            writer.event(t_ns, FrameRef(t_ns, t_ns, 1, 0, 640, 480, 1))
        if k == 22:
            fix = Fix(t_ns, t_ns - 2 * STEP_NS, 1, 1, "deep", PLACE, EAST, ((1.0, 0.0), (0.0, 1.0)), 1.0, 0.01, 0.001, 80.0)
            writer.event(t_ns, fix)
            writer.notice(t_ns, Notice(Severity.CRITICAL, "hangs: camera", to_operator=True))
        mode, age_s = (Mode.AIDING, (k - 20) / 10) if k > 22 else (Mode.SHADOW, None)
        writer.command(t_ns, status(t_ns, mode, age_s))
        writer.command(t_ns, Notice(Severity.INFO, "not for the operator"))


@pytest.fixture
def journal(tmp_path: Path) -> Path:
    path = tmp_path / "flight.mcap"
    writer = JournalWriter(path.open("xb"), JournalHeader({}), path=path)
    flight(writer)
    writer.close()
    return path


async def test_it_is_played_at_the_speed_that_is_asked_for_and_begins_again(journal: Path) -> None:
    now_s = [50.0]
    recording = Recording(journal, 4.0, clock_s=lambda: now_s[0])
    assert (recording.origin.name, recording.origin.speed) == ("flight.mcap", 4.0)
    at_s = []
    for _ in range(5):
        at_s.append(((await recording.ask())["t_ns"] - T0_NS) / 1e9)
        now_s[0] += 0.5
    assert at_s == pytest.approx([0.0, 2.0, 4.0, 6.0, 8.0])
    for _ in range(4):
        now_s[0] += 0.9
        end = await recording.ask()
    assert end["t_ns"] == T0_NS + (N - 1) * STEP_NS
    now_s[0] += REST_S + 1.0
    assert (await recording.ask())["t_ns"] == T0_NS


async def test_it_says_what_the_daemon_would_have_said(journal: Path) -> None:
    now_s = [0.0]
    recording = Recording(journal, 10.0, clock_s=lambda: now_s[0])
    await recording.ask()
    now_s[0] = 0.5
    view = view_of(Heard(await recording.ask(), 0.0), recording.origin, 0.0)
    assert view["state"] == "live"
    assert view["source"] == {"name": "flight.mcap", "recording": True, "speed": 10.0}
    assert view["mode"]["name"] == "aiding"
    assert view["position"]["direction_deg"] == pytest.approx(90.0)
    assert view["fix"]["source"] == "camera against map (deep)"
    assert [row["text"] for row in view["notices"]] == ["hangs: camera"], "the shell's own notices are told, too"
    rows = {row["part"]: row for row in view["health"]}
    assert rows["link"]["says"] == "PX4 1.16.0, armed"
    assert rows["worker"]["ok"] is True
    assert rows["camera"]["says"] == "last frame 3.0 s ago"


async def test_what_cannot_keep_pace_is_played_slower(journal: Path) -> None:
    now_s = [0.0]
    recording = Recording(journal, 1.0, clock_s=lambda: now_s[0])
    await recording.ask()
    now_s[0] = 60.0
    assert (await recording.ask())["t_ns"] == T0_NS + 1_000_000_000


def test_a_journal_without_a_navigators_status_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "empty.mcap"
    JournalWriter(path.open("xb"), JournalHeader({}), path=path).close()
    with pytest.raises(JournalError, match=r"empty\.mcap: holds no Status"):
        Recording(path, 1.0)


def test_what_is_no_journal_is_refused(tmp_path: Path) -> None:
    (tmp_path / "notes.txt").write_text("not a journal")
    with pytest.raises(JournalError, match=r"notes\.txt: is not a journal"):
        Recording(tmp_path / "notes.txt", 1.0)


def test_a_journal_tells_what_was_given_not_what_was_sent(tmp_path: Path) -> None:
    """Positions that the link keeps back are commands of the navigator's all the same."""
    path = tmp_path / "flight.mcap"
    writer = JournalWriter(path.open("xb"), JournalHeader({}), path=path)
    for k in range(3):
        t_ns = T0_NS + k
        writer.command(t_ns, status(t_ns, Mode.AIDING, 1.0))
        writer.command(t_ns, Injection(t_ns, (1.0, 2.0, -3.0), PLACE, EAST, ((1.0, 0.0), (0.0, 1.0)), 1.0, 0.1, 0))
    writer.close()
    now_s = [0.0]
    recording = Recording(path, 1.0, clock_s=lambda: now_s[0])
    asyncio.run(recording.ask())
    now_s[0] = 0.5
    snapshot = asyncio.run(recording.ask())
    assert snapshot["injections"] == {"given": 3, "sent": None, "dropped": None}
    shown = condition.injection(snapshot)
    assert (shown["given"], shown["sent"], shown["now"]) == (3, None, True)
