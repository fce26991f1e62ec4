"""An analytic map and frames of it, with known truth."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from visloc_companion.errors import OutsideMap
from visloc_companion.geo.camera import R_FRD_CAM, unproject
from visloc_companion.geo.raster import apply_affine, invert_affine, window_affine
from visloc_companion.geo.se3 import R_from_quat, quat_from_euler
from visloc_companion.geo.wgs84 import geo_from_ned, ned_from_geo
from visloc_companion.types import (
    CameraModel,
    FloatArray,
    FrameRef,
    GeoPoint,
    Image,
    LocaliseRequest,
    PosePrior,
    ReferencePatch,
    Vec3,
)

HOME = GeoPoint(47.0, 8.0, 0.0)
MODEL = CameraModel(160, 120, 140.0, 140.0, 79.5, 59.5)


@dataclass(frozen=True)
class Projection:
    """The flat map's CRS is metres east and north of HOME."""

    J_map_ne: FloatArray
    origin_map_m: tuple[float, float]


@dataclass
class FlatMap:
    """A ReferenceMap over an array of 1 m pixels, centred on HOME, with a surface of its own."""

    pixels: Image
    surface: NDArray[np.float32]
    gsd_m: float = 1.0
    features: dict[str, NDArray[np.float32]] = field(default_factory=dict)
    known: NDArray[np.bool_] | None = None
    """(H, W) where there is map; None: everywhere."""

    def __post_init__(self) -> None:
        height, width = self.pixels.shape[:2]
        self.T_map_pix = np.array([[1.0, 0.0, -(width - 1) / 2], [0.0, -1.0, (height - 1) / 2]])

    def patch(
        self, center_map_m: tuple[float, float], size_px: tuple[int, int], gsd_m: float, heading_rad: float
    ) -> ReferencePatch:
        T = window_affine(center_map_m, size_px, np.array([[0.0, 1.0], [1.0, 0.0]]), gsd_m, heading_rad)
        v, u = np.mgrid[0 : size_px[1], 0 : size_px[0]]
        pix = apply_affine(invert_affine(self.T_map_pix), apply_affine(T, np.stack([u, v], -1).astype(float)))
        height, width = self.pixels.shape[:2]
        valid = (pix >= -0.5).all(-1) & (pix[..., 0] <= width - 0.5) & (pix[..., 1] <= height - 0.5)
        if self.known is not None:
            v, u = (np.clip(np.rint(pix[..., k]).astype(int), 0, n - 1) for k, n in ((1, height), (0, width)))
            valid &= self.known[v, u]
        if not valid.any():
            raise OutsideMap("the window is outside the map")
        source = cv2.GaussianBlur(self.pixels, (0, 0), 0.5 * math.sqrt(gsd_m**2 - 1)) if gsd_m > 1.1 else self.pixels
        x, y = pix[..., 0].astype(np.float32), pix[..., 1].astype(np.float32)
        pixels = cv2.remap(source, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        heights = cv2.remap(self.surface, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        return ReferencePatch(pixels.astype(np.uint8), valid, np.where(valid, heights, np.nan), T, gsd_m, heading_rad)

    def projection_at(self, place: GeoPoint) -> Projection:
        return Projection(np.array([[0.0, 1.0], [1.0, 0.0]]), self.to_map(place.lat_deg, place.lon_deg))

    def to_map(self, lat_deg: float, lon_deg: float) -> tuple[float, float]:
        north, east, _ = ned_from_geo(GeoPoint(lat_deg, lon_deg, 0.0), HOME)
        return east, north

    def to_geo(self, easting_m: float, northing_m: float) -> tuple[float, float]:
        place = geo_from_ned((northing_m, easting_m, 0.0), HOME)
        return place.lat_deg, place.lon_deg

    def height_amsl_m(self, easting_m: float, northing_m: float) -> float:
        u, v = apply_affine(invert_affine(self.T_map_pix), np.array([easting_m, northing_m]))
        return float(self.surface[round(v), round(u)])

    def covers(self, lat_deg: float, lon_deg: float, margin_m: float = 0.0) -> bool:
        east, north = self.to_map(lat_deg, lon_deg)
        height, width = self.pixels.shape[:2]
        return abs(east) <= width / 2 + margin_m and abs(north) <= height / 2 + margin_m


def texture(seed: int, size: int = 500) -> Image:
    """Fields, lines and blobs: structure at many scales, no periodicity."""
    rng = np.random.default_rng(seed)
    image = np.full((size, size), 110.0, np.float32)
    for _ in range(size * size // 900):
        x, y, a, b = rng.uniform(0, size, 2).tolist() + rng.uniform(4, 40, 2).tolist()
        box = cv2.boxPoints(((x, y), (a, b), rng.uniform(0, 180)))
        cv2.fillPoly(image, [np.int32(box)], float(rng.uniform(30, 220)))
    image += cv2.GaussianBlur(rng.normal(0, 60, image.shape).astype(np.float32), (0, 0), 2)
    return np.clip(image, 0, 255).astype(np.uint8)


def blobs(seed: int = 1, size: int = 1024) -> Image:
    """Blobs and grain of several sizes: corners everywhere, no edges."""
    rng = np.random.default_rng(seed)
    image = np.full((size, size), 110.0, np.float32)
    for sigma, strength in ((1.0, 22.0), (3.0, 22.0), (12.0, 25.0)):
        layer = cv2.GaussianBlur(rng.standard_normal((size, size)).astype(np.float32), (0, 0), sigma)
        image += strength * layer / layer.std()
    return np.clip(image, 0, 255).astype(np.uint8)


def render(world: FlatMap, model: CameraModel, p_ned_m: Vec3, euler_rad: Vec3) -> Image:
    """What a camera over the map sees: rays marched onto the surface; written apart from the code under test."""
    v, u = np.mgrid[0 : model.height_px, 0 : model.width_px]
    rays = (
        unproject(model, np.column_stack([u.ravel(), v.ravel()]).astype(float))
        @ (R_from_quat(quat_from_euler(*euler_rad)) @ R_FRD_CAM).T
    )
    ahead, to_pix = np.maximum(rays[:, 2], 1e-3), invert_affine(world.T_map_pix)
    highest = float(world.surface.max())
    level = highest == float(world.surface.min())

    def met(surface: FloatArray) -> NDArray[np.float32]:
        """(H, W, 2) pixels of the map where the rays meet heights (H W,)."""
        ne = np.array(p_ned_m[:2]) + rays[:, :2] * ((-p_ned_m[2] - surface) / ahead)[:, None]
        return apply_affine(to_pix, ne[:, ::-1]).astype(np.float32).reshape(model.height_px, model.width_px, 2)

    surface = np.zeros(len(rays))
    for _ in range(24):
        if level:
            surface = 0.5 * surface + 0.5 * highest
            continue
        pix = met(surface)
        hit = cv2.remap(world.surface, pix[..., 0], pix[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        surface = 0.5 * surface + 0.5 * np.asarray(hit, dtype=float).ravel()
    pix = met(surface)
    colors = cv2.remap(world.pixels, pix[..., 0], pix[..., 1], cv2.INTER_CUBIC, borderMode=cv2.BORDER_CONSTANT)
    return np.asarray(colors).astype(np.uint8)


def request_at(
    p_ned_m: Vec3,
    euler_rad: Vec3,
    sigma_m: float = 12.0,
    sigma_h_m: float = 4.0,
    sigma_yaw_deg: float = 3.0,
    model: CameraModel = MODEL,
) -> LocaliseRequest:
    """A request whose prior lies at a pose (NED about HOME at sea level)."""
    prior = PosePrior(
        geo_from_ned(p_ned_m, HOME),
        quat_from_euler(*euler_rad),
        ((sigma_m**2, 0.0), (0.0, sigma_m**2)),
        sigma_h_m,
        math.radians(sigma_yaw_deg),
        math.radians(0.5),
    )
    return LocaliseRequest(7, FrameRef(1, 2, 3, 0, model.width_px, model.height_px, 1), prior, 1)


class ElsewhereOnEarth(FlatMap):
    """A map in whose CRS no prior's place has coordinates, as in a UTM zone on the other side of the earth."""

    def to_map(self, lat_deg: float, lon_deg: float) -> tuple[float, float]:
        raise OutsideMap("no coordinates in UTM zone 32N")


@pytest.fixture(scope="session")
def elsewhere(flat) -> ElsewhereOnEarth:
    """Of the flat map's pixels."""
    return ElsewhereOnEarth(flat.pixels, flat.surface)


@pytest.fixture(scope="session")
def flat() -> FlatMap:
    """A textured map on level ground at 100 m above the sea."""
    pixels = texture(1)
    return FlatMap(pixels, np.full(pixels.shape, 100.0, np.float32))


@pytest.fixture(scope="session")
def hilly() -> FlatMap:
    """The same on hills of ±12 m."""
    pixels = texture(1)
    v, u = np.mgrid[0 : pixels.shape[0], 0 : pixels.shape[1]]
    return FlatMap(pixels, (100 + 12 * np.sin(u / 40) * np.cos(v / 55)).astype(np.float32))


@pytest.fixture(scope="session")
def support() -> SimpleNamespace:
    """The helpers of this file."""
    return SimpleNamespace(HOME=HOME, render=render, request_at=request_at, texture=texture, blobs=blobs, FlatMap=FlatMap)
