"""What runs in the worker process: map and localiser, one request at a time. Started by app/worker.py."""

from __future__ import annotations

import importlib
import os
import signal
from collections.abc import Callable
from dataclasses import dataclass
from multiprocessing.connection import Connection
from pathlib import Path
from typing import TYPE_CHECKING, Any

from visloc_companion.adapters.camera.calibration import camera_model
from visloc_companion.app.slots import SlotsName, WorkerSlots
from visloc_companion.app.terrain import TerrainAnswer
from visloc_companion.config import Config
from visloc_companion.core.terrain.terrain_aiding import METHOD as TERRAIN
from visloc_companion.errors import ModelError, Reason, VislocError, WorkerError, fault_text
from visloc_companion.protocols import Localiser, ReferenceMap
from visloc_companion.types import Fix, Image, LocaliseRequest, NoFix, TerrainRequest

if TYPE_CHECKING:
    from visloc_companion.localise.runtime import NetworkSession

WorkerRequest = LocaliseRequest | TerrainRequest
Answer = Callable[[LocaliseRequest, Image], Fix | NoFix]
"""What the worker does with a request: pure, and it may take long."""
AnswerFactory = Callable[[Config], Answer]
REAL_ANSWERS = "visloc_companion.app.worker_process:open_localiser"
FAULTS_IN_A_ROW = 5
_NO_MEMORY_OF_OPENCV = -4
"""cv2.Error.StsNoMem."""
_THREAD_LIMITS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMEXPR_NUM_THREADS", "GDAL_NUM_THREADS")


@dataclass(frozen=True, slots=True)
class WorkerJob:
    """What a worker needs to start; travels to the process by pickle.

    `factory` is `module:function`, a function of the configuration that opens map and localiser and returns the function that
    answers requests.
    """

    config: Config
    slots: SlotsName
    factory: str = REAL_ANSWERS


@dataclass(frozen=True, slots=True)
class Ready:
    """The worker's first message: map and localiser are open; `about` says what computes, where that is a question."""

    about: str = ""


@dataclass(frozen=True, slots=True)
class Failed:
    """The worker's first message: why it cannot start; or its last one: why it ends."""

    error: VislocError


@dataclass(frozen=True, slots=True)
class Changed:
    """Another provider computes than before: what computes now, and what was left and why."""

    about: str


@dataclass(frozen=True, slots=True)
class Faulty:
    """`FAULTS_IN_A_ROW` requests failed by faults of the program, the last by `why`; said again once one was answered between."""

    why: str


class Faults:
    """Faults in a row. One costs its frame, more are told, and a worker that finds no memory for so many ends: another one begins
    with what this one has gathered given back."""

    def __init__(self) -> None:
        self._short = self._other = 0

    def seen(self, fault: Exception | None) -> Faulty | Failed | None:
        """Take what the newest request failed by, None where it was answered; what the daemon is to be told."""
        if fault is None:
            self._short = self._other = 0
            return None
        short = is_shortage(fault)
        self._short, self._other = self._short + short, self._other + (not short)
        if short and self._short == FAULTS_IN_A_ROW:
            remedy = "the unit's LimitAS= and MemoryMax=, ulimit -v; a smaller camera.width_px or localiser.max_search_radius_m"
            return Failed(WorkerError(f"finds no memory: {fault_text(fault)}", where="worker", remedy=remedy))
        return Faulty(fault_text(fault)) if not short and self._other == FAULTS_IN_A_ROW else None


def is_shortage(fault: Exception) -> bool:
    """Whether a fault says that no memory is to be had: Python's, OpenCV's or ONNX Runtime's."""
    of_network = isinstance(fault, ModelError) and "allocate memory" in str(fault)
    return isinstance(fault, MemoryError) or getattr(fault, "code", None) == _NO_MEMORY_OF_OPENCV or of_network


@dataclass(frozen=True, slots=True)
class OverMap:
    """An `Answer`: a localiser over a map, and who answers about the ground below the track."""

    localiser: Localiser
    reference: ReferenceMap
    network: NetworkSession | None = None
    unstored: str = ""
    """Why the network's features of the map are computed in flight, where they are."""
    terrain: TerrainAnswer | None = None

    @property
    def about(self) -> str:
        """What computes now, for the log; empty without a network."""
        return "; ".join(part for part in (self.network.about, self.unstored) if part) if self.network is not None else ""

    def __call__(self, request: LocaliseRequest, pixels: Image) -> Fix | NoFix:
        """Localise a frame."""
        return self.localiser.localise(request, pixels, self.reference)


def open_localiser(config: Config) -> OverMap:
    """Open the pack and the localiser of a configuration; a network is opened in the worker alone and tested at once.

    Raises MapError, ModelError or ConfigError.
    """
    from visloc_companion.app.localiser import configured_localiser
    from visloc_companion.app.terrain import configured_terrain
    from visloc_companion.maps.pack import PackMap
    from visloc_companion.maps.signature import public_keys

    trusted = public_keys(config.map.trusted_keys)
    reference = PackMap.open(Path(config.map.pack), verify_hashes=config.map.verify_hashes, trusted=trusted)
    localiser, features = configured_localiser(config.localiser, camera_model(config.camera))
    unstored = reference.why_not_stored(features.name, features.recipe) if features else ""
    terrain = configured_terrain(config.localiser, reference)
    return OverMap(localiser, reference, features.session if features else None, unstored, terrain)


def load_factory(name: str) -> AnswerFactory:
    """The function that `module:function` names. Raises WorkerError where there is none."""
    module, _, function = name.partition(":")
    try:
        factory: Any = getattr(importlib.import_module(module), function)
    except (ImportError, AttributeError) as why:
        raise WorkerError(f"no function {name!r}: {why}", where="worker", remedy="reinstall visloc-companion") from why
    return factory  # type: ignore[no-any-return]


def limit_threads() -> None:
    """One thread for every numerical library, for this process and what it imports later."""
    for name in _THREAD_LIMITS:
        os.environ[name] = "1"
    import cv2

    cv2.setNumThreads(1)
    cv2.ocl.setUseOpenCL(False)


def run_worker(job: WorkerJob, connection: Connection) -> None:
    """Body of the process: report readiness or the reason against it, then answer until the connection ends.

    Signals for the whole process group (Ctrl-C) are the daemon's business: it ends its worker itself.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
    os.nice(job.config.worker.nice)
    limit_threads()
    try:
        answer = load_factory(job.factory)(job.config)
        slots = WorkerSlots(job.slots)
    except VislocError as error:
        connection.send(Failed(error))
        return
    except Exception as error:  # whatever else it is, the operator must read it
        connection.send(Failed(WorkerError(f"cannot start: {type(error).__name__}: {error}", where="worker")))
        return
    try:
        about, faults = about_of(answer), Faults()
        connection.send(Ready(about))
        while (request := connection.recv()) is not None:
            answered, fault = _answered(answer, request, slots, job.config.localiser.method)
            if about != (about := about_of(answer)):
                connection.send(Changed(about))
            connection.send(answered)
            told = faults.seen(fault)
            if told is not None:
                connection.send(told)
            if isinstance(told, Failed):
                return
    except (EOFError, BrokenPipeError, ConnectionResetError):
        return  # the daemon is gone


def no_fix(request: WorkerRequest, method: str, reason: Reason, detail: str, now_ns: int = 0) -> NoFix:
    """The answer to a request that nobody answered."""
    if isinstance(request, TerrainRequest):
        return NoFix(now_ns, request.t_ns, request.request_id, 0, TERRAIN, reason, 0.0, detail)
    frame = request.frame
    return NoFix(now_ns, frame.t_ns, request.request_id, frame.frame_id, method, reason, 0.0, detail)


def about_terrain(terrain: TerrainAnswer | None, request: TerrainRequest) -> Fix | NoFix:
    """The answer about the ground; nobody to ask is an answer too."""
    if terrain is None:
        return no_fix(request, TERRAIN, Reason.OUTSIDE_MAP, "there is no map to compare the ground with", request.t_ns)
    return terrain(request)


def about_of(answer: Answer) -> str:
    """What computes, for the log; empty where that is no question."""
    return answer.about if isinstance(answer, OverMap) else ""


def _answered(answer: Answer, request: WorkerRequest, slots: WorkerSlots, method: str) -> tuple[Fix | NoFix, Exception | None]:
    """The answer, and what it failed by: a fault that one frame provokes must not cost the process, so it is an answer too."""
    try:
        if isinstance(request, TerrainRequest):
            return about_terrain(answer.terrain if isinstance(answer, OverMap) else None, request), None
        return answer(request, slots.read(request.frame)), None
    except Exception as fault:
        return no_fix(request, method, Reason.BAD_INPUT, fault_text(fault)), fault
