"""Frames of a camera that sees its own vehicle: what stands still in them is no ground, and must not be followed or found again.

What a mask names is left out by whoever looks at single pixels (frame.py, structure/view.py, odometry/turn_follow.py). Filters,
pyramids and networks look around a pixel, too: so that they meet no edge there, it is first painted over with what lies around.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from visloc_companion.localise.asking import Asking
from visloc_companion.protocols import Localiser, ReferenceMap
from visloc_companion.types import CameraMask, CameraModel, Fix, Image, LocaliseRequest, NoFix

MARGIN_RAD = 0.01
"""Left out around what is masked: gear quivers, and setting a rolling shutter right moves it, by so much at 40°/s and 30 ms."""
SAMPLED_PX, CELLS_ACROSS, REACH_CELLS = 320, 40, 1.5
"""What is painted over with is averaged from about so many pixels across to so many cells, and about a cell so far."""
LEAST_SHARE = 1e-3
"""Where less ground lies about, the whole frame's mean is taken."""


class Masked(Asking):
    """protocols.Localiser: asks another one, made for `with_margin(model)`, about frames that are painted over."""

    def __init__(self, localiser: Localiser, model: CameraModel) -> None:
        super().__init__(localiser)
        self._model = model

    def localise(self, request: LocaliseRequest, pixels: Image, ref: ReferenceMap) -> Fix | NoFix:
        """The other localiser's answer."""
        return self._localiser.localise(request, painted_over(pixels, self._model), ref)


def behind_the_mask(made_for: Callable[[CameraModel], Localiser], model: CameraModel) -> Localiser:
    """A localiser for frames of a model that may have a mask."""
    return made_for(model) if model.mask is None else Masked(made_for(with_margin(model)), model)


def with_margin(model: CameraModel) -> CameraModel:
    """The model with a mask that leaves out MARGIN_RAD more on all sides; itself where it has none."""
    if model.mask is None:
        return model
    radius_px = max(1, round(MARGIN_RAD * max(model.fx_px, model.fy_px)))
    kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * radius_px + 1, 2 * radius_px + 1))
    return replace(model, mask=CameraMask.of(cv2.erode(ground_of(model), kernel) > 0))


@lru_cache(maxsize=8)
def ground_of(model: CameraModel) -> NDArray[np.uint8]:
    """(H, W) 255 where frames of this camera show ground, 0 where its mask says that they do not. Read-only."""
    shape = model.height_px, model.width_px
    ground = np.full(shape, 255, np.uint8) if model.mask is None else model.mask.ground() * np.uint8(255)
    ground.setflags(write=False)
    return ground


def painted_over(pixels: Image, model: CameraModel) -> Image:
    """The frame (H, W[, 3]) with what is masked painted over smoothly from the ground around it; itself where nothing is masked,
    or it is not uint8 of the size of `model`."""
    if model.mask is None or pixels.dtype != np.uint8 or pixels.shape[:2] != (model.height_px, model.width_px):
        return pixels
    ground = ground_of(model)
    every = max(1, model.width_px // SAMPLED_PX)
    sample, sampled = np.ascontiguousarray(pixels[::every, ::every]), np.ascontiguousarray(ground[::every, ::every])
    height, width = sampled.shape
    size = min(CELLS_ACROSS, width), max(1, min(CELLS_ACROSS, width) * height // width)
    light = cv2.resize(cv2.bitwise_and(sample, sample, mask=sampled), size, interpolation=cv2.INTER_AREA).astype(np.float32)
    share = cv2.resize(sampled, size, interpolation=cv2.INTER_AREA).astype(np.float32) / 255
    mean = light.sum((0, 1)) / max(float(share.sum()), LEAST_SHARE)
    around, of_ground = (cv2.GaussianBlur(of, (0, 0), REACH_CELLS) for of in (light, share))
    of_ground = of_ground if pixels.ndim == 2 else of_ground[..., None]
    smooth = np.clip((around + LEAST_SHARE * mean) / (of_ground + LEAST_SHARE), 0, 255).astype(np.uint8)
    painted = cv2.resize(smooth, (model.width_px, model.height_px), interpolation=cv2.INTER_LINEAR)
    return np.asarray(cv2.copyTo(pixels, ground, painted), dtype=np.uint8)
