"""What lens, air and sensor do to a picture: haze, vignetting, blur, exposure and noise, drawn from a seed."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from visloc_companion.types import Image

Plane = NDArray[np.float32]
AIRLIGHT = (196.0, 205.0, 216.0)
DAY_GAIN, LEAST_GAIN = 3.0, 0.4


@dataclass(frozen=True)
class CameraEffects:
    """Strengths; zero switches an effect off.

    `exposure_mean` is the mean brightness the exposure is set to (0: as the scene is), `exposure_jitter` its 1-sigma error as a
    share, `vignetting` the loss in the corners, `motion_blur_px` the 1-sigma length of the smear in a random direction,
    `focus_blur_px` a Gaussian's sigma, `read_noise` and `shot_noise` in grey values (the second at brightness 255),
    `visibility_m` the distance at which air leaves 2 % of the contrast (Koschmieder). `light` is the share of daylight on the
    scene; beyond `DAY_GAIN` the sensor, up to `max_gain`, amplifies its noise with the picture.
    """

    exposure_mean: float = 112.0
    exposure_jitter: float = 0.08
    vignetting: float = 0.25
    motion_blur_px: float = 0.8
    focus_blur_px: float = 0.5
    read_noise: float = 1.5
    shot_noise: float = 3.0
    visibility_m: float = 8000.0
    light: float = 1.0
    max_gain: float = 3.0


NO_EFFECTS = CameraEffects(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


def apply_effects(pixels: Image, range_m: Plane, effects: CameraEffects, seed: int) -> Image:
    """The picture (H, W, 3) RGB as the sensor gives it. `range_m` (H, W) is the distance along each ray."""
    if effects == NO_EFFECTS:
        return pixels
    rng = np.random.default_rng(seed)
    light = pixels.astype(np.float32)
    if effects.visibility_m > 0:
        light = _haze(light, range_m, effects.visibility_m)
    if effects.light != 1.0:
        light *= np.float32(effects.light)
    light = _blur(light, effects, rng)
    gain = _gain(light, effects, rng)
    if effects.vignetting > 0:
        light *= _vignette(light.shape[1], light.shape[0], effects.vignetting)[:, :, None] * np.float32(gain)
    elif gain != 1.0:
        light *= np.float32(gain)
    if effects.read_noise > 0 or effects.shot_noise > 0:
        _add_noise(light, effects, rng, max(1.0, gain / DAY_GAIN))
    return np.asarray(np.clip(light, 0, 255), dtype=np.uint8)


def _haze(light: Plane, range_m: Plane, visibility_m: float) -> Plane:
    passed = cv2.exp(range_m * np.float32(-3.912 / visibility_m))
    lost = 1 - passed
    return np.asarray(light * passed[:, :, None] + lost[:, :, None] * np.array(AIRLIGHT, np.float32), dtype=np.float32)


def _blur(light: Plane, effects: CameraEffects, rng: np.random.Generator) -> Plane:
    length, angle = abs(rng.normal(0, 1)) * effects.motion_blur_px, rng.uniform(0, np.pi)
    if effects.focus_blur_px <= 0 and length < 0.1:
        return light
    reach = int(np.ceil(length / 2 + 3 * effects.focus_blur_px)) + 1
    at = np.arange(-reach, reach + 1)
    x, y = np.meshgrid(at, at)
    kernel = np.zeros(x.shape)
    sigma = max(effects.focus_blur_px, 0.35)
    for along in np.linspace(-length / 2, length / 2, 2 * reach + 1):
        kernel += np.exp(-((x - along * np.cos(angle)) ** 2 + (y - along * np.sin(angle)) ** 2) / (2 * sigma**2))
    kernel32 = (kernel / kernel.sum()).astype(np.float32)
    return np.asarray(cv2.filter2D(light, -1, kernel32, borderType=cv2.BORDER_REPLICATE), dtype=np.float32)


def _gain(light: Plane, effects: CameraEffects, rng: np.random.Generator) -> float:
    jitter = float(np.exp(rng.normal(0, 1) * effects.exposure_jitter))
    if effects.exposure_mean <= 0:
        return jitter
    mean = float(np.mean(cv2.mean(light[::4, ::4])[:3]))
    return jitter * float(np.clip(effects.exposure_mean / max(mean, 1e-3), LEAST_GAIN, effects.max_gain))


@lru_cache(maxsize=4)
def _vignette(width_px: int, height_px: int, loss: float) -> Plane:
    x = np.linspace(-1, 1, width_px, dtype=np.float32) * width_px
    y = np.linspace(-1, 1, height_px, dtype=np.float32) * height_px
    r2 = (x**2 + (y**2)[:, None]) / (width_px**2 + height_px**2)
    return np.asarray(1 - np.float32(loss) * r2**1.5, dtype=np.float32)


@lru_cache(maxsize=2)
def _noise_bank(width_px: int, height_px: int) -> Plane:
    return np.random.default_rng(20240607).standard_normal((height_px + 256, width_px + 256, 3), dtype=np.float32)


def _add_noise(light: Plane, effects: CameraEffects, rng: np.random.Generator, amplified: float) -> None:
    """In place. The noise is a window of one fixed field (drawing it anew takes 10 ms), its rows in an order of the seed's: the
    same field twice, but shifted, would look like something that moved."""
    height, width = light.shape[:2]
    bank = _noise_bank(width, height)
    column = int(rng.integers(0, bank.shape[1] - width + 1))
    sign = 1.0 if rng.random() < 0.5 else -1.0
    noise = bank[rng.permutation(len(bank))[:height]][:, column : column + width]
    shot, read = amplified * effects.shot_noise**2 / 255, (amplified * effects.read_noise) ** 2
    variance = np.maximum(light, 0) * np.float32(shot) + np.float32(read)
    cv2.sqrt(variance, variance)
    variance *= np.float32(sign)
    variance *= noise
    light += variance
