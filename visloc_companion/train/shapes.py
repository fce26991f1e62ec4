"""Invented towns and fields of flat shapes, on two dates: endless variety of geometry where imagery is scarce.

In the manner of the dead-leaves model (Lee, Mumford & Huang 2001): parcels, roads, roofs with shadows, crowns. Between the dates
tones change or turn round, shadows move, roofs lean by parallax, things come and go.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

Float32Array = NDArray[np.float32]
Rng = np.random.Generator


def paint_dates(rng: Rng, size_px: int, dates: int = 2) -> list[Float32Array]:
    """`dates` grey images (size, size) float32 0..255 of one invented place."""
    labels, n_parcels = _parcels(rng, size_px)
    roads, roofs, crowns = _roads(rng, size_px), _roofs(rng, size_px), _crowns(rng, size_px)
    lasting = _texture(rng, size_px)
    tones = rng.uniform(40, 200, n_parcels)
    road_tone = rng.uniform(60, 220)
    return [_date(rng, labels, tones, roads, road_tone, roofs, crowns, lasting) for _ in range(dates)]


def _date(
    rng: Rng,
    labels: NDArray[np.int32],
    tones: NDArray[np.float64],
    roads: list[tuple[NDArray[np.int32], int]],
    road_tone: float,
    roofs: NDArray[np.float64],
    crowns: NDArray[np.float64],
    lasting: Float32Array,
) -> Float32Array:
    changed = rng.random(len(tones)) < rng.uniform(0.2, 1.0)
    now = np.where(changed, rng.uniform(40, 200, len(tones)), tones).astype(np.float32)
    image = now[labels]
    image += lasting * np.float32(rng.uniform(0.0, 18)) + _texture(rng, len(image)) * np.float32(rng.uniform(0, 14))
    tone = road_tone if rng.random() < 0.6 else rng.uniform(40, 230)
    for line, width in roads:
        cv2.polylines(image, [line], False, float(tone + rng.normal(0, 6)), width, cv2.LINE_AA)
    sun, reach = rng.uniform(0, 2 * np.pi), rng.uniform(0.2, 1.3)
    shadow = np.array([np.cos(sun), np.sin(sun)]) * reach
    lean = rng.normal(0, 0.12, 2)
    _draw_crowns(rng, image, crowns, shadow)
    _draw_roofs(rng, image, roofs, shadow, lean)
    return np.clip(cv2.GaussianBlur(image, (0, 0), rng.uniform(0.4, 0.9)), 0, 255).astype(np.float32)


def _parcels(rng: Rng, size: int) -> tuple[NDArray[np.int32], int]:
    """Label of the nearest of some seeds, on stretched and turned axes: fields."""
    n = int(rng.integers(3, 40))
    seeds = rng.uniform(-0.2 * size, 1.2 * size, (n, 2))
    turn, stretch = rng.uniform(0, np.pi), rng.uniform(1, 4)
    A = np.array([[np.cos(turn), np.sin(turn)], [-stretch * np.sin(turn), stretch * np.cos(turn)]])
    step = 2
    grid = np.stack(np.meshgrid(np.arange(0, size, step), np.arange(0, size, step)), -1).reshape(-1, 2)
    near = (grid @ A.T)[:, None] - (seeds @ A.T)[None]
    metric = np.abs(near).sum(-1) if rng.random() < 0.5 else (near * near).sum(-1)
    small = metric.argmin(1).reshape(-(-size // step), -1).astype(np.float32)
    return cv2.resize(small, None, fx=step, fy=step, interpolation=cv2.INTER_NEAREST)[:size, :size].astype(np.int32), n


def _roads(rng: Rng, size: int) -> list[tuple[NDArray[np.int32], int]]:
    """Polylines (N, 1, 2) with a width."""
    roads = []
    main = rng.uniform(0, np.pi)
    for _ in range(int(rng.integers(0, 7))):
        angle = main + (rng.integers(2) * np.pi / 2 if rng.random() < 0.7 else rng.uniform(0, np.pi)) + rng.normal(0, 0.05)
        at, along = rng.uniform(0, size, 2), np.array([np.cos(angle), np.sin(angle)])
        steps = np.linspace(-1.5 * size, 1.5 * size, 24)
        bend = np.cumsum(rng.normal(0, size * rng.choice([0.0, 0.004, 0.03]), 24))
        points = at + steps[:, None] * along + bend[:, None] * along[::-1] * np.array([-1, 1])
        roads.append((points.astype(np.int32)[:, None], int(rng.integers(1, max(2, size // 30)))))
    return roads


def _roofs(rng: Rng, size: int) -> NDArray[np.float64]:
    """(N, 8): centre u, v, length, width, angle, height, tone, second tone."""
    n = int(rng.integers(0, 60) * (rng.random() < 0.7))
    main, unit = rng.uniform(0, np.pi), rng.uniform(0.03, 0.1) * size
    centre = rng.uniform(0, size, (n, 2))
    length = unit * np.exp(rng.normal(0, 0.35, n))
    angle = main + rng.integers(0, 2, n) * np.pi / 2 + rng.normal(0, 0.06, n)
    tone = rng.uniform(30, 235, n)
    return np.column_stack(
        [
            centre,
            length,
            length * rng.uniform(0.35, 1, n),
            angle,
            unit * rng.uniform(0.1, 0.6, n),
            tone,
            tone * rng.uniform(0.6, 1, n),
        ]
    )


def _crowns(rng: Rng, size: int) -> NDArray[np.float64]:
    """(N, 3): centre u, v, radius; clustered."""
    n = int(rng.integers(0, 200) * (rng.random() < 0.75))
    groups = rng.uniform(0, size, (max(1, n // 20), 2))
    at = groups[rng.integers(len(groups), size=n)] + rng.normal(0, size * rng.uniform(0.03, 0.25), (n, 2))
    return np.column_stack([at, np.exp(rng.normal(0, 0.3, n)) * rng.uniform(0.008, 0.03) * size])


def _draw_crowns(rng: Rng, image: Float32Array, crowns: NDArray[np.float64], shadow: NDArray[np.float64]) -> None:
    tone, swell, gone = rng.uniform(30, 110), rng.uniform(0.7, 1.2), rng.uniform(0, 0.3)
    opacity = rng.uniform(0.3, 1)
    layer = image.copy()
    for u, v, radius in crowns[rng.random(len(crowns)) > gone]:
        r = max(1, round(radius * swell))
        cv2.circle(layer, (int(u + shadow[0] * r), int(v + shadow[1] * r)), r, float(tone * 0.5), -1, cv2.LINE_AA)
        cv2.circle(layer, (int(u), int(v)), r, float(tone * rng.uniform(0.75, 1.3)), -1, cv2.LINE_AA)
    cv2.addWeighted(layer, opacity, image, 1 - opacity, 0, dst=image)


def _draw_roofs(
    rng: Rng, image: Float32Array, roofs: NDArray[np.float64], shadow: NDArray[np.float64], lean: NDArray[np.float64]
) -> None:
    retone, gone = rng.uniform(0, 0.5), rng.uniform(0, 0.25)
    for u, v, length, width, angle, height, tone, second in roofs[rng.random(len(roofs)) > gone]:
        along, across = (
            np.array([np.cos(angle), np.sin(angle)]) * length / 2,
            np.array([-np.sin(angle), np.cos(angle)]) * width / 2,
        )
        corners = np.array([u, v]) + np.array([along + across, along - across, -along - across, -along + across])
        cast = cv2.convexHull(np.concatenate([corners, corners + shadow * height]).astype(np.float32))
        cv2.fillPoly(image, [np.rint(cast * 8).astype(np.int32)], 25.0, cv2.LINE_AA, 3)
        top = corners + lean * height
        bright = float(rng.uniform(30, 235)) if rng.random() < retone else float(tone)
        cv2.fillPoly(image, [np.rint(top * 8).astype(np.int32)], bright, cv2.LINE_AA, 3)
        ridge = np.array([top[0], top[3], (top[3] + top[2]) / 2, (top[0] + top[1]) / 2])
        cv2.fillPoly(image, [np.rint(ridge * 8).astype(np.int32)], bright * float(second / tone), cv2.LINE_AA, 3)


def _texture(rng: Rng, size: int) -> Float32Array:
    """Noise of several scales, deviation about 1."""
    total = np.zeros((size, size), np.float32)
    for scale in (1, 3, 8, 24):
        n = max(2, size // scale + 2)
        coarse = rng.standard_normal((n, n), dtype=np.float32)
        total += cv2.resize(coarse, (size, size), interpolation=cv2.INTER_CUBIC) * np.float32(rng.uniform(0.1, 0.8))
    return total
