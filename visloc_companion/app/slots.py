"""Shared-memory slots for pixels: the daemon writes frames, the worker reads them, nothing is copied through a pipe.

With three slots the writer always finds one: at most one is held by the worker, one is the newest frame that the core may
still ask for, and the third gives way. All bookkeeping is the writer's (the daemon's), so a worker that is killed while it
reads leaves nothing locked.
"""

from __future__ import annotations

import contextlib
import fcntl
import mmap
import os
import secrets
import shutil
import threading
import time
from dataclasses import dataclass
from multiprocessing import resource_tracker, shared_memory
from pathlib import Path
from types import TracebackType
from typing import Self, cast

import numpy as np

from visloc_companion.errors import CameraError
from visloc_companion.types import CameraModel, FrameRef, Image

N_SLOTS = 3
_CHANNELS = 3
_SHARED_MEMORY = "/dev/shm"
_PREFIX = "visloc-"


@dataclass(frozen=True, slots=True)
class SlotsName:
    """What another process needs to open the slots: the name of the memory, the largest frame in bytes, and the file that
    the daemon holds open (/proc/PID/fd/N; "" where the system shows none), which stays when the name is removed."""

    name: str
    slot_bytes: int
    held: str = ""


class _Slots:
    """Shared memory cut into equal slots."""

    def __init__(self, buffer: memoryview | mmap.mmap, slot_bytes: int) -> None:
        self._buffer, self.slot_bytes = buffer, slot_bytes

    def _view(self, slot: int, shape: tuple[int, ...]) -> Image:
        return np.ndarray(shape, dtype=np.uint8, buffer=self._buffer, offset=slot * self.slot_bytes)

    def read(self, frame: FrameRef) -> Image:
        """(H, W) or (H, W, 3) uint8 pixels of a frame, a view. Raises CameraError for a frame that no slot can hold."""
        shape: tuple[int, ...] = (frame.height_px, frame.width_px)
        shape = shape if frame.channels == 1 else (*shape, frame.channels)
        fits = 0 < int(np.prod(shape, dtype=np.int64)) <= self.slot_bytes
        if not (fits and 0 <= frame.slot < N_SLOTS and frame.channels in (1, _CHANNELS)):
            raise CameraError(f"no slot holds a frame of {shape} in slot {frame.slot}", remedy="report this: it is a fault")
        return self._view(frame.slot, shape)


def _create(n_bytes: int) -> shared_memory.SharedMemory:
    """New shared memory. Raises CameraError where there is too little: what is missing would else be noticed in flight."""
    with contextlib.suppress(OSError):
        free = shutil.disk_usage(_SHARED_MEMORY).free
        if free < n_bytes:
            raise CameraError(
                f"three frames need {n_bytes / 1e6:.0f} MB of shared memory, {free / 1e6:.0f} MB are free",
                where=_SHARED_MEMORY,
                remedy="make /dev/shm larger or the images smaller",
            )
    try:
        return shared_memory.SharedMemory(_PREFIX + secrets.token_hex(6), create=True, size=n_bytes)
    except OSError as why:
        raise CameraError(f"no shared memory: {why}", where=_SHARED_MEMORY, remedy="mount /dev/shm") from why


def _buffer(memory: shared_memory.SharedMemory) -> memoryview:
    """Of open memory; there is none only once it is closed."""
    return cast(memoryview, memory.buf)


def _reserve(memory: shared_memory.SharedMemory) -> int | None:
    """Have its pages now: one that is not to be had when it is written to ends the process (SIGBUS). A descriptor whose lock
    tells other daemons that it is in use; None where the system shows no file. Raises CameraError."""
    path = Path(_SHARED_MEMORY) / memory.name
    if not path.exists():
        return None
    descriptor = os.open(path, os.O_RDWR | os.O_CLOEXEC)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        os.posix_fallocate(descriptor, 0, memory.size)
    except OSError as why:
        os.close(descriptor)
        remedy = "make /dev/shm larger or the images smaller"
        raise CameraError(f"no room for three frames: {why.strerror}", where=_SHARED_MEMORY, remedy=remedy) from why
    return descriptor


def sweep(folder: Path = Path(_SHARED_MEMORY), older_s: float = 10.0) -> None:
    """Remove what daemons left that were killed with all their processes: files of ours that nobody holds a lock on any more."""
    for path in folder.glob(_PREFIX + "*"):
        with contextlib.suppress(OSError):  # another user's, in use, or just gone
            if time.time() - path.stat().st_mtime < older_s:
                continue  # it may not be locked yet
            descriptor = os.open(path, os.O_RDWR | os.O_CLOEXEC)
            try:
                fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
                path.unlink()
            finally:
                os.close(descriptor)


def _unlink(memory: shared_memory.SharedMemory) -> None:
    """Remove the name; one that is gone already, as with logind's RemoveIPC when the user logs out, is no fault."""
    try:
        memory.unlink()
    except FileNotFoundError:
        resource_tracker.unregister(f"/{memory.name}", "shared_memory")  # or it is warned about at the end of the process


class SharedFrameSlots(_Slots):
    """The daemon's side (protocols.FrameSlots): creates, writes, and removes the memory on close."""

    def __init__(self, model: CameraModel) -> None:
        slot_bytes = model.width_px * model.height_px * _CHANNELS
        sweep()
        self._memory = _create(N_SLOTS * slot_bytes)
        try:
            self._reserved = _reserve(self._memory)
        except CameraError:
            self._memory.close()
            _unlink(self._memory)
            raise
        super().__init__(_buffer(self._memory), slot_bytes)
        self._size = (model.height_px, model.width_px)
        self._lock = threading.Lock()  # cameras may write from a thread
        self._held: int | None = None
        self._newest: int | None = None
        self._generation = [0] * N_SLOTS
        self._frames: dict[int, tuple[int, int]] = {}
        self._closed = False

    @property
    def name(self) -> SlotsName:
        """For WorkerSlots in the other process."""
        held = "" if self._reserved is None else f"/proc/{os.getpid()}/fd/{self._reserved}"
        return SlotsName(self._memory.name, self.slot_bytes, held)

    def write(self, pixels: Image) -> int:
        """Copy (H, W) or (H, W, 3) uint8 pixels into a slot that nobody reads; the oldest unread frame gives way.

        Raises CameraError for an image of another size than the calibration's, or of other channels.
        """
        if pixels.shape[:2] != self._size:
            raise CameraError(
                f"frame has shape {pixels.shape}, the calibration is for {self._size[1]}x{self._size[0]} grey or RGB",
                where="camera",
                remedy="set width_px and height_px to the camera's image size and calibrate at that size",
            )
        if pixels.ndim != 2 and pixels.shape[2:] != (_CHANNELS,):
            remedy = "let it deliver grey, BGR or BGRx (GStreamer: videoconvert ! video/x-raw,format=BGR ! appsink)"
            raise CameraError(f"frame has shape {pixels.shape}, which is neither grey nor RGB", where="camera", remedy=remedy)
        with self._lock:
            free = [slot for slot in range(N_SLOTS) if slot not in (self._held, self._newest)]
            slot = min(free, key=self._generation.__getitem__)
            np.copyto(self._view(slot, pixels.shape), pixels)
            self._generation[slot] = max(self._generation) + 1
            self._newest = slot
            return slot

    def announce(self, frame: FrameRef) -> None:
        """Remember which writing of its slot a frame is; call it when the frame arrives from the camera."""
        self._frames[frame.slot] = (frame.frame_id, self._generation[frame.slot])

    def hold(self, frame: FrameRef) -> bool:
        """Keep a frame's slot from being overwritten until `release`; False when another frame already took the slot."""
        with self._lock:
            current = self._frames.get(frame.slot) == (frame.frame_id, self._generation[frame.slot])
            if current:
                self._held = frame.slot
            return current

    def release(self) -> None:
        """The worker no longer reads."""
        with self._lock:
            self._held = None

    def close(self) -> None:
        """Remove the memory; views that still exist keep theirs until they are gone."""
        if self._closed:
            return
        self._closed = True
        with contextlib.suppress(BufferError):
            self._memory.close()
        _unlink(self._memory)
        if self._reserved is not None:
            os.close(self._reserved)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self.close()


class WorkerSlots(_Slots):
    """The worker's side: reads only. The memory belongs to the daemon, and is left to it."""

    def __init__(self, name: SlotsName) -> None:
        """Raises CameraError where the memory is gone."""
        try:
            self._memory = shared_memory.SharedMemory(name=name.name)
        except FileNotFoundError:
            super().__init__(_still_held(name), name.slot_bytes)
        else:
            super().__init__(_buffer(self._memory), name.slot_bytes)


def _still_held(name: SlotsName) -> mmap.mmap:
    """The memory whose name was removed while the daemon runs: it is there as long as the daemon holds it open."""
    try:
        with Path(name.held).open("r+b") as file:
            return mmap.mmap(file.fileno(), N_SLOTS * name.slot_bytes)
    except (OSError, ValueError) as why:
        remedy = "run the daemon as a service (logind removes a user's shared memory at logout: RemoveIPC), start it again"
        raise CameraError(f"the frames' memory {name.name} is gone: {why}", where=_SHARED_MEMORY, remedy=remedy) from why
