"""A world of textured planes and boxes, ray-cast exactly: apart from the code under test and from the simulator."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import partial
from types import SimpleNamespace

import cv2
import numpy as np
import pytest

from visloc_companion.geo.camera import R_FRD_CAM, unproject
from visloc_companion.geo.se3 import R_from_quat, quat_from_euler
from visloc_companion.localise.structure.base import PosedFrame
from visloc_companion.types import CameraModel, FloatArray, Image

MODEL = CameraModel(320, 240, 212.7, 212.7, 159.5, 119.5)
WIDE = CameraModel(320, 240, 212.7, 212.7, 159.5, 119.5, (-0.08, 0.01, 0.0, 0.0, 0.0))
ENU_NED = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
TEXEL_M = 0.25
REACH_M = 160.0
"""The texture of a world reaches so far each way."""
SIDE_PX = round(2 * REACH_M / TEXEL_M)


@dataclass(frozen=True)
class Box:
    """A block on the ground: east and north from, to, and its height."""

    west: float
    east: float
    south: float
    north: float
    height: float


@dataclass(frozen=True)
class World:
    """Level ground at up = 0 with boxes; surfaces show the texture at their place, shifted by their height."""

    picture: Image
    boxes: tuple[Box, ...] = ()
    slope: float = 0.0

    def height(self, points: FloatArray) -> FloatArray:
        """Truth at (N, 2) east, north."""
        up = self.slope * points[:, 0]
        for box in self.boxes:
            inside = (abs(points[:, 0] - (box.west + box.east) / 2) <= (box.east - box.west) / 2) & (
                abs(points[:, 1] - (box.south + box.north) / 2) <= (box.north - box.south) / 2
            )
            up = np.where(inside, box.height, up)
        return up

    def render(self, model: CameraModel, T_local_cam: FloatArray, noise: float = 1.5, seed: int = 0) -> Image:
        """(H, W) grey."""
        v, u = np.mgrid[0 : model.height_px, 0 : model.width_px]
        d = unproject(model, np.column_stack([u.ravel(), v.ravel()]).astype(float)) @ T_local_cam[:3, :3].T
        origin, along = T_local_cam[:3, 3], np.ascontiguousarray(d.T)  # the largest of three is found faster among rows
        normal = np.array([-self.slope, 0.0, 1.0])
        t = -(origin @ normal) / np.minimum(d @ normal, -1e-6)
        for box in self.boxes:
            with np.errstate(divide="ignore", invalid="ignore"):
                a = (np.array([[box.west], [box.south], [-50.0]]) - origin[:, None]) / along
                b = (np.array([[box.east], [box.north], [box.height]]) - origin[:, None]) / along
            enter, leave = np.minimum(a, b).max(0), np.maximum(a, b).min(0)
            t = np.where((enter < leave) & (enter > 0) & (enter < t), enter, t)
        p = origin + d * t[:, None]
        x = ((p[:, 0] + 0.7 * p[:, 2] + REACH_M) / TEXEL_M).astype(np.float32).reshape(u.shape)
        y = ((REACH_M - p[:, 1] + 0.4 * p[:, 2]) / TEXEL_M).astype(np.float32).reshape(u.shape)
        image = cv2.remap(self.picture, x, y, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REFLECT).astype(np.float32)
        image += np.random.default_rng(seed).normal(0, noise, image.shape)
        return np.clip(image, 0, 255).astype(np.uint8)


def pose(east: float, north: float, up: float, roll_deg: float = 0.0, pitch_deg: float = 0.0, yaw_deg: float = 0.0) -> FloatArray:
    """(4, 4) T_local_cam of a down-looking camera."""
    T = np.eye(4)
    T[:3, :3] = ENU_NED @ R_from_quat(quat_from_euler(*(math.radians(a) for a in (roll_deg, pitch_deg, yaw_deg)))) @ R_FRD_CAM
    T[:3, 3] = east, north, up
    return T


def disturbed(T: FloatArray, rng: np.random.Generator, sigma_m: float = 0.2, sigma_deg: float = 0.5) -> FloatArray:
    """What an autopilot would say of a pose."""
    out = T.copy()
    out[:3, 3] += rng.normal(0, sigma_m, 3)
    out[:3, :3] = cv2.Rodrigues(rng.normal(0, math.radians(sigma_deg), 3))[0] @ T[:3, :3]
    return out


def posed(pixels: Image, T: FloatArray, height_m: float = 90.0, **other: float) -> PosedFrame:
    """A frame with an autopilot's usual sigmas."""
    sigma = {"sigma_position_m": 0.2, "sigma_tilt_rad": math.radians(0.5), "sigma_yaw_rad": math.radians(0.5), **other}
    return PosedFrame(pixels, T, height_m=height_m, **sigma)


def flown(
    world: World, truth: list[FloatArray], model: CameraModel = MODEL, seed: int = 1, sigma_m: float = 0.2, sigma_deg: float = 0.5
) -> list[PosedFrame]:
    """Frames of true poses with disturbed priors."""
    rng = np.random.default_rng(seed)
    return [posed(world.render(model, T, seed=i), disturbed(T, rng, sigma_m, sigma_deg)) for i, T in enumerate(truth)]


@pytest.fixture(scope="session")
def structure(support) -> SimpleNamespace:
    """The helpers of this file."""
    texture = partial(support.blobs, size=SIDE_PX)
    return SimpleNamespace(
        Box=Box, MODEL=MODEL, WIDE=WIDE, World=World, disturbed=disturbed, flown=flown, pose=pose, posed=posed, texture=texture
    )


@pytest.fixture(scope="session")
def town(structure) -> World:
    """Two boxes of 12 and 20 m on level ground."""
    return World(structure.texture(1), (Box(-14, 6, -10, 12, 12.0), Box(22, 32, -25, -5, 20.0)))
