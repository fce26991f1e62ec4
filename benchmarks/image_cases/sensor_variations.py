"""What other cameras make of a picture: pure functions of the picture's bands and a generator, by name.

A picture is (H, W, 4) uint8: red, green, blue and near infrared, all of a real photograph. What a function adds to it (noise, a
blade, text) is made, at the size and strength that its docstring states.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import cv2
import numpy as np
from numpy.typing import NDArray

from visloc_companion.types import Image

Bands = NDArray[np.uint8]
Seen = Callable[[Bands, np.random.Generator], Image]
RED, GREEN, BLUE, INFRARED = range(4)
OSD_TEXTS = (
    ("16.4V", 0.04, 0.1),
    ("ALT 118M", 0.62, 0.1),
    ("12.7M/S", 0.04, 0.96),
    ("SAT 14", 0.7, 0.96),
    ("00:07:41", 0.38, 0.96),
)


def colour(bands: Bands) -> Image:
    """(H, W, 3) red, green and blue."""
    return np.ascontiguousarray(bands[..., :INFRARED])


def grey(bands: Bands) -> Image:
    """(H, W) luminance."""
    return np.asarray(cv2.cvtColor(colour(bands), cv2.COLOR_RGB2GRAY), dtype=np.uint8)


def single(band: int) -> Seen:
    """A monochrome camera behind a filter that passes one band."""
    return lambda bands, _: np.ascontiguousarray(bands[..., band])


def inverted(bands: Bands, _: np.random.Generator) -> Image:
    """Black for white: a thermal camera's black-hot, in part."""
    return np.asarray(255 - grey(bands), dtype=np.uint8)


def thermal_like(bands: Bands, rng: np.random.Generator) -> Image:
    """Made, not thermal: inverted, blurred by 1.5 % of the width, 30 levels of 60 grey levels in all, noise of one level."""
    blurred = cv2.GaussianBlur(inverted(bands, rng), (0, 0), 0.015 * bands.shape[1]).astype(np.float64)
    low, high = np.percentile(blurred, (1, 99))
    levels = np.clip((blurred - low) / max(high - low, 1.0), 0, 1) * 29 + rng.normal(0, 0.5, blurred.shape)
    return _in_8_bits(100 + 2 * np.round(levels))


def night_gain(bands: Bands, rng: np.random.Generator) -> Image:
    """Monochrome, white noise of a quarter of the mean (a signal-to-noise ratio of 4)."""
    light = grey(bands).astype(np.float64)
    return _in_8_bits(light + rng.normal(0, light.mean() / 4, light.shape))


def jpeg(quality: int) -> Seen:
    """Compressed as JPEG of that quality."""

    def through(bands: Bands, _: np.random.Generator) -> Image:
        _, data = cv2.imencode(".jpg", colour(bands)[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, quality])
        return np.ascontiguousarray(cv2.imdecode(data, cv2.IMREAD_COLOR)[..., ::-1], dtype=np.uint8)

    return through


def haze(bands: Bands, _: np.random.Generator) -> Image:
    """A third of the contrast before a bright veil."""
    return _in_8_bits(150 + (colour(bands) - 110.0) / 3)


def vignetting(bands: Bands, _: np.random.Generator) -> Image:
    """A quarter of the light in the corners, with the square of the distance from the middle."""
    height, width = bands.shape[:2]
    u, v = np.meshgrid(np.linspace(-1, 1, width), np.linspace(-1, 1, height))
    return _in_8_bits(colour(bands) * (1 - 0.75 * (u**2 + v**2) / 2)[..., None])


def glint(bands: Bands, rng: np.random.Generator) -> Image:
    """A saturated spot of the sun with a halo (1 sigma: an eighth of the width) anywhere in the picture."""
    height, width = bands.shape[:2]
    at = rng.uniform(0.2, 0.8, 2)
    u, v = np.meshgrid(np.arange(width) - at[0] * width, np.arange(height) - at[1] * height)
    return _in_8_bits(colour(bands) + 400 * np.exp(-(u**2 + v**2) / (2 * (width / 8) ** 2))[..., None])


def blade(bands: Bands, rng: np.random.Generator) -> Image:
    """A dark propeller blade, an eighth of the width wide, from the right border to past the middle, at a new angle each time."""
    picture = colour(bands).astype(np.float64)
    height, width = picture.shape[:2]
    angle = rng.uniform(-0.6, 0.6)
    tip = 0.45 * width, height * (0.5 + 0.5 * math.tan(angle))
    cover = np.zeros((height, width), np.float32)
    cv2.line(cover, (width, height // 2), (round(tip[0]), round(tip[1])), 1.0, width // 8, cv2.LINE_AA)
    share = cv2.GaussianBlur(cover, (0, 0), width / 85)[..., None] * 0.85
    return _in_8_bits(picture * (1 - share) + 30 * share)


def drop(bands: Bands, _: np.random.Generator) -> Image:
    """A drop of water on the lens, two fifths of the width across, a little off the middle, always in the same place."""
    picture = colour(bands)
    height, width = picture.shape[:2]
    cover = np.zeros((height, width), np.float32)
    cv2.circle(cover, (round(0.4 * width), round(0.55 * height)), round(0.2 * width), 1.0, -1)
    share = cv2.GaussianBlur(cover, (0, 0), width / 60)[..., None]
    return _in_8_bits(picture * (1 - share) + cv2.GaussianBlur(picture, (0, 0), width / 20) * share)


def dead_lines(bands: Bands, _: np.random.Generator) -> Image:
    """Three dark and two bright columns, one dark row, each a pixel wide, always the same."""
    picture = colour(bands)
    height, width = picture.shape[:2]
    for share, value in ((0.21, 0), (0.38, 255), (0.52, 0), (0.66, 0), (0.83, 255)):
        picture[:, round(share * width)] = value
    picture[round(0.44 * height)] = 0
    return picture


def interlaced(bands: Bands, _: np.random.Generator) -> Image:
    """Rows of two fields in turn, 20 ms and 1.6 % of the width apart (48°/s at 60° of view); the pose is that between them."""
    picture = colour(bands)
    half_px = round(0.008 * picture.shape[1])
    for first, way in ((0, half_px), (1, -half_px)):
        picture[first::2] = np.roll(picture[first::2], way, axis=1)
    return picture


def on_screen_display(bands: Bands, _: np.random.Generator) -> Image:
    """What an analogue video link burns in: a cross hair, a horizon, five texts, white with a black outline."""
    picture = colour(bands)
    height, width = picture.shape[:2]
    scale, middle = width / 500, (width // 2, height // 2)
    arm, gap = width // 12, width // 40
    for shade, thick in ((0, max(2, round(3 * scale * 2))), (255, max(1, round(scale * 2)))):
        ink = (shade,) * 3
        for side in (-1, 1):
            start, end = middle[0] + side * gap, middle[0] + side * arm
            cv2.line(picture, (start, middle[1]), (end, middle[1]), ink, thick)
            cv2.line(picture, (middle[0], middle[1] + side * gap), (middle[0], middle[1] + side * arm), ink, thick)
            far = middle[0] + side * width // 3
            cv2.line(picture, (far, middle[1]), (far - side * width // 8, middle[1]), ink, thick)
        for text, left, bottom in OSD_TEXTS:
            at = round(left * width), round(bottom * height)
            cv2.putText(picture, text, at, cv2.FONT_HERSHEY_SIMPLEX, 0.9 * scale, ink, thick, cv2.LINE_AA)
    return picture


def letterbox(bands: Bands, _: np.random.Generator) -> Image:
    """16:9 within 4:3: black bars of an eighth of the height above and below."""
    picture = colour(bands)
    bar = picture.shape[0] // 8
    picture[:bar] = picture[-bar:] = 0
    return picture


def mirrored(bands: Bands, _: np.random.Generator) -> Image:
    """Left for right, as a driver's setting or a mirror does it."""
    return np.ascontiguousarray(colour(bands)[:, ::-1])


def flipped(bands: Bands, _: np.random.Generator) -> Image:
    """Top for bottom."""
    return np.ascontiguousarray(colour(bands)[::-1])


def upside_down(bands: Bands, _: np.random.Generator) -> Image:
    """Turned by 180 degrees: a camera mounted the other way round, without the mounting angle that says so."""
    return np.ascontiguousarray(colour(bands)[::-1, ::-1])


def undemosaiced(bands: Bands, _: np.random.Generator) -> Image:
    """The raw mosaic (RGGB) taken for a monochrome picture."""
    mosaic = np.ascontiguousarray(bands[..., GREEN])
    mosaic[::2, ::2], mosaic[1::2, 1::2] = bands[::2, ::2, RED], bands[1::2, 1::2, BLUE]
    return mosaic


def wrong_mosaic(bands: Bands, rng: np.random.Generator) -> Image:
    """The mosaic (RGGB) developed as if it were GRBG: green and red or blue change places."""
    return np.asarray(cv2.cvtColor(undemosaiced(bands, rng), cv2.COLOR_BayerGB2RGB), dtype=np.uint8)


def _in_8_bits(picture: NDArray[np.float64] | NDArray[np.float32]) -> Image:
    return np.asarray(np.clip(np.round(picture), 0, 255), dtype=np.uint8)


FRAMES: dict[str, Seen] = {
    "colour": lambda bands, _: colour(bands),
    "grey": lambda bands, _: grey(bands),
    "near infrared": single(INFRARED),
    "red only": single(RED),
    "blue only": single(BLUE),
    "inverted grey": inverted,
    "thermal-like (made)": thermal_like,
    "night gain, SNR 4": night_gain,
    "JPEG 20": jpeg(20),
    "JPEG 10": jpeg(10),
    "haze": haze,
    "vignetting 1:4": vignetting,
    "sun glint": glint,
    "propeller blade": blade,
    "drop on the lens": drop,
    "dead lines": dead_lines,
    "interlaced": interlaced,
    "on-screen display": on_screen_display,
    "letterbox": letterbox,
    "raw mosaic": undemosaiced,
    "wrong mosaic": wrong_mosaic,
    "mirrored": mirrored,
    "flipped": flipped,
    "upside down": upside_down,
}
"""Same size and calibration as the picture's."""
NOT_OF_THIS_CAMERA = ("mirrored", "flipped", "upside down")
"""Pictures that no pose of the camera gives: the right answer is a refusal."""
