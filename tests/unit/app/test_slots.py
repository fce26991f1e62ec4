"""Shared-memory slots."""

from __future__ import annotations

import errno
import fcntl
import os
import secrets
import subprocess
import sys
from collections.abc import Iterator
from multiprocessing import shared_memory
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from visloc_companion.app.slots import N_SLOTS, SharedFrameSlots, WorkerSlots, sweep
from visloc_companion.errors import CameraError
from visloc_companion.types import CameraModel, FrameRef, Image

MODEL = CameraModel(8, 6, 10.0, 10.0, 3.5, 2.5)


@pytest.fixture
def slots() -> Iterator[SharedFrameSlots]:
    with SharedFrameSlots(MODEL) as made:
        yield made


def image(value: int, channels: int = 1) -> Image:
    return np.full((6, 8) if channels == 1 else (6, 8, 3), value, np.uint8)


def arrive(slots: SharedFrameSlots, frame_id: int, channels: int = 1) -> FrameRef:
    frame = FrameRef(frame_id, frame_id, frame_id, slots.write(image(frame_id, channels)), 8, 6, channels)
    slots.announce(frame)
    return frame


@pytest.mark.parametrize("channels", [1, 3])
def test_pixels_come_back(slots: SharedFrameSlots, channels: int) -> None:
    frame = arrive(slots, 7, channels)
    np.testing.assert_array_equal(slots.read(frame), image(7, channels))


def test_a_held_frame_is_never_overwritten(slots: SharedFrameSlots) -> None:
    held = arrive(slots, 1)
    assert slots.hold(held)
    for frame_id in range(2, 20):
        newest = arrive(slots, frame_id)
        assert newest.slot != held.slot
        assert (slots.read(held) == 1).all()
        assert (slots.read(newest) == frame_id).all()
    slots.release()
    assert held.slot in {arrive(slots, frame_id).slot for frame_id in range(20, 23)}


def test_a_frame_whose_slot_was_taken_cannot_be_held(slots: SharedFrameSlots) -> None:
    old = arrive(slots, 1)
    for frame_id in range(2, 2 + N_SLOTS):
        arrive(slots, frame_id)
    assert not slots.hold(old)
    assert slots.hold(FrameRef(0, 0, 4, arrive(slots, 9).slot, 8, 6, 1)) is False  # right slot, wrong frame


@given(st.lists(st.sampled_from(["write", "hold newest", "hold previous", "release"]), max_size=40))
@settings(max_examples=60)
def test_what_is_held_stays_whatever_happens(actions: list[str]) -> None:
    with SharedFrameSlots(MODEL) as slots:
        frames: list[FrameRef] = []
        held: FrameRef | None = None
        for n, action in enumerate(actions, start=1):
            if action == "write":
                frames.append(arrive(slots, n))
            elif action == "release":
                slots.release()
                held = None
            elif held is None and len(frames) >= 2:
                frame = frames[-1] if action == "hold newest" else frames[-2]
                held = frame if slots.hold(frame) else None
            for frame in [*frames[-1:], *([held] if held else [])]:
                assert (slots.read(frame) == frame.frame_id).all()


@pytest.mark.parametrize("shape", [(6, 9), (8, 6), (6,)])
def test_an_image_of_another_size_than_the_calibration(slots: SharedFrameSlots, shape: tuple[int, ...]) -> None:
    with pytest.raises(CameraError, match=r"the calibration is for 8x6 grey or RGB.*remedy: set width_px"):
        slots.write(np.zeros(shape, np.uint8))


@pytest.mark.parametrize("shape", [(6, 8, 4), (6, 8, 2), (6, 8, 1), (6, 8, 3, 1)])
def test_an_image_of_other_channels_is_no_matter_of_its_size(slots: SharedFrameSlots, shape: tuple[int, ...]) -> None:
    with pytest.raises(CameraError, match=r"neither grey nor RGB; remedy: let it deliver grey, BGR or BGRx"):
        slots.write(np.zeros(shape, np.uint8))


@pytest.mark.parametrize(
    ("slot", "width", "height", "channels"),
    [(3, 8, 6, 1), (-1, 8, 6, 1), (0, 8, 60, 1), (0, 8, 6, 2), (0, 0, 6, 1), (0, 2**40, 2**40, 3)],
)
def test_a_frame_that_no_slot_holds(slots: SharedFrameSlots, slot: int, width: int, height: int, channels: int) -> None:
    with pytest.raises(CameraError, match="no slot holds"):
        slots.read(FrameRef(0, 0, 0, slot, width, height, channels))


def test_too_little_shared_memory_is_told_at_the_start() -> None:
    with pytest.raises(CameraError, match=r"three frames need \d+ MB of shared memory.*remedy: make /dev/shm larger"):
        SharedFrameSlots(CameraModel(10**7, 10**6, 1.0, 1.0, 0.0, 0.0))


def test_every_page_is_had_at_the_start(monkeypatch: pytest.MonkeyPatch) -> None:
    """A page that is not to be had when it is written to ends the process, in flight."""
    with SharedFrameSlots(MODEL) as slots:
        status = Path("/dev/shm", slots.name.name).stat()
        assert status.st_blocks * 512 >= N_SLOTS * slots.name.slot_bytes

    def full(*_: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(os, "posix_fallocate", full)
    monkeypatch.setattr(secrets, "token_hex", lambda _: "of-this-test")
    with pytest.raises(CameraError, match="no room for three frames: No space left on device"):
        SharedFrameSlots(MODEL)
    assert not Path("/dev/shm/visloc-of-this-test").exists()


def test_what_a_killed_daemon_left_is_removed_and_what_is_in_use_is_not(tmp_path: Path) -> None:
    left, young, locked, other = (tmp_path / name for name in ("visloc-a", "visloc-b", "visloc-c", "psm_d"))
    for path in (left, young, locked, other):
        path.write_bytes(b"0")
        os.utime(path, (0, 0) if path is not young else None)
    with locked.open() as held:
        fcntl.flock(held, fcntl.LOCK_EX)
        sweep(tmp_path)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["psm_d", "visloc-b", "visloc-c"]
    sweep(tmp_path, older_s=0.0)
    assert [path.name for path in tmp_path.iterdir()] == ["psm_d"]


def test_slots_in_use_stay_whoever_sweeps(monkeypatch: pytest.MonkeyPatch) -> None:
    # a prefix of its own: others that test beside this one have memory that is as young and not locked yet
    monkeypatch.setattr("visloc_companion.app.slots._PREFIX", f"visloc-{secrets.token_hex(4)}-")
    with SharedFrameSlots(MODEL) as slots:
        sweep(older_s=0.0)
        assert Path("/dev/shm", slots.name.name).exists()


def test_memory_whose_name_was_removed_goes_on(slots: SharedFrameSlots) -> None:
    """As logind does when the user who started the daemon logs out; a worker that starts after that reads on."""
    Path("/dev/shm", slots.name.name).unlink()
    frame = arrive(slots, 7)
    np.testing.assert_array_equal(WorkerSlots(slots.name).read(frame), image(7))


def test_memory_that_is_gone_is_told(slots: SharedFrameSlots) -> None:
    name = slots.name
    slots.close()
    with pytest.raises(CameraError, match=r"/dev/shm: the frames' memory visloc-\w+ is gone.*remedy: run the daemon"):
        WorkerSlots(name)


def test_close_removes_the_memory_once() -> None:
    slots = SharedFrameSlots(MODEL)
    name = slots.name.name
    slots.close()
    slots.close()
    with pytest.raises(FileNotFoundError):
        shared_memory.SharedMemory(name=name)


@pytest.mark.parametrize("name", ["kept", "removed"])
def test_nothing_is_left_and_nothing_is_said_at_the_end_of_a_process(name: str) -> None:
    code = """
import sys
from pathlib import Path
import numpy as np
from visloc_companion.app.slots import SharedFrameSlots
from visloc_companion.types import CameraModel
with SharedFrameSlots(CameraModel(8, 6, 1.0, 1.0, 0.0, 0.0)) as slots:
    slots.write(np.zeros((6, 8), np.uint8))
    if sys.argv[1] == "removed":
        Path("/dev/shm", slots.name.name).unlink()
"""
    command = [sys.executable, "-W", "error", "-c", code, name]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    assert (done.returncode, done.stderr) == (0, "")
