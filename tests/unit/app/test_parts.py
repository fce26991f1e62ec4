"""What is started of a configuration: a worker for a camera, and one for the ground below the track."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from visloc_companion.app.clock import MonotonicClock
from visloc_companion.app.parts import Constructors, Reports, StartFailed, assemble, check_journal_folder
from visloc_companion.app.status import status_server
from visloc_companion.app.worker import WorkerSupervisor
from visloc_companion.config import parse_config
from visloc_companion.errors import JournalError
from visloc_companion.testing.fake_link import FakeLink

REPORTS = Reports(lambda notice: None, lambda text: None, lambda text: None)


def constructors() -> Constructors:
    def no_camera(*_: object) -> object:
        raise AssertionError("there is no camera to be made")

    return Constructors(lambda config, clock, *_: FakeLink(clock), no_camera, "answers:prior_is_right")  # type: ignore[arg-type]


@pytest.fixture(autouse=True)
def _answers_can_be_imported(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(Path(__file__).parent))


async def test_terrain_without_a_camera_has_a_worker(tmp_path: Path) -> None:
    config = parse_config({"localiser": {"terrain": True}, "map": {"pack": str(tmp_path)}})
    parts = await assemble(config, MonotonicClock(), constructors(), REPORTS)
    try:
        assert parts.worker is not None
        assert parts.camera is None
    finally:
        await parts.close()


async def test_without_camera_and_terrain_there_is_none() -> None:
    parts = await assemble(parse_config({}), MonotonicClock(), constructors(), REPORTS)
    try:
        assert parts.worker is None
    finally:
        await parts.close()


async def test_terrain_without_a_map_is_refused() -> None:
    config = parse_config({"localiser": {"terrain": True}})
    with pytest.raises(StartFailed) as raised:
        await assemble(config, MonotonicClock(), constructors(), REPORTS)
    assert any("localiser.terrain is set" in str(problem) for problem in raised.value.exceptions)


async def test_the_worker_is_begun_first_and_the_autopilot_heard_while_it_starts(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    done: list[str] = []

    async def started(self: WorkerSupervisor) -> None:
        done.append(f"worker awaited, autopilot {'heard' if link.up else 'not heard'}")

    def make_link(*_: object) -> FakeLink:
        done.append("link made")
        return link

    link = FakeLink(MonotonicClock())
    monkeypatch.setattr(WorkerSupervisor, "begin", lambda self: done.append("worker begun"))
    monkeypatch.setattr(WorkerSupervisor, "start", started)
    config = parse_config({"localiser": {"terrain": True}, "map": {"pack": str(tmp_path)}})
    parts = await assemble(config, MonotonicClock(), Constructors(make_link, constructors().camera), REPORTS)
    await parts.close()
    assert done == ["worker begun", "link made", "worker awaited, autopilot heard"]


async def test_beside_a_daemon_that_runs_nothing_is_said_to_the_autopilot_and_nothing_begun(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A second `visloc run` by hand hashed the pack and loaded the network, beside one that flew, before it was refused."""
    monkeypatch.setattr(WorkerSupervisor, "begin", lambda self: pytest.fail("a worker was begun"))
    socket, journals = tmp_path / "status.sock", tmp_path / "journals"
    link = FakeLink(MonotonicClock())
    config = parse_config(
        {
            "status": {"socket": str(socket)},
            "journal": {"folder": str(journals)},
            "localiser": {"terrain": True},
            "map": {"pack": str(tmp_path)},
        }
    )
    make = Constructors(lambda *_: link, constructors().camera)
    async with status_server(socket, dict, print):
        with pytest.raises(StartFailed) as raised:
            await assemble(config, MonotonicClock(), make, REPORTS)
    assert [problem.what for problem in raised.value.exceptions] == ["another visloc is running and answers here"]
    assert not link.up
    assert not journals.exists()


def test_what_takes_long_to_import_is_not_waited_for_before_the_worker_begins() -> None:
    code = "import sys, visloc_companion.app.live as _; print([m for m in ('filterpy', 'pymavlink', 'cv2') if m in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=True)
    assert done.stdout.strip() == "[]"


def test_a_check_leaves_no_folder_that_it_made(tmp_path: Path) -> None:
    """`sudo visloc doctor` left a journal's folder that was root's, and the daemon's own user could write no journal."""
    config = parse_config({"journal": {"folder": str(tmp_path / "lib" / "journals")}})
    check_journal_folder(config)
    assert list(tmp_path.iterdir()) == []
    (tmp_path / "lib" / "journals").mkdir(parents=True)
    check_journal_folder(config)
    assert list(tmp_path.rglob("*")) == [tmp_path / "lib", tmp_path / "lib" / "journals"]
    in_a_file = parse_config({"journal": {"folder": str(tmp_path / "lib" / "file" / "journals")}})
    (tmp_path / "lib" / "file").touch()
    with pytest.raises(JournalError, match=r"journals: cannot be written"):
        check_journal_folder(in_a_file)
