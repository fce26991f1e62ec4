"""Dense features by a network: what `localise.runtime` opens, as localise.features.base.Features.

Large images go through the network in overlapping tiles, so that memory stays bounded; they overlap by what an output pixel
depends on, so that no seam is to be seen. What the network is fed is computed on the whole image in either case.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from visloc_companion.errors import ModelError
from visloc_companion.localise.features.base import Float32Array, Mask, without_margin
from visloc_companion.localise.features.gradient import GRADIENT, eroded
from visloc_companion.localise.features.network_input import CHANNELS, NORMALISE_SIGMA_PX, RECIPE, network_input
from visloc_companion.localise.model_folder import MANIFEST, VariantName, shipped_model
from visloc_companion.localise.runtime import NetworkSession, ProviderName, open_session

TILE_PX = 768
"""Largest side of what goes through the network at once: a U-shaped one of 16 and 32 channels takes 460 bytes a pixel."""
BORDER_PX = 3
"""Next to invalid pixels there are edges that are none."""
TOLERANCE = (math.radians(8.0), 0.08)
"""Turn and change of scale within which one pass serves: what a network sees of pairs in training."""
INPUT_CONTEXT_PX = max(GRADIENT.context_px, round(8 * NORMALISE_SIGMA_PX)) + BORDER_PX
"""Reach of `network_input`: the local deviation is of what the local mean left, four sigmas each."""


class NetworkFeatures:
    """localise.features.base.Features of an opened network. Not to be sent to another process."""

    recipe = RECIPE
    tolerance: tuple[float, float] | None = TOLERANCE

    def __init__(self, session: NetworkSession, tile_px: int = TILE_PX) -> None:
        output = session.manifest.output
        self.session = session
        self.name = session.manifest.identity
        self.channels, self.oriented, self.bound = output.channels, output.oriented, output.bound
        self._multiple = output.multiple_px
        self._overlap = -(-output.context_px // output.multiple_px) * output.multiple_px
        self.context_px = INPUT_CONTEXT_PX + self._overlap
        self._tile_px = max(tile_px, 4 * self._overlap) // self._multiple * self._multiple

    def __call__(self, image: NDArray[np.uint8] | Float32Array, valid: Mask, margin_px: int = 0) -> Float32Array:
        """(H, W, channels) float32 of an (H, W) or (H, W, 3) RGB image; zero where `valid` (H, W) is not, and 3 px around it.

        Of `margin_px` around the image only what the network itself reaches goes through it; the rest serves its input.
        Raises ModelError where the network cannot be run or answers what is not finite.
        """
        spare = max(0, margin_px - self._overlap) // self._multiple * self._multiple
        answer = self._through(_cut(network_input(image, valid), spare))
        return self._finished(_cut(answer, margin_px - spare), without_margin(eroded(valid, BORDER_PX), margin_px))

    def many(self, images: Sequence[NDArray[np.uint8] | Float32Array], valids: Sequence[Mask]) -> list[Float32Array]:
        """The same of several images of one size, as many at once as are together no larger than a tile."""
        fed = [network_input(image, valid) for image, valid in zip(images, valids, strict=True)]
        if not fed:
            return []
        height, width = fed[0].shape[1:]
        at_once = max(1, self._tile_px**2 // (height * width))
        answers: list[Float32Array] = []
        for start in range(0, len(fed), at_once):
            some = fed[start : start + at_once]
            answers += list(self._run(np.stack(some))) if len(some) > 1 else [self._through(some[0])]
        return [self._finished(answer, eroded(valid, BORDER_PX)) for answer, valid in zip(answers, valids, strict=True)]

    def _through(self, fed: Float32Array) -> Float32Array:
        """(channels, H, W) of (3, H, W), whole or in tiles."""
        height, width = fed.shape[1:]
        if height * width <= self._tile_px**2:
            return np.asarray(self._run(fed[None])[0])
        out = np.empty((self.channels, height, width), np.float32)
        for rows, seen_rows in _spans(height, self._tile_px, self._overlap):
            for cols, seen_cols in _spans(width, self._tile_px, self._overlap):
                answer = self._run(fed[None, :, seen_rows, seen_cols])[0]
                inner_rows = slice(rows.start - seen_rows.start, rows.stop - seen_rows.start)
                inner_cols = slice(cols.start - seen_cols.start, cols.stop - seen_cols.start)
                out[:, rows, cols] = answer[:, inner_rows, inner_cols]
        return out

    def _run(self, batch: Float32Array) -> Float32Array:
        """Pad with zeros to the network's multiple, run, cut the padding off."""
        height, width = batch.shape[2:]
        more = ((0, 0), (0, 0), (0, -height % self._multiple), (0, -width % self._multiple))
        padded = np.pad(batch, more) if height % self._multiple or width % self._multiple else batch
        answer = self.session.run(np.ascontiguousarray(padded))
        if not np.isfinite(answer).all():
            raise ModelError(
                f"answers what is not finite to {padded.shape}",
                where=self.name,
                remedy="use another of localiser.providers (cpu) or another localiser.model",
            )
        return answer[:, :, :height, :width]

    def _finished(self, answer: Float32Array, inside: Float32Array) -> Float32Array:
        """(H, W, channels) of (channels, H, W), within the bound, zero where `inside` (H, W) is."""
        planes = [np.clip(plane, -self.bound, self.bound) * inside for plane in answer]
        return np.asarray(cv2.merge(planes), dtype=np.float32).reshape(*inside.shape, self.channels)


def open_features(
    folder: Path | None = None,
    providers: Sequence[ProviderName] = ("cpu",),
    threads: int | None = None,
    variant: VariantName = "float32",
) -> NetworkFeatures:
    """Open a model's folder, or the network that came with this version, and test it.

    Raises ConfigError where onnxruntime is not installed or has none of the providers, ModelError where there is no such network,
    it is changed, made for another input, or answers wrong.
    """
    folder = shipped_model() if folder is None else folder
    session = open_session(folder, providers, threads, variant)
    given = session.manifest.input
    if (given.recipe, given.channels) != (RECIPE, CHANNELS):
        raise ModelError(
            f"input.recipe: it was trained on {given.recipe!r}, this version feeds {RECIPE!r}",
            where=str(folder / MANIFEST),
            remedy="use the model that came with this version, or train and export it again",
        )
    return NetworkFeatures(session)


def _cut(planes: Float32Array, margin_px: int) -> Float32Array:
    """(channels, H, W) without the margin around it."""
    return planes[:, margin_px : planes.shape[1] - margin_px, margin_px : planes.shape[2] - margin_px]


def _spans(length: int, tile: int, overlap: int) -> Iterator[tuple[slice, slice]]:
    """Spans that together are the whole length, each with what must be seen for it: at most a tile, cut by `overlap`.

    What is seen begins at a multiple of the network's, since tile and overlap are such.
    """
    if length <= tile:
        yield slice(0, length), slice(0, length)
        return
    step = tile - 2 * overlap
    for start in range(0, length, step):
        stop = min(start + step, length)
        yield slice(start, stop), slice(max(0, start - overlap), min(length, stop + overlap))
