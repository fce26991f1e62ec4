"""Scenes on disk: exact round trips, foreign GeoTIFFs, and faults that are named."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import rasterio
from rasterio.enums import ColorInterp
from rasterio.transform import Affine

from visloc_companion.errors import MapError
from visloc_companion.geo.wgs84 import geo_from_ned
from visloc_companion.maps.crs import map_crs
from visloc_companion.sim.scene import Scene
from visloc_companion.types import GeoPoint


def scene() -> Scene:
    rng = np.random.default_rng(4)
    pixels = rng.integers(0, 256, (70, 90, 3), dtype=np.uint8)
    heights = rng.normal(400, 20, (70, 90)).astype(np.float32)
    return Scene(pixels, heights, np.array([[0.5, 0.0, 604_000.25], [0.0, -0.5, 5_350_000.0]]), "EPSG:32632")


def write(path: Path, bands: np.ndarray, crs: str | None = "EPSG:26914", gsd_m: float = 5.0, **more: str) -> Path:
    count, height, width = bands.shape
    transform = Affine(gsd_m, 0, 485_905.0, 0, -gsd_m, 5_209_240.0)
    profile = {"driver": "GTiff", "count": count, "height": height, "width": width, "dtype": bands.dtype.name}
    with rasterio.open(path, "w", **profile, crs=crs, transform=transform, **more) as target:
        target.write(bands)
    return path


def test_a_saved_scene_comes_back_exactly(tmp_path: Path) -> None:
    before = scene()
    after = Scene.load(*before.save(tmp_path / "new" / "folder"))
    assert np.array_equal(after.pixels, before.pixels)
    assert np.array_equal(after.dsm_amsl_m, before.dsm_amsl_m)
    assert np.array_equal(after.T_map_pix, before.T_map_pix)
    assert (after.crs, after.size_px) == ("EPSG:32632", (90, 70))
    assert after.center_map == pytest.approx((604_000.25 + 44.5 * 0.5, 5_350_000.0 - 34.5 * 0.5))


def test_the_first_three_of_four_bands_over_a_plane(tmp_path: Path) -> None:
    bands = np.arange(4 * 6 * 8, dtype=np.uint8).reshape(4, 6, 8)
    loaded = Scene.load(write(tmp_path / "naip.tif", bands), ground_h_amsl_m=470.0)
    assert np.array_equal(loaded.pixels, np.moveaxis(bands[:3], 0, 2))
    assert (loaded.dsm_amsl_m == 470.0).all()
    assert loaded.T_map_pix[:, 2] == pytest.approx([485_907.5, 5_209_237.5])


def test_colours_are_those_that_are_named_and_no_numbers_of_a_table(tmp_path: Path) -> None:
    """Infrared first, or a colour table's numbers for colours, would be a scene that nobody ever saw."""
    bands = np.arange(4 * 6 * 8, dtype=np.uint8).reshape(4, 6, 8)
    named = write(tmp_path / "nrgb.tif", bands)
    with rasterio.open(named, "r+") as file:
        file.colorinterp = [ColorInterp.undefined, ColorInterp.red, ColorInterp.green, ColorInterp.blue]
    assert np.array_equal(Scene.load(named).pixels, np.moveaxis(bands[1:], 0, 2))
    table = write(tmp_path / "table.tif", bands[:1])
    with rasterio.open(table, "r+") as file:
        file.write_colormap(1, {k: (255 - k, k, 7, 255) for k in range(256)})
    with pytest.raises(MapError, match=r"table\.tif: has a colour table; remedy: expand it: gdal_translate -expand rgb"):
        Scene.load(table)


def test_one_grey_band_serves_as_all_three(tmp_path: Path) -> None:
    grey = np.arange(48, dtype=np.uint8).reshape(1, 6, 8)
    loaded = Scene.load(write(tmp_path / "grey.tif", grey))
    assert np.array_equal(loaded.pixels, np.dstack([grey[0]] * 3))


def test_grey_that_counts_from_white_is_seen_as_what_it_shows(tmp_path: Path) -> None:
    """The map reads it so; a simulated camera saw its negative."""
    grey = np.arange(48, dtype=np.uint8).reshape(1, 6, 8)
    loaded = Scene.load(write(tmp_path / "grey.tif", 255 - grey, photometric="MINISWHITE"))
    assert np.array_equal(loaded.pixels, np.dstack([grey[0]] * 3))


def test_a_surface_model_of_another_grid_is_resampled_and_its_holes_are_low(tmp_path: Path) -> None:
    ortho = write(tmp_path / "ortho.tif", np.zeros((3, 40, 40), np.uint8), gsd_m=5.0)
    columns = np.tile(np.arange(20, dtype=np.float32) * 10 + 400, (10, 1))[None]
    loaded = Scene.load(ortho, write(tmp_path / "dsm.tif", columns, gsd_m=10.0))
    assert loaded.dsm_amsl_m[5, 9] == pytest.approx(400 + (9 * 5 + 2.5) - 5, abs=0.1)
    assert (loaded.dsm_amsl_m[25:] == loaded.dsm_amsl_m[:18].min()).all(), "below the surface model's ten rows"


@pytest.mark.parametrize(
    ("bands", "crs", "text"),
    [
        (np.zeros((3, 4, 4), np.uint16), "EPSG:32632", r"bad\.tif: has uint16 bands.*remedy: gdal_translate"),
        (np.zeros((3, 4, 4), np.uint8), None, r"bad\.tif: has no coordinate reference system.*remedy"),
    ],
)
def test_orthophotos_that_cannot_be_used_are_named(tmp_path: Path, bands: np.ndarray, crs: str | None, text: str) -> None:
    with pytest.raises(MapError, match=text):
        Scene.load(write(tmp_path / "bad.tif", bands, crs))


def test_damaged_and_missing_files_are_named(tmp_path: Path) -> None:
    (tmp_path / "noise.tif").write_bytes(b"not a picture")
    for name in ("noise.tif", "nowhere.tif"):
        with pytest.raises(MapError, match=rf"{name}.*cannot be read"):
            Scene.load(tmp_path / name)


def test_a_surface_model_of_another_place_is_named(tmp_path: Path) -> None:
    ortho = write(tmp_path / "ortho.tif", np.zeros((3, 4, 4), np.uint8))
    elsewhere = write(tmp_path / "dsm.tif", np.zeros((1, 4, 4), np.float32), "EPSG:32632")
    with pytest.raises(MapError, match=r"dsm\.tif: does not overlap"):
        Scene.load(ortho, elsewhere)


def test_layers_of_different_size_are_refused() -> None:
    with pytest.raises(MapError, match="differ in size"):
        Scene(np.zeros((4, 4, 3), np.uint8), np.zeros((4, 5), np.float32), np.eye(2, 3), "EPSG:32632")
    with pytest.raises(MapError, match="uint8"):
        Scene(np.zeros((4, 4, 4), np.uint8), np.zeros((4, 4), np.float32), np.eye(2, 3), "EPSG:32632")


def test_a_damaged_surface_model_is_named_and_not_the_orthophoto(tmp_path: Path) -> None:
    ortho = write(tmp_path / "ortho.tif", np.zeros((3, 4, 4), np.uint8))
    (tmp_path / "dsm.tif").write_bytes(b"no heights")
    for name in ("dsm.tif", "nowhere.tif"):
        with pytest.raises(MapError, match=rf"^\S*{name}: (cannot be opened|there is no such file)"):
            Scene.load(ortho, tmp_path / name)


def test_heights_that_no_land_has_are_holes(tmp_path: Path) -> None:
    """-9999 that no tag declares would be a shaft ten kilometres deep."""
    ortho = write(tmp_path / "ortho.tif", np.zeros((3, 20, 20), np.uint8))
    heights = np.full((1, 20, 20), 430.0, np.float32)
    heights[:, 4:8], heights[:, 9:12], heights[:, 15:] = -9999.0, 3.4e38, 420.0
    loaded = Scene.load(ortho, write(tmp_path / "dsm.tif", heights))
    assert loaded.dsm_amsl_m.min() == 420.0
    assert loaded.dsm_amsl_m.max() == 430.0


def test_heights_in_feet_are_metres_in_the_scene(tmp_path: Path) -> None:
    ortho = write(tmp_path / "ortho.tif", np.zeros((3, 20, 20), np.uint8))
    dsm = write(tmp_path / "dsm.tif", np.full((1, 20, 20), 1000.0, np.float32))
    with rasterio.open(dsm, "r+") as target:
        target.set_band_unit(1, "ft")
    assert Scene.load(ortho, dsm).dsm_amsl_m == pytest.approx(304.8, abs=0.01)


@pytest.mark.parametrize("turn_deg", [0.0, 90.0])
def test_how_far_a_scene_reaches_about_a_place(turn_deg: float) -> None:
    """200 x 100 pixels of 0.5 m: 25 m from the middle to the nearer edges, and less beside it, however the raster is turned."""
    c, s = np.cos(np.radians(turn_deg)), np.sin(np.radians(turn_deg))
    linear = np.array([[c, -s], [s, c]]) @ np.diag([0.5, -0.5])
    corner = np.array([500_000.0, 5_250_000.0]) - linear @ [99.5, 49.5]
    scene = Scene(
        np.zeros((100, 200, 3), np.uint8), np.zeros((100, 200), np.float32), np.column_stack([linear, corner]), "EPSG:32632"
    )
    middle = GeoPoint(*map_crs("EPSG:32632").to_geo(500_000.0, 5_250_000.0), 0.0)
    across = (-10.0, 0.0, 0.0) if turn_deg == 0.0 else (0.0, 10.0, 0.0)
    assert scene.reach_m(middle) == pytest.approx(25.0, abs=0.1)
    assert scene.reach_m(geo_from_ned(across, middle)) == pytest.approx(15.0, abs=0.1)
    beyond = scene.reach_m(geo_from_ned((-400.0, 0.0, 0.0), middle))
    assert beyond == pytest.approx(-375.0 if turn_deg == 0.0 else -350.0, abs=0.3)


def test_an_orthophoto_that_is_too_large_to_be_looked_at_is_refused(tmp_path: Path) -> None:
    """OpenCV ended the flight at its first frame: dst.cols < SHRT_MAX."""
    ortho = write(tmp_path / "ortho.tif", np.zeros((3, 2, 33_000), np.uint8))
    with pytest.raises(MapError, match=r"ortho\.tif: has 33000 x 2 px; .* remedy: cut out"):
        Scene.load(ortho)
