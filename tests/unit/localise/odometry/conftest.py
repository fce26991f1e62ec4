"""Textured ground, level or sloping, ray-cast exactly, and what an autopilot says of the camera above it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from types import SimpleNamespace

import cv2
import numpy as np
import pytest

from visloc_companion.geo.camera import R_FRD_CAM, unproject
from visloc_companion.geo.se3 import R_from_quat, quat_from_euler
from visloc_companion.localise.odometry.base import Sight, Surface
from visloc_companion.types import CameraModel, FloatArray, Image

MODEL = CameraModel(320, 240, 220.0, 220.0, 159.5, 119.5)
WIDE = CameraModel(320, 240, 220.0, 220.0, 159.5, 119.5, (-0.08, 0.01, 0.0, 0.0, 0.0))
PERIOD_NS = 250_000_000


@dataclass(frozen=True)
class Ground:
    """A plane at up = 0 under the origin that rises towards north by `slope`; texels of `texel_m`."""

    picture: Image
    texel_m: float = 0.4
    slope: float = 0.0
    model: CameraModel = MODEL

    def frame(self, p_ned_m, euler_deg=(0.0, 0.0, 0.0), seed: int = 0, noise: float = 1.5) -> Image:
        """(H, W) grey."""
        v, u = np.mgrid[0 : self.model.height_px, 0 : self.model.width_px]
        R = R_from_quat(quat_from_euler(*(math.radians(a) for a in euler_deg))) @ R_FRD_CAM
        d = unproject(self.model, np.column_stack([u.ravel(), v.ravel()]).astype(float)) @ R.T
        p = np.array(p_ned_m, float)
        t = (-p[2] - self.slope * p[0]) / np.maximum(d[:, 2] + self.slope * d[:, 0], 1e-3)
        at = (p[:2] + d[:, :2] * t[:, None]) / self.texel_m + len(self.picture) / 2
        x, y = (at[:, k].astype(np.float32).reshape(u.shape) for k in (1, 0))
        image = cv2.remap(self.picture, x, y, cv2.INTER_CUBIC, borderMode=cv2.BORDER_WRAP).astype(np.float32)
        image += np.random.default_rng(seed).normal(0, noise, image.shape)
        return np.clip(image, 0, 255).astype(np.uint8)

    def surface(self, reach_m: float = 300.0, step_m: float = 5.0) -> Surface:
        """The same as a model: rows towards south, columns towards east."""
        n = round(2 * reach_m / step_m) + 1
        north = reach_m - step_m * np.arange(n)
        up = np.repeat((self.slope * north).astype(np.float32)[:, None], n, 1)
        return Surface(up, np.array([[0.0, -step_m, reach_m], [step_m, 0.0, -reach_m]]))


def sight(pixels: Image, k: int, p_ned_m, euler_deg=(0.0, 0.0, 0.0), **other) -> Sight:
    """A frame with an autopilot's usual sigmas over ground at zero; `other` replaces fields."""
    q = quat_from_euler(*(math.radians(a) for a in euler_deg))
    given = {
        "sigma_tilt_rad": math.radians(0.5),
        "sigma_yaw_rad": math.radians(1.0),
        "up_m": -float(p_ned_m[2]),
        "height_m": -float(p_ned_m[2]),
        "sigma_height_m": 0.3,
        "ranged": True,
    }
    return Sight(pixels, k * PERIOD_NS, q, **(given | other))


def path(n: int, step_m: FloatArray | tuple[float, float, float], start=(0.0, 0.0, -100.0)) -> FloatArray:
    """(n, 3) a straight line."""
    return np.array(start) + np.arange(n)[:, None] * np.array(step_m)


@pytest.fixture(scope="session")
def odo(support) -> SimpleNamespace:
    """The helpers of this file."""
    return SimpleNamespace(
        MODEL=MODEL, WIDE=WIDE, Ground=Ground, texture=support.blobs, sight=sight, path=path, PERIOD_NS=PERIOD_NS
    )


@pytest.fixture(scope="session")
def field(support) -> Ground:
    """Level ground."""
    return Ground(support.blobs())
