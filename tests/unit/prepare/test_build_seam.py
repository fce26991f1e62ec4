"""A surface model that goes all around the earth, below a map at its seam."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pyproj
import pytest
import rasterio
from rasterio import Affine

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
