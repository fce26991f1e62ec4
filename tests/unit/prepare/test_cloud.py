import struct
from pathlib import Path

import numpy as np
import pytest

from visloc_companion.errors import CloudError, DatumMissing, MapError
from visloc_companion.maps.crs import map_crs
from visloc_companion.maps.pack import PackMap
from visloc_companion.prepare.build import build_pack
from visloc_companion.prepare.cloud import cloud_surface

laspy = pytest.importorskip("laspy")
PLACE = (47.0, 15.3)


def write_cloud(path: Path, points: np.ndarray, crs: str | None, classes: np.ndarray | None = None) -> None:
    header = laspy.LasHeader(point_format=6, version="1.4")
    header.offsets, header.scales = np.floor(points.min(axis=0)), np.array([0.001] * 3)
    if crs is not None:
        from pyproj import CRS

        header.add_crs(CRS.from_user_input(crs))
    las = laspy.LasData(header)
    las.x, las.y, las.z = points.T
    las.classification = np.full(len(points), 2, np.uint8) if classes is None else classes
    las.write(path)


def scene(middle: tuple[float, float], n: int = 40_000) -> np.ndarray:
    """Ground at 300 m with a house of 20 m x 20 m and 10 m, over 100 m x 100 m."""
    xy = np.random.default_rng(2).uniform(-50, 50, (n, 2))
    z = np.where((np.abs(xy) < 10).all(axis=1), 310.0, 300.0)
    return np.column_stack([xy + middle, z])


def test_upper_surface_in_the_pack(tmp_path: Path, write_raster) -> None:
    T = write_raster(
        tmp_path / "a.tif", np.random.default_rng(1).integers(0, 255, (120, 120)).astype(np.uint8), "EPSG:32633", PLACE, 0.5
    )
    middle = T @ [59.5, 59.5, 1.0]
    points = scene((middle[0], middle[1]))
    noise = points[:50] + np.array([0, 0, 500.0])
    classes = np.concatenate([np.full(len(points), 2), np.full(50, 18)]).astype(np.uint8)
    write_cloud(tmp_path / "c.laz", np.concatenate([points, noise]), "EPSG:32633", classes)
    manifest = build_pack([tmp_path / "a.tif"], None, tmp_path / "pack", clouds=[tmp_path / "c.laz"])
    assert manifest.heights.share_known > 0.99
    assert [entry.file for entry in manifest.inputs] == ["a.tif", "c.laz"]
    pack = PackMap.open(tmp_path / "pack")
    easting, northing = middle
    assert pack.height_amsl_m(easting, northing) == pytest.approx(310.0, abs=0.01)
    assert pack.height_amsl_m(easting + 20, northing - 15) == pytest.approx(300.0, abs=0.01)
    assert pack.height_amsl_m(easting + 8.5, northing) == pytest.approx(310.0, abs=0.01)
    assert pack.height_amsl_m(easting + 12.0, northing) == pytest.approx(300.0, abs=0.01)


def test_a_cloud_of_another_crs_makes_as_good_a_surface(tmp_path: Path, write_raster) -> None:
    """One cell in twenty holds no point, by chance; resampled, each cost all about it: a third of the heights was filled in."""
    grey = np.random.default_rng(1).integers(0, 255, (100, 100)).astype(np.uint8)
    T = write_raster(tmp_path / "a.tif", grey, "EPSG:32633", PLACE, 1.0)
    middle = T @ [49.5, 49.5, 1.0]
    xy = np.random.default_rng(2).uniform(-60, 60, (40_000, 2)) + middle
    points = np.column_stack([xy, 300.0 + 0.5 * (xy[:, 0] - middle[0])])
    here, there = map_crs("EPSG:32633"), map_crs("EPSG:31256")
    write_cloud(tmp_path / "own.laz", points, "EPSG:32633")
    write_cloud(tmp_path / "other.laz", np.column_stack([there.to_map_array(here.to_geo_array(xy)), points[:, 2]]), "EPSG:31256")
    off = {}
    for name in ("own", "other"):
        build_pack([tmp_path / "a.tif"], None, tmp_path / name, clouds=[tmp_path / f"{name}.laz"])
        pack = PackMap.open(tmp_path / name)
        places = np.random.default_rng(3).uniform(-45, 45, (2000, 2)) + middle
        off[name] = pack.heights_amsl_m(places) - (300.0 + 0.5 * (places[:, 0] - middle[0]))
        assert pack.manifest.heights.share_filled < 0.01
    assert off["other"].std() < 1.1 * off["own"].std()
    assert off["other"].mean() == pytest.approx(off["own"].mean(), abs=0.02)


def test_crs_is_stated_or_given(tmp_path: Path) -> None:
    write_cloud(tmp_path / "c.las", scene((5e5, 5.2e6), 3000), None)
    with pytest.raises(DatumMissing, match=r"c\.las.*--cloud-crs"):
        cloud_surface(tmp_path / "c.las")
    surface = cloud_surface(tmp_path / "c.las", "EPSG:32633")
    assert surface.crs.epsg == 32633
    assert surface.gsd_m == pytest.approx(10**0.5, rel=0.01), "three points a cell at 0.3 a square metre"


@pytest.mark.parametrize("crs", ["EPSG:2227+6360", "EPSG:2227"])
def test_feet_become_metres(tmp_path: Path, crs: str) -> None:
    write_cloud(tmp_path / "c.las", scene((6e6, 2e6), 3000), crs)
    values, valid = cloud_surface(tmp_path / "c.las").layer.read(0, (10, 11), (10, 11))
    assert valid.all()
    assert values[0, 0] == pytest.approx(300 * 0.3048006, abs=0.01)


def test_unusable_clouds_are_named(tmp_path: Path) -> None:
    write_cloud(tmp_path / "good.laz", scene((5e5, 5.2e6), 3000), "EPSG:32633")
    whole = (tmp_path / "good.laz").read_bytes()
    (tmp_path / "cut.laz").write_bytes(whole[: len(whole) // 2])
    (tmp_path / "head.laz").write_bytes(whole[:100])
    (tmp_path / "noise.laz").write_bytes(b"points" * 500)
    write_cloud(tmp_path / "degrees.las", np.array([[15.0, 47.0, 300.0], [15.1, 47.1, 300.0]]), "EPSG:4326")
    write_cloud(tmp_path / "bad.las", scene((5e5, 5.2e6), 50), "EPSG:32633", np.full(50, 7, np.uint8))
    for name in ("cut.laz", "head.laz", "noise.laz", "absent.laz", "degrees.las", "bad.las"):
        with pytest.raises(MapError, match=rf"{name}.*remedy"):
            cloud_surface(tmp_path / name)


def test_points_outside_of_the_headers_bounds_are_not_piled_up_at_its_edge(tmp_path: Path) -> None:
    write_cloud(tmp_path / "c.las", scene((5e5, 5.2e6)), "EPSG:32633")
    raw = bytearray((tmp_path / "c.las").read_bytes())
    struct.pack_into("<2d", raw, 179, 500_020.0, 499_980.0)  # largest and smallest x
    (tmp_path / "c.las").write_bytes(raw)
    with pytest.raises(CloudError, match=r"c\.las: header: its bounds do not hold all points.*remedy"):
        cloud_surface(tmp_path / "c.las")


def test_heights_that_no_land_has_do_not_count(tmp_path: Path, write_raster) -> None:
    T = write_raster(tmp_path / "a.tif", np.full((160, 160), 90, np.uint8), "EPSG:32633", PLACE, 0.5)
    points = scene((T @ [79.5, 79.5, 1.0])[:2])
    high = points[::50] + np.array([0.0, 0.0, 29_000.0])
    write_cloud(tmp_path / "c.las", np.concatenate([points, high]), "EPSG:32633")
    build_pack([tmp_path / "a.tif"], None, tmp_path / "pack", clouds=[tmp_path / "c.las"])
    pack = PackMap.open(tmp_path / "pack")
    heights = pack.patch(pack.center_map_m, (120, 120), 0.5, 0.0).dsm_amsl_m
    assert np.isfinite(heights).all() and heights.max() <= 310.01
    assert pack.cloud_around(pack.center_map_m, 40.0)[:, 2].max() <= 310.01
    write_cloud(tmp_path / "c.las", points - np.array([0.0, 0.0, 9999.0]), "EPSG:32633")
    with pytest.raises(CloudError, match=r"c\.las: holds no point that is a surface"):
        build_pack([tmp_path / "a.tif"], None, tmp_path / "pack", clouds=[tmp_path / "c.las"])


@pytest.mark.shared
def test_real_cloud(shared_data: Path) -> None:
    surface = cloud_surface(shared_data / "clouds" / "suburb_fusa.laz")
    rows, cols = surface.layer.shapes[0]
    values, valid = surface.layer.read(0, (0, rows), (0, cols))
    assert surface.crs.epsg == 32754
    assert valid.mean() > 255 * 0.8
    assert 2 < np.ptp(np.percentile(values[valid > 0], [2, 98])) < 60
