"""Opens the configured camera for a few seconds and looks at what it gives."""

from __future__ import annotations

import asyncio
import time

import numpy as np

from visloc_companion.adapters.camera.calibration import camera_model
from visloc_companion.app.constructors import make_camera
from visloc_companion.app.parts import MakeCamera, check_calibration
from visloc_companion.config import Config
from visloc_companion.doctor.collect.still import StillEdges
from visloc_companion.doctor.facts import CameraFacts
from visloc_companion.errors import VislocError
from visloc_companion.geo.pinhole_view import pinhole_view
from visloc_companion.localise.around.rectified import rectified
from visloc_companion.localise.masked import ground_of
from visloc_companion.protocols import Camera, Clock
from visloc_companion.types import CameraModel, FrameRef, Image

_BLACK, _WHITE, _LIT, _PATIENCE_S = 8, 247, 32, 4.0


class _Slots:
    """protocols.FrameSlots that looks at what of each frame is looked at in flight, and keeps one frame."""

    def __init__(self, model: CameraModel) -> None:
        self._model, self._brightest = model, np.zeros((1, 1), np.uint8)
        self._ground = ground_of(pinhole_view(model)) > 0
        self.edges = StillEdges(self._ground)
        self.dark: list[float] = []
        self.bright: list[float] = []
        self.repeated = 0
        self._last: Image | None = None

    def write(self, pixels: Image) -> int:
        view = rectified(pixels, self._model)
        of_ground = view[self._ground] if view.shape[:2] == self._ground.shape else view
        self.dark.append(float(np.mean(of_ground <= _BLACK)))
        self.bright.append(float(np.mean(of_ground >= _WHITE)))
        grey = view if view.ndim == 2 else view.max(axis=2)
        self._brightest = np.maximum(self._brightest, grey) if self._brightest.shape == grey.shape else grey
        self.edges.add(view)
        self.repeated += self._last is not None and np.array_equal(pixels, self._last)
        self._last = pixels.copy()
        return 0

    def read(self, frame: FrameRef) -> Image:
        del frame
        assert self._last is not None
        return self._last

    @property
    def unlit(self) -> float:
        """Share of the view that stayed black where no mask says why, 0 where the middle hardly shows anything either."""
        height, width = self._brightest.shape
        middle = self._brightest[height // 4 : height - height // 4, width // 4 : width - width // 4]
        black = self._brightest <= _BLACK
        if black.shape == self._ground.shape:
            black &= self._ground
        return float(np.mean(black)) if np.median(middle) >= _LIT else 0.0


async def read_camera(config: Config, clock: Clock, seconds: float, make: MakeCamera = make_camera) -> CameraFacts | None:
    """What the camera gives in some seconds; None where none is configured. Recorded frames come as fast as they are read."""
    if not config.camera.url:
        return None
    try:
        camera = make(config, clock)
        check_calibration(config, camera)
    except VislocError as why:
        return CameraFacts(problem=str(why))
    try:
        return await _watch(camera, seconds, camera_model(config.camera))
    except VislocError as why:
        return CameraFacts(problem=str(why))
    finally:
        await camera.close()


async def _watch(camera: Camera, seconds: float, model: CameraModel) -> CameraFacts:
    slots, times = _Slots(model), list[float]()

    async def take() -> None:
        async for _frame in camera.frames(slots):
            times.append(time.monotonic())
            if times[-1] - times[0] >= seconds:
                return

    try:
        await asyncio.wait_for(take(), seconds + _PATIENCE_S)
    except TimeoutError:
        if not times:
            return CameraFacts(problem=f"no frame within {seconds + _PATIENCE_S:g} s")
    if not times:
        return CameraFacts(problem="gave no frames")
    span_s = times[-1] - times[0]
    return CameraFacts(
        rate_hz=(len(times) - 1) / span_s if span_s > 0 else 0.0,
        n_frames=len(times),
        dark=float(np.mean(slots.dark)),
        bright=float(np.mean(slots.bright)),
        repeated=slots.repeated / max(1, len(times) - 1),
        unlit=slots.unlit,
        still=slots.edges.share,
    )
