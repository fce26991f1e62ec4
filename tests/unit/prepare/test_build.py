import math
import struct
from pathlib import Path

import numpy as np
import pytest
import rasterio

from visloc_companion.errors import DatumMissing, MapError
from visloc_companion.geo.raster import apply_affine, invert_affine
from visloc_companion.localise.features.gradient import GRADIENT
from visloc_companion.maps.crs import map_crs
from visloc_companion.maps.pack import PackMap
from visloc_companion.maps.raster import RasterMap
from visloc_companion.prepare.build import build_pack
from visloc_companion.types import GeoPoint

UTM, PLACE = "EPSG:32633", (47.0, 15.3)


def picture(side: int, seed: int = 1) -> np.ndarray:
    coarse = np.random.default_rng(seed).uniform(20, 235, (side // 8 + 2, side // 8 + 2))
    t = np.arange(side) / 8
    i, f = t.astype(int), t - t.astype(int)
    rows = coarse[i] * (1 - f)[:, None] + coarse[i + 1] * f[:, None]
    return np.rint(rows[:, i] * (1 - f) + rows[:, i + 1] * f).astype(np.uint8)


def slope(side: int) -> np.ndarray:
    v, u = np.mgrid[:side, :side]
    return (400 + 0.1 * u + 0.05 * v).astype(np.float32)


def test_pack_shows_what_the_files_show(tmp_path: Path, write_raster) -> None:
    rgb = np.dstack([picture(700, k) for k in range(3)])
    write_raster(tmp_path / "a.tif", rgb, UTM, PLACE, 0.5, photometric="RGB")
    write_raster(tmp_path / "dsm.tif", slope(300), UTM, PLACE, 1.5)
    stages: list[tuple[str, float]] = []
    manifest = build_pack(
        [tmp_path / "a.tif"], tmp_path / "dsm.tif", tmp_path / "pack", capture_date="2021-05-06", source="s", licence="CC0-1.0",
        progress=lambda stage, share: stages.append((stage, share)),
    )  # fmt: skip
    pack, files = PackMap.open(tmp_path / "pack"), RasterMap.open(tmp_path / "a.tif", tmp_path / "dsm.tif")
    assert pack.manifest == manifest
    assert (manifest.capture_date, manifest.source, manifest.licence, manifest.name) == ("2021-05-06", "s", "CC0-1.0", "pack")
    assert manifest.crs.epsg == 32633 and manifest.gsd_m == pytest.approx(0.5, rel=1e-4)
    for size, gsd, heading in (((200, 150), 0.5, 0.0), ((200, 150), 0.5, 0.7), ((90, 90), 1.3, 2.0), ((40, 40), 4.0, 0.3)):
        a, b = (ref.patch(files.center_map_m, size, gsd, heading) for ref in (pack, files))
        both = a.valid & b.valid
        assert both.mean() > 0.95
        assert np.abs(a.pixels[both].astype(int) - b.pixels[both]).max() <= 2
        assert np.abs(a.dsm_amsl_m[both] - b.dsm_amsl_m[both]).max() < 0.02
        assert a.dsm_gsd_m == pytest.approx(b.dsm_gsd_m, rel=0.01)
    assert {stage for stage, _ in stages} == {"inputs", "orthophoto", "surface model", "features gradient", "hashes"}
    assert all(0 <= share <= 1 for _, share in stages) and stages[-1] == ("hashes", 1.0)
    assert not list(tmp_path.glob(".pack*"))


def test_sixteen_bit_tiles_of_one_survey_stay_alike(tmp_path: Path, write_raster) -> None:
    bright = 3000 + 40 * picture(200).astype(np.uint16)
    write_raster(tmp_path / "n.tif", bright, UTM, PLACE, 0.5)
    write_raster(tmp_path / "s.tif", bright // 3, UTM, (PLACE[0] - 100 / 111_200, PLACE[1]), 0.5)
    build_pack([tmp_path / "n.tif", tmp_path / "s.tif"], None, tmp_path / "pack")
    pack = PackMap.open(tmp_path / "pack")
    to_map = map_crs(UTM).to_map
    middles = [np.array(to_map(PLACE[0] - south_m / 111_200, PLACE[1])) for south_m in (0, 100)]
    north, south = (pack.patch((float(m[0]), float(m[1])), (60, 60), 0.5, 0.0).pixels.astype(float) for m in middles)
    assert north.mean() > 2 * south.mean()  # each by its own values, both would have the same mean


def test_rasters_are_cloud_optimised_and_uncompressed(tmp_path: Path, write_raster) -> None:
    write_raster(tmp_path / "a.tif", picture(1300), UTM, PLACE, 0.5)
    build_pack([tmp_path / "a.tif"], None, tmp_path / "pack")
    with rasterio.open(tmp_path / "pack" / "ortho.tif") as cog:
        assert cog.tags(ns="IMAGE_STRUCTURE").get("LAYOUT") == "COG"
        assert cog.compression is None
        assert cog.block_shapes[0] == (256, 256)
        assert cog.overviews(1) == [2, 4]
        assert (cog.width % 4, cog.height % 4) == (0, 0)


def test_geographic_rasters_become_utm(tmp_path: Path, write_raster) -> None:
    T = write_raster(tmp_path / "a.tif", picture(500), "EPSG:4326", PLACE, 0.5)
    write_raster(tmp_path / "dsm.tif", slope(200), "EPSG:4326", PLACE, 2.0)
    manifest = build_pack([tmp_path / "a.tif"], tmp_path / "dsm.tif", tmp_path / "pack")
    assert manifest.crs.epsg == 32633 and manifest.gsd_m == pytest.approx(0.5, rel=1e-3)
    pack, files = PackMap.open(tmp_path / "pack"), RasterMap.open(tmp_path / "a.tif", tmp_path / "dsm.tif")
    patch = pack.patch(pack.center_map_m, (120, 100), 0.5, 0.4)
    stored = pack.stored_patch(pack.center_map_m, (20, 20), 2.0, "gradient", GRADIENT.recipe)
    assert stored is not None
    assert stored.dsm_gsd_m == patch.dsm_gsd_m == pytest.approx(2.0, rel=0.02)
    v, u = np.mgrid[:100, :120]
    places = apply_affine(patch.T_map_pix, np.stack([u, v], axis=-1).reshape(-1, 2).astype(float))
    geo = pack.crs.to_geo_array(places)
    heights = files.heights_amsl_m(geo[:, ::-1])
    assert np.abs(patch.dsm_amsl_m.ravel() - heights).max() < 0.02
    truth = picture(500)
    at = apply_affine(invert_affine(T), geo[:, ::-1])
    nearest = truth[np.rint(at[:, 1]).astype(int), np.rint(at[:, 0]).astype(int)]
    assert np.corrcoef(nearest, patch.pixels.ravel())[0, 1] > 0.98


def test_turned_feet_and_mercator_rasters_become_metric_and_north_up(tmp_path: Path, write_raster) -> None:
    for crs, place, turn in (("EPSG:2227", (37.5, -122.0), 0.0), ("EPSG:3857", PLACE, 0.0), (UTM, PLACE, 25.0)):
        write_raster(tmp_path / "a.tif", picture(300), crs, place, 1.0, turn)
        manifest = build_pack([tmp_path / "a.tif"], None, tmp_path / "pack")
        a, b, _, d, e, _ = manifest.ortho.transform
        assert (b, d, a) == (0.0, 0.0, -e)
        assert map_crs(manifest.crs.wkt).metres_per_unit == 1.0
        assert manifest.gsd_m == pytest.approx(1.0, rel=2e-3)
        assert PackMap.open(tmp_path / "pack").covers(*place)


@pytest.mark.parametrize(
    ("crs", "east_deg"), [("EPSG:4326", 180.0), ("EPSG:4326", -180.0), ("EPSG:4326", 190.0), ("EPSG:32701", 180.0)]
)
def test_maps_about_and_beyond_the_antimeridian_are_whole(tmp_path: Path, write_raster, crs: str, east_deg: float) -> None:
    write_raster(tmp_path / "a.tif", picture(200), crs, (-16.8, east_deg), 1.0)
    write_raster(tmp_path / "dsm.tif", slope(200), "EPSG:4326", (-16.8, east_deg), 1.0)
    manifest = build_pack([tmp_path / "a.tif"], tmp_path / "dsm.tif", tmp_path / "pack")
    pack = PackMap.open(tmp_path / "pack")
    assert manifest.share_valid > 0.95 and manifest.heights.share_known > 0.95
    for step_deg in (-5e-4, 5e-4):
        lon_deg = (east_deg + step_deg + 180) % 360 - 180
        patch = pack.patch(pack.to_map(-16.8, lon_deg), (9, 9), 1.0, 0.0)
        assert patch.valid.all()
        assert patch.dsm_amsl_m[4, 4] == pytest.approx(415 + step_deg * 1.066e5 * 0.1, abs=0.6)
    bounds = manifest.bounds
    assert (bounds.east_deg - bounds.west_deg) % 360 < 0.003
    assert (bounds.west_deg > bounds.east_deg) == (abs(east_deg) == 180)
    assert bounds.east_map_m - bounds.west_map_m == pytest.approx(manifest.ortho.cols * manifest.ortho.transform[0])


@pytest.mark.parametrize(("crs", "place", "gsd_m"), [("EPSG:4326", (10.0, 20.0), 50_000.0), (UTM, PLACE, 30_000.0)])
def test_a_raster_of_a_continent_is_refused(
    tmp_path: Path, write_raster, crs: str, place: tuple[float, float], gsd_m: float
) -> None:
    write_raster(tmp_path / "a.tif", picture(64), crs, place, gsd_m)
    with pytest.raises(MapError, match=r"a\.tif: (spans|has no place).*remedy"):
        build_pack([tmp_path / "a.tif"], None, tmp_path / "pack")


def test_first_orthophoto_lies_on_top_and_others_fill(tmp_path: Path, write_raster) -> None:
    first = np.full((200, 200), 200, np.uint8)
    first[:, 150:] = 0
    write_raster(tmp_path / "a.tif", first, UTM, PLACE, 1.0, nodata=0)
    write_raster(tmp_path / "b.tif", np.full((200, 200, 3), 90, np.uint8), "EPSG:32634", PLACE, 1.0, photometric="RGB")
    build_pack([tmp_path / "a.tif", tmp_path / "b.tif"], None, tmp_path / "pack")
    pack = PackMap.open(tmp_path / "pack")
    patch = pack.patch(map_crs(UTM).to_map(*PLACE), (180, 180), 1.0, 0.0)
    assert patch.pixels.shape[2] == 3
    assert patch.valid.all()
    assert (patch.pixels[20:160, 20:130] == 200).all() and (patch.pixels[20:160, 145:170] == 90).all()


def test_a_finer_orthophoto_below_a_coarse_one_is_told(tmp_path: Path, write_raster) -> None:
    """Of a survey of 0.5 m below a satellite's picture of 5 m nothing was left, without a word."""
    fine, alike, coarse = (tmp_path / name for name in ("fine.tif", "alike.tif", "coarse.tif"))
    for path, side, gsd_m in ((fine, 200, 0.5), (alike, 200, 0.45), (coarse, 60, 5.0)):
        write_raster(path, picture(side), UTM, PLACE, gsd_m)
    said: list[str] = []
    assert build_pack([coarse, fine], None, tmp_path / "pack", warn=said.append).gsd_m == pytest.approx(5.0, rel=1e-3)
    (words,) = said
    assert words.startswith(f"{fine} has pixels of 0.5 m, and the pack gets those of {coarse}, 5 m") and "finest first" in words
    build_pack([fine, alike, coarse], None, tmp_path / "pack", warn=said.append)
    assert said == [words]


def test_a_finer_surface_model_below_a_coarse_one_is_told(tmp_path: Path, write_raster) -> None:
    """The fine model's crowns and roofs were lost, without a word; what is finer than the orthophoto serves nobody."""
    ortho, fine, finer, coarse = (tmp_path / f"{name}.tif" for name in ("ortho", "fine", "finer", "coarse"))
    write_raster(ortho, picture(300), UTM, PLACE, 2.0)
    for path, side, gsd_m in ((fine, 300, 1.5), (finer, 300, 1.0), (coarse, 30, 20.0)):
        write_raster(path, np.full((side, side), 300, np.float32), UTM, PLACE, gsd_m)
    said: list[str] = []
    build_pack([ortho], [coarse, fine], tmp_path / "pack", warn=said.append)
    (words,) = said
    assert words.startswith(f"{fine} has pixels of 1.5 m, and the pack gets those of {coarse}, 20 m") and "finest first" in words
    build_pack([ortho], [fine, finer, coarse], tmp_path / "pack", warn=said.append)
    assert said == [words]


def test_a_hillshade_is_no_surface_model(tmp_path: Path, write_raster) -> None:
    write_raster(tmp_path / "a.tif", picture(100), UTM, PLACE, 1.0)
    files = [tmp_path / "a.tif"], tmp_path / "shade.tif", tmp_path / "pack"
    write_raster(tmp_path / "shade.tif", picture(100), UTM, PLACE, 1.0)
    with pytest.raises(MapError, match=r"shade\.tif: holds 256 shades, .*; remedy: name the surface model itself"):
        build_pack(*files)
    with rasterio.open(tmp_path / "shade.tif", "r+") as heights:
        heights.scales, heights.offsets = (2.0,), (100.0,)
    assert build_pack(*files).heights.share_known == 1.0


def test_small_holes_of_the_surface_are_filled_and_large_ones_are_not(tmp_path: Path, write_raster) -> None:
    heights = slope(300)
    heights[100:106, 100:106] = -9999
    heights[180:260, 180:260] = -9999
    write_raster(tmp_path / "a.tif", picture(300), UTM, PLACE, 1.0)
    write_raster(tmp_path / "dsm.tif", heights, UTM, PLACE, 1.0, nodata=-9999)
    manifest = build_pack([tmp_path / "a.tif"], tmp_path / "dsm.tif", tmp_path / "pack")
    assert 0.9 < manifest.heights.share_known < 0.99
    assert manifest.heights.share_filled > 36 / 300**2 * 0.8
    pack = PackMap.open(tmp_path / "pack")
    easting, northing = pack.T_map_pix @ [103, 103, 1]
    assert pack.height_amsl_m(easting, northing) == pytest.approx(slope(300)[103, 103], abs=1.0)
    easting, northing = pack.T_map_pix @ [220, 220, 1]
    assert np.isnan(pack.height_amsl_m(easting, northing))


@pytest.mark.parametrize("pixel_m", [1.0, 5.0, 30.0])
def test_heights_are_not_made_up_far_beyond_a_surface_model(tmp_path: Path, write_raster, pixel_m: float) -> None:
    """A model of 30 m was carried on 360 m beyond its end, on a slope of 20 % 70 m wrong."""
    T = write_raster(tmp_path / "a.tif", picture(1200), UTM, PLACE, 1.0)
    side = round(1260 / pixel_m)
    heights = 400 + 0.2 * pixel_m * (np.tile(np.arange(side), (side, 1)) + 0.5 - side / 2)
    heights[:, side // 2 :] = -9999
    heights[side // 2, side // 4] = -9999
    write_raster(tmp_path / "dsm.tif", heights.astype(np.float32), UTM, PLACE, pixel_m, nodata=-9999)
    build_pack([tmp_path / "a.tif"], tmp_path / "dsm.tif", tmp_path / "pack")
    pack = PackMap.open(tmp_path / "pack")
    right = np.arange(1200)
    found = pack.heights_amsl_m(apply_affine(T, np.column_stack([right, np.full(1200, 600)]).astype(float)))
    known = np.isfinite(found)
    assert np.abs(found - 400 - 0.2 * (right - 599.5))[known].max() < 0.2 * 60
    assert known[:560].all() and not known[600 + 46 :].any()  # the small hole at a quarter is filled


@pytest.mark.parametrize("pixel_m", [2.0, 30.0, 500.0])
def test_heights_at_the_orthophotos_border_lie_between_known_ones(tmp_path: Path, write_raster, pixel_m: float) -> None:
    T = write_raster(tmp_path / "a.tif", picture(300), UTM, PLACE, 1.0)
    side = round(300 / pixel_m) // 2 * 2 + 6
    v, u = np.mgrid[:side, :side] - (side - 1) / 2
    write_raster(tmp_path / "dsm.tif", (400 + pixel_m * (0.2 * u + 0.1 * v)).astype(np.float32), UTM, PLACE, pixel_m)
    manifest = build_pack([tmp_path / "a.tif"], tmp_path / "dsm.tif", tmp_path / "pack")
    pack = PackMap.open(tmp_path / "pack")
    v, u = np.mgrid[:300:13, :300:13]
    heights = pack.heights_amsl_m(apply_affine(T, np.column_stack([u.ravel(), v.ravel()]).astype(float)))
    np.testing.assert_allclose(heights, 400 + 0.2 * (u.ravel() - 149.5) + 0.1 * (v.ravel() - 149.5), atol=0.01)
    assert pack.patch(pack.center_map_m, (280, 280), 1.0, 0.0).valid.all()
    assert manifest.heights.share_known == 1.0


def test_a_hole_of_a_coarse_surface_model_counts(tmp_path: Path, write_raster) -> None:
    write_raster(tmp_path / "a.tif", picture(300), UTM, PLACE, 1.0)
    heights = np.full((120, 120), 400, np.float32)
    heights[60:, 60:] = -9999
    write_raster(tmp_path / "dsm.tif", heights, UTM, PLACE, 5.0, nodata=-9999)
    share = build_pack([tmp_path / "a.tif"], tmp_path / "dsm.tif", tmp_path / "pack").heights.share_known
    assert share == pytest.approx(1 - 24**2 / 60**2, abs=0.02), "of its 30 x 30 pixels 6 at the edge, 30 m, are filled"


def test_ellipsoidal_heights_need_and_get_the_undulation(tmp_path: Path, write_raster) -> None:
    write_raster(tmp_path / "a.tif", picture(200), UTM, PLACE, 1.0)
    write_raster(tmp_path / "dsm.tif", slope(200), UTM, PLACE, 1.0)
    with pytest.raises(DatumMissing, match=r"dsm\.tif.*--geoid-undulation-m"):
        build_pack([tmp_path / "a.tif"], tmp_path / "dsm.tif", tmp_path / "pack", vertical_datum="ellipsoidal")
    build_pack(
        [tmp_path / "a.tif"], tmp_path / "dsm.tif", tmp_path / "pack", vertical_datum="ellipsoidal", geoid_undulation_m=46.5
    )
    pack = PackMap.open(tmp_path / "pack")
    assert pack.height_amsl_m(*pack.center_map_m) == pytest.approx(slope(200)[99:101, 99:101].mean() - 46.5, abs=0.01)
    assert (pack.manifest.heights.source_datum, pack.manifest.heights.geoid_undulation_m) == ("ellipsoidal", 46.5)


def test_an_undulation_that_would_be_passed_over_or_is_none_is_refused(tmp_path: Path, write_raster) -> None:
    write_raster(tmp_path / "a.tif", picture(100), UTM, PLACE, 1.0)
    write_raster(tmp_path / "dsm.tif", slope(100), UTM, PLACE, 1.0)
    files = [tmp_path / "a.tif"], tmp_path / "dsm.tif", tmp_path / "pack"
    for stated in (None, "amsl"):
        with pytest.raises(DatumMissing, match=r"--geoid-undulation-m: is given.*--vertical-datum ellipsoidal"):
            build_pack(*files, vertical_datum=stated, geoid_undulation_m=46.5)
    for undulation_m in (460.0, math.nan, math.inf):
        with pytest.raises(DatumMissing, match=rf"nowhere on earth.*{undulation_m:g} m.*remedy"):
            build_pack(*files, vertical_datum="ellipsoidal", geoid_undulation_m=undulation_m)
    with pytest.raises(DatumMissing, match=r"--geoid-undulation-m: is given.*remedy"):
        build_pack([tmp_path / "a.tif"], None, tmp_path / "pack", ground_h_amsl_m=430.0, geoid_undulation_m=46.5)


def test_three_dimensional_crs_is_ellipsoidal(tmp_path: Path, write_raster) -> None:
    write_raster(tmp_path / "a.tif", picture(100), "EPSG:4326", PLACE, 1.0)
    write_raster(tmp_path / "dsm.tif", slope(100), "EPSG:4979", PLACE, 1.0)
    for stated in (None, "amsl"):
        with pytest.raises(DatumMissing, match="ellipsoidal"):
            build_pack([tmp_path / "a.tif"], tmp_path / "dsm.tif", tmp_path / "pack", vertical_datum=stated)


@pytest.mark.parametrize("key", [5019, 5030])
def test_geotiffs_old_keys_of_ellipsoids_count(tmp_path: Path, write_raster, key: int) -> None:
    """On a grid of another datum GDAL makes a vertical CRS without a name of them: heights counted as above sea level."""
    write_raster(tmp_path / "a.tif", picture(100), "EPSG:26911", (37.0, -117.0), 1.0)
    write_raster(tmp_path / "dsm.tif", slope(100), "EPSG:26911+5703", (37.0, -117.0), 1.0)
    raw = (tmp_path / "dsm.tif").read_bytes()
    vertical_crs = struct.pack("<4H", 4096, 0, 1, 5703)
    assert raw.count(vertical_crs) == 1
    (tmp_path / "dsm.tif").write_bytes(raw.replace(vertical_crs, struct.pack("<4H", 4096, 0, 1, key)))
    files = [tmp_path / "a.tif"], tmp_path / "dsm.tif", tmp_path / "pack"
    with pytest.raises(DatumMissing, match=r"dsm\.tif: heights are ellipsoidal and the geoid undulation is not given; remedy"):
        build_pack(*files)
    assert build_pack(*files, geoid_undulation_m=-30.0).heights.source_datum == "ellipsoidal"
    pack = PackMap.open(tmp_path / "pack")
    assert pack.height_amsl_m(*pack.center_map_m) == pytest.approx(float(np.median(slope(100))) + 30.0, abs=0.1)


def test_heights_that_the_crs_places_above_sea_level_are_not_corrected_once_more(tmp_path: Path, write_raster) -> None:
    write_raster(tmp_path / "a.tif", picture(100), UTM, PLACE, 1.0)
    write_raster(tmp_path / "dsm.tif", slope(100), f"{UTM}+5773", PLACE, 1.0)
    files = [tmp_path / "a.tif"], tmp_path / "dsm.tif", tmp_path / "pack"
    with pytest.raises(DatumMissing, match=r"dsm\.tif: its CRS says that heights are above sea level \(EGM96 height\); remedy"):
        build_pack(*files, vertical_datum="ellipsoidal", geoid_undulation_m=46.5)
    assert build_pack(*files, vertical_datum="amsl").heights.source_datum == "amsl"


def test_depths_are_no_heights(tmp_path: Path, write_raster) -> None:
    write_raster(tmp_path / "a.tif", picture(100), UTM, PLACE, 1.0)
    write_raster(tmp_path / "dsm.tif", slope(100), f"{UTM}+5715", PLACE, 1.0)
    with pytest.raises(DatumMissing, match=r"dsm\.tif: its CRS says that it holds depths \(MSL depth\); remedy"):
        build_pack([tmp_path / "a.tif"], tmp_path / "dsm.tif", tmp_path / "pack")


def test_plane_ground(tmp_path: Path, write_raster) -> None:
    write_raster(tmp_path / "a.tif", picture(100), UTM, PLACE, 1.0)
    build_pack([tmp_path / "a.tif"], None, tmp_path / "pack", ground_h_amsl_m=321.0)
    pack = PackMap.open(tmp_path / "pack")
    assert pack.height_amsl_m(*pack.center_map_m) == 321.0
    with pytest.raises(MapError, match="no orthophoto"):
        build_pack([], None, tmp_path / "pack")


def test_unusable_input_is_named_and_leaves_nothing_behind(tmp_path: Path, write_raster) -> None:
    write_raster(tmp_path / "a.tif", picture(600), UTM, PLACE, 1.0, compress="deflate")
    write_raster(tmp_path / "far.tif", slope(50), UTM, (48.0, 15.3), 1.0)
    write_raster(tmp_path / "empty.tif", np.full((50, 50), -9999, np.float32), UTM, PLACE, 1.0, nodata=-9999)
    write_raster(tmp_path / "blank.tif", np.zeros((50, 50), np.uint8), UTM, PLACE, 1.0, nodata=0)
    cut = (tmp_path / "a.tif").read_bytes()
    (tmp_path / "cut.tif").write_bytes(cut[: len(cut) * 2 // 3])
    for ortho, dsm, named in (
        ("cut.tif", None, "cut.tif"),
        ("absent.tif", None, "absent.tif"),
        ("a.tif", "far.tif", "far.tif.*overlap"),
        ("a.tif", "empty.tif", "empty.tif.*no height"),
        ("a.tif", "cut.tif", "cut.tif"),
        ("blank.tif", None, "blank.tif.*no valid pixel"),
    ):
        with pytest.raises(MapError, match=rf"{named}.*remedy"):
            build_pack([tmp_path / ortho], tmp_path / dsm if dsm else None, tmp_path / "pack")
        assert not (tmp_path / "pack").exists() and not list(tmp_path.glob(".pack*"))


def test_large_damaged_files_are_found_while_building(tmp_path: Path, write_raster, monkeypatch: pytest.MonkeyPatch) -> None:
    write_raster(tmp_path / "a.tif", picture(600), UTM, PLACE, 1.0, compress="deflate")
    cut = (tmp_path / "a.tif").read_bytes()
    (tmp_path / "cut.tif").write_bytes(cut[: len(cut) * 2 // 3])
    monkeypatch.setattr("visloc_companion.maps.geotiff.IN_MEMORY_BYTES", 1000)
    with pytest.raises(MapError, match=r"cut\.tif.*remedy"):
        build_pack([tmp_path / "cut.tif"], None, tmp_path / "pack")
    assert not (tmp_path / "pack").exists() and not list(tmp_path.glob(".pack*"))


def test_orthophotos_a_continent_apart_are_refused(tmp_path: Path, write_raster) -> None:
    write_raster(tmp_path / "a.tif", picture(100), UTM, PLACE, 0.5)
    write_raster(tmp_path / "b.tif", picture(100), UTM, (40.0, 15.3), 0.5)
    with pytest.raises(MapError, match="far apart"):
        build_pack([tmp_path / "a.tif", tmp_path / "b.tif"], None, tmp_path / "pack")


@pytest.mark.shared
def test_real_orthophoto_is_copied_pixel_by_pixel(tmp_path: Path, shared_data: Path) -> None:
    ortho = shared_data / "naip" / "20150926.tif"
    build_pack([ortho], None, tmp_path / "pack")
    pack = PackMap.open(tmp_path / "pack")
    with rasterio.open(ortho) as source:
        want = source.read()[:3]
        lat, lon = map_crs(source.crs.to_wkt()).to_geo(*(source.transform @ (0.5, 0.5)))
    rows, cols = want.shape[1:]
    with rasterio.open(tmp_path / "pack" / "ortho.tif") as got:
        assert (got.read()[:3, :rows, :cols] == want).all()
    assert pack.covers(lat, lon)
    assert pack.projection_at(GeoPoint(lat, lon, 0.0)).scale == pytest.approx(0.9996, abs=1e-4)


@pytest.mark.parametrize(("lat_deg", "polar"), [(84.1, "5041"), (-80.1, "5042")])
def test_degrees_beyond_utm_are_refused_with_a_projection_of_the_pole(
    tmp_path: Path, write_raster, lat_deg: float, polar: str
) -> None:
    write_raster(tmp_path / "a.tif", picture(100), "EPSG:4326", (lat_deg, 20.0), 1.0)
    with pytest.raises(MapError, match=rf"a\.tif: lies at latitude .*; remedy: .*gdalwarp -t_srs EPSG:{polar} "):
        build_pack([tmp_path / "a.tif"], None, tmp_path / "pack")
    write_raster(tmp_path / "a.tif", picture(100), f"EPSG:{polar}", (lat_deg, 20.0), 1.0)
    assert build_pack([tmp_path / "a.tif"], None, tmp_path / "pack").crs.epsg == int(polar)


def test_square_degrees_beside_the_pole_are_not_worked_on(tmp_path: Path) -> None:
    """A pixel of 0.11 m from north to south is 0.04 mm wide: minutes were spent on maps of tens of thousands of rows."""
    shape = {"width": 400, "height": 400, "count": 1, "dtype": "uint8"}
    place = rasterio.Affine(1e-6, 0, 10.0, 0, -1e-6, 89.98)
    with rasterio.open(tmp_path / "a.tif", "w", driver="GTiff", crs="EPSG:4326", transform=place, **shape) as out:
        out.write(picture(400), 1)
    with pytest.raises(MapError, match=r"a\.tif: lies at latitude 89\.9798 .*remedy: .*EPSG:5041"):
        build_pack([tmp_path / "a.tif"], None, tmp_path / "pack")
