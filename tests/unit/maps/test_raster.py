import math
from pathlib import Path

import numpy as np
import pytest
import rasterio

from visloc_companion.errors import DatumMissing, MapError, OutsideMap
from visloc_companion.geo.raster import apply_affine, invert_affine
from visloc_companion.maps.crs import map_crs
from visloc_companion.maps.raster import RasterMap
from visloc_companion.protocols import ReferenceMap
from visloc_companion.types import FloatArray, GeoPoint, ReferencePatch

NORTH, SOUTH, GEOGRAPHIC = ("EPSG:32612", (40.5, -112.9)), ("EPSG:32719", (-23.3, -67.1)), ("EPSG:4326", (61.2, 25.1))
FEET = ("EPSG:2227", (37.5, -122.0))
PERIOD_PX = 23.0


def waves(pix: FloatArray) -> FloatArray:
    """Two crossing waves of 23 and 30 px: an image with known content between the pixels."""
    u, v = pix[..., 0], pix[..., 1]
    return 127 + 50 * np.sin(2 * np.pi * u / PERIOD_PX) + 50 * np.sin(2 * np.pi * (0.8 * v + 0.6 * u) / (1.3 * PERIOD_PX))


def pix_grid(width: int, height: int) -> FloatArray:
    v, u = np.mgrid[:height, :width]
    return np.stack([u, v], axis=-1).astype(np.float64)


def image(side: int = 640) -> np.ndarray:
    return np.rint(waves(pix_grid(side, side))).astype(np.uint8)


def shift_px(patch: ReferencePatch, T_map_pix: FloatArray) -> float:
    """Misregistration of a window against the analytic image, in pixels of the raster (least squares over all pixels)."""
    height, width = patch.pixels.shape
    place = apply_affine(invert_affine(T_map_pix), apply_affine(patch.T_map_pix, pix_grid(width, height)))
    want, ok = waves(place), patch.valid
    du, dv = (waves(place + step) - waves(place - step) for step in (np.array([0.01, 0.0]), np.array([0.0, 0.01])))
    columns = np.stack([du[ok] / 0.02, dv[ok] / 0.02, want[ok] - 127, np.ones(ok.sum())], axis=1)
    solution = np.linalg.lstsq(columns, patch.pixels[ok] - want[ok], rcond=None)[0]
    return float(np.hypot(solution[0], solution[1]))


@pytest.mark.parametrize(
    ("where", "turn_deg"), [*((where, 0.0) for where in (NORTH, SOUTH, GEOGRAPHIC, FEET)), (NORTH, 17.0), (FEET, -100.0)]
)
def test_windows_are_where_they_say(tmp_path: Path, write_raster, where, turn_deg: float) -> None:
    T = write_raster(tmp_path / "a.tif", image(), where[0], where[1], 0.5, turn_deg)
    ref = RasterMap.open(tmp_path / "a.tif")
    assert isinstance(ref, ReferenceMap)
    for gsd_m in (0.2, 0.5, 0.61, 0.9, 1.3):
        for heading_rad in (0.0, 0.3, 1.7, -2.5):
            patch = ref.patch(ref.center_map_m, (131, 90), gsd_m, heading_rad)
            assert patch.valid.all()
            assert shift_px(patch, T) < 0.05
            if gsd_m < 0.7:
                height, width = patch.pixels.shape
                place = apply_affine(invert_affine(T), apply_affine(patch.T_map_pix, pix_grid(width, height)))
                assert np.abs(patch.pixels - waves(place)).max() < 3


@pytest.mark.parametrize("where", [NORTH, SOUTH, GEOGRAPHIC, FEET])
def test_window_has_the_scale_centre_and_heading_that_were_asked_for(tmp_path: Path, write_raster, where) -> None:
    write_raster(tmp_path / "a.tif", image(), where[0], where[1], 0.5)
    ref = RasterMap.open(tmp_path / "a.tif")
    assert ref.gsd_m == pytest.approx(0.5, rel=1e-6)
    centre, heading = ref.center_map_m, 0.4
    patch = ref.patch(centre, (101, 61), 0.7, heading)
    assert apply_affine(patch.T_map_pix, np.array([50.0, 30.0])) == pytest.approx(centre, abs=1e-9)
    to_ne = np.linalg.inv(ref.projection_at(GeoPoint(*ref.to_geo(*centre), 0.0)).J_map_ne)
    up = to_ne @ patch.T_map_pix[:, :2] @ [0.0, -1.0]
    right = to_ne @ patch.T_map_pix[:, :2] @ [1.0, 0.0]
    assert (np.linalg.norm(up), np.linalg.norm(right)) == pytest.approx((0.7, 0.7), rel=1e-6)
    assert up @ right == pytest.approx(0.0, abs=1e-9)
    grid_north = to_ne @ [0.0, 1.0]
    true_heading = math.atan2(up[1], up[0]) - math.atan2(grid_north[1], grid_north[0])
    assert true_heading == pytest.approx(heading, abs=1e-9)


def test_thinned_windows_are_averages_not_samples(tmp_path: Path, write_raster) -> None:
    noise = np.random.default_rng(1).integers(0, 256, (1200, 1200)).astype(np.uint8)
    write_raster(tmp_path / "a.tif", noise, *NORTH, 0.5)
    ref = RasterMap.open(tmp_path / "a.tif")
    for gsd_m, heading in ((2.0, 0.0), (2.0, 0.5), (2.9, 0.5), (4.0, 1.0)):
        pixels = ref.patch(ref.center_map_m, (100, 100), gsd_m, heading).pixels
        n = (gsd_m / 0.5) ** 2
        assert 0.4 * 74 / math.sqrt(n) < pixels.std() < 1.35 * 74 / math.sqrt(n), "noise falls as in an average of n pixels"
        assert pixels.mean() == pytest.approx(127.5, abs=1.5)


def test_holes_and_outside_are_invalid_and_zero(tmp_path: Path, write_raster) -> None:
    rgba = np.dstack([image(300)] * 3 + [np.full((300, 300), 255, np.uint8)])
    rgba[100:140, 120:180, 3] = 0
    rgba[100:140, 120:180, :3] = 255
    T = write_raster(tmp_path / "a.tif", rgba, *NORTH, 1.0, photometric="RGB", alpha="yes")
    ref = RasterMap.open(tmp_path / "a.tif")
    patch = ref.patch(ref.center_map_m, (420, 420), 1.0, 0.3)
    place = apply_affine(invert_affine(T), apply_affine(patch.T_map_pix, pix_grid(420, 420)))
    u, v = place[..., 0], place[..., 1]
    hole = (u > 119.5) & (u < 179.5) & (v > 99.5) & (v < 139.5)
    far = (u < 116) | (u > 183) | (v < 96) | (v > 143)
    on_map = (u > -0.45) & (v > -0.45) & (u < 299.45) & (v < 299.45)
    off_map = (u < -0.55) | (v < -0.55) | (u > 299.55) | (v > 299.55)
    assert not patch.valid[hole | off_map].any()
    assert patch.valid[on_map & far].all()
    assert patch.pixels.shape == (420, 420, 3)
    assert not patch.pixels[~patch.valid].any()
    assert np.abs(patch.pixels[patch.valid][:, 0] - waves(place[patch.valid])).max() < 25, "no white bleeds out of the hole"
    thin = ref.patch(ref.center_map_m, (60, 60), 6.0, 0.3)
    assert 0.3 < thin.valid.mean() < 0.75
    assert thin.pixels[thin.valid].max() < 240


def test_nodata_value_is_invalid(tmp_path: Path, write_raster) -> None:
    grey = image(200)
    grey[:, :50] = 0
    write_raster(
        tmp_path / "a.tif", np.maximum(grey, np.where(np.arange(200) < 50, 0, 1)).astype(np.uint8), *NORTH, 1.0, nodata=0
    )
    patch = RasterMap.open(tmp_path / "a.tif").patch(map_crs(NORTH[0]).to_map(*NORTH[1]), (198, 198), 1.0, 0.0)
    assert not patch.valid[:, :48].any() and patch.valid[:, 55:].all()


def surface(side: int) -> np.ndarray:
    v, u = np.mgrid[:side, :side]
    return (500 + 0.25 * u - 0.1 * v).astype(np.float32)


@pytest.mark.parametrize(("crs", "gsd_m"), [("EPSG:32612", 2.0), ("EPSG:32611", 2.0), ("EPSG:4326", 2.0), ("EPSG:32612", 0.3)])
def test_heights_of_any_grid_lie_on_the_pixels(tmp_path: Path, write_raster, crs: str, gsd_m: float) -> None:
    side = 800 if gsd_m < 1 else 400
    write_raster(tmp_path / "a.tif", image(400), *NORTH, 0.5)
    T = write_raster(tmp_path / "dsm.tif", surface(side), crs, NORTH[1], gsd_m)
    ref = RasterMap.open(tmp_path / "a.tif", tmp_path / "dsm.tif", 7.0)
    patch = ref.patch(ref.center_map_m, (140, 120), 0.6, 0.9)
    assert patch.valid.all()
    assert patch.dsm_amsl_m.dtype == np.float32
    assert patch.dsm_gsd_m == pytest.approx(gsd_m, rel=0.01)
    places = apply_affine(patch.T_map_pix, pix_grid(140, 120)).reshape(-1, 2)
    geo = map_crs(NORTH[0]).to_geo_array(places)
    pix = apply_affine(invert_affine(T), map_crs(crs).to_map_array(geo))
    truth = 500 + 0.25 * pix[:, 0] - 0.1 * pix[:, 1]
    assert np.abs(patch.dsm_amsl_m.ravel() - truth).max() < 0.02
    assert ref.heights_amsl_m(places) == pytest.approx(truth, abs=0.001)
    assert ref.height_amsl_m(*places[77]) == pytest.approx(truth[77], abs=0.001)


def test_heights_in_feet_become_metres(tmp_path: Path, write_raster) -> None:
    write_raster(tmp_path / "a.tif", image(100), *NORTH, 1.0)
    write_raster(tmp_path / "dsm.tif", np.full((100, 100), 1000, np.float32), *NORTH, 1.0)
    with rasterio.open(tmp_path / "dsm.tif", "r+") as dsm:
        dsm.units = ("ft",)
    ref = RasterMap.open(tmp_path / "a.tif", tmp_path / "dsm.tif")
    assert ref.height_amsl_m(*ref.center_map_m) == pytest.approx(304.8)
    with rasterio.open(tmp_path / "dsm.tif", "r+") as dsm:
        dsm.units = ("furlong",)
    with pytest.raises(MapError, match="furlong"):
        RasterMap.open(tmp_path / "a.tif", tmp_path / "dsm.tif")


def test_heights_on_a_grid_in_feet_need_their_unit(tmp_path: Path, write_raster) -> None:
    write_raster(tmp_path / "a.tif", image(100), *FEET, 1.0)
    write_raster(tmp_path / "dsm.tif", np.full((100, 100), 1000, np.float32), *FEET, 1.0)
    with pytest.raises(DatumMissing, match=r"dsm\.tif: its grid is in feet.*-units ft"):
        RasterMap.open(tmp_path / "a.tif", tmp_path / "dsm.tif")
    with rasterio.open(tmp_path / "dsm.tif", "r+") as dsm:
        dsm.units = ("m",)
    ref = RasterMap.open(tmp_path / "a.tif", tmp_path / "dsm.tif")
    assert ref.height_amsl_m(*ref.center_map_m) == pytest.approx(1000.0)
    write_raster(tmp_path / "dsm.tif", np.full((100, 100), 1000, np.float32), "EPSG:2227+6360", FEET[1], 1.0)
    ref = RasterMap.open(tmp_path / "a.tif", tmp_path / "dsm.tif")
    assert ref.height_amsl_m(*ref.center_map_m) == pytest.approx(304.8, abs=0.01)


def test_heights_on_a_grid_in_kilometres_are_metres(tmp_path: Path, write_raster) -> None:
    """They were refused as those of a grid in feet."""
    grid = "+proj=utm +zone=32 +datum=WGS84 +units=km", (47.5, 8.5), 1.0
    write_raster(tmp_path / "a.tif", image(100), *grid)
    write_raster(tmp_path / "dsm.tif", np.full((100, 100), 432.5, np.float32), *grid)
    ref = RasterMap.open(tmp_path / "a.tif", tmp_path / "dsm.tif")
    assert (ref.height_amsl_m(*ref.center_map_m), ref.gsd_m) == pytest.approx((432.5, 1.0), rel=1e-3)


def test_scale_and_offset_of_heights(tmp_path: Path, write_raster) -> None:
    write_raster(tmp_path / "a.tif", image(100), *NORTH, 1.0)
    write_raster(tmp_path / "dsm.tif", np.full((100, 100), 1234, np.int16), *NORTH, 1.0)
    with rasterio.open(tmp_path / "dsm.tif", "r+") as dsm:
        dsm.scales, dsm.offsets = (0.1,), (200.0,)
    ref = RasterMap.open(tmp_path / "a.tif", tmp_path / "dsm.tif")
    assert ref.height_amsl_m(*ref.center_map_m) == pytest.approx(323.4)


@pytest.mark.parametrize("unknown", [-9999, -32767, -3.4028234663852886e38, 1e20])
def test_heights_that_no_land_has_are_unknown_whether_or_not_the_file_says_so(
    tmp_path: Path, write_raster, unknown: float
) -> None:
    heights = surface(100)
    heights[:, :30] = unknown
    write_raster(tmp_path / "a.tif", image(100), *NORTH, 1.0)
    write_raster(tmp_path / "dsm.tif", heights, *NORTH, 1.0)
    patch = RasterMap.open(tmp_path / "a.tif", tmp_path / "dsm.tif").patch(
        map_crs(NORTH[0]).to_map(*NORTH[1]), (90, 20), 1.0, 0.0
    )
    assert np.isnan(patch.dsm_amsl_m[:, :23]).all() and not patch.valid[:, :23].any()
    assert patch.valid[:, 30:80].all()


@pytest.mark.parametrize("fill", [0, 255])
def test_fill_about_a_picture_is_empty_though_the_file_does_not_say_so(tmp_path: Path, write_raster, fill: int) -> None:
    rgb = np.dstack([image(300)] * 3)
    v, u = np.mgrid[:300, :300]
    corner = u + v < 200
    rgb[corner] = fill
    rgb[150:180, 200:230] = fill  # a roof
    rgb[295:, 100:103] = fill  # a thing at the border
    write_raster(tmp_path / "a.tif", rgb, *NORTH, 1.0, photometric="RGB")
    ref = RasterMap.open(tmp_path / "a.tif")
    patch = ref.patch(ref.center_map_m, (300, 300), 1.0, 0.0)
    np.testing.assert_array_equal(patch.valid, ~corner)


def test_near_infrared_that_is_marked_as_alpha_hides_nothing(tmp_path: Path, write_raster) -> None:
    bands = np.dstack([image(300)] * 4)
    write_raster(tmp_path / "a.tif", bands, *NORTH, 1.0, photometric="RGB", alpha="yes")
    ref = RasterMap.open(tmp_path / "a.tif")
    assert ref.patch(ref.center_map_m, (290, 290), 1.0, 0.0).valid.all()


def test_a_picture_is_no_surface_model(tmp_path: Path, write_raster) -> None:
    write_raster(tmp_path / "a.tif", np.dstack([image(100)] * 3), *NORTH, 1.0, photometric="RGB")
    with pytest.raises(MapError, match=r"a\.tif: holds colours, no heights"):
        RasterMap.open(tmp_path / "a.tif", tmp_path / "a.tif")


def test_alpha_of_a_wider_type_counts_from_its_smallest_value(tmp_path: Path, write_raster) -> None:
    bands = np.dstack([image(100).astype(np.uint16) * 100] * 3 + [np.full((100, 100), 255, np.uint16)])
    bands[:, :30, 3] = 0
    write_raster(tmp_path / "a.tif", bands, *NORTH, 1.0, photometric="RGB", alpha="yes")
    ref = RasterMap.open(tmp_path / "a.tif")
    patch = ref.patch(ref.center_map_m, (90, 20), 1.0, 0.0)
    assert patch.valid[:, 30:].all() and not patch.valid[:, :20].any()


def test_unknown_heights_are_not_a_number_and_invalid(tmp_path: Path, write_raster) -> None:
    heights = surface(100)
    heights[:, :30] = -9999
    write_raster(tmp_path / "a.tif", image(200), *NORTH, 1.0)
    for crs in (NORTH[0], "EPSG:32611"):
        write_raster(tmp_path / "dsm.tif", heights, crs, NORTH[1], 1.0, nodata=-9999)
        ref = RasterMap.open(tmp_path / "a.tif", tmp_path / "dsm.tif")
        patch = ref.patch(ref.center_map_m, (180, 20), 1.0, 0.0)
        assert np.isnan(patch.dsm_amsl_m[:, :66]).all() and not patch.valid[:, :66].any()
        assert patch.valid[:, 76:136].all()
        assert patch.dsm_amsl_m[patch.valid].min() > 480
        easting, northing = ref.center_map_m
        assert math.isnan(ref.height_amsl_m(easting - 40, northing))
        assert math.isnan(ref.height_amsl_m(easting + 5000, northing))


def test_plane_where_there_is_no_surface_model(tmp_path: Path, write_raster) -> None:
    write_raster(tmp_path / "a.tif", image(100), *NORTH, 1.0)
    ref = RasterMap.open(tmp_path / "a.tif", ground_h_amsl_m=12.5)
    patch = ref.patch(ref.center_map_m, (10, 10), 1.0, 0.0)
    assert (patch.dsm_amsl_m == 12.5).all()
    assert patch.dsm_gsd_m == 0
    easting, northing = ref.center_map_m
    assert ref.height_amsl_m(easting, northing) == 12.5
    assert math.isnan(ref.height_amsl_m(easting + 51, northing))


def test_outside_and_impossible_windows(tmp_path: Path, write_raster) -> None:
    write_raster(tmp_path / "a.tif", image(100), *NORTH, 1.0)
    ref = RasterMap.open(tmp_path / "a.tif")
    easting, northing = ref.center_map_m
    for heading in (0.0, 0.5):
        with pytest.raises(OutsideMap):
            ref.patch((easting + 200, northing), (100, 100), 1.0, heading)
    with pytest.raises(OutsideMap):
        ref.patch((math.nan, northing), (100, 100), 1.0, 0.0)
    for size, gsd in (((0, 5), 1.0), ((5, 5), 0.0), ((5, 5), math.nan), ((5, 5), -1.0)):
        with pytest.raises(MapError, match="no window"):
            ref.patch((easting, northing), size, gsd, 0.0)


def test_covers_with_margin(tmp_path: Path, write_raster) -> None:
    write_raster(tmp_path / "a.tif", image(100), *NORTH, 1.0)
    ref = RasterMap.open(tmp_path / "a.tif")
    easting, northing = ref.center_map_m
    place = ref.to_geo(easting + 55, northing)
    assert not ref.covers(*place)
    assert ref.covers(*place, margin_m=6)
    inside = ref.to_geo(easting + 45, northing)
    assert ref.covers(*inside) and not ref.covers(*inside, margin_m=-6)
    assert not ref.covers(95.0, 10.0)


def test_large_rasters_are_read_by_windows(tmp_path: Path, write_raster, monkeypatch: pytest.MonkeyPatch) -> None:
    rgb = np.dstack([image(700), image(700)[::-1], image(700)[:, ::-1]])
    write_raster(tmp_path / "a.tif", rgb, *NORTH, 0.5, photometric="RGB", tiled=True, blockxsize=128, blockysize=128)
    write_raster(tmp_path / "dsm.tif", surface(300), *NORTH, 2.0)
    whole = RasterMap.open(tmp_path / "a.tif", tmp_path / "dsm.tif")
    monkeypatch.setattr("visloc_companion.maps.geotiff.IN_MEMORY_BYTES", 1000)
    lazy = RasterMap.open(tmp_path / "a.tif", tmp_path / "dsm.tif")
    for size, gsd, heading in (((90, 70), 0.5, 0.0), ((90, 70), 0.5, 0.4), ((60, 60), 2.2, 1.0), ((500, 400), 1.0, 0.2)):
        a, b = (ref.patch(ref.center_map_m, size, gsd, heading) for ref in (whole, lazy))
        assert (a.valid == b.valid).mean() > 0.995
        both = a.valid & b.valid
        assert np.abs(a.pixels[both].astype(int) - b.pixels[both]).max() <= 2
        assert np.abs(a.dsm_amsl_m[both] - b.dsm_amsl_m[both]).max() < 0.05


def test_windows_of_thousands_of_pixels_are_whole(tmp_path: Path, write_raster) -> None:
    T = write_raster(tmp_path / "a.tif", image(900), *NORTH, 0.5)
    patch = RasterMap.open(tmp_path / "a.tif").patch(map_crs(NORTH[0]).to_map(*NORTH[1]), (2600, 2300), 0.12, 0.2)
    place = apply_affine(invert_affine(T), apply_affine(patch.T_map_pix, pix_grid(2600, 2300)))
    assert patch.valid.all()
    assert np.abs(patch.pixels - waves(place)).max() < 4, "chunks join without a seam"


def test_sixteen_bit_imagery_is_stretched(tmp_path: Path, write_raster) -> None:
    deep = (300 + 10 * waves(pix_grid(200, 200))).astype(np.uint16)
    write_raster(tmp_path / "a.tif", deep, *NORTH, 1.0)
    ref = RasterMap.open(tmp_path / "a.tif")
    pixels = ref.patch(ref.center_map_m, (150, 150), 1.0, 0.0).pixels
    assert pixels.dtype == np.uint8
    assert pixels.min() < 10 and pixels.max() > 245
    flat = np.full((64, 64), np.nan, np.float32)
    write_raster(tmp_path / "nan.tif", flat, *NORTH, 1.0, nodata=math.nan)
    with pytest.raises(MapError, match="no valid pixel"):
        RasterMap.open(tmp_path / "nan.tif")


def test_bad_files_are_refused_by_name(tmp_path: Path, write_raster) -> None:
    write_raster(tmp_path / "good.tif", image(300), *NORTH, 1.0, compress="deflate")
    whole = (tmp_path / "good.tif").read_bytes()
    (tmp_path / "cut.tif").write_bytes(whole[: len(whole) // 2])
    (tmp_path / "noise.tif").write_bytes(b"not a picture" * 100)
    for name in ("cut.tif", "noise.tif", "absent.tif"):
        with pytest.raises(MapError, match=rf"{name}.*remedy"):
            RasterMap.open(tmp_path / name)
    with rasterio.open(
        tmp_path / "nocrs.tif",
        "w",
        driver="GTiff",
        width=9,
        height=9,
        count=1,
        dtype="uint8",
        transform=rasterio.Affine(1, 0, 5e5, 0, -1, 5e6),
    ) as out:
        out.write(np.ones((1, 9, 9), np.uint8))
    with pytest.raises(DatumMissing, match=r"nocrs\.tif.*gdal_edit"):
        RasterMap.open(tmp_path / "nocrs.tif")
    with (
        pytest.warns(rasterio.errors.NotGeoreferencedWarning),
        rasterio.open(
            tmp_path / "noplace.tif", "w", driver="GTiff", width=9, height=9, count=1, dtype="uint8", crs="EPSG:32612"
        ) as out,
    ):
        out.write(np.ones((1, 9, 9), np.uint8))
    with pytest.raises(DatumMissing, match=r"noplace\.tif.*georeference"):
        RasterMap.open(tmp_path / "noplace.tif")


def test_a_folder_is_no_raster(tmp_path: Path) -> None:
    with pytest.raises(MapError, match="is a folder; remedy"):
        RasterMap.open(tmp_path)


def test_colour_tables_are_refused_and_four_bands_read_as_colour(tmp_path: Path, write_raster) -> None:
    write_raster(tmp_path / "p.tif", image(64), *NORTH, 1.0, photometric="palette")
    with rasterio.open(tmp_path / "p.tif", "r+") as out:
        out.write_colormap(1, {k: (k, k, 255 - k, 255) for k in range(256)})
    with pytest.raises(MapError, match="colour table"):
        RasterMap.open(tmp_path / "p.tif")
    write_raster(tmp_path / "n.tif", np.dstack([image(64)] * 4), *NORTH, 1.0, photometric="minisblack")
    ref = RasterMap.open(tmp_path / "n.tif")
    assert ref.patch(ref.center_map_m, (8, 8), 1.0, 0.0).pixels.shape == (8, 8, 3)


@pytest.mark.shared
def test_two_dates_of_one_place_agree(shared_data: Path) -> None:
    maps = [RasterMap.open(shared_data / "naip" / f"{date}.tif") for date in ("20150926", "20160816")]
    a, b = (ref.patch(maps[0].center_map_m, (200, 200), 5.0, 0.5).pixels.mean(axis=2).ravel() for ref in maps)
    assert np.corrcoef(a, b)[0, 1] > 0.4


def test_places_spread_over_a_map_are_the_middles_of_equal_parts(tmp_path: Path, write_raster) -> None:
    T = write_raster(tmp_path / "a.tif", np.full((60, 90), 100, np.uint8), *NORTH, 2.0)
    spread = RasterMap.open(tmp_path / "a.tif").spread_map_m(3)
    assert spread.shape == (3, 3, 2)
    for row in range(3):
        for col in range(3):
            np.testing.assert_allclose(spread[row, col], T @ [15 + 30 * col - 0.5, 10 + 20 * row - 0.5, 1.0])
