from pathlib import Path

import cv2
import numpy as np
import pytest
import rasterio
from rasterio.warp import Resampling, reproject

from visloc_companion.errors import MapError
from visloc_companion.localise.features.gradient import GRADIENT
from visloc_companion.maps.crs import map_crs
from visloc_companion.maps.manifest import Manifest, read_manifest
from visloc_companion.maps.pack import PackMap
from visloc_companion.prepare.add_features import add_features
from visloc_companion.prepare.build import build_pack
from visloc_companion.prepare.dates import bent_dates
from visloc_companion.prepare.features import GRADIENT as STORED
from visloc_companion.testing.fake_features import FakeNetwork

UTM, PLACE, SIDE = "EPSG:32633", (47.0, 15.3), 400
NETWORK = FakeNetwork()


def patches(seed: int) -> np.ndarray:
    """(SIDE, SIDE) fields of 60 and 190 grey levels with winding borders."""
    noise = np.random.default_rng(seed).standard_normal((SIDE, SIDE))
    return 60.0 + 130.0 * (cv2.GaussianBlur(noise, (0, 0), 6.0) > 0)


def season(seed: int, changed: float = 0.4, roll: tuple[int, int] = (0, 0)) -> np.ndarray:
    """Lasting edges under crops of a year of its own; `roll`: rows and columns by which it lies further south and east."""
    values = (1 - changed) * patches(0) + changed * patches(100 + seed)
    return np.roll(np.rint(values).astype(np.uint8), roll, axis=(0, 1))


@pytest.fixture
def folder(tmp_path: Path, write_raster) -> Path:
    write_raster(tmp_path / "a.tif", season(1), UTM, PLACE, 0.5)
    write_raster(tmp_path / "b.tif", season(2), UTM, PLACE, 0.5)
    write_raster(tmp_path / "c.tif", season(3), UTM, PLACE, 0.5)
    return tmp_path


def built(folder: Path, out: str, *others: str, **options: object) -> Manifest:
    return build_pack([folder / "a.tif"], None, folder / out, other_dates=[folder / name for name in others], **options)


def stored(folder: Path, level: int = 0) -> np.ndarray:
    """(rows, cols, channels) of a level of the gradient's features."""
    tiles = np.load(folder / f"{STORED.name}_{level:02d}.npy")
    rows, cols, high, wide, channels = tiles.shape
    return tiles.transpose(0, 2, 1, 3, 4).reshape(rows * high, cols * wide, channels)[:SIDE, :SIDE]


def test_features_are_the_mean_over_the_dates(folder: Path) -> None:
    manifest = built(folder, "pack", "b.tif", "c.tif")
    want = np.mean([GRADIENT(season(k), np.ones((SIDE, SIDE), np.bool_)) for k in (1, 2, 3)], axis=0)
    got = stored(folder / "pack") * manifest.features[0].step
    inner = slice(100, -100), slice(100, -100)
    assert float(np.abs(got - want)[inner].max()) < 0.6 * manifest.features[0].step
    assert {level.n_dates for level in manifest.features} == {3}
    assert [date.inputs[0].file for date in manifest.other_dates] == ["b.tif", "c.tif"]
    assert read_manifest(folder / "pack") == manifest
    with rasterio.open(folder / "pack" / "ortho.tif") as shown, rasterio.open(folder / "a.tif") as first:
        assert np.array_equal(shown.read(1)[:SIDE, :SIDE], first.read(1)), "the picture stays that of the first"


def test_what_changes_from_year_to_year_counts_less(folder: Path, write_raster) -> None:
    """East of the middle nothing but crops: their features shrink, those of lasting edges stay."""
    half = SIDE // 2
    for k, name in enumerate("abc"):
        pixels = season(k, 0.0)
        pixels[:, half:] = season(k, 1.0)[:, half:]
        write_raster(folder / f"{name}.tif", pixels, UTM, PLACE, 0.5)
    built(folder, "one")
    built(folder, "three", "b.tif", "c.tif")
    lasting, crops = (slice(20, -20), slice(20, half - 20)), (slice(20, -20), slice(half + 20, -20))
    length = {
        (pack, what): float(np.sqrt(np.mean(stored(folder / pack)[where].astype(np.float64) ** 2)))
        for pack in ("one", "three")
        for what, where in (("lasting", lasting), ("crops", crops))
    }
    assert length["three", "lasting"] == pytest.approx(length["one", "lasting"], rel=0.02)
    assert length["three", "crops"] == pytest.approx(length["one", "crops"] / np.sqrt(3), rel=0.1)


@pytest.mark.parametrize("roll", [(0, 0), (3, -5), (-12, 7), (44, -36)])
def test_a_date_that_lies_beside_the_first_is_moved_onto_it(folder: Path, write_raster, roll: tuple[int, int]) -> None:
    write_raster(folder / "b.tif", season(2, roll=roll), UTM, PLACE, 0.5)
    moved = built(folder, "pack", "b.tif").other_dates[0]
    assert moved.moved_north_m == pytest.approx(0.5 * roll[0], abs=0.06)
    assert moved.moved_east_m == pytest.approx(-0.5 * roll[1], abs=0.06)
    straight = built(folder, "straight", "c.tif")
    write_raster(folder / "b.tif", season(3, roll=roll), UTM, PLACE, 0.5)
    built(folder, "pack", "b.tif")
    apart = np.abs(stored(folder / "pack").astype(int) - stored(folder / "straight"))[40:-40, 40:-40]
    assert float(np.mean(apart)) < 3 and straight.features[0].n_dates == 2


def test_dates_in_colour_and_in_grey_go_together(folder: Path, write_raster) -> None:
    write_raster(folder / "b.tif", np.dstack([season(2)] * 3), UTM, PLACE, 0.5, photometric="RGB")
    more = season(1)[:, :200]
    write_raster(folder / "a.tif", more, UTM, PLACE, 0.5)
    orthos = [folder / "a.tif", folder / "b.tif"]
    manifest = build_pack(orthos, None, folder / "pack", other_dates=[folder / "c.tif", folder / "b.tif"])
    assert {level.n_dates for level in manifest.features} == {3}


def test_a_date_of_another_datum_is_refused(folder: Path, write_raster, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("visloc_companion.prepare.dates.MOST_MOVE_M", 20.0)
    write_raster(folder / "b.tif", season(2, roll=(44, -36)), UTM, PLACE, 0.5)
    with pytest.raises(MapError, match=r"b\.tif: lies 28 m beside .*a\.tif.*check its CRS"):
        built(folder, "pack", "b.tif")


def test_a_date_that_is_bent_against_the_first_is_told_of(folder: Path, write_raster) -> None:
    """North of the middle it lies 2 m west of where it lies south of it."""
    straight, moved = season(2), season(2, roll=(0, -4))
    write_raster(folder / "b.tif", np.vstack([moved[: SIDE // 2], straight[SIDE // 2 :]]), UTM, PLACE, 0.5)
    manifest = built(folder, "pack", "b.tif", "c.tif")
    bent, fitting = manifest.other_dates
    assert bent.parts_apart_m is not None and 0.6 < bent.parts_apart_m < 2.5
    assert fitting.parts_apart_m is not None and fitting.parts_apart_m < 0.2
    (said,) = bent_dates(manifest.other_dates, manifest.gsd_m)
    assert said.startswith("parts of b.tif lie ") and "leave it out of --other-dates" in said


def test_a_date_in_another_crs_is_laid_on_the_first(folder: Path) -> None:
    with rasterio.open(folder / "b.tif") as source:
        pixels, transform = source.read(1), source.transform
    other = np.zeros((600, 600), np.uint8)

    middle = map_crs("EPSG:32632").to_map(*PLACE)
    to = rasterio.Affine(0.5, 0.0, middle[0] - 150, 0.0, -0.5, middle[1] + 150)
    reproject(
        pixels, other, src_transform=transform, src_crs=UTM, dst_transform=to, dst_crs="EPSG:32632", resampling=Resampling.cubic
    )
    shape = {"width": 600, "height": 600, "count": 1, "dtype": "uint8", "nodata": 0}
    with rasterio.open(folder / "d.tif", "w", driver="GTiff", crs="EPSG:32632", transform=to, **shape) as out:
        out.write(other, 1)
    moved = built(folder, "pack", "d.tif").other_dates[0]
    assert abs(moved.moved_east_m) < 0.1 and abs(moved.moved_north_m) < 0.1


def test_where_a_date_shows_nothing_the_others_count_whole(folder: Path, write_raster) -> None:
    half = season(2)
    half[:, : SIDE // 2] = 0
    write_raster(folder / "b.tif", half, UTM, PLACE, 0.5, nodata=0)
    built(folder, "one")
    built(folder, "two", "b.tif")
    one, two = (stored(folder / pack) for pack in ("one", "two"))
    west, east = slice(0, SIDE // 2 - 4), slice(SIDE // 2 + 4, SIDE)
    assert np.array_equal(one[:, west], two[:, west])
    assert not np.array_equal(one[:, east], two[:, east])


def test_a_coarser_date_serves_the_levels_that_it_can(folder: Path, write_raster) -> None:
    coarse = season(2).reshape(SIDE // 4, 4, SIDE // 4, 4).mean((1, 3)).astype(np.uint8)
    write_raster(folder / "b.tif", coarse, UTM, PLACE, 2.0)
    manifest = built(folder, "pack", "b.tif")
    assert [level.n_dates for level in manifest.features if level.gsd_m < 1.6] == [1, 1, 1, 1]
    assert {level.n_dates for level in manifest.features if level.gsd_m > 1.9} == {2}


@pytest.mark.parametrize(
    ("pixels", "place"),
    [
        (np.random.default_rng(9).integers(1, 255, (SIDE, SIDE)), PLACE),
        (season(2), (47.1, 15.3)),
        (np.full((SIDE, SIDE), 90), PLACE),
    ],
)
def test_a_date_of_another_place_or_of_nothing_is_refused(folder: Path, write_raster, pixels: np.ndarray, place) -> None:
    write_raster(folder / "b.tif", pixels.astype(np.uint8), UTM, place, 0.5)
    with pytest.raises(MapError, match=r"b\.tif: nothing shows how it lies on .*a\.tif.*--other-dates"):
        built(folder, "pack", "b.tif")
    assert not (folder / "pack").exists()


def test_a_network_added_later_needs_the_same_dates(folder: Path) -> None:
    built(folder, "pack", "b.tif", "c.tif")
    for wrong in ([], ["b.tif"], ["c.tif", "b.tif"], ["b.tif", "a.tif"]):
        with pytest.raises(MapError, match=r"mean over other dates.*--other-dates b\.tif c\.tif"):
            add_features(folder / "pack", [NETWORK], other_dates=[folder / name for name in wrong])
    manifest = add_features(folder / "pack", [NETWORK], other_dates=[folder / "b.tif", folder / "c.tif"])
    assert {level.n_dates for level in manifest.features if level.name == NETWORK.name} == {3}
    at_once = built(folder, "whole", "b.tif", "c.tif", networks=[NETWORK])
    names = [level.file for level in at_once.features if level.name == NETWORK.name]
    assert names and all((folder / "pack" / name).read_bytes() == (folder / "whole" / name).read_bytes() for name in names)
    add_features(folder / "pack", [], replace=True)
    PackMap.open(folder / "pack")


def test_a_pack_of_one_date_takes_no_others_later(folder: Path) -> None:
    built(folder, "pack")
    with pytest.raises(MapError, match=r"built from one date.*build it again"):
        add_features(folder / "pack", [NETWORK], other_dates=[folder / "b.tif"])
