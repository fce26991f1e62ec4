"""What a daemon leaves to the one after it."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest
import structlog

from tests.unit.app.daemon import HOME, configuration, entries, events_of, flight, hovering
from visloc_companion.adapters.mavlink.pymavlink_link import PymavlinkLink
from visloc_companion.app.clock import ManualClock
from visloc_companion.app.first_position import At
from visloc_companion.app.handover import FRESH_NS, WRITE_EVERY_NS, Handover
from visloc_companion.app.journal import read_journal
from visloc_companion.app.link import make_link
from visloc_companion.config import parse_config
from visloc_companion.types import (
    Command,
    FoundOnVision,
    GeoPoint,
    Injection,
    LinkChanged,
    Mode,
    Notice,
    OperatorFix,
    Status,
    Tick,
    Verdict,
)

S = 1_000_000_000
COV = ((1.0, 0.0), (0.0, 1.0))
SENT = Injection(0, (0.0, 0.0, 0.0), GeoPoint(47.0, 8.0, 400.0), (1.0, 0.0, 0.0, 0.0), COV, 1.0, 0.02, 0)


class BootClock:
    def __init__(self) -> None:
        self.ns = 50 * S

    def __call__(self) -> int:
        return self.ns


@pytest.fixture
def clock() -> BootClock:
    return BootClock()


@pytest.fixture
def socket(tmp_path: Path) -> str:
    return str(tmp_path / "status.sock")


def came_up(system_id: int = 7, *, armed: bool = True, up: bool = True) -> LinkChanged:
    return LinkChanged(3, up=up, system_id=system_id, armed=armed)


def status(mode: Mode, *, injected: bool) -> Command:
    return Status(0, mode, Verdict.OK, (), None, (0.0, 0.0, 0.0), COV, 0.0, None, None, injected, 0)


def left_behind(socket: str, clock: BootClock, system_id: int = 7) -> None:
    before = Handover(socket, clock)
    assert before.heard(came_up(system_id)) is None
    before.did(replace(SENT, reset_counter=41))


def test_the_next_daemon_hears_of_it_with_the_first_word_of_the_autopilot_and_once(socket: str, clock: BootClock) -> None:
    left_behind(socket, clock)
    clock.ns += 8 * S
    after = Handover(socket, clock)
    assert after.heard(Tick(1)) is None
    assert after.heard(came_up(up=False)) is None
    assert after.heard(came_up()) == FoundOnVision(3, 41)
    assert after.heard(came_up()) is None


def test_not_of_an_autopilot_that_is_heard_only_when_it_was_sent_nothing_for_long(socket: str, clock: BootClock) -> None:
    """Its radio was away, or it had no power: the daemon that waits for it was started in time, and is too late all the same."""
    left_behind(socket, clock)
    clock.ns += 8 * S
    after = Handover(socket, clock)
    clock.ns += FRESH_NS
    assert after.heard(came_up()) is None


@pytest.mark.parametrize(("system_id", "expected"), [(7, 7), (0, 0), (999, 0)])
def test_the_link_is_told_which_autopilot_to_ask_for_its_heartbeat(tmp_path: Path, system_id: int, expected: int) -> None:
    socket = str(tmp_path / "status.sock")
    config = parse_config({"link": {"url": "udpin:127.0.0.1:0"}, "status": {"socket": socket}})
    before = Handover(socket)
    before.heard(came_up(system_id))
    before.did(SENT)
    link = make_link(config, ManualClock(), lambda *_: None, lambda _: None, Handover(socket).left)
    assert isinstance(link, PymavlinkLink)
    assert link.session.settings.left_system_id == expected


async def test_the_file_is_read_once_at_a_start(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A damaged one is told of once, though worker, link and daemon want to know what it says."""
    monkeypatch.syspath_prepend(str(Path(__file__).parent))
    (tmp_path / "s.on-vision").write_bytes(b"{\xff")
    (tmp_path / "pack").mkdir()
    sections = {"status": {"socket": str(tmp_path / "s.sock")}, "map": {"pack": str(tmp_path / "pack")}}
    with structlog.testing.capture_logs() as logs:
        async with flight(configuration(tmp_path, **sections)):
            pass
    assert [line["event"] for line in logs].count("what the daemon before left cannot be read") == 1


def test_not_of_another_autopilot_nor_of_one_that_has_landed(socket: str, clock: BootClock) -> None:
    left_behind(socket, clock)
    assert Handover(socket, clock).heard(came_up(8)) is None
    assert Handover(socket, clock).heard(came_up(armed=False)) is None


def test_what_is_old_or_of_another_start_of_the_computer_is_not_believed(socket: str, clock: BootClock) -> None:
    left_behind(socket, clock)
    file = Path(socket).with_suffix(".on-vision")
    clock.ns += FRESH_NS + 1
    assert Handover(socket, clock).heard(came_up()) is None
    clock.ns -= FRESH_NS
    file.write_text(json.dumps(json.loads(file.read_text()) | {"boot_id": "another"}))
    assert Handover(socket, clock).heard(came_up()) is None


def test_it_is_noted_anew_every_other_second_and_taken_back_with_the_autopilot_on_gnss(socket: str, clock: BootClock) -> None:
    daemon, file = Handover(socket, clock), Path(socket).with_suffix(".on-vision")
    daemon.heard(came_up())
    for _ in range(40):
        daemon.did(SENT)
        daemon.did(status(Mode.AIDING, injected=True))
        clock.ns += WRITE_EVERY_NS // 10
    assert clock.ns - json.loads(file.read_text())["boot_time_ns"] <= WRITE_EVERY_NS
    daemon.did(status(Mode.LOST, injected=False))
    assert file.exists(), "the autopilot is still on vision"
    daemon.did(status(Mode.SHADOW, injected=False))
    assert not file.exists()
    assert list(file.parent.iterdir()) == []


@pytest.mark.parametrize(
    "text",
    [
        *("", "{", "[]", "[" * 100_000, '{"boot_id": ""}'),
        '{"boot_time_ns": "x", "system_id": 7, "boot_id": ""}',
        '{"boot_time_ns": 1e999, "system_id": 7, "boot_id": ""}',
    ],
)
def test_a_damaged_file_is_said_and_passed_over(socket: str, clock: BootClock, text: str) -> None:
    file = Path(socket).with_suffix(".on-vision")
    file.write_text(text)
    with structlog.testing.capture_logs() as said:
        assert Handover(socket, clock).heard(came_up()) is None
    assert [entry["file"] for entry in said] == [str(file)]


def test_a_folder_that_takes_no_file_is_said_once_and_holds_up_nothing(tmp_path: Path, clock: BootClock) -> None:
    daemon = Handover(str(tmp_path / "gone" / "status.sock"), clock)
    with structlog.testing.capture_logs() as said:
        for _ in range(5):
            daemon.did(SENT)
            clock.ns += WRITE_EVERY_NS
    assert len(said) == 1


def test_a_file_system_that_was_full_for_a_while_is_written_to_again(socket: str, clock: BootClock) -> None:
    daemon, file = Handover(socket, clock), Path(socket).with_suffix(".on-vision")
    daemon.heard(came_up())
    beside = file.with_name(f".{file.name}.part")
    beside.mkdir()
    with structlog.testing.capture_logs() as said:
        for _ in range(3):
            daemon.did(SENT)
            clock.ns += WRITE_EVERY_NS
        beside.rmdir()
        daemon.did(SENT)
    assert len(said) == 1
    assert Handover(socket, clock).heard(came_up()) == FoundOnVision(3)


def test_without_a_status_socket_nothing_is_left(clock: BootClock, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    left_behind("", clock)
    assert Handover("", clock).heard(came_up()) is None
    assert list(tmp_path.iterdir()) == []


async def test_a_daemon_that_is_started_again_is_told_by_the_one_before(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(Path(__file__).parent))
    for name in ("first", "second"):
        config = configuration(tmp_path, status={"socket": str(tmp_path / "s.sock")}, journal={"folder": str(tmp_path / name)})
        async with flight(config, armed=True) as f, hovering(f):
            await f.until(lambda link=f.link: link.injections, "an injection")
        found = events_of(FoundOnVision, entries(config))
        assert len(found) == (name == "second")
        counters = {sent.reset_counter for sent in f.link.injections}
        assert found == [] or not any(0 <= counter - found[0].reset_counter < 10 for counter in counters), "a step is announced"


async def test_where_the_vehicle_started_is_not_told_again_of_one_that_has_flown_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The filter would start there, and not where the autopilot has been brought by what it was sent."""
    monkeypatch.syspath_prepend(str(Path(__file__).parent))
    for name in ("first", "second"):
        config = configuration(tmp_path, status={"socket": str(tmp_path / "s.sock")}, journal={"folder": str(tmp_path / name)})
        async with flight(config, at=At(HOME.lat_deg, HOME.lon_deg, 20.0), armed=True) as f, hovering(f):
            await f.until(lambda link=f.link: link.injections, "an injection")
            passed_over = [notice.text for notice in f.link.notices if "--at" in notice.text]
        assert len(events_of(OperatorFix, entries(config))) == (name == "first")
        assert passed_over == ["visloc: restarted in flight, --at passed over"] * (name == "second")


async def test_a_daemon_that_is_started_again_in_flight_need_not_hash_the_pack_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.syspath_prepend(str(Path(__file__).parent))
    (tmp_path / "pack").mkdir()
    (tmp_path / "pack" / "ortho.tif").write_bytes(b"as verified")
    said = list[list[str]]()
    for name in ("first", "second"):
        sections = {"status": {"socket": str(tmp_path / "s.sock")}, "map": {"pack": str(tmp_path / "pack")}}
        config = configuration(tmp_path, journal={"folder": str(tmp_path / name)}, **sections)
        async with flight(config, armed=True) as f, hovering(f):
            await f.until(lambda link=f.link: link.injections, "an injection")
        (journal,) = (tmp_path / name).glob("*.mcap")
        notices = [entry.command for entry in read_journal(journal, shell=True) if isinstance(entry.command, Notice)]
        said.append([notice.text for notice in notices if "map pack" in notice.text])
    assert said == [[], ["the map pack is as the daemon before this one has verified it"]]
