"""Rasters as map makers write them: a frame over their pack is placed where it was taken."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import rasterio
from rasterio import Affine
from rasterio.shutil import copy
from rasterio.warp import Resampling, reproject

from visloc_companion.errors import MapError
from visloc_companion.geo.se3 import quat_from_euler
from visloc_companion.geo.wgs84 import distance_m, geo_from_ned
from visloc_companion.localise.registry import make_localiser
from visloc_companion.maps.crs import map_crs
from visloc_companion.maps.pack import PackMap
from visloc_companion.prepare.build import build_pack
from visloc_companion.sim.render import CameraSimulator
from visloc_companion.sim.scene import Scene
from visloc_companion.types import CameraModel, Fix, FrameRef, GeoPoint, Image, LocaliseRequest, PosePrior

CRS, EAST, NORTH, SIDE, GSD_M = "EPSG:32632", 604_000.0, 5_350_000.0, 500, 0.5
CENTRES = Affine(GSD_M, 0, EAST, 0, -GSD_M, NORTH)
EDGES = Affine(GSD_M, 0, EAST - GSD_M / 2, 0, -GSD_M, NORTH + GSD_M / 2)
MODEL = CameraModel(320, 240, 277.0, 277.0, 159.5, 119.5)
ATTITUDE = quat_from_euler(0.02, -0.03, 0.5)
PLACE = GeoPoint(*map_crs(CRS).to_geo(EAST + 125, NORTH - 125), 520.0)
Rasters = tuple[Path, Path]


def _scene() -> Scene:
    rng = np.random.default_rng(3)
    rgb = np.full((SIDE, SIDE, 3), 110.0, np.float32)
    for _ in range(SIDE * SIDE // 900):
        box = cv2.boxPoints((rng.uniform(0, SIDE, 2).tolist(), rng.uniform(6, 50, 2).tolist(), rng.uniform(0, 180)))
        cv2.fillPoly(rgb, [np.int32(box)], rng.uniform(30, 220, 3).tolist())
    v, u = np.mgrid[:SIDE, :SIDE]
    heights = (430 + 6 * np.sin(u / 90) + 5 * np.cos(v / 70)).astype(np.float32)
    return Scene(np.clip(rgb, 1, 254).astype(np.uint8), heights, np.array([*CENTRES[:6]]).reshape(2, 3), CRS)


SCENE = _scene()


def write(path: Path, values: np.ndarray, transform: Affine = EDGES, crs: str = CRS, **profile: Any) -> Path:
    bands = values[None] if values.ndim == 2 else values.transpose(2, 0, 1)
    profile = {"width": bands.shape[2], "height": bands.shape[1], "count": len(bands), "dtype": bands.dtype} | profile
    with rasterio.open(path, "w", "GTiff", transform=transform, crs=crs, **profile) as out:
        out.write(bands)
    return path


def plain(folder: Path) -> Rasters:
    return write(folder / "a.tif", SCENE.pixels), write(folder / "dsm.tif", SCENE.dsm_amsl_m)


def south_up(folder: Path) -> Rasters:
    flipped = Affine(GSD_M, 0, EDGES.c, 0, GSD_M, EDGES.f - SIDE * GSD_M)
    ortho = write(folder / "a.tif", SCENE.pixels[::-1], flipped)
    return ortho, write(folder / "dsm.tif", SCENE.dsm_amsl_m[::-1], flipped)


def turned_columns_first(folder: Path) -> Rasters:
    """Rows run east: a geotransform without a diagonal."""
    swapped = Affine(0, GSD_M, EDGES.c, -GSD_M, 0, EDGES.f)
    ortho = write(folder / "a.tif", SCENE.pixels.transpose(1, 0, 2), swapped)
    return ortho, write(folder / "dsm.tif", SCENE.dsm_amsl_m.T, swapped)


def pixel_is_point(folder: Path) -> Rasters:
    """Tie points as other programs write them: of the first pixel's centre."""
    with rasterio.Env(GTIFF_POINT_GEO_IGNORE=True):
        for name, values in (("a.tif", SCENE.pixels), ("dsm.tif", SCENE.dsm_amsl_m)):
            with rasterio.open(write(folder / name, values, CENTRES), "r+") as out:
                out.update_tags(AREA_OR_POINT="Point")
    with rasterio.open(folder / "a.tif") as told:
        assert told.transform == EDGES, "half a pixel from what is written"
    return folder / "a.tif", folder / "dsm.tif"


def bands_of_satellites(folder: Path) -> Rasters:
    """Red, green, blue, near infrared, none of them named, of 11 bits, with a collar that nobody declares."""
    infrared = cv2.GaussianBlur(255 - SCENE.pixels[..., :1], (0, 0), 1)
    bands = np.dstack([SCENE.pixels, infrared]).astype(np.uint16) * 8
    bands[:40] = 0
    ortho = write(folder / "a.tif", bands, photometric="MINISBLACK", bigtiff="YES")
    return ortho, write(folder / "dsm.tif", SCENE.dsm_amsl_m)


def cloud_optimised(folder: Path) -> Rasters:
    """JPEG with an internal mask and overviews that were averaged."""
    with rasterio.Env(GDAL_TIFF_INTERNAL_MASK=True):
        with rasterio.open(write(folder / "rgb.tif", SCENE.pixels, photometric="RGB"), "r+") as out:
            mask = np.full((SIDE, SIDE), 255, np.uint8)
            mask[:60] = 0
            out.write_mask(mask)
        copy(folder / "rgb.tif", folder / "a.tif", driver="COG", COMPRESS="JPEG", BLOCKSIZE=128, OVERVIEW_RESAMPLING="AVERAGE")
    return folder / "a.tif", write(folder / "dsm.tif", SCENE.dsm_amsl_m)


def heights_in_degrees(folder: Path) -> Rasters:
    """EPSG:4326, whose axes are latitude and longitude, in that order."""
    corners = [map_crs(CRS).to_geo(EAST + e, NORTH - n) for e in (0.0, SIDE * GSD_M) for n in (0.0, SIDE * GSD_M)]
    (south, west), (north, east) = np.min(corners, axis=0), np.max(corners, axis=0)
    grid = Affine((east - west) / SIDE, 0, west, 0, (south - north) / SIDE, north)
    heights = np.full((SIDE, SIDE), -9999, np.float32)
    reproject(
        SCENE.dsm_amsl_m, heights, src_transform=EDGES, src_crs=CRS, dst_transform=grid, dst_crs="EPSG:4326",
        resampling=Resampling.cubic, dst_nodata=-9999,
    )  # fmt: skip
    return write(folder / "a.tif", SCENE.pixels), write(folder / "dsm.tif", heights, grid, "EPSG:4326", nodata=-9999)


def heights_of_a_compound_crs(folder: Path) -> Rasters:
    """Above EGM96."""
    return write(folder / "a.tif", SCENE.pixels), write(folder / "dsm.tif", SCENE.dsm_amsl_m, crs="EPSG:32632+5773")


def heights_in_feet_of_a_compound_crs(folder: Path) -> Rasters:
    """Above NAVD88, US survey feet by its vertical axis alone."""
    feet = (SCENE.dsm_amsl_m / (1200 / 3937)).astype(np.float32)
    return write(folder / "a.tif", SCENE.pixels), write(folder / "dsm.tif", feet, crs="EPSG:32632+6360")


@pytest.fixture(scope="module")
def frame() -> Image:
    return CameraSimulator(SCENE, MODEL).frame(PLACE, ATTITUDE)


@pytest.mark.parametrize(
    "rasters",
    [
        plain,
        south_up,
        turned_columns_first,
        pixel_is_point,
        bands_of_satellites,
        cloud_optimised,
        heights_in_degrees,
        heights_of_a_compound_crs,
        heights_in_feet_of_a_compound_crs,
    ],
    ids=lambda rasters: rasters.__name__,
)
def test_a_frame_is_placed_where_it_was_taken(tmp_path: Path, frame: Image, rasters: Callable[[Path], Rasters]) -> None:
    ortho, dsm = rasters(tmp_path)
    build_pack([ortho], dsm, tmp_path / "pack", networks=[])
    pack = PackMap.open(tmp_path / "pack", verify_hashes=False)
    start = geo_from_ned((6.0, -5.0, 1.5), PLACE)
    prior = PosePrior(start, ATTITUDE, ((100.0, 0.0), (0.0, 100.0)), 3.0, math.radians(3), math.radians(1))
    request = LocaliseRequest(1, FrameRef(0, 0, 1, 0, 320, 240, 3), prior, 1)
    answer = make_localiser("gradient", MODEL).localise(request, frame, pack)
    assert isinstance(answer, Fix), answer
    assert distance_m(answer.place, PLACE) < 0.16, "a third of a pixel: half a pixel of another convention shows"
    assert answer.place.h_amsl_m == pytest.approx(PLACE.h_amsl_m, abs=0.2)


def test_a_surface_model_in_tiles_is_put_together(tmp_path: Path) -> None:
    """One of them in another CRS: where they meet there is neither a gap nor a step. The first lies on top."""
    heights, half = SCENE.dsm_amsl_m, SIDE // 2
    west = write(tmp_path / "west.tif", heights[:, :half])
    east = write(tmp_path / "east.tif", heights[:, half:], EDGES @ Affine.translation(half, 0))
    wrong = write(tmp_path / "wrong.tif", heights + 100)
    other = write(tmp_path / "other.tif", heights[:, half:], EDGES @ Affine.translation(half, 0), "EPSG:25832")
    ortho = write(tmp_path / "a.tif", SCENE.pixels)
    places = np.stack(np.meshgrid(EAST + np.arange(5.0, 245), NORTH - np.arange(5.0, 245)), -1).reshape(-1, 2)
    truth = heights[np.rint((NORTH - places[:, 1]) / GSD_M).astype(int), np.rint((places[:, 0] - EAST) / GSD_M).astype(int)]
    for tiles in ([west, east], [east, west, wrong], [west, other]):
        said: list[str] = []
        manifest = build_pack([ortho], tiles, tmp_path / "pack", warn=said.append)
        beside = [f"{wrong} lies 100.0 m above the surface models before it"] if wrong in tiles else []
        assert [words.split(",")[0] for words in said] == beside, "hidden here, where it reaches beyond them a step"
        assert manifest.heights.share_known == 1.0
        assert [entry.file for entry in manifest.inputs] == ["a.tif", *(tile.name for tile in tiles)]
        assert np.abs(PackMap.open(tmp_path / "pack").heights_amsl_m(places) - truth).max() < 0.01


@pytest.mark.parametrize("raised_m", [47.5, -47.5, 2.0, -1.5, 0.8])
@pytest.mark.parametrize("turn", [False, True], ids=["east", "south"])
def test_a_step_between_tiles_that_only_touch_is_told(tmp_path: Path, turn: bool, raised_m: float) -> None:
    """On a slope of 45 degrees, which is no step, with a gap between them."""
    v, u = np.mgrid[:SIDE, :SIDE]
    heights, half = (400 + GSD_M * (v if turn else u)).astype(np.float32), SIDE // 2
    cut = (slice(half + 1, None), slice(None)) if turn else (slice(None), slice(half + 1, None))
    first = write(tmp_path / "first.tif", heights[:half] if turn else heights[:, :half])
    place = EDGES @ (Affine.translation(0, half + 1) if turn else Affine.translation(half + 1, 0))
    second = write(tmp_path / "second.tif", heights[cut] + np.float32(raised_m), place)
    said: list[str] = []
    build_pack([write(tmp_path / "a.tif", SCENE.pixels)], [first, second], tmp_path / "pack", warn=said.append)
    side = f"{abs(raised_m):.1f} m {'above' if raised_m > 0 else 'below'}"
    told = [f"{second} lies {side} the surface models before it, along their border"] if abs(raised_m) > 1 else []
    assert [words.split(":")[0] for words in said] == told
    mended = f"gdal_calc.py -A FILE --calc=A{-raised_m:+.1f} --outfile NEW.tif"
    assert all((mended in words) == (abs(raised_m) < 5) for words in said), said


@pytest.mark.parametrize(("over_px", "grown_m", "raised_m"), [(40, 2.0, 0.0), (40, 0.0, 2.0), (0, 0.3, 0.0)])
def test_a_step_of_metres_is_told_apart_from_crowns(tmp_path: Path, over_px: int, grown_m: float, raised_m: float) -> None:
    """Where crowns differ by 2 m in the median, or those at the ends of two tiles by chance, none is told."""
    rng, first = np.random.default_rng(4), SIDE // 2 - over_px
    woods, grown = (cv2.resize(rng.normal(0, 3, (SIDE // 5,) * 2), (SIDE, SIDE)) for _ in range(2))
    west = write(tmp_path / "west.tif", (SCENE.dsm_amsl_m + woods)[:, : SIDE // 2].astype(np.float32))
    heights = SCENE.dsm_amsl_m + (grown + grown_m if grown_m else woods + raised_m)
    east = write(tmp_path / "east.tif", heights[:, first:].astype(np.float32), EDGES @ Affine.translation(first, 0))
    said: list[str] = []
    build_pack([write(tmp_path / "a.tif", SCENE.pixels)], [west, east], tmp_path / "pack", warn=said.append)
    told = [f"{east} lies 2.0 m above the surface models before it"] if raised_m else []
    assert [words.split(",")[0] for words in said] == told


def test_degrees_that_are_held_for_metres_are_told(tmp_path: Path) -> None:
    """The map would lie at the zone's corner on the equator, with pixels of micrometres."""
    degrees = write(tmp_path / "deg.tif", SCENE.pixels, Affine(5e-6, 0, 10.4, 0, -5e-6, 48.2))
    with pytest.raises(MapError, match=r"deg\.tif: has pixels of 5e-06 m in .*; remedy: where its coordinates are degrees"):
        build_pack([write(tmp_path / "a.tif", SCENE.pixels), degrees], None, tmp_path / "pack")


def test_damage_is_told_by_block_and_by_tile(tmp_path: Path) -> None:
    """rasterio's own words are "Read failed. See previous exception for details"."""
    ortho = write(tmp_path / "a.tif", SCENE.pixels, tiled=True, compress="deflate")
    size = ortho.stat().st_size
    with ortho.open("r+b") as stream:
        stream.seek(size // 2)
        stream.write(b"\xff" * (size // 4))
    with pytest.raises(MapError, match=r"a\.tif: pixels cannot be read: .*a\.tif, band 1: IReadBlock failed"):
        build_pack([ortho], None, tmp_path / "pack")
    corner = ", ".join(str(value) for value in EDGES.to_gdal())
    (tmp_path / "a.vrt").write_text(
        f'<VRTDataset rasterXSize="{SIDE}" rasterYSize="{SIDE}"><SRS>{CRS}</SRS><GeoTransform>{corner}</GeoTransform>'
        '<VRTRasterBand dataType="Byte" band="1"><SimpleSource><SourceFilename relativeToVRT="1">gone.tif</SourceFilename>'
        "<SourceBand>1</SourceBand></SimpleSource></VRTRasterBand></VRTDataset>"
    )
    with pytest.raises(MapError, match=r"a\.vrt: pixels cannot be read: .*gone\.tif: No such file"):
        build_pack([tmp_path / "a.vrt"], None, tmp_path / "pack")
