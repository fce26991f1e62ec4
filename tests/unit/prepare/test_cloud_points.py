from __future__ import annotations

import errno
import json
import os
import shutil
from pathlib import Path

import numpy as np
import pytest
import rasterio
from typer.testing import CliRunner

from visloc_companion.cli.map import map_app
from visloc_companion.errors import CloudError, ConfigError, DatumMissing, HashMismatch, MapError, OutsideMap
from visloc_companion.maps.crs import map_crs
from visloc_companion.maps.manifest import MANIFEST
from visloc_companion.maps.pack import PackMap
from visloc_companion.prepare import cloud_points
from visloc_companion.prepare.add_features import add_features
from visloc_companion.prepare.build import build_pack
from visloc_companion.prepare.check import check_pack
from visloc_companion.types import GeoPoint

laspy = pytest.importorskip("laspy")
PLACE = (47.0, 15.3)
SIZE = 200
MIDDLE = map_crs("EPSG:32633").to_map(*PLACE)


def ground(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Sloping ground with a house of 20 m x 20 m in the middle."""
    return 300 + 0.05 * x - 0.02 * y + np.where((np.abs(x) < 10) & (np.abs(y) < 10), 8.0, 0.0)


def write_las(path: Path, points: np.ndarray, crs: str | None) -> Path:
    from pyproj import CRS

    header = laspy.LasHeader(point_format=6, version="1.4")
    header.offsets, header.scales = np.floor(points.min(axis=0)), np.array([0.001] * 3)
    if crs is not None:
        if CRS.from_user_input(crs).is_geographic:
            header.scales = np.array([1e-9, 1e-9, 0.001])
        header.add_crs(CRS.from_user_input(crs))
    las = laspy.LasData(header)
    las.x, las.y, las.z = points.T
    las.write(path)
    return path


def scene(middle: tuple[float, float], density: float = 5.0, half: float = 90.0, seed: int = 2) -> np.ndarray:
    xy = np.random.default_rng(seed).uniform(-half, half, (int(density * 4 * half * half), 2))
    return np.column_stack([xy + middle, ground(*xy.T)])


def write_tif(path: Path, values: np.ndarray) -> Path:
    place = rasterio.Affine(1.0, 0.0, MIDDLE[0] - SIZE / 2, 0.0, -1.0, MIDDLE[1] + SIZE / 2)
    shape = {"width": SIZE, "height": SIZE, "count": 1, "dtype": values.dtype}
    with rasterio.open(path, "w", driver="GTiff", crs="EPSG:32633", transform=place, **shape) as out:
        out.write(values, 1)
    return path


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """a.tif, 200 m x 200 m in UTM 33N, away from its meridian, a cloud over it, and the pack of both: for reading only."""
    folder = tmp_path_factory.mktemp("cloud")
    write_tif(folder / "a.tif", np.random.default_rng(1).integers(1, 255, (SIZE, SIZE)).astype(np.uint8))
    las = write_las(folder / "c.laz", scene(MIDDLE), "EPSG:32633")
    build_pack([folder / "a.tif"], None, folder / "pack", clouds=[las])
    return folder


@pytest.fixture
def ortho(built: Path) -> tuple[Path, tuple[float, float]]:
    """The orthophoto, and easting and northing of its middle."""
    return built / "a.tif", MIDDLE


@pytest.fixture
def pack(built: Path, tmp_path: Path) -> PackMap:
    """A copy, to be damaged."""
    shutil.copytree(built / "pack", tmp_path / "pack")
    return PackMap.open(tmp_path / "pack")


def test_points_are_metres_east_and_north_of_the_place(pack: PackMap) -> None:
    """The place is the house's corner; true north is taken, 0.2 degrees from grid north here."""
    easting, northing = pack.to_map(*PLACE)
    corner = (easting + 10.0, northing + 10.0)
    points = pack.cloud_around(corner, 40.0)
    assert np.hypot(points[:, 0], points[:, 1]).max() <= 40.0
    assert len(points) == pytest.approx(np.pi * 40**2 * 16 * (1 - np.exp(-5 / 16)), rel=0.05), (
        "one of each cell of 0.25 m that has any"
    )
    J = pack.projection_at(GeoPoint(*pack.to_geo(*corner), 0.0)).J_map_ne
    back = points[:, 1::-1] @ J.T + [10.0, 10.0]
    edge = (np.abs(np.abs(back) - 10.0) < 0.05).any(axis=1)
    np.testing.assert_allclose(points[~edge, 2], ground(*back[~edge].T), atol=0.012)


@pytest.mark.parametrize(
    ("raised_m", "scale", "above_m"),
    [(0.0, 1.0, 0.0), (-3.0, 1.0, 3.0), (48.0, 1.0, -48.0), (-12.0, 1.0, 12.0), (0.0, 1 / 0.3048, -684)],
)
def test_a_cloud_and_a_surface_model_that_do_not_fit_are_told(
    tmp_path: Path, ortho, built: Path, raised_m: float, scale: float, above_m: float
) -> None:
    """Ellipsoidal heights, the bare ground below woods, and feet on a grid in metres: nothing else would tell."""
    y, x = np.mgrid[SIZE / 2 - 0.5 : -SIZE / 2 : -1, -SIZE / 2 + 0.5 : SIZE / 2 : 1]
    dsm = write_tif(tmp_path / "dsm.tif", ((ground(x, y) + raised_m) * scale).astype(np.float32))
    build_pack([ortho[0]], dsm, tmp_path / "pack", clouds=[built / "c.laz"])
    result = check_pack(PackMap.open(tmp_path / "pack"), None)
    assert result["cloud_above_surface_m"] == pytest.approx(above_m, abs=1.0)
    assert any("the surface model: another vertical datum" in warning for warning in result["warnings"]) == (abs(above_m) > 5)
    low, median, high = (result["surface"][key] for key in ("low_m", "median_m", "high_m"))
    assert (low, median, high) == pytest.approx(np.percentile((ground(x, y) + raised_m) * scale, [1, 50, 99]), abs=0.5 * scale)
    said = CliRunner().invoke(map_app, ["info", str(tmp_path / "pack")]).output
    assert f"heights          {low:.0f} to {high:.0f} m above sea level, made from amsl heights\n" in said


def test_one_cloud_of_several_that_does_not_fit_is_told(tmp_path: Path, ortho, built: Path) -> None:
    """In the median over all of them nothing is seen; without a surface model the map has a step where they meet."""
    points = scene(MIDDLE)
    east = points[:, 0] > MIDDLE[0] + 30.0
    y, x = np.mgrid[SIZE / 2 - 0.5 : -SIZE / 2 : -1, -SIZE / 2 + 0.5 : SIZE / 2 : 1]
    dsm = write_tif(tmp_path / "dsm.tif", ground(x, y).astype(np.float32))
    west = write_las(tmp_path / "west.laz", points[~east], "EPSG:32633")
    for raised_m in (0.0, 48.0):
        other = write_las(tmp_path / "east.laz", points[east] + [0.0, 0.0, raised_m], "EPSG:32633")
        build_pack([ortho[0]], dsm, tmp_path / "pack", clouds=[west, other])
        result = check_pack(PackMap.open(tmp_path / "pack"), None)
        assert abs(result["cloud_above_surface_m"]) < 1
        parts = [said for said in result["warnings"] if said.startswith("the cloud lies 48.0 m above the surface model on 3")]
        said: list[str] = []
        build_pack([ortho[0]], None, tmp_path / "pack", clouds=[west, other], warn=said.append)
        steps = [words.split(",")[0] for words in said]
        if raised_m:
            assert len(parts) == 1, result["warnings"]
            assert steps == [f"{other} lies 48.0 m above the clouds before it"]
        else:
            assert not said and not any("the cloud lies" in words for words in result["warnings"])


def test_points_that_lie_alone_make_no_surface(tmp_path: Path, ortho, built: Path) -> None:
    """A bird that no class marks was a needle of 120 m in the map's heights, though not among its points."""
    bird = np.array([[MIDDLE[0] + 40.0, MIDDLE[1] + 40.0, 420.0], [MIDDLE[0] + 40.1, MIDDLE[1] + 40.0, 420.1]])
    path = write_las(tmp_path / "bird.laz", np.vstack([scene(MIDDLE), bird]), "EPSG:32633")
    build_pack([ortho[0]], None, tmp_path / "pack", clouds=[path])
    with rasterio.open(tmp_path / "pack" / "dsm.tif") as dsm:
        heights = dsm.read(1)
        x, y = dsm.xy(*np.nonzero(np.isfinite(heights)))
    off = heights[np.isfinite(heights)] - ground(np.array(x) - MIDDLE[0], np.array(y) - MIDDLE[1])
    assert np.abs(off).max() < 8.2


def test_a_disk_that_fills_up_is_told_before_points_are_folded(
    tmp_path: Path, ortho, built: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(descriptor: int, offset: int, length: int) -> None:
        if Path(f"/proc/self/fd/{descriptor}").readlink().name == cloud_points.SCRATCH:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(os, "posix_fallocate", full)
    with pytest.raises(MapError, match=r"cannot be written: No space left on device .*; remedy: check the disk"):
        build_pack([ortho[0]], None, tmp_path / "pack", clouds=[built / "c.laz"])


def test_the_highest_point_of_a_cell_is_kept_and_wild_ones_are_not(tmp_path: Path, ortho) -> None:
    image, middle = ortho
    points = scene(middle)
    below = points[::2] - np.array([0.0, 0.0, 3.0])
    inner = points[np.hypot(*(points[:, :2] - middle).T) < 80]
    wild = np.array([inner[0] + [0, 0, 90.0], inner[1] - [0, 0, 150.0]])
    files = [write_las(tmp_path / f"{k}.laz", part, "EPSG:32633") for k, part in enumerate((below, points, wild))]
    build_pack([image], None, tmp_path / "pack", clouds=files)
    folders = (tmp_path / "pack", image.parent / "pack")
    both, one = ({tuple(point) for point in PackMap.open(folder).cloud_around(middle, 90.0)} for folder in folders)
    assert both < one and len(one - both) == 1, "but for the cell that the wild point had taken"


def test_clouds_of_another_crs_and_feet_come_to_the_same_place(tmp_path: Path, ortho) -> None:
    """The next UTM zone, heights in feet."""
    image, middle = ortho
    points = scene(middle, 2.0)
    utm32 = points.copy()
    utm32[:, :2] = map_crs("EPSG:32632").to_map_array(map_crs("EPSG:32633").to_geo_array(points[:, :2]))
    feet = utm32 / [1, 1, 0.3048006096012192]
    build_pack([image], None, tmp_path / "pack", clouds=[write_las(tmp_path / "c.laz", feet, "EPSG:32632+6360")])
    found = PackMap.open(tmp_path / "pack").cloud_around(middle, 60.0)
    assert found[:, 2].min() > 290 and found[:, 2].max() == pytest.approx(308, abs=1.0)


def test_a_crs_that_no_cloud_takes_is_not_passed_over(tmp_path: Path, ortho) -> None:
    """`--cloud-crs` is that of clouds that state none; given over a wrong one, it was ignored without a word."""
    image, middle = ortho
    las = write_las(tmp_path / "c.laz", scene(middle, 2.0), "EPSG:32633")
    with pytest.raises(
        DatumMissing, match=r"c\.laz: states WGS 84 / UTM zone 33N, .*--cloud-crs \(ETRS89 / UTM zone 32N\).*remedy"
    ):
        build_pack([image], None, tmp_path / "pack", clouds=[las], cloud_crs="EPSG:25832")
    with pytest.raises(MapError, match=r"--cloud-crs: is not a coordinate reference system: 'UTM 33'"):
        build_pack([image], None, tmp_path / "pack", clouds=[las], cloud_crs="UTM 33")
    with pytest.raises(ConfigError, match=r"--cloud-crs: is given without --cloud; remedy"):
        build_pack([image], None, tmp_path / "pack", cloud_crs="EPSG:32633")
    build_pack([image], None, tmp_path / "pack", clouds=[las], cloud_crs="EPSG:32633")


def test_clouds_that_state_another_crs_keep_it_beside_one_that_states_none(tmp_path: Path, ortho) -> None:
    image, middle = ortho
    points = scene(middle, 2.0)
    utm32 = points.copy()
    utm32[:, :2] = map_crs("EPSG:32632").to_map_array(map_crs("EPSG:32633").to_geo_array(points[:, :2]))
    stated, silent = write_las(tmp_path / "a.laz", utm32, "EPSG:32632"), write_las(tmp_path / "b.laz", points, None)
    manifest = build_pack([image], None, tmp_path / "pack", clouds=[stated, silent], cloud_crs="EPSG:32633")
    assert manifest.cloud is not None and manifest.cloud.share_covered > 0.7
    found = PackMap.open(tmp_path / "pack").cloud_around(middle, 60.0)
    assert found[:, 2].min() > 290 and found[:, 2].max() == pytest.approx(308, abs=1.0)


def test_ellipsoidal_heights_lose_the_undulation(tmp_path: Path, ortho) -> None:
    image, middle = ortho
    las = write_las(tmp_path / "c.laz", scene(middle, 2.0), "EPSG:32633")
    with pytest.raises(DatumMissing, match=r"c\.laz.*--geoid-undulation-m"):
        build_pack([image], None, tmp_path / "pack", clouds=[las], vertical_datum="ellipsoidal")
    manifest = build_pack([image], None, tmp_path / "pack", clouds=[las], vertical_datum="ellipsoidal", geoid_undulation_m=45.0)
    assert manifest.cloud is not None and manifest.cloud.geoid_undulation_m == 45.0
    found = PackMap.open(tmp_path / "pack").cloud_around(middle, 5.0)
    assert np.median(found[:, 2]) == pytest.approx(308 - 45, abs=0.3)


def test_a_surface_model_answers_the_same_call(tmp_path: Path, ortho) -> None:
    image, middle = ortho
    x, y = np.meshgrid(np.arange(SIZE) - SIZE / 2 + 0.5, SIZE / 2 - np.arange(SIZE) - 0.5)
    write_tif(tmp_path / "dsm.tif", ground(x, y).astype(np.float32))
    build_pack([image], tmp_path / "dsm.tif", tmp_path / "pack")
    pack = PackMap.open(tmp_path / "pack")
    points = pack.cloud_around(middle, 30.0)
    assert len(points) == pytest.approx(np.pi * 30**2, rel=0.02)
    J = pack.projection_at(GeoPoint(*PLACE, 0.0)).J_map_ne
    np.testing.assert_allclose(points[:, 2], ground(*(points[:, 1::-1] @ J.T).T), atol=1e-3)
    assert len(pack.cloud_around(middle, 30.0, max_points=200)) == pytest.approx(200, rel=0.15)
    build_pack([image], None, tmp_path / "flat")
    with pytest.raises(MapError, match=r"its ground is a plane.*--dsm or --cloud"):
        PackMap.open(tmp_path / "flat").cloud_around(middle, 30.0)


def test_both_a_surface_model_and_clouds(tmp_path: Path, ortho) -> None:
    """The points come from the cloud where it has any, else from the surface model, which is 100 m higher here."""
    image, middle = ortho
    write_tif(tmp_path / "dsm.tif", np.full((SIZE, SIZE), 400, np.float32))
    half = write_las(tmp_path / "c.las", scene((middle[0] - 60, middle[1]), half=30.0), "EPSG:32633")
    manifest = build_pack([image], tmp_path / "dsm.tif", tmp_path / "pack", clouds=[half])
    assert [entry.file for entry in manifest.inputs] == ["a.tif", "dsm.tif", "c.las"]
    pack = PackMap.open(tmp_path / "pack")
    assert pack.height_amsl_m(*middle) == 400.0
    assert pack.cloud_around((middle[0] - 60, middle[1]), 20.0)[:, 2].max() < 320
    assert np.allclose(pack.cloud_around((middle[0] + 60, middle[1]), 20.0)[:, 2], 400.0)


def test_large_circles_are_thinned_evenly(pack: PackMap) -> None:
    middle = pack.center_map_m
    every, few = pack.cloud_around(middle, 80.0), pack.cloud_around(middle, 80.0, max_points=3000)
    assert 0.3 * 3000 < len(few) <= 3000
    kept = {tuple(point) for point in np.round(every, 6)}
    assert all(tuple(point) in kept for point in np.round(few, 6))
    quarters = [np.count_nonzero((few[:, 0] > 0) == a) for a in (True, False)]
    assert min(quarters) > 0.9 * max(quarters)


def test_places_and_circles_that_are_none(pack: PackMap) -> None:
    easting, northing = pack.center_map_m
    with pytest.raises(OutsideMap):
        pack.cloud_around((easting + 5000, northing), 50.0)
    for radius, most in ((0.0, 10), (float("nan"), 10), (float("inf"), 10), (5.0, 0)):
        with pytest.raises(MapError, match="no circle"):
            pack.cloud_around((easting, northing), radius, most)


def test_clouds_off_the_orthophoto_are_named(tmp_path: Path, ortho) -> None:
    image, (easting, northing) = ortho
    write_tif(tmp_path / "dsm.tif", np.full((SIZE, SIZE), 400, np.float32))
    away = write_las(tmp_path / "away.laz", scene((easting + 900, northing), 1.0), "EPSG:32633")
    for dsm, what in ((None, "does not overlap"), (tmp_path / "dsm.tif", "no point on the orthophoto")):
        with pytest.raises(MapError, match=rf"away\.laz: .*{what}.*remedy"):
            build_pack([image], dsm, tmp_path / "pack", clouds=[away])
    assert not (tmp_path / ".pack.building").exists()


def test_a_build_that_was_broken_off_ends_in_the_same_bytes(tmp_path: Path, ortho, monkeypatch: pytest.MonkeyPatch) -> None:
    image, middle = ortho
    files = [write_las(tmp_path / f"{k}.laz", scene(middle, 1.0, seed=k), "EPSG:32633") for k in range(3)]
    build_pack([image], None, tmp_path / "whole", clouds=files)
    fold, calls = cloud_points._fold, 0

    def interrupted(*args):
        nonlocal calls
        calls += 1
        done = fold(*args)
        if calls == 2:
            raise KeyboardInterrupt
        return done

    monkeypatch.setattr(cloud_points, "_fold", interrupted)
    with pytest.raises(KeyboardInterrupt):
        build_pack([image], None, tmp_path / "pack", clouds=files, name="whole")
    assert (tmp_path / ".pack.building" / cloud_points.SCRATCH).exists()
    build_pack([image], None, tmp_path / "pack", clouds=files, name="whole")
    names = sorted(path.name for path in (tmp_path / "whole").iterdir())
    assert names == sorted(path.name for path in (tmp_path / "pack").iterdir()) and cloud_points.SCRATCH not in names
    for name in ("cloud.npy", "cloud_tiles.npy", "dsm.tif", MANIFEST):
        assert (tmp_path / "whole" / name).read_bytes() == (tmp_path / "pack" / name).read_bytes()


def test_damaged_tiles_are_named(tmp_path: Path, pack: PackMap) -> None:
    for name in ("cloud.npy", "cloud_tiles.npy"):
        path = tmp_path / "pack" / name
        raw = path.read_bytes()
        flipped = bytearray(raw)
        flipped[len(raw) * 2 // 3] ^= 1
        path.write_bytes(flipped)
        with pytest.raises(HashMismatch, match=rf"{name}.*SHA-256.*remedy"):
            PackMap.open(tmp_path / "pack")
        path.write_bytes(raw[:-6])
        with pytest.raises(HashMismatch, match=rf"{name}: has \d+ bytes"):
            PackMap.open(tmp_path / "pack", verify_hashes=False)
        path.write_bytes(b"\x00" * 64 + raw[64:])
        with pytest.raises(MapError, match=rf"{name}: is not the array of .*int.* that the manifest says"):
            PackMap.open(tmp_path / "pack", verify_hashes=False)
        path.unlink()
        with pytest.raises(MapError, match=rf"{name}: the pack lacks this file"):
            PackMap.open(tmp_path / "pack")
        path.write_bytes(raw)


def test_tiles_that_do_not_divide_the_points(tmp_path: Path, pack: PackMap) -> None:
    path = tmp_path / "pack" / "cloud_tiles.npy"
    raw = path.read_bytes()
    for at, value in ((len(raw) - 16, 0), (128, 5), (128 + 16, 10**12)):
        path.write_bytes(raw[:at] + np.int64(value).tobytes() + raw[at + 8 :])
        with pytest.raises(MapError, match=r"cloud_tiles\.npy: does not divide the points"):
            PackMap.open(tmp_path / "pack", verify_hashes=False)


def test_added_features_leave_the_cloud(tmp_path: Path, pack: PackMap) -> None:
    before = pack.cloud_around(pack.center_map_m, 30.0)
    add_features(tmp_path / "pack", ())
    np.testing.assert_array_equal(PackMap.open(tmp_path / "pack").cloud_around(pack.center_map_m, 30.0), before)


def test_info_and_check_tell_of_the_cloud(tmp_path: Path, pack: PackMap) -> None:
    assert pack.manifest.cloud is not None
    told = CliRunner().invoke(map_app, ["info", str(tmp_path / "pack"), "--json", str(tmp_path / "i.json")])
    count, share = pack.manifest.cloud.n_points, pack.manifest.cloud.share_covered
    assert 0.8 < share < 0.86
    assert f"{count} points, {count / (SIZE**2 * share):.3g} a square" in told.output and "% of the map" in told.output
    assert json.loads((tmp_path / "i.json").read_text())["cloud"]["points"] == count
    checked = CliRunner().invoke(map_app, ["check", str(tmp_path / "pack"), "--model", "none"])
    assert checked.exit_code == 0 and "of the map has no point of the cloud" in checked.output


def test_noise_alone_is_no_cloud(tmp_path: Path, ortho) -> None:
    image, middle = ortho
    write_tif(tmp_path / "dsm.tif", np.full((SIZE, SIZE), 400, np.float32))
    las = laspy.read(write_las(tmp_path / "c.laz", scene(middle, 1.0), "EPSG:32633"))
    las.classification = np.full(len(las.x), 7, np.uint8)
    las.write(tmp_path / "noise.laz")
    with pytest.raises(CloudError, match=r"noise\.laz: has no point on the orthophoto"):
        build_pack([image], tmp_path / "dsm.tif", tmp_path / "pack", clouds=[tmp_path / "noise.laz"])
