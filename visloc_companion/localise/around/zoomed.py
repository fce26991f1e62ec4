"""Frames of a camera that zoomed in flight: looked at through the lens that would have taken them.

A digital zoom cuts the middle out of the picture and enlarges it. That is the calibrated lens with other pixels: the distortion
is as it was, focal length and principal point grow about the picture's middle.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import cv2
import numpy as np

from visloc_companion.errors import Reason
from visloc_companion.localise.asking import Asking
from visloc_companion.protocols import Localiser, ReferenceMap
from visloc_companion.types import CameraMask, CameraModel, Fix, Image, LocaliseRequest, NoFix, Vote

SEEN_BY_NONE = (Reason.BAD_FRAME, Reason.FROZEN, Reason.TOO_DARK, Reason.OVEREXPOSED, Reason.LOW_TEXTURE)
"""Of such a frame no lens shows more."""


class Zoomed(Asking):
    """protocols.Localiser: asks another one or, where a request names an enlargement, one that is made for such a lens; and where
    the frame is not recognised so, one that is made for the lens that the request would have tried."""

    def __init__(
        self,
        localiser: Localiser,
        made_for: Callable[[CameraModel], Localiser],
        tries_for: Callable[[CameraModel], Localiser],
        model: CameraModel,
    ) -> None:
        super().__init__(localiser)
        self._model = model
        self._zooms, self._tries = _Newest(made_for), _Newest(tries_for)

    def localise(self, request: LocaliseRequest, pixels: Image, ref: ReferenceMap) -> Fix | NoFix:
        """The other localiser's answer; a refusal bears the fix that another lens would have given."""
        believed = self._localiser if request.zoom == 1.0 else self._zooms.of(enlarged(self._model, request.zoom))
        found = believed.localise(request, pixels, ref)
        if request.try_zoom is None or isinstance(found, Fix) or found.reason in SEEN_BY_NONE:
            return found
        tried = self._tries.of(enlarged(self._model, request.try_zoom)).localise(replace(request, vote=Vote.IMAGE), pixels, ref)
        elapsed_ms = found.elapsed_ms + tried.elapsed_ms
        return replace(found, zoomed=tried if isinstance(tried, Fix) else None, elapsed_ms=elapsed_ms)


class _Newest:
    """Makes localisers, and keeps the newest: what it remembers of frames before is of the same lens."""

    def __init__(self, made_for: Callable[[CameraModel], Localiser]) -> None:
        self._made_for = made_for
        self._kept: tuple[CameraModel, Localiser] | None = None

    def of(self, model: CameraModel) -> Localiser:
        """For the frames of a camera."""
        if self._kept is None or self._kept[0] != model:
            self._kept = model, self._made_for(model)
        return self._kept[1]


def enlarged(model: CameraModel, zoom: float) -> CameraModel:
    """The camera whose frames show the middle of the other one's, so many times larger. A mask is enlarged with them; what no
    pixel of it showed is taken for no ground."""
    middle_u, middle_v = (model.width_px - 1) / 2, (model.height_px - 1) / 2
    lens = replace(
        model,
        fx_px=zoom * model.fx_px,
        fy_px=zoom * model.fy_px,
        cx_px=middle_u + zoom * (model.cx_px - middle_u),
        cy_px=middle_v + zoom * (model.cy_px - middle_v),
    )
    if model.mask is None:
        return lens
    to_px = np.array([[zoom, 0.0, (1 - zoom) * middle_u], [0.0, zoom, (1 - zoom) * middle_v]])
    ground = model.mask.ground().astype(np.uint8)
    shown = cv2.warpAffine(ground, to_px, (model.width_px, model.height_px), flags=cv2.INTER_NEAREST)
    return replace(lens, mask=CameraMask.of(shown > 0))
