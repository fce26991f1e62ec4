"""The daemon with a fake link, a fake camera and a real worker process."""

from __future__ import annotations

import asyncio
import errno
import json
import os
import signal
from pathlib import Path
from typing import Any

import pytest
import structlog

from tests.unit.app.daemon import (
    HOME,
    commands_of,
    configuration,
    constructors,
    entries,
    events_of,
    flight,
    hovering,
)
from visloc_companion.app import camera_feed
from visloc_companion.app.clock import MonotonicClock
from visloc_companion.app.first_position import At
from visloc_companion.app.ground_reports import MODES
from visloc_companion.app.journal import read_header
from visloc_companion.app.live import Daemon, run_daemon
from visloc_companion.app.parts import Constructors, StartFailed, check_journal_folder
from visloc_companion.app.replay import compare_with_recording
from visloc_companion.core.navigator import Navigator
from visloc_companion.errors import ConfigError, HashMismatch, JournalError, LinkError
from visloc_companion.testing.fake_link import FakeLink
from visloc_companion.types import (
    Attitude,
    EkfSource,
    Fix,
    FrameRef,
    Injection,
    LinkChanged,
    LocaliseRequest,
    Mode,
    NoFix,
    RequestMessage,
    Status,
    SwitchSource,
    Tick,
    WorkerState,
)


@pytest.fixture(autouse=True)
def _answers_can_be_imported(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(Path(__file__).parent))


@pytest.fixture(autouse=True)
def _quiet() -> None:
    structlog.configure(logger_factory=structlog.ReturnLoggerFactory(), processors=[lambda _, __, event: str(event)])


async def test_ground_stations_are_told_how_it_does(tmp_path: Path) -> None:
    async with flight(configuration(tmp_path, link={"telemetry_rate_hz": 10.0})) as f, hovering(f):
        await f.until(lambda: any(report.load for report in f.link.reports), "the computer's load")
        await f.until(
            lambda: any(dict(report.values).get("VL_MODE") == MODES[Mode.AIDING] for report in f.link.reports), "the mode"
        )
        assert not f.link.reports[-1].critical


async def test_frames_are_localised_and_positions_injected_and_the_journal_replays(tmp_path: Path) -> None:
    config = configuration(tmp_path)
    async with flight(config) as f, hovering(f):
        await f.until(lambda: len(f.link.injections) >= 10, "ten injections")
    recorded = entries(config)
    assert len(events_of(FrameRef, recorded)) > len(events_of(Fix, recorded)) > 0
    assert {fix.request_id for fix in events_of(Fix, recorded)} <= {r.request_id for r in commands_of(LocaliseRequest, recorded)}
    assert len(commands_of(Status, recorded)) == len(events_of(Tick, recorded))
    sent = commands_of(Injection, recorded)
    assert f.link.injections == sent[: len(f.link.injections)]
    assert all(abs(injection.p_ned_m[2] + 100) < 5 for injection in f.link.injections)
    assert f.cameras[0].closed
    assert f.link.closed
    assert f.notifier.said[0] == "READY=1"
    assert "WATCHDOG=1" in f.notifier.said
    assert f.notifier.said[-1] == "STOPPING=1"
    (path,) = (tmp_path / "journals").glob("*.mcap")
    assert read_header(path).configuration == config.model_dump(mode="json")
    comparison = compare_with_recording(path)
    assert comparison.first_difference is None
    assert comparison.n_recorded == comparison.n_replayed >= 20  # ten injections, each with its Status


async def test_the_daemon_begins_where_it_is_told_that_the_vehicle_is(tmp_path: Path) -> None:
    config = configuration(tmp_path)
    async with flight(config, at=At(HOME.lat_deg, HOME.lon_deg, 20.0)) as f, hovering(f):
        await f.until(lambda: f.link.injections, "an injection")
    assert [notice.text for notice in f.link.notices].count("visloc: position taken, looking there") == 1


async def test_a_killed_worker_costs_nothing_but_its_frame(tmp_path: Path) -> None:
    config = configuration(tmp_path)
    async with flight(config) as f, hovering(f):
        await f.until(lambda: f.link.injections, "an injection")
        worker = f.daemon.parts.worker
        assert worker is not None
        first = worker.pid
        assert first is not None
        os.kill(first, signal.SIGKILL)
        await f.until(lambda: worker.up and worker.pid != first, "another worker")
        n_ticks, n_injections = f.daemon.health.ticks, len(f.link.injections)
        await f.until(lambda: f.daemon.health.ticks > n_ticks + 5, "more ticks")
        assert len(f.link.injections) > n_injections
    states = events_of(WorkerState, entries(config))
    assert [state.up for state in states] == [True, False, True]


async def test_injection_stops_before_anything_else(tmp_path: Path) -> None:
    config = configuration(tmp_path)
    async with flight(config) as f, hovering(f):
        await f.until(lambda: len(f.link.injections) >= 3, "injections")
        f.stop.set()
        sent = len(f.link.injections)
        await asyncio.sleep(0)
        f.daemon.handle(Tick(f.clock.now_ns()))  # whatever still comes
        await f.until(lambda: f.link.closed, "the link's end")
        assert len(f.link.injections) <= sent + 1
        assert f.daemon.handle(Tick(f.clock.now_ns())) is None


async def test_a_camera_that_breaks_is_opened_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(camera_feed, "RETRY_S", 0.05)
    config = configuration(tmp_path)
    async with flight(config, n_frames=3, then="break") as f:
        await f.until(lambda: len(f.cameras) == 2, "another camera")
        assert f.cameras[0].closed
        await f.until(lambda: f.daemon.health.ticks > 3, "ticks go on")
    frames = events_of(FrameRef, entries(config))
    assert len(frames) > 4
    assert [frame.frame_id for frame in frames] == list(range(len(frames)))


async def test_a_camera_that_takes_long_to_open_stops_nothing_else(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """An RTSP address where nobody answers takes half a minute; watchdog, ticks and positions cannot wait for that."""
    monkeypatch.setattr(camera_feed, "RETRY_S", 0.05)
    async with flight(configuration(tmp_path), n_frames=3, then="break", opens_s=2.0) as f:
        f.daemon.health.limits_s["camera"] = 1.0
        n_slipped, n_beats = f.daemon.health.cycle_slips, f.notifier.said.count("WATCHDOG=1")
        await f.until(lambda: len(f.cameras) == 2, "another camera")
        await asyncio.sleep(0.3)
        assert f.daemon.health.cycle_slips - n_slipped < 10
        assert f.notifier.said.count("WATCHDOG=1") - n_beats >= 3


async def test_a_stop_is_heard_while_the_camera_opens(tmp_path: Path) -> None:
    stop, clock = asyncio.Event(), MonotonicClock()
    link = FakeLink(clock)
    asyncio.get_running_loop().call_later(0.2, stop.set)
    opening = constructors(link, [], "prior_is_right", opens_s=3.0)
    begun_s = clock.now_ns() / 1e9
    await run_daemon(configuration(tmp_path), stop=stop, clock=clock, make=opening)
    assert clock.now_ns() / 1e9 - begun_s < 2.5


async def test_a_camera_that_falls_silent_is_opened_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(camera_feed, "RETRY_S", 0.05)
    monkeypatch.setattr(camera_feed, "STALL_S", 0.3)
    config = configuration(tmp_path)
    async with flight(config, n_frames=3, then="hang") as f:
        await f.until(lambda: len(f.cameras) == 2, "another camera")
        assert f.cameras[0].closed


async def test_a_recording_that_ends_is_not_played_again(tmp_path: Path) -> None:
    config = configuration(tmp_path)
    async with flight(config, n_frames=3) as f:
        await f.until(lambda: "camera" not in f.daemon.health.limits_s, "the end of the recording")
        n_ticks = f.daemon.health.ticks
        await f.until(lambda: f.daemon.health.ticks > n_ticks + 3, "ticks go on")
        assert len(f.cameras) == 1
    assert len(events_of(FrameRef, entries(config))) == 3


async def test_a_full_disk_ends_the_journal_and_not_the_flight(tmp_path: Path) -> None:
    config = configuration(tmp_path)
    folder = tmp_path / "journals"
    folder.mkdir()
    async with flight(config) as f, hovering(f):
        journal = f.daemon.parts.journal
        assert journal is not None
        os.dup2(os.open("/dev/full", os.O_WRONLY), journal._stream.fileno())
        await f.until(lambda: journal.problem, "the journal's end")
        assert journal.problem == "journal stopped: No space left on device"
        await f.until(lambda: f.link.notices, "the operator's notice")
        n = len(f.link.injections)
        await f.until(lambda: len(f.link.injections) > n + 3, "injection goes on")
        assert journal.dropped > 0
        assert [notice.text for notice in f.link.notices if "journal" in notice.text] == [
            "visloc: journal stopped: No space left on device"
        ]
        told = next(dict(notice.data) for notice in f.link.notices if "journal" in notice.text)
        assert told["where"] == f"journal.folder = {folder}"


async def test_a_disk_that_became_read_only_keeps_no_daemon_from_starting_again_in_flight(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As Linux mounts a card whose sectors fail; a folder that may not be written to is a fault of the configuration still."""

    opens = Path.open

    def fails(path: Path, mode: str = "r", *rest: Any, **more: Any) -> Any:
        if "x" in mode:
            raise OSError(errno.EROFS, os.strerror(errno.EROFS), str(path))
        return opens(path, mode, *rest, **more)

    with monkeypatch.context() as read_only:
        read_only.setattr(Path, "open", fails)
        with pytest.raises(JournalError):
            check_journal_folder(configuration(tmp_path))
        async with flight(configuration(tmp_path)) as f, hovering(f):
            await f.until(lambda: f.link.injections, "an injection")
            await f.until(lambda: f.link.notices, "the operator's notice")
            assert f.daemon.snapshot()["journal"] is None
            assert "visloc: no journal: Read-only file system" in [notice.text for notice in f.link.notices]
            assert not f.daemon._condition().recording


def test_a_disk_without_room_is_found_by_the_check(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A full disk lets a file be made and nothing be written into it: `run --check` and the doctor took it for good."""
    check_journal_folder(configuration(tmp_path))

    def full(descriptor: int) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr("visloc_companion.app.journal.os.fsync", full)
    with pytest.raises(JournalError, match=r"journal stopped: No space left on device; remedy: make room"):
        check_journal_folder(configuration(tmp_path))
    assert not list(tmp_path.rglob("*.mcap"))


class LeapingClock(MonotonicClock):
    """A clock that a fault sets back."""

    back_ns = 0

    def now_ns(self) -> int:
        return super().now_ns() - self.back_ns


async def test_time_that_goes_back_is_survived(tmp_path: Path) -> None:
    config, clock, stop = configuration(tmp_path, camera={"url": ""}), LeapingClock(), asyncio.Event()
    link = FakeLink(clock, origin=HOME)
    daemons: list[Daemon] = []
    task = asyncio.create_task(
        run_daemon(config, stop=stop, clock=clock, make=constructors(link, [], "prior_is_right"), on_ready=daemons.append)
    )
    for step_ns in (0, 300_000_000, 3_600_000_000_000):
        clock.back_ns = step_ns
        async with asyncio.timeout(30):
            while not daemons or daemons[0].health.ticks < 2:  # noqa: ASYNC110
                await asyncio.sleep(0.01)
        daemons[0].handle(Tick(clock.now_ns()))
        daemons[0].handle(Attitude(clock.now_ns(), 5, (1.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0)))
    stop.set()
    await task
    (path,) = (tmp_path / "journals").glob("*.mcap")
    assert compare_with_recording(path).first_difference is None


async def test_everything_that_stands_against_the_start_is_told_at_once(tmp_path: Path) -> None:
    config = configuration(tmp_path, journal={"folder": "/proc/none"})

    def no_link(*_: object) -> FakeLink:
        raise LinkError("names no link", where="link.url", remedy="correct it")

    make = constructors(FakeLink(MonotonicClock()), [], "broken_pack")
    with pytest.raises(StartFailed) as caught:
        await run_daemon(config, make=Constructors(no_link, make.camera, make.answers))
    assert [type(problem) for problem in caught.value.exceptions] == [LinkError, JournalError, HashMismatch]


async def test_a_camera_without_a_map_is_refused(tmp_path: Path) -> None:
    config = configuration(tmp_path, map={"pack": ""})
    link = FakeLink(MonotonicClock())
    with pytest.raises(StartFailed) as caught:
        await run_daemon(config, make=constructors(link, [], "prior_is_right"))
    (problem,) = caught.value.exceptions
    assert isinstance(problem, ConfigError)
    assert problem.where == "map.pack"
    assert link.closed
    assert not (tmp_path / "journals").exists() or not list((tmp_path / "journals").iterdir())


async def test_a_stop_while_it_starts_ends_it(tmp_path: Path) -> None:
    stop = asyncio.Event()
    link = FakeLink(MonotonicClock())
    task = asyncio.create_task(run_daemon(configuration(tmp_path), stop=stop, make=constructors(link, [], "prior_is_right")))
    await asyncio.sleep(0.02)
    stop.set()
    await asyncio.wait_for(task, 30)
    assert link.closed
    assert not list((tmp_path / "journals").glob("*.mcap"))


async def test_a_link_that_ends_by_itself_ends_the_daemon(tmp_path: Path) -> None:
    with pytest.raises(ExceptionGroup) as caught:
        async with flight(configuration(tmp_path, camera={"url": ""})) as f:
            await f.link.close()
            await asyncio.sleep(0.5)
    assert caught.value.subgroup(LinkError) is not None


async def test_without_a_camera_there_is_telemetry_only(tmp_path: Path) -> None:
    config = configuration(tmp_path, camera={"url": ""}, map={"pack": ""}, status={"socket": str(tmp_path / "s.sock")})
    async with flight(config) as f, hovering(f):
        await f.until(lambda: f.daemon.status is not None and f.daemon.snapshot()["computer"], "a status")
        reader, writer = await asyncio.open_unix_connection(tmp_path / "s.sock")
        snapshot = json.loads(await reader.read())
        writer.close()
        await writer.wait_closed()
        assert snapshot["schema"] == 1
        assert snapshot["link_up"] is True
        assert snapshot["worker"] is None
        assert snapshot["status"]["type"] == "Status"
        assert snapshot["late"] == []
        assert snapshot["camera"] is False
        assert snapshot["computer"]["ram_total_bytes"] > 0
        assert snapshot["autopilot"]["kind"] in ("ardupilot", "px4")
        assert 0.0 <= snapshot["heading_deg"] < 360.0
        assert snapshot["fix"] is None
    assert not (tmp_path / "s.sock").exists()
    recorded = entries(config)
    assert events_of(LinkChanged, recorded)
    assert not events_of(NoFix, recorded)


async def test_a_fault_in_the_core_ends_the_daemon_loudly_and_cleanly(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    config = configuration(tmp_path)

    def fault(*_: object) -> list[object]:
        raise ZeroDivisionError("fault")

    with pytest.raises(ExceptionGroup) as caught:
        async with flight(config) as f:
            monkeypatch.setattr(Navigator, "on", fault)
            await f.until(lambda: f.link.closed, "the end")
    assert caught.value.subgroup(ZeroDivisionError) is not None


async def test_an_autopilot_that_is_heard_and_answers_nothing_is_no_link_that_hangs(tmp_path: Path) -> None:
    """A sending wire that is broken, or another signing key there: heartbeats come, and they make no event."""
    config = configuration(tmp_path, camera={"url": ""}, map={"pack": ""}, journal={"folder": ""})
    async with flight(config) as f:
        await f.until(lambda: f.daemon._link_up, "the link")
        f.daemon.health.limits_s["link"] = 1.5
        await asyncio.sleep(2.5)
        assert f.daemon.health.late(f.daemon._wall.now_ns()) == []
        n = f.notifier.said.count("WATCHDOG=1")
        await f.until(lambda: f.notifier.said.count("WATCHDOG=1") > n, "another beat")
        f.link.hangs = True
        await f.until(lambda: f.daemon.health.late(f.daemon._wall.now_ns()) == ["link"], "a link that nobody sees to")


async def test_a_switch_of_the_source_is_ordered_however_many_messages_are_waited_for(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """ArduPilot grants the origin that it does not have yet: after some minutes indoors 32 requests for it wait."""

    async def waits(*_: object) -> bool:
        await asyncio.Event().wait()
        return True

    config = configuration(tmp_path, camera={"url": ""}, map={"pack": ""}, journal={"folder": ""})
    monkeypatch.setattr(FakeLink, "request", waits)
    async with flight(config) as f:
        await f.until(lambda: f.daemon._link_up, "the link")
        for _ in range(40):
            f.daemon._dispatch(RequestMessage(49, 0.0))
        assert f.daemon.orders_dropped > 0
        f.daemon._dispatch(SwitchSource(EkfSource.VISION))
        await f.until(lambda: f.link.source is EkfSource.VISION, "the switch")


async def test_the_watchdog_is_silent_while_a_part_hangs(tmp_path: Path) -> None:
    config = configuration(tmp_path, camera={"url": ""}, map={"pack": ""}, journal={"folder": ""})
    async with flight(config) as f:
        await f.until(lambda: f.notifier.said.count("WATCHDOG=1") >= 1, "a beat")
        f.daemon.health.limits_s["camera"] = 0.0
        await f.until(lambda: f.daemon.health.late(f.daemon._wall.now_ns()) == ["camera"], "a late part")
        await asyncio.sleep(1.1)
        n = f.notifier.said.count("WATCHDOG=1")
        await asyncio.sleep(1.1)
        assert f.notifier.said.count("WATCHDOG=1") == n
