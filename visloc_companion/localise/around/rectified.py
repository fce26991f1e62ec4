"""Frames of a rational or fisheye camera as the pinhole camera in its place sees them (geo/pinhole_view.py), once for all that
looks at them: search, turns, motion and stereo are made for straight lines and even scales."""

from __future__ import annotations

from functools import lru_cache

import cv2
import numpy as np

from visloc_companion.geo.camera import pinhole_matrix
from visloc_companion.geo.pinhole_view import pinhole_view
from visloc_companion.localise.answer import Stopwatch, no_fix
from visloc_companion.localise.asking import Asking
from visloc_companion.localise.features.base import Float32Array
from visloc_companion.localise.frame import unfit
from visloc_companion.localise.lens_maps import where_seen
from visloc_companion.protocols import Localiser, ReferenceMap
from visloc_companion.types import CameraModel, Fix, Image, LocaliseRequest, NoFix


class Rectified(Asking):
    """protocols.Localiser: asks another one, made for `pinhole_view(model)`, about frames of `model`."""

    def __init__(self, localiser: Localiser, model: CameraModel) -> None:
        super().__init__(localiser)
        self._model = model

    def localise(self, request: LocaliseRequest, pixels: Image, ref: ReferenceMap) -> Fix | NoFix:
        """The other localiser's answer."""
        if why := unfit(pixels, self._model):
            return no_fix(request, self.method, Stopwatch(), why)
        return self._localiser.localise(request, rectified(pixels, self._model), ref)


def behind_the_lens(localiser: Localiser, model: CameraModel) -> Localiser:
    """A localiser for frames of `model` from one for frames of `pinhole_view(model)`."""
    return localiser if pinhole_view(model) == model else Rectified(localiser, model)


def rectified(pixels: Image, model: CameraModel) -> Image:
    """The picture (H, W[, 3]) that `pinhole_view(model)` takes where `model` took this one; itself where they are the
    same, or it is not of the size of `model`."""
    if pinhole_view(model) == model or pixels.shape[:2] != (model.height_px, model.width_px):
        return pixels
    map_u, map_v = _maps(model)
    return np.asarray(cv2.remap(pixels, map_u, map_v, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE), dtype=np.uint8)


@lru_cache(maxsize=2)
def _maps(model: CameraModel) -> tuple[Float32Array, Float32Array]:
    view = pinhole_view(model)
    maps = where_seen(model, np.eye(3), pinhole_matrix(view), (view.width_px, view.height_px))
    for shared in maps:
        shared.setflags(write=False)
    return maps
