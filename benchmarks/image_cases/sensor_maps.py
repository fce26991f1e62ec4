"""Other maps of the same ground: pure functions of a photograph's bands, those of a second date and a generator, by name.

Bands are (H, W, 4) uint8: red, green, blue and near infrared; the result is (H, W) or (H, W, 3) of the same ground, coarser where
the function says so.
"""

from __future__ import annotations

from collections.abc import Callable

import cv2
import numpy as np

from benchmarks.image_cases.sensor_variations import BLUE, GREEN, INFRARED, RED, Bands, colour, grey, haze, jpeg
from visloc_companion.types import Image

Drawn = Callable[[Bands, Bands, np.random.Generator], Image]
MOSAIC_PX, SIGN_EVERY_PX, STEP = 90, 110, 1.35
SIGNS = ("(c) Map Data Ltd 2020", "Imagery (c) Provider", "CR 27", "46th Ave SE", "Example")


def false_colour(bands: Bands, _second: Bands, _rng: np.random.Generator) -> Image:
    """Near infrared, red and green shown as red, green and blue."""
    return np.ascontiguousarray(bands[..., [INFRARED, RED, GREEN]])


def coarser(times: int) -> Drawn:
    """Pixels of that many times the side, averaged; what is left over at the lower right border is cut off."""

    def drawn(bands: Bands, _second: Bands, _rng: np.random.Generator) -> Image:
        height, width = (side // times * times for side in bands.shape[:2])
        whole = colour(bands)[:height, :width]
        return np.asarray(cv2.resize(whole, (width // times, height // times), interpolation=cv2.INTER_AREA), dtype=np.uint8)

    return drawn


def signs(bands: Bands, _second: Bands, rng: np.random.Generator) -> Image:
    """Labels and a provider's watermark, white with a dark outline, one every 110 px each way, as a screen capture has them."""
    picture = colour(bands)
    for number, top in enumerate(range(20, picture.shape[0], SIGN_EVERY_PX // 2)):
        for left in range(number % 2 * SIGN_EVERY_PX // 2, picture.shape[1], SIGN_EVERY_PX):
            text, at = SIGNS[rng.integers(len(SIGNS))], (left + int(rng.integers(12)), top)
            for ink, thick in (((20, 20, 20), 3), ((245, 245, 245), 1)):
                cv2.putText(picture, text, at, cv2.FONT_HERSHEY_SIMPLEX, 0.35, ink, thick, cv2.LINE_AA)
    return picture


def seams(bands: Bands, second: Bands, _rng: np.random.Generator) -> Image:
    """A chequerboard of two dates, 90 px a field, the second brighter by a third."""
    rows, columns = np.indices(bands.shape[:2]) // MOSAIC_PX
    brighter = np.clip(colour(second) * STEP, 0, 255).astype(np.uint8)
    return np.where(((rows + columns) % 2 == 0)[..., None], colour(bands), brighter)


def stretched(bands: Bands, _second: Bands, _rng: np.random.Generator) -> Image:
    """Three times the contrast about each band's median: what lies beyond is black or white."""
    picture = colour(bands).astype(np.float64)
    middle = np.median(picture, axis=(0, 1))
    return np.asarray(np.clip((picture - middle) * 3 + 128, 0, 255), dtype=np.uint8)


def gamma(exponent: float) -> Drawn:
    """Brightness to that power."""

    def drawn(bands: Bands, _second: Bands, _rng: np.random.Generator) -> Image:
        return np.asarray(np.round(255 * (colour(bands) / 255.0) ** exponent), dtype=np.uint8)

    return drawn


def _of_frame(seen: Callable[[Bands, np.random.Generator], Image]) -> Drawn:
    return lambda bands, _second, rng: seen(bands, rng)


MAPS: dict[str, Drawn] = {
    "grey": lambda bands, _second, _rng: grey(bands),
    "false colour (NIR, red, green)": false_colour,
    "blue only": lambda bands, _second, _rng: np.ascontiguousarray(bands[..., BLUE]),
    "2 times coarser": coarser(2),
    "4 times coarser": coarser(4),
    "labels and watermark": signs,
    "JPEG 30": _of_frame(jpeg(30)),
    "JPEG 10": _of_frame(jpeg(10)),
    "seams of two dates": seams,
    "contrast x 3": stretched,
    "gamma 2.2": gamma(2.2),
    "gamma 0.45": gamma(0.45),
    "haze": _of_frame(haze),
}
