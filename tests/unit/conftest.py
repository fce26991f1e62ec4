"""Eyes that know the truth (closed-loop flights without rendering, in a second or two each), and small GeoTIFFs in any CRS."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from random import Random
from typing import Any, cast

import numpy as np
import pytest
import rasterio
from rasterio.transform import Affine

from visloc_companion.errors import Reason
from visloc_companion.geo.raster import T_map_pix_from_gdal
from visloc_companion.geo.wgs84 import geo_from_ned, ned_from_geo
from visloc_companion.localise.around.freshness import FreshFramesOnly
from visloc_companion.localise.features.network_input import RECIPE
from visloc_companion.localise.model_folder import (
    InputSpec,
    ModelManifest,
    OutputSpec,
    Training,
    variant_entry,
    write_golden,
    write_manifest,
)
from visloc_companion.localise.runtime import run_onnx
from visloc_companion.maps.crs import map_crs
from visloc_companion.prepare.build import build_pack
from visloc_companion.protocols import ReferenceMap
from visloc_companion.sim import faults
from visloc_companion.sim.camera import SimulatedCamera
from visloc_companion.sim.flight import Eyes
from visloc_companion.sim.rendering.render_motion import STILL, Shot
from visloc_companion.sim.scenarios import FLIGHTS, SCENARIOS
from visloc_companion.sim.scene import Scene
from visloc_companion.types import CameraModel, Fix, FloatArray, GeoPoint, Image, LocaliseRequest, NoFix, Quat, Vec3


class PoseCamera:
    """A camera whose pixels are the bytes of its pose."""

    def __init__(self) -> None:
        self.model = CameraModel(640, 480, 554.0, 554.0, 319.5, 239.5)
        self.rendered: list[int] = []

    def render(self, place: GeoPoint, q_ned_frd: Quat, frame_id: int, shot: Shot = STILL) -> Image:
        self.rendered.append(frame_id)
        numbers = np.array([place.lat_deg, place.lon_deg, place.h_amsl_m, *q_ned_frd])
        return np.frombuffer(numbers.tobytes(), np.uint8)


class Oracle:
    """A localiser that reads the pose from the pixels, adds seeded noise, and only finds what the prior lets it search."""

    method = "oracle"

    def __init__(self, seed: int, sigma_m: float = 1.0, misses: float = 0.1, bias_ned_m: Vec3 = (0.0, 0.0, 0.0)) -> None:
        self._random, self._sigma_m, self._misses, self._bias_ned_m = Random(seed), sigma_m, misses, bias_ned_m

    def localise(self, request: LocaliseRequest, pixels: Image, ref: ReferenceMap) -> Fix | NoFix:
        lat_deg, lon_deg, h_amsl_m, *q = np.frombuffer(pixels.tobytes(), np.float64).tolist()
        place, frame, prior = GeoPoint(lat_deg, lon_deg, h_amsl_m), request.frame, request.prior
        north_m, east_m, _ = ned_from_geo(place, prior.place)
        reach_m = 3 * math.sqrt(np.linalg.eigvalsh(np.array(prior.cov_ne_m2))[-1]) + 5.0
        if math.hypot(north_m, east_m) > reach_m or self._random.random() < self._misses:
            return NoFix(0, frame.t_ns, request.request_id, frame.frame_id, self.method, Reason.NO_MATCH, 50.0)
        noise_m = [self._random.gauss(bias, self._sigma_m) for bias in self._bias_ned_m[:2]]
        found = geo_from_ned((noise_m[0], noise_m[1], self._bias_ned_m[2]), place)
        cov = ((self._sigma_m**2, 0.0), (0.0, self._sigma_m**2))
        return Fix(
            0,
            frame.t_ns,
            request.request_id,
            frame.frame_id,
            self.method,
            found,
            cast("Quat", tuple(q)),
            cov,
            2.0,
            0.02,
            1e-3,
            50.0,
        )


def make_oracle_eyes(seed: int = 5, **how: Any) -> Eyes:
    return Eyes(cast("SimulatedCamera", PoseCamera()), FreshFramesOnly(Oracle(seed, **how)), cast("ReferenceMap", None), 4.0)


@pytest.fixture
def oracle_eyes() -> Callable[..., Eyes]:
    """`oracle_eyes(seed, sigma_m=, misses=, bias_ned_m=)`: the camera of poses and the oracle that reads them."""
    return make_oracle_eyes


@pytest.fixture
def short_jam(monkeypatch: pytest.MonkeyPatch) -> None:
    """Half a minute, jammed after 12 s: what is told of a flight does not depend on its length."""
    monkeypatch.setitem(FLIGHTS, "jam", replace(SCENARIOS["jam"], duration_s=30.0, faults=faults.jam(12.0)))


@dataclass(frozen=True)
class TinyWorld:
    """400 x 400 m of noise with one hill, 1 m pixels: a pack, and the files of what the camera sees (the same date)."""

    pack: Path
    ortho: Path
    dsm: Path


@pytest.fixture(scope="session")
def tiny_world(tmp_path_factory: pytest.TempPathFactory) -> TinyWorld:
    """Built once."""
    folder, size_px, rng = tmp_path_factory.mktemp("tiny_world"), 400, np.random.default_rng(2)
    pixels = rng.integers(0, 255, (size_px, size_px, 3)).astype(np.uint8)
    v, u = np.mgrid[0:size_px, 0:size_px]
    heights = 300.0 + 10.0 * np.exp(-((u - 120.0) ** 2 + (v - 250.0) ** 2) / 800.0)
    T_map_pix = np.array([[1.0, 0.0, 500_000.0], [0.0, -1.0, 5_205_000.0]])
    ortho, dsm = Scene(pixels, heights.astype(np.float32), T_map_pix, "EPSG:32632").save(folder)
    build_pack([ortho], dsm, folder / "pack", capture_date="2026-01-01")
    return TinyWorld(folder / "pack", ortho, dsm)


WriteRaster = Callable[..., FloatArray]


@pytest.fixture
def write_raster() -> WriteRaster:
    """(path, values (H, W) or (H, W, C), crs, (lat, lon) of the middle, gsd_m, turn_deg) -> T_map_pix."""

    def write(
        path: Path, values: np.ndarray, crs: str, middle: tuple[float, float], gsd_m: float, turn_deg: float = 0.0, **profile: Any
    ) -> FloatArray:
        rows, cols = values.shape[:2]
        here = map_crs(crs).linearised_at(GeoPoint(*middle, 0.0))
        north, east = np.linalg.norm(here.J_map_ne, axis=0) * gsd_m
        c, s = np.cos(np.radians(turn_deg)), np.sin(np.radians(turn_deg))
        linear = np.array([[c, -s], [s, c]]) @ np.diag([east, -north])
        corner = np.array(here.origin_map_m) - linear @ [cols / 2, rows / 2]
        affine = Affine(*linear[0], corner[0], *linear[1], corner[1])
        bands = values[None] if values.ndim == 2 else values.transpose(2, 0, 1)
        shape = {"width": cols, "height": rows, "count": len(bands), "dtype": values.dtype}
        with rasterio.open(path, "w", driver="GTiff", crs=crs, transform=affine, **shape, **profile) as out:
            out.write(bands)
        return T_map_pix_from_gdal(tuple(affine)[:6])

    return write


TINY = Path(__file__).parents[1] / "data" / "tiny.onnx"


@pytest.fixture(scope="session")
def make_network() -> Callable[..., Path]:
    """Fills a folder with a network of 10 channels that has learned nothing; keywords replace fields of its manifest."""
    pytest.importorskip("onnxruntime")

    def make(folder: Path, onnx: Path = TINY, **changes: Any) -> Path:
        folder.mkdir(parents=True, exist_ok=True)
        content = onnx.read_bytes()
        (folder / "model.onnx").write_bytes(content)
        given = np.random.default_rng(3).standard_normal((1, 3, 32, 32)).astype(np.float32)
        manifest = ModelManifest(
            name="tiny",
            licence="Apache-2.0",
            opset=20,
            variants={"float32": variant_entry(folder / "model.onnx", 1e-4, 1e-5)},
            input=InputSpec(name="image", channels=3, channel_names=("grey", "cosine", "sine"), recipe=RECIPE),
            output=OutputSpec(name="features", channels=10, oriented=1, bound=2.0, multiple_px=4, context_px=7),
            training=Training(data=(), split="none", seeds=(7,), steps=0, hours=0.0, hardware="none", software="onnx"),
            figures={},
            golden=write_golden(folder, given, run_onnx(content, given)),
        )
        write_manifest(folder, manifest.model_copy(update=changes))
        return folder

    return make


@pytest.fixture(scope="session")
def network(make_network: Callable[..., Path], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of such a network, for reading only."""
    return make_network(tmp_path_factory.mktemp("models") / "tiny")
