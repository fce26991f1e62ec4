"""In which CRS a pack is made where that of its orthophoto does not serve: mirrored, or lost in a GeoTIFF."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
import rasterio

from tests.unit.prepare.test_build import picture
from visloc_companion.errors import MapError
from visloc_companion.geo.raster import apply_affine, invert_affine
from visloc_companion.maps.crs import map_crs
from visloc_companion.maps.outlasts import outlasts_geotiff
from visloc_companion.maps.pack import PackMap
from visloc_companion.maps.raster import RasterMap
from visloc_companion.maps.registration import pack_tie
from visloc_companion.prepare.build import build_pack
from visloc_companion.types import GeoPoint

BOHEMIA, BOSNIA = (49.8, 15.0), (44.0, 15.5)


def off_the_file(pack: PackMap, place: tuple[float, float], file: RasterMap, stored: np.ndarray) -> float:
    """Mean difference between a window of the pack, turned as it may be, and what the file has stored at the same places."""
    patch = pack.patch(pack.to_map(*place), (81, 81), 1.0, 0.3)
    v, u = np.mgrid[:81, :81]
    map_m = apply_affine(patch.T_map_pix, np.column_stack([u.ravel(), v.ravel()]).astype(float))
    pix = apply_affine(invert_affine(file.T_map_pix), file.crs.to_map_array(pack.crs.to_geo_array(map_m)))
    u_file, v_file = (pix[:, k].reshape(81, 81).astype(np.float32) for k in (0, 1))
    want = cv2.remap(stored, u_file, v_file, cv2.INTER_CUBIC)
    return float(np.abs(patch.pixels.astype(int) - want).mean())


def test_a_map_in_southings_and_westings_is_not_built_as_its_mirror_image(tmp_path: Path, write_raster) -> None:
    """Stored pixels and features lie as the pack's axes do: frames found nothing on the mirror image."""
    write_raster(tmp_path / "a.tif", picture(300), "EPSG:5513", BOHEMIA, 1.0)
    assert np.linalg.det(map_crs("EPSG:5513").linearised_at(GeoPoint(*BOHEMIA, 0.0)).J_map_ne) == pytest.approx(1.0, abs=0.01)
    manifest = build_pack([tmp_path / "a.tif"], None, tmp_path / "pack")
    assert manifest.crs.epsg == 32633
    pack = PackMap.open(tmp_path / "pack")
    assert np.linalg.det(pack.projection_at(GeoPoint(*BOHEMIA, 0.0)).J_map_ne) < 0, "east is right of north"
    assert off_the_file(pack, BOHEMIA, RasterMap.open(tmp_path / "a.tif"), picture(300)) < 2.0


@pytest.mark.parametrize(("crs", "lasts"), [("EPSG:32633", True), ("EPSG:2056", True), ("EPSG:31275", False)])
def test_which_crs_a_geotiff_gives_back(crs: str, lasts: bool) -> None:
    assert outlasts_geotiff(map_crs(crs)) == lasts


def test_a_pack_in_a_crs_that_no_geotiff_gives_back_can_be_opened(tmp_path: Path, write_raster) -> None:
    """It was built whole, and then was "not what the manifest says"."""
    write_raster(tmp_path / "a.tif", picture(200), "EPSG:31275", BOSNIA, 1.0)
    east, north = map_crs("EPSG:31275").to_map(*BOSNIA)
    (tmp_path / "a.vrt").write_text(
        f'<VRTDataset rasterXSize="200" rasterYSize="200"><SRS>EPSG:31275</SRS>'
        f"<GeoTransform>{east - 100}, 1, 0, {north + 100}, 0, -1</GeoTransform>"
        '<VRTRasterBand dataType="Byte" band="1"><SimpleSource><SourceFilename relativeToVRT="1">a.tif</SourceFilename>'
        "<SourceBand>1</SourceBand></SimpleSource></VRTRasterBand></VRTDataset>"
    )
    assert build_pack([tmp_path / "a.vrt"], None, tmp_path / "pack").crs.epsg == 32633
    pack, file = PackMap.open(tmp_path / "pack"), RasterMap.open(tmp_path / "a.vrt")
    place = file.to_geo(*file.center_map_m)
    assert off_the_file(pack, place, file, picture(200)) < 2.0


@pytest.mark.parametrize(("crs", "which"), [("EPSG:5041", "north"), ("EPSG:5042", "south")])
def test_what_is_centred_on_a_pole_is_named_with_what_to_do(tmp_path: Path, crs: str, which: str) -> None:
    """No direction is north there. Orthophoto, surface model, or a cut of it beside the pole."""

    def raster(name: str, dtype: str, east_m: float) -> Path:
        place = rasterio.Affine(1.0, 0, 1_999_900.0 + east_m, 0, -1.0, 2_000_100.0)
        shape = {"width": 200, "height": 200, "count": 1, "dtype": dtype}
        with rasterio.open(tmp_path / name, "w", driver="GTiff", crs=crs, transform=place, **shape) as out:
            out.write(np.random.default_rng(1).integers(1, 255, (200, 200)).astype(dtype), 1)
        return tmp_path / name

    told = rf"{which} pole, where no direction is north; remedy: cut it .*gdal_translate -srcwin"
    with pytest.raises(MapError, match=rf"a\.tif: has its middle at the {told}"):
        build_pack([raster("a.tif", "uint8", 0.0)], None, tmp_path / "pack")
    beside = raster("b.tif", "uint8", 150.0)
    with pytest.raises(MapError, match=rf"dsm\.tif: has its middle at the {told}"):
        build_pack([beside], raster("dsm.tif", "float32", 0.0), tmp_path / "pack")
    assert build_pack([beside], None, tmp_path / "pack").crs.epsg == int(crs[5:])


def test_a_pack_keeps_what_the_crs_its_orthophotos_were_changed_from_is_off_by(tmp_path: Path, write_raster) -> None:
    """Degrees of NAD27 became UTM of WGS 84, and the pack was tied to that by its nature, good to 0.5 m in flight."""
    write_raster(tmp_path / "nad27.tif", picture(200), "EPSG:4267", (36.0, -80.0), 1.0)
    write_raster(tmp_path / "utm.tif", picture(200), "EPSG:32617", (36.0, -80.0), 1.0)
    write_raster(tmp_path / "nad83.tif", picture(200), "EPSG:26917", (36.0, -80.0), 1.0)
    ties = {}
    for first, *others in (["nad27"], ["utm"], ["utm", "nad27"], ["utm", "nad83", "nad27"], ["nad83"], ["nad83", "utm"]):
        build_pack([tmp_path / f"{name}.tif" for name in (first, *others)], None, tmp_path / "pack")
        ties[(first, *others)] = pack_tie(PackMap.open(tmp_path / "pack"))
    assert [(*tie,) for tie in ties.values()] == [
        ("NAD27", 10.0),
        ("WGS 84 / UTM zone 17N", 0.0),
        ("NAD27", 10.0),
        ("NAD27", 10.0),
        ("NAD83 / UTM zone 17N", 4.0),
        ("NAD83 / UTM zone 17N", 4.0),
    ]
