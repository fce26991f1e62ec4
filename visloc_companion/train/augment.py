"""What cameras, light and years do to a grey image, at random: tones, haze, shadow, blur, noise, JPEG, things that change; and
what a tilt does that is not known."""

from __future__ import annotations

import math

import cv2
import numpy as np
from numpy.typing import NDArray

Float32Array = NDArray[np.float32]
Rng = np.random.Generator
LUMINANCE = (0.299, 0.587, 0.114)


def mixed_bands(rng: Rng, image: NDArray[np.uint8]) -> Float32Array:
    """(H, W) grey of (H, W, K) bands: the luminance (the first of fewer than three bands), or at random another mixture of all
    bands (near infrared turns vegetation bright)."""
    bands = image.shape[2]
    weights = np.zeros(bands)
    weights[:3] = LUMINANCE if bands >= 3 else (1, 0)[:bands]
    if rng.random() < 0.5:
        weights = rng.dirichlet(np.full(bands, 0.6))
    return np.asarray(cv2.transform(image, weights[None].astype(np.float64)), dtype=np.float32)


def photographed(rng: Rng, image: Float32Array, strength: float = 1.0) -> Float32Array:
    """The image (H, W) 0..255 as another camera on another day would give it. `strength` scales how often things happen."""
    out = image
    if rng.random() < 0.35 * strength:
        out = recoloured(rng, out)
    if rng.random() < 0.4 * strength:
        out = _lit(rng, out)
    if rng.random() < 0.3 * strength:
        out = _shadowed(rng, out)
    gain, gamma = np.exp(rng.normal(0, 0.25)), np.exp(rng.normal(0, 0.3))
    out = 255 * np.power(np.clip(out / 255, 0, 1), gamma) * gain
    if rng.random() < 0.3 * strength:
        share = rng.uniform(0.1, 0.6)
        out = out * (1 - share) + share * rng.uniform(120, 230)
    if rng.random() < 0.5:
        out = cv2.GaussianBlur(out, (0, 0), rng.uniform(0.3, 1.3))
    out = out + rng.standard_normal(out.shape, dtype=np.float32) * np.float32(rng.uniform(0, 5))
    out = np.clip(out, 0, 255)
    if rng.random() < 0.3:
        out = _compressed(rng, out)
    return np.asarray(out, dtype=np.float32)


def recoloured(rng: Rng, image: Float32Array) -> Float32Array:
    """Broad tones exchanged at random while the detail stays: crops, soil and leaves of another season."""
    broad = cv2.GaussianBlur(image, (0, 0), rng.uniform(1.5, 6))
    knots = np.linspace(0, 255, int(rng.integers(4, 8)))
    tones = rng.uniform(20, 235, len(knots))
    share = rng.uniform(0.4, 1.0)
    new = np.interp(broad, knots, tones).astype(np.float32)
    detail = (image - broad) * np.float32(rng.choice([1.0, 1.0, 0.5, -0.7]))
    return np.asarray(np.clip((1 - share) * image + share * (new + detail), 0, 255), dtype=np.float32)


def changed(rng: Rng, image: Float32Array, other: Float32Array) -> Float32Array:
    """The image with up to a third of it replaced by pieces of another one: what was built, felled or flooded since."""
    out = image.copy()
    height, width = image.shape
    for _ in range(int(rng.integers(1, 4))):
        h, w = (int(side * rng.uniform(0.1, 0.4)) for side in (height, width))
        row, col = int(rng.integers(0, height - h + 1)), int(rng.integers(0, width - w + 1))
        r, c = int(rng.integers(0, other.shape[0] - h + 1)), int(rng.integers(0, other.shape[1] - w + 1))
        piece = other[r : r + h, c : c + w]
        mask = np.zeros((h, w), np.float32)
        cv2.ellipse(mask, (w // 2, h // 2), (w // 2, h // 2), 0, 0, 360, 1.0, -1)
        if rng.random() < 0.5:
            mask[:] = 1
        out[row : row + h, col : col + w] += mask * (piece - out[row : row + h, col : col + w])
    return out


def leaned(image: Float32Array, tilt_rad: float, towards_rad: float, height_px: float) -> Float32Array:
    """The image (H, W) of level ground as seen from `height_px` above it by a camera that leans by `tilt_rad` more than it knows.

    Its middle stays in place: the shift that comes with it is found as an offset. `towards_rad`: from u to v.
    """
    c, s = math.cos(towards_rad), math.sin(towards_rad)
    turn = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
    level, up = math.cos(tilt_rad), math.sin(tilt_rad)
    lean = np.array([[level, 0.0, up], [0.0, 1.0, 0.0], [-up, 0.0, level]])
    middle = (np.array(image.shape[1::-1]) - 1) / 2
    rays = np.array([[1.0, 0.0, -middle[0]], [0.0, 1.0, -middle[1]], [0.0, 0.0, height_px]])
    H = turn.T @ lean @ turn @ rays
    shift_px = middle - np.array([c, s]) * height_px * math.tan(tilt_rad)
    seen = np.array([[height_px, 0.0, shift_px[0]], [0.0, height_px, shift_px[1]], [0.0, 0.0, 1.0]])
    size = (image.shape[1], image.shape[0])
    warped = cv2.warpPerspective(image, seen @ H, size, flags=cv2.INTER_LINEAR, borderMode=cv2.BORDER_REFLECT)
    return np.asarray(warped, dtype=np.float32)


def _lit(rng: Rng, image: Float32Array) -> Float32Array:
    """Uneven light: a smooth field of gain."""
    field = rng.standard_normal((4, 4)).astype(np.float32)
    gain = np.exp(cv2.resize(field, image.shape[::-1], interpolation=cv2.INTER_CUBIC) * np.float32(rng.uniform(0.05, 0.35)))
    return np.asarray(image * gain, dtype=np.float32)


def _shadowed(rng: Rng, image: Float32Array) -> Float32Array:
    """Cloud or tree shadows: blobs that are darker."""
    mask = np.zeros(image.shape, np.float32)
    height, width = image.shape
    for _ in range(int(rng.integers(1, 5))):
        axes = (int(rng.uniform(0.03, 0.3) * width), int(rng.uniform(0.03, 0.3) * height))
        centre = (int(rng.integers(width)), int(rng.integers(height)))
        cv2.ellipse(mask, centre, axes, float(rng.uniform(0, 180)), 0, 360, 1.0, -1)
    soft = np.asarray(cv2.GaussianBlur(mask, (0, 0), float(rng.uniform(0.5, 6))), dtype=np.float32)
    return np.asarray(image * (1 - soft * rng.uniform(0.2, 0.6)), dtype=np.float32)


def _compressed(rng: Rng, image: Float32Array) -> Float32Array:
    quality = int(rng.integers(25, 90))
    coded = cv2.imencode(".jpg", image.astype(np.uint8), [cv2.IMWRITE_JPEG_QUALITY, quality])[1]
    return np.asarray(cv2.imdecode(coded, cv2.IMREAD_GRAYSCALE), dtype=np.float32)
