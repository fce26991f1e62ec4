"""Surface models and orthophotos that go all around the earth, for a place at their seam."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pyproj
import pytest
import rasterio
from rasterio import Affine
from rasterio.warp import Resampling, reproject
from rasterio.windows import Window

from visloc_companion.errors import MapError
from visloc_companion.maps.crs import map_crs
from visloc_companion.maps.layer import ArrayLayer, array_layer
from visloc_companion.maps.raster import RasterMap
from visloc_companion.maps.seamless import RolledLayer, seam_away
from visloc_companion.prepare.build import build_pack

UTM, SIDE, NORTH = "EPSG:32760", 200, -16.799


def heights(lat_deg: np.ndarray, lon_deg: np.ndarray) -> np.ndarray:
    east_deg = (lon_deg + 360) % 360 - 180
    return np.asarray(400 + 2_000 * east_deg - 1_000 * (lat_deg - NORTH))


def ortho(folder: Path) -> Path:
    easting, northing = pyproj.Transformer.from_crs(4326, UTM, always_xy=True).transform(180.0, -16.8)
    pixels = np.random.default_rng(1).integers(1, 255, (SIDE, SIDE), dtype=np.uint8)
    place = Affine(0.5, 0, easting - SIDE / 4, 0, -0.5, northing + SIDE / 4)
    with rasterio.open(
        folder / "a.tif", "w", "GTiff", width=SIDE, height=SIDE, count=1, dtype="uint8", crs=UTM, transform=place
    ) as out:
        out.write(pixels, 1)
    return folder / "a.tif"


@pytest.mark.parametrize(
    ("cols", "repeats", "first_deg"), [(36_000, 0, -180.0), (36_000, 1, -180.0), (360_000, 0, -180.0), (36_000, 0, 0.0)]
)
def test_heights_on_both_sides_of_the_seam_are_used(tmp_path: Path, cols: int, repeats: int, first_deg: float) -> None:
    """As gdalbuildvrt puts tiles on both sides of the antimeridian together. Between its ends heights were made up, and of more
    than 32767 columns nothing could be made."""
    step = 360 / cols
    lon = first_deg + (np.arange(cols + repeats) + 0.5) * step
    lat = NORTH + 2 * step - (np.arange(12) + 0.5) * step
    values = heights(lat[:, None], lon[None]).astype(np.float32)
    near = np.abs((lon + 360) % 360 - 180) < 0.1
    values[:, ~near] = np.nan
    size = {"width": len(lon), "height": len(lat), "count": 1, "dtype": "float32", "nodata": np.nan}
    place = Affine(step, 0, first_deg, 0, -step, NORTH + 2 * step)
    with rasterio.open(tmp_path / "dsm.tif", "w", "GTiff", crs="EPSG:4326", transform=place, tiled=True, **size) as out:
        out.write(values, 1)
    files = RasterMap.open(ortho(tmp_path), tmp_path / "dsm.tif")
    patch = files.patch(files.center_map_m, (60, 60), 0.5, 0.0)
    assert patch.valid.all()
    assert patch.dsm_amsl_m[29:31, 29:31] == pytest.approx(400, abs=1.5)  # on the antimeridian
    manifest = build_pack([tmp_path / "a.tif"], tmp_path / "dsm.tif", tmp_path / "pack")
    assert manifest.heights.share_known == 1.0
    assert manifest.heights.share_filled == 0.0
    with rasterio.open(tmp_path / "pack" / "dsm.tif") as made:
        found, at = made.read(1), made.transform
    easting, northing = np.meshgrid(
        at.c + at.a * (np.arange(found.shape[1]) + 0.5), at.f + at.e * (np.arange(found.shape[0]) + 0.5)
    )
    lon_deg, lat_deg = pyproj.Transformer.from_crs(UTM, 4326, always_xy=True).transform(easting.ravel(), northing.ravel())
    assert np.abs(found.ravel() - heights(np.array(lat_deg), np.array(lon_deg))).max() < 0.1  # of 20 m a pixel of 0.01 degrees


def test_only_what_goes_all_around_is_opened_elsewhere() -> None:
    degrees = map_crs("EPSG:4326")
    values = np.tile(np.arange(360, dtype=np.float32), (40, 1))

    def layer(west_deg: float, cols: int, step: float = 1.0) -> ArrayLayer:
        T = np.array([[step, 0.0, west_deg + step / 2], [0.0, -step, 19.5]])
        return array_layer(T, values[:, :cols], np.ones((40, cols), np.bool_))

    whole = layer(-180.0, 360)
    rolled = seam_away(whole, degrees, (0.0, 179.9))
    assert isinstance(rolled, RolledLayer)
    assert seam_away(whole, degrees, (0.0, 20.0)) is whole
    for other in (layer(-180.0, 180), layer(100.0, 160), layer(-180.0, 360, 0.999)):
        assert seam_away(other, degrees, (0.0, 179.9)) is other
    assert seam_away(whole, map_crs("EPSG:32633"), (0.0, 15.0)) is whole
    assert rolled.shapes == ((40, 360),)
    assert rolled.T_map_pix[0].tolist() == [1.0, 0.0, 0.5]
    got, valid = rolled.read(0, (3, 5), (170, 190))
    assert got[0].tolist() == [*range(350, 360), *range(10)]
    assert valid.shape == (2, 20)
    for cols, first in (((0, 4), 180), ((200, 204), 20), ((176, 180), 356), ((180, 184), 0)):
        assert rolled.read(0, (0, 1), cols)[0][0].tolist() == list(range(first, first + 4))


def globe(folder: Path, name: str, values: np.ndarray, first_deg: float, crs: str = "EPSG:4326") -> Path:
    """A raster of whole columns all around the earth, from a longitude on; its rows about NORTH."""
    step = 360 / values.shape[1]
    size = {"width": values.shape[1], "height": values.shape[0], "count": 1, "dtype": values.dtype.name}
    place = Affine(step, 0, first_deg, 0, -step, NORTH + values.shape[0] / 2 * step)
    with rasterio.open(folder / name, "w", "GTiff", crs=crs, transform=place, tiled=True, **size) as out:
        out.write(values, 1)
    return folder / name


@pytest.mark.parametrize(("first_deg", "lon_deg"), [(-180.0, 180.0), (-180.0, -179.97), (0.0, 0.02), (-180.0, 10.0)])
def test_an_orthophoto_around_the_earth_is_opened_away_from_the_place(tmp_path: Path, first_deg: float, lon_deg: float) -> None:
    """Beyond its seam there was no map: the half of a picture about the antimeridian was empty, and so were its heights."""
    cols, wide = 36_000, 60
    values = np.random.default_rng(2).integers(1, 255, (wide, cols), dtype=np.uint8)
    heights = np.tile(np.abs(np.linspace(-500, 500, cols, dtype=np.float32)), (wide, 1))
    whole = RasterMap.open(globe(tmp_path, "a.tif", values, first_deg), globe(tmp_path, "d.tif", heights, first_deg))
    ground = whole.near(NORTH, lon_deg)
    column = round((lon_deg - first_deg) % 360 * cols / 360)
    about = np.arange(column - wide // 2, column + wide // 2) % cols
    east, north = ground.to_map(NORTH, lon_deg)
    T_map_pix = np.array([[0.01, 0.0, east - 0.01 * (wide - 1) / 2], [0.0, -0.01, north + 0.01 * (wide - 1) / 2]])
    picture, valid = ground.picture(T_map_pix, (wide, wide))
    assert valid.all()
    assert np.array_equal(picture, values[:, about])
    assert whole.near(NORTH, (first_deg + 180) % 360) is not ground
    patch = ground.patch((east, north), (21, 21), 1_100.0, 0.0)
    assert patch.valid.all()
    assert patch.dsm_amsl_m[10, 10] == pytest.approx(np.interp(column, np.arange(cols), heights[0]), abs=1.0)


def test_heights_whose_eastings_are_a_turn_off_are_found(tmp_path: Path) -> None:
    """An orthophoto with 190 degrees over a surface model with -170, both in EPSG:4326, had no heights."""
    pixels = np.random.default_rng(3).integers(1, 255, (40, 40), dtype=np.uint8)
    for name, west_deg, values in (("a", 190.0, pixels), ("d", -170.0, np.full((40, 40), 123, np.float32))):
        profile = {"width": 40, "height": 40, "count": 1, "dtype": values.dtype.name, "crs": "EPSG:4326"}
        place = Affine(1e-5, 0, west_deg, 0, -1e-5, NORTH)
        with rasterio.open(tmp_path / f"{name}.tif", "w", "GTiff", transform=place, **profile) as out:
            out.write(values, 1)
    ground = RasterMap.open(tmp_path / "a.tif", tmp_path / "d.tif")
    assert ground.patch(ground.center_map_m, (20, 20), 1.0, 0.0).dsm_amsl_m == pytest.approx(123.0)


def test_a_pack_of_an_orthophoto_around_the_earth_is_refused_with_what_to_name(tmp_path: Path) -> None:
    values = np.random.default_rng(2).integers(1, 255, (60, 3_600), dtype=np.uint8)
    with pytest.raises(MapError, match=r"a\.tif: goes all around the earth.*remedy: name the tiles of the place, on both sides"):
        build_pack([globe(tmp_path, "a.tif", values, -180.0)], None, tmp_path / "pack")


def test_another_date_around_the_earth_is_laid_on_a_pack_at_its_seam(tmp_path: Path) -> None:
    """As gdalbuildvrt puts its tiles together: west or east of the antimeridian it was not laid on the pack."""
    noise = np.random.default_rng(5).standard_normal((SIDE, SIDE))
    easting, northing = pyproj.Transformer.from_crs(4326, UTM, always_xy=True).transform(180.0, -16.8)
    place = Affine(2.0, 0, easting - SIDE, 0, -2.0, northing + SIDE)
    pixels = np.rint(60 + 130 * (cv2.GaussianBlur(noise, (0, 0), 4.0) > 0)).astype(np.uint8)
    with rasterio.open(
        tmp_path / "a.tif", "w", "GTiff", width=SIDE, height=SIDE, count=1, dtype="uint8", crs=UTM, transform=place
    ) as out:
        out.write(pixels, 1)
    cols, rows, wide = 18_000_000, 256, 256
    step = 360 / cols  # 2.1 m
    about = np.zeros((rows, wide), np.uint8)
    to = Affine(step, 0, 180 - step * wide / 2, 0, -step, -16.8 + step * rows / 2)
    reproject(pixels, about, src_transform=place, src_crs=UTM, dst_transform=to, dst_crs="EPSG:4326", resampling=Resampling.cubic)
    assert (about > 0).mean() > 0.5
    profile = {"width": cols, "height": rows, "count": 1, "dtype": "uint8", "crs": "EPSG:4326", "nodata": 0, "SPARSE_OK": True}
    place = Affine(step, 0, -180, 0, -step, to.f)
    with rasterio.open(tmp_path / "b.tif", "w", "GTiff", transform=place, tiled=True, blockysize=256, **profile) as out:
        out.write(about[:, : wide // 2], 1, window=Window(cols - wide // 2, 0, wide // 2, rows))
        out.write(about[:, wide // 2 :], 1, window=Window(0, 0, wide // 2, rows))
    build_pack([tmp_path / "a.tif"], None, tmp_path / "one")
    manifest = build_pack([tmp_path / "a.tif"], None, tmp_path / "two", other_dates=[tmp_path / "b.tif"])
    one, two = (np.load(tmp_path / pack / manifest.features[0].file)[0, 0].astype(np.int16) for pack in ("one", "two"))
    changed = (one != two).any(axis=-1)
    assert changed[80:120, 20:90].mean() > 0.3 and changed[80:120, 110:180].mean() > 0.3, "west and east of the antimeridian"
    assert abs(manifest.other_dates[0].moved_east_m) < 0.5
