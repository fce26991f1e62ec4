import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from visloc_companion.errors import OutsideMap
from visloc_companion.localise.features.gradient import GRADIENT
from visloc_companion.localise.local_frame import local_frame
from visloc_companion.localise.mapped.window import LEAST_PX, map_grid, part_of_box
from visloc_companion.localise.mapped.working_gsd import working_gsd_m
from visloc_companion.maps.pack import PackMap
from visloc_companion.maps.raster import RasterMap
from visloc_companion.prepare.build import build_pack
from visloc_companion.testing.fake_features import FakeNetwork
from visloc_companion.types import GeoPoint

UTM, PLACE = "EPSG:32633", (47.0, 15.3)
NETWORK = FakeNetwork()


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("window")


@pytest.fixture
def files(folder: Path, write_raster) -> RasterMap:
    if not (folder / "pack").exists():
        rng = np.random.default_rng(3)
        coarse = rng.uniform(20, 235, (102, 102))
        image = np.kron(coarse, np.ones((6, 6)))[:600, :600] + rng.normal(0, 5, (600, 600))
        image[:, :100] = 0
        write_raster(folder / "a.tif", np.clip(image, 0, 255).astype(np.uint8), UTM, PLACE, 0.5, nodata=0)
        build_pack([folder / "a.tif"], None, folder / "pack", ground_h_amsl_m=300.0, networks=[NETWORK])
    return RasterMap.open(folder / "a.tif", ground_h_amsl_m=300.0)


@pytest.fixture
def pack(files: RasterMap, folder: Path) -> PackMap:
    return PackMap.open(folder / "pack", verify_hashes=False)


def window(ref, gsd_m: float, features, middle=(0.0, 0.0), half_m: float = 60.0):
    frame = local_frame(GeoPoint(*PLACE, 0.0), ref)
    at = np.array(middle)
    return map_grid(ref, frame, at - half_m, at + half_m, gsd_m, features)


class Counting:
    """Features that count how often they are computed."""

    def __init__(self, inner) -> None:
        self.inner, self.calls = inner, 0

    def __getattr__(self, name: str):
        return getattr(self.inner, name)

    def __call__(self, image, valid):
        self.calls += 1
        return self.inner(image, valid)


@pytest.mark.parametrize("features", [GRADIENT, NETWORK])
@pytest.mark.parametrize("asked_m", [0.5, 0.6, 0.75, 0.9, 1.1, 1.6])
def test_stored_features_are_those_that_would_be_computed(pack: PackMap, files: RasterMap, features, asked_m: float) -> None:
    counting = Counting(features)
    grid = window(pack, asked_m, counting)
    assert counting.calls == 0
    assert abs(math.log2(grid.gsd_m / asked_m)) < 0.26
    level = math.log2(grid.gsd_m / pack.gsd_m) * 2
    assert level == pytest.approx(round(level), abs=1e-3), "a stored GSD"
    easting, northing = pack.projection_at(GeoPoint(*PLACE, 0.0)).origin_map_m
    want_px = round(2 * 60.0 / grid.gsd_m) + 1
    assert abs(grid.weight.shape[1] - want_px) <= 3
    middle = grid.A_ne_pix @ [(grid.weight.shape[1] - 1) / 2, (grid.weight.shape[0] - 1) / 2, 1.0]
    assert np.abs(middle).max() < 0.75 * grid.gsd_m, "at most half a pixel off, in each axis of the map"
    exact = files.patch((easting, northing), grid.weight.shape[::-1], grid.gsd_m, 0.0)
    corner = pack.T_map_pix[:, :2] * (grid.gsd_m / pack.gsd_m)
    assert np.isfinite(corner).all() and exact.valid.all()
    patch = pack.stored_patch((easting, northing), grid.weight.shape[::-1], grid.gsd_m, features.name, features.recipe)
    centre = patch.T_map_pix @ [(patch.valid.shape[1] - 1) / 2, (patch.valid.shape[0] - 1) / 2, 1.0]
    same = pack.patch((float(centre[0]), float(centre[1])), patch.valid.shape[::-1], patch.gsd_m, 0.0)
    assert np.abs(same.T_map_pix - patch.T_map_pix).max() < 1e-4
    inner = slice(20, -20), slice(20, -20)
    got, want = grid.features[inner], features(same.pixels, same.valid)[inner]
    assert np.corrcoef(got.ravel(), want.ravel())[0, 1] > 0.995


def test_gsds_are_the_stored_ones_and_stay_what_they_are(pack: PackMap) -> None:
    at = pack.center_map_m
    for asked in (0.5, 0.59, 0.84, 1.3):
        once = working_gsd_m(pack, at, asked, GRADIENT)
        assert working_gsd_m(pack, at, once, GRADIENT) == once
        assert abs(math.log2(once / asked)) < 0.26
    assert working_gsd_m(pack, at, 0.3, GRADIENT) == 0.3, "finer than what is stored"
    assert working_gsd_m(pack, at, 500.0, GRADIENT) == 500.0


@pytest.mark.parametrize("other", [replace(NETWORK, recipe="fake 2"), replace(NETWORK, name="fake-ba9876543210")])
def test_features_of_another_recipe_or_model_are_never_used(pack: PackMap, other: FakeNetwork) -> None:
    counting = Counting(other)
    grid = window(pack, 0.6, counting)
    assert counting.calls == 1 and grid.gsd_m == 0.6
    assert pack.why_not_stored(other.name, other.recipe)
    assert not pack.why_not_stored(NETWORK.name, NETWORK.recipe)
    assert window(pack, 0.6, NETWORK).gsd_m != 0.6


def test_maps_without_stored_features_compute_them(files: RasterMap) -> None:
    counting = Counting(GRADIENT)
    assert window(files, 0.8, counting).gsd_m == 0.8
    assert counting.calls == 1


def test_window_over_the_edge_of_the_content(pack: PackMap) -> None:
    grid = window(pack, 0.5, GRADIENT, middle=(0.0, -120.0))
    off = grid.weight == 0
    assert 0.5 < off.mean() < 0.9 and not grid.features[off & (np.abs(grid.features).sum(-1) == 0)].any()
    with pytest.raises(OutsideMap):
        window(pack, 0.5, GRADIENT, middle=(0.0, -900.0))


def test_a_part_of_a_window_lies_where_the_window_has_it(files: RasterMap) -> None:
    grid = window(files, 1.0, GRADIENT)
    part = part_of_box(grid, np.array([-20.0, -5.0]), np.array([15.0, 30.0]), 4)
    corner = part.A_ne_pix @ np.array([3.0, 2.0, 1.0])
    u, v = np.rint(np.linalg.solve(grid.A_ne_pix[:, :2], corner - grid.A_ne_pix[:, 2])).astype(int)
    assert np.array_equal(part.features[2:12, 3:13], grid.features[v : v + 10, u : u + 10])
    assert all(35 + 2 * 4 <= side <= 35 + 2 * 4 + 4 for side in part.weight.shape)
    assert part_of_box(grid, np.array([900.0, 900.0]), np.array([905.0, 905.0]), 4).weight.shape == (LEAST_PX, LEAST_PX)
