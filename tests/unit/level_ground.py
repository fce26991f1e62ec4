"""Level ground with smooth random brightness, and how far two pictures of it are apart."""

from __future__ import annotations

import cv2
import numpy as np

from visloc_companion.maps.crs import map_crs
from visloc_companion.sim.scene import Scene
from visloc_companion.types import GeoPoint, Image

CRS, EAST, NORTH, GROUND_M = "EPSG:32632", 604_000.0, 5_350_000.0, 430.0


def level_ground() -> Scene:
    """600 m by 600 m, 0.5 m a pixel."""
    noise = np.random.default_rng(1).standard_normal((1200, 1200)).astype(np.float32)
    grey = cv2.GaussianBlur(noise, (0, 0), 3.0)
    pixels = np.clip(120 + 40 * grey / grey.std(), 0, 255).astype(np.uint8)
    T = np.array([[0.5, 0.0, EAST], [0.0, -0.5, NORTH]])
    return Scene(np.dstack([pixels] * 3), np.full((1200, 1200), GROUND_M, np.float32), T, CRS)


def over_its_middle(height_m: float, north_m: float = 0.0, east_m: float = 0.0) -> GeoPoint:
    """So far above the ground, and beside its middle."""
    lat, lon = map_crs(CRS).to_geo(EAST + 300.0 + east_m, NORTH - 300.0 + north_m)
    return GeoPoint(lat, lon, GROUND_M + height_m)


def apart(a: Image, b: Image) -> float:
    """Mean difference in grey values."""
    return float(np.abs(a.astype(float) - b.astype(float)).mean())
