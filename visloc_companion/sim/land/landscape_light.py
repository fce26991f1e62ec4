"""Sunlight on the procedural landscape: shading by slope, and the photograph's tones."""

from __future__ import annotations

import cv2
import numpy as np

from visloc_companion.sim.land.landscape_noise import Raster
from visloc_companion.sim.land.season import Season
from visloc_companion.types import Image

BAND_ROWS = 400


def light_up(albedo: Image, surface_m: Raster, shaded: Raster, gsd_m: float, season: Season) -> Image:
    """The photograph: albedo under sun and sky. `shaded` (H, W) is the share of sunlight that is blocked."""
    result = np.empty_like(albedo)
    rows = albedo.shape[0]
    for top in range(0, rows, BAND_ROWS):
        bottom = min(top + BAND_ROWS, rows)
        low, high = max(0, top - 12), min(rows, bottom + 12)
        part = slice(top - low, top - low + bottom - top)
        sun, open_sky = _sun_and_sky(surface_m[low:high], gsd_m, season)
        direct = sun[part] * (1 - shaded[top:bottom])
        light = direct[:, :, None] * np.array(season.direct, np.float32)
        light += open_sky[part][:, :, None] * np.array(season.ambient, np.float32)
        result[top:bottom] = _tones(albedo[top:bottom] * light, season)
    return result


def _sun_and_sky(surface_m: Raster, gsd_m: float, season: Season) -> tuple[Raster, Raster]:
    """Sunlight by slope (1 on level ground) and how open the sky is (1 on open ground)."""
    kernel = np.array([[-0.5, 0.0, 0.5]], np.float32) / np.float32(gsd_m)
    slope_x = cv2.filter2D(surface_m, -1, kernel)
    slope_y = cv2.filter2D(surface_m, -1, kernel.T)
    azimuth, elevation = np.radians(season.sun_azimuth_deg), np.radians(season.sun_elevation_deg)
    flat = np.float32(1 / np.tan(elevation))
    facing = 1 - flat * np.float32(np.sin(azimuth)) * slope_x + flat * np.float32(np.cos(azimuth)) * slope_y
    sun = facing / cv2.sqrt(1 + slope_x * slope_x + slope_y * slope_y)
    around = cv2.blur(surface_m, (2 * int(3 / gsd_m) + 1,) * 2)
    open_sky = np.clip(1 + 0.06 * (surface_m - around), 0.45, 1.15)
    return np.clip(sun, 0, 1.7).astype(np.float32), np.asarray(open_sky, dtype=np.float32)


def _tones(light: Raster, season: Season) -> Image:
    grey = light.mean(2, keepdims=True)
    toned = grey + np.float32(season.saturation) * (light - grey)
    toned = (toned - 100) * np.float32(season.contrast) + 100
    toned = toned * np.float32(1 - season.haze) + np.float32(season.haze) * np.array((200, 208, 220), np.float32)
    return np.asarray(np.clip(toned, 0, 255), dtype=np.uint8)
