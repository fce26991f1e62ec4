"""What stands for "unknown" without saying so: in surface models, in imagery, in tiles that were never written."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
import rasterio

from visloc_companion.errors import DatumMissing, MapError
from visloc_companion.maps import geotiff
from visloc_companion.maps.geotiff import layer_of, open_dsm, open_ortho, require_heights
from visloc_companion.maps.raster import RasterMap

NORTH = ("EPSG:32612", (40.5, -112.9))
SIDE = 300
V, U = np.mgrid[:SIDE, :SIDE]
HOLE = (abs(U - 200) < 30) & (abs(V - 120) < 20)
CORNER = U + V < 200


def hills() -> np.ndarray:
    return (430 + 6 * np.sin(U / 40) + 5 * np.cos(V / 30)).astype(np.float32)


def colours() -> np.ndarray:
    noise = np.random.default_rng(2).normal(0, 40, (SIDE, SIDE, 3)).astype(np.float32)
    return np.clip(120 + 3 * cv2.GaussianBlur(noise, (0, 0), 2), 1, 254)


@pytest.mark.parametrize("fill", [0.0, -1.0, -999.0, 9999.0])
@pytest.mark.parametrize("dtype", [np.float32, np.int16])
def test_holes_that_look_like_ground_are_an_error(tmp_path: Path, write_raster, fill: float, dtype: type) -> None:
    path = tmp_path / "dsm.tif"
    heights = np.where(HOLE, fill, hills()).astype(dtype)
    write_raster(path, heights, *NORTH, 1.0)
    told = rf"dsm.tif: 2.6 % of its pixels are {fill:g}, far from .*; remedy: gdal_edit.py -a_nodata {fill:g} FILE"
    with pytest.raises(MapError, match=told):
        require_heights(open_dsm(path))
    with rasterio.open(path, "r+") as dsm:
        dsm.nodata = fill
    tiff = open_dsm(path)
    require_heights(tiff)
    layer = layer_of(tiff)
    np.testing.assert_array_equal(layer.read(0, (0, SIDE), (0, SIDE))[1] > 0, ~HOLE)


def test_a_sea_under_cliffs_is_one_where_the_file_declares_another_value(tmp_path: Path, write_raster) -> None:
    path = tmp_path / "dsm.tif"
    write_raster(path, np.where(HOLE, 0.0, hills()).astype(np.float32), *NORTH, 1.0)
    with pytest.raises(MapError, match="where that is a height, declare what none has: -a_nodata -32768"):
        require_heights(open_dsm(path))
    with rasterio.open(path, "r+") as dsm:
        dsm.nodata = -32768.0
    tiff = open_dsm(path)
    require_heights(tiff)
    assert (layer_of(tiff).read(0, (0, SIDE), (0, SIDE))[1] > 0).all()


@pytest.mark.parametrize(
    "heights",
    [
        np.where(V < 150, 0.0, (V - 150) * 0.5),  # a sea, and the land that rises from it
        np.where(V < 150, 0.0, (V - 150) * 3.0),  # a fjord: 70 degrees
        np.where(HOLE, 395.0, hills()),  # a quarry with water in it
        np.where(HOLE, 520.0, hills()),  # a flat roof
        np.zeros((SIDE, SIDE)),
        hills() - 800.0,
    ],
    ids=["sea", "fjord", "quarry", "roof", "level", "below the sea"],
)
def test_ground_is_no_hole(tmp_path: Path, write_raster, heights: np.ndarray) -> None:
    write_raster(tmp_path / "dsm.tif", heights.astype(np.float32), *NORTH, 1.0)
    require_heights(open_dsm(tmp_path / "dsm.tif"))


def resampled(heights: np.ndarray, scale: float, kernel: int) -> np.ndarray:
    """As by a program that takes holes for ground, between the pixels."""
    size = round(SIDE * scale)
    grid = np.float32([[1 / scale, 0, 0.3], [0, 1 / scale, 0.4]])
    return cv2.warpAffine(heights, grid, (size, size), flags=kernel | cv2.WARP_INVERSE_MAP, borderMode=cv2.BORDER_REPLICATE)


@pytest.mark.parametrize(
    ("fill", "declared"), [(-9999.0, False), (-32768.0, False), (32767.0, False), (-9999.0, True), (32767.0, True), (0.0, True)]
)
@pytest.mark.parametrize(("scale", "kernel"), [(0.7, cv2.INTER_LINEAR), (1.0, cv2.INTER_CUBIC), (2.5, cv2.INTER_LINEAR)])
def test_holes_that_were_averaged_with_the_ground_are_an_error(
    tmp_path: Path, write_raster, scale: float, kernel: int, fill: float, declared: bool
) -> None:
    """What of their rims could be heights (-999 m to the ground) stays: of ten frames from 80 m 3 instead of 8 are placed."""
    heights = np.where(HOLE | CORNER, np.float32(fill), hills())
    path = tmp_path / "dsm.tif"
    write_raster(path, resampled(heights, scale, kernel), *NORTH, 1.0, nodata=fill if declared else None)
    side = ("A<LOWEST" if fill <= 0 else "A>HIGHEST") + ".* heights is 4[2-3]"
    with pytest.raises(MapError, match=rf"dsm\.tif: holes were averaged with the ground .* -srcnodata .*{side}"):
        require_heights(open_dsm(path))
    write_raster(path, heights, *NORTH, 1.0, nodata=fill if declared else None)
    require_heights(open_dsm(path))


@pytest.mark.parametrize("fill", [0.0, -1.0, -999.0])
@pytest.mark.parametrize(("scale", "kernel"), [(0.7, cv2.INTER_LINEAR), (1.0, cv2.INTER_CUBIC), (2.5, cv2.INTER_LINEAR)])
def test_rims_of_holes_hide_no_hole(tmp_path: Path, write_raster, scale: float, kernel: int, fill: float) -> None:
    """Of small holes over low ground a large part of the rim lies within 30 m of the fill."""
    holes = ((U % 100 < 12) & (V % 50 < 12)).astype(bool)
    heights = resampled(np.where(holes, np.float32(fill), hills() - 330), scale, kernel)
    write_raster(tmp_path / "dsm.tif", heights, *NORTH, 1.0)
    with pytest.raises(MapError, match=r"far from all other heights: holes that it does not declare|holes were averaged"):
        require_heights(open_dsm(tmp_path / "dsm.tif"))


@pytest.mark.parametrize(("per_metre", "dtype"), [(100, np.int32), (1000, np.int32), (100, np.float32)])
@pytest.mark.parametrize("fill", [None, 99999.0, -9999.0])
def test_heights_of_another_unit_are_no_holes(
    tmp_path: Path, write_raster, per_metre: int, dtype: type, fill: float | None
) -> None:
    """Centimetres of ground at 430 m were said to be holes that somebody averaged, millimetres to be of another place."""
    path = tmp_path / "dsm.tif"
    heights = hills() * per_metre
    write_raster(path, (heights if fill is None else np.where(HOLE, fill, heights)).astype(dtype), *NORTH, 1.0)
    with pytest.raises(MapError, match=rf"dsm.tif: its heights would be {per_metre * 0.43:.0f}\d+ m .*; remedy: .* -scale 0.01"):
        require_heights(open_dsm(path))
    with rasterio.open(path, "r+") as dsm:
        dsm.scales = (1 / per_metre,)
        dsm.nodata = fill
    require_heights(open_dsm(path))


@pytest.mark.parametrize("wild", ["floor", "outliers", "overviews"])
def test_what_no_land_has_is_no_average(tmp_path: Path, write_raster, wild: str) -> None:
    """The floor of a deep sea, single wrong matches, and overviews that were averaged though the file is not."""
    path, heights = tmp_path / "dsm.tif", hills()
    if wild == "floor":
        heights = np.where(U < 200, -1500 + 9 * U, heights).astype(np.float32)
    elif wild == "outliers":
        at = np.random.default_rng(1).random((SIDE, SIDE)) < 1e-3
        heights = np.where(at, np.random.default_rng(2).uniform(-5e3, 5e4, (SIDE, SIDE)), heights).astype(np.float32)
    else:
        heights = np.where(HOLE, np.float32(-9999), heights)
    gsd_m, nodata = 100.0 if wild == "floor" else 1.0, None if wild == "overviews" else -9999
    write_raster(path, heights, *NORTH, gsd_m, nodata=nodata)
    if wild == "overviews":
        with rasterio.open(path, "r+") as dsm:
            dsm.build_overviews([2, 4], rasterio.enums.Resampling.average)
    require_heights(open_dsm(path))


def test_levels_of_a_large_surface_model_keep_what_it_does_not_declare_apart(
    tmp_path: Path, write_raster, monkeypatch: pytest.MonkeyPatch
) -> None:
    """GDAL averages undeclared -9999 with their neighbours: to -883 m, which is a height as any other."""
    monkeypatch.setattr(geotiff, "STRIP_ROWS", 16)
    speckled = np.where(np.random.default_rng(0).random((SIDE, SIDE)) < 0.05, -9999.0, hills()).astype(np.float32)
    write_raster(tmp_path / "dsm.tif", speckled, *NORTH, 1.0)
    whole = layer_of(open_dsm(tmp_path / "dsm.tif"))
    lazy = layer_of(open_dsm(tmp_path / "dsm.tif"), in_memory_bytes=0)
    assert lazy.shapes == whole.shapes
    for level, (rows, cols) in enumerate(lazy.shapes):
        values, valid = lazy.read(level, (0, rows), (0, cols))
        assert (valid > 0).mean() > 0.9
        assert values[valid > 0].min() > 415
        window = (rows // 4, rows // 2), (cols // 4, cols // 2)
        for got, want in zip(lazy.read(level, *window), whole.read(level, *window), strict=True):
            np.testing.assert_allclose(got, want, rtol=1e-6)


def never_written(path: Path, values: np.ndarray) -> np.ndarray:
    """Write all blocks of 64 but some. (H, W) where those lie."""
    blocks = [(0, 0), (2, 1), (1, 4)]
    missing = np.zeros((SIDE, SIDE), np.bool_)
    profile = {"width": SIDE, "height": SIDE, "count": len(values), "dtype": values.dtype, "tiled": True}
    with rasterio.open(
        path, "w", "GTiff", crs=NORTH[0], transform=rasterio.Affine(1, 0, 3e5, 0, -1, 4.4e6), blockxsize=64, blockysize=64,
        SPARSE_OK=True, **profile,
    ) as out:  # fmt: skip
        for row in range(-(-SIDE // 64)):
            for col in range(-(-SIDE // 64)):
                rows, cols = slice(64 * row, min(64 * row + 64, SIDE)), slice(64 * col, min(64 * col + 64, SIDE))
                missing[rows, cols] = (row, col) in blocks
                if (row, col) not in blocks:
                    window = ((rows.start, rows.stop), (cols.start, cols.stop))
                    out.write(values[:, rows, cols], window=window)
    return missing


def test_tiles_that_were_never_written_are_empty(tmp_path: Path) -> None:
    dsm, ortho = tmp_path / "dsm.tif", tmp_path / "a.tif"
    missing = never_written(dsm, hills()[None])
    never_written(ortho, colours().astype(np.uint8).transpose(2, 0, 1))
    require_heights(open_dsm(dsm))
    for tiff in (open_dsm(dsm), open_ortho(ortho)):
        for in_memory_bytes in (0, 10**9):
            valid = layer_of(tiff, in_memory_bytes).read(0, (0, SIDE), (0, SIDE))[1] > 0
            np.testing.assert_array_equal(valid, ~missing)


@pytest.mark.parametrize(
    ("dtype", "scale", "fill"),
    [
        ("uint16", 8.0, 0),
        ("uint16", 8.0, 65535),
        ("int16", 8.0, -32768),
        ("int16", 8.0, -9999),
        ("float32", 1 / 255, -9999),
        ("float32", 1 / 255, np.nan),
        ("float32", 1 / 255, 0),
    ],
)
def test_fill_of_wider_types_is_empty_and_does_not_spoil_the_contrast(
    tmp_path: Path, write_raster, dtype: str, scale: float, fill: float
) -> None:
    plain = (colours() * scale).astype(dtype)
    plain[(U + V >= 200) & (U + V < 203)] = scale  # shadow beside the fill: black once it is stretched
    filled = plain.copy()
    filled[CORNER] = fill
    write_raster(tmp_path / "plain.tif", plain, *NORTH, 1.0, photometric="RGB")
    write_raster(tmp_path / "filled.tif", filled, *NORTH, 1.0, photometric="RGB")
    want, _ = layer_of(open_ortho(tmp_path / "plain.tif")).read(0, (0, SIDE), (0, SIDE))
    got, valid = layer_of(open_ortho(tmp_path / "filled.tif")).read(0, (0, SIDE), (0, SIDE))
    np.testing.assert_array_equal(valid > 0, ~CORNER)
    assert np.abs(got[~CORNER].astype(float) - want[~CORNER]).max() < 8


@pytest.mark.parametrize("fill", [0, 255])
def test_the_smear_of_a_jpeg_at_its_collar_is_no_content(tmp_path: Path, write_raster, fill: int) -> None:
    rgb = colours().astype(np.uint8)
    rgb[CORNER] = fill
    write_raster(
        tmp_path / "a.tif", rgb, *NORTH, 1.0, photometric="YCBCR", compress="JPEG", tiled=True, blockxsize=64, blockysize=64
    )
    ref = RasterMap.open(tmp_path / "a.tif")
    valid = ref.patch(ref.center_map_m, (SIDE, SIDE), 1.0, 0.0).valid
    assert not valid[CORNER].any()
    assert valid[U + V > 260].all(), "of the picture hardly more is lost than the smeared blocks"


def test_control_points_alone_are_told_with_the_command_that_rectifies(tmp_path: Path) -> None:
    points = [rasterio.control.GroundControlPoint(row=r, col=c, x=3e5 + c, y=4.4e6 - r) for r in (0, 40) for c in (0, 40)]
    profile = {"width": 40, "height": 40, "count": 1, "dtype": "uint8", "gcps": points, "crs": "EPSG:32612"}
    with rasterio.open(tmp_path / "a.tif", "w", "GTiff", **profile) as out:
        out.write(np.full((1, 40, 40), 9, np.uint8))
    with pytest.raises(DatumMissing, match=r"georeferenced by ground control points alone; .*gdalwarp -tps -t_srs"):
        RasterMap.open(tmp_path / "a.tif")
