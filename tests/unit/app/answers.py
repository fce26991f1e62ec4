"""Stand-ins for map and localiser; the worker process loads them by name (`answers:FUNCTION`)."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

from visloc_companion.app.worker_process import OverMap
from visloc_companion.config import Config
from visloc_companion.errors import HashMismatch, MapError, ModelError, Reason
from visloc_companion.types import Fix, Image, LocaliseRequest, NoFix

Answer = Callable[[LocaliseRequest, Image], Fix | NoFix]


def _fix(request: LocaliseRequest, pixels: Image) -> Fix:
    prior = request.prior
    evidence = (("mean", float(pixels.mean())), ("nice", float(os.nice(0))), ("threads", float(os.environ["OMP_NUM_THREADS"])))
    return Fix(
        0,
        request.frame.t_ns,
        request.request_id,
        request.frame.frame_id,
        "fake",
        prior.place,
        prior.q_ned_frd,
        prior.cov_ne_m2,
        1.0,
        0.1,
        0.001,
        1.0,
        evidence,
    )


def _compute(seconds: float) -> None:
    end = time.process_time() + seconds
    while time.process_time() < end:
        pass


def prior_is_right(config: Config) -> Answer:
    """Answers with the prior at once."""
    return _fix


def by_request_id(config: Config) -> Answer:
    """Misbehaves as the number of the request says."""

    def answer(request: LocaliseRequest, pixels: Image) -> Fix | NoFix:
        kind = request.request_id % 10
        if kind == 1:
            time.sleep(60)
        if kind == 2:
            os.kill(os.getpid(), signal.SIGKILL)
        if kind == 3:
            raise ZeroDivisionError("a fault")
        if kind == 4:
            os._exit(7)
        if kind == 5:
            time.sleep(0.3)
        if kind == 7:  # as if it got a core now and then, for as long on a busy computer as on an idle one
            end = time.monotonic() + 2.2
            while time.monotonic() < end:
                time.sleep(0.03)
                _compute(0.005)
        if kind == 8:
            _compute(60.0)
        if kind == 6:
            return NoFix(0, 0, request.request_id, request.frame.frame_id, "fake", Reason.NO_MATCH, 1.0)
        return _fix(request, pixels)

    return answer


def by_tens(config: Config) -> Answer:
    """Fails as the tens of the request's number say: 1 for want of memory, 2 and 3 as OpenCV, ONNX Runtime do then, 4 else."""

    def answer(request: LocaliseRequest, pixels: Image) -> Fix | NoFix:
        kind = request.request_id // 10
        if kind == 1:
            raise MemoryError("Unable to allocate 1.50 MiB")
        if kind == 2:
            raise _NoMemoryOfOpenCv("Insufficient memory")
        if kind == 3:
            raise ModelError("does not run on (1, 3, 8, 8): Failed to allocate memory for requested buffer of size 6773760")
        if kind == 4:
            raise ZeroDivisionError("a fault")
        return _fix(request, pixels)

    return answer


class _NoMemoryOfOpenCv(Exception):
    """As cv2.error, which takes its code from C++ alone."""

    code = -4


def broken_pack(config: Config) -> Answer:
    """The pack cannot be opened."""
    raise HashMismatch("differs from the manifest", where="pack/ortho.tif", remedy="copy the pack again")


def bug_at_start(config: Config) -> Answer:
    """Fails in a way that nobody foresaw."""
    raise KeyError("surprise")


def dies_at_start(config: Config) -> Answer:
    """Is killed while it starts."""
    os.kill(os.getpid(), signal.SIGKILL)
    raise AssertionError


def starts_once(config: Config) -> Answer:
    """The first start works, later ones (told by verify_hashes) do not."""
    if not config.map.verify_hashes:
        raise HashMismatch("is gone", where="pack")
    return by_request_id(config)


def needs_its_pack(config: Config) -> Answer:
    """Starts while the folder of the pack is there."""
    if not Path(config.map.pack).is_dir():
        raise MapError("is away", where="pack")
    return _fix


class _Leaving(OverMap):
    """Over a network whose accelerator is lost with the second request."""

    def __call__(self, request: LocaliseRequest, pixels: Image) -> Fix | NoFix:
        network = cast(Any, self.network)
        network.about = "on cuda" if request.request_id < 20 else "on cpu; passed over cuda: lost"
        return _fix(request, pixels)


def leaving(config: Config) -> Answer:
    """Says which provider computes."""
    nothing = cast(Any, None)
    return _Leaving(nothing, nothing, cast(Any, SimpleNamespace(about="on cuda")))
