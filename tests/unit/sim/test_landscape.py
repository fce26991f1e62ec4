"""The procedural landscape: the same by seed, two dates that differ as seasons do, and light that obeys the surface model."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest

from visloc_companion.geo.wgs84 import distance_m
from visloc_companion.localise.mapped.shadow import cast_shadow
from visloc_companion.maps.crs import map_crs
from visloc_companion.sim.land.landscape_grid import Grid
from visloc_companion.sim.land.landscape_ground import lasting_layers
from visloc_companion.sim.land.landscape_objects import place_buildings, plant_trees
from visloc_companion.sim.land.landscape_plan import Line, Use, make_plan
from visloc_companion.sim.land.landscape_snow import drifted, snowed
from visloc_companion.sim.land.landscape_stamps import Objects
from visloc_companion.sim.land.landscape_terrain import terrain
from visloc_companion.sim.land.season import DEEP_SNOW, SNOW, SnowCover
from visloc_companion.sim.landscape import build_landscape, home
from visloc_companion.sim.scene import Scene
from visloc_companion.types import GeoPoint

SIZE_M, GSD_M = 900.0, 1.0


@pytest.fixture(scope="module")
def dates() -> tuple[Scene, Scene]:
    return build_landscape(3, "map", SIZE_M, GSD_M), build_landscape(3, "flight", SIZE_M, GSD_M)


def correlation(a: np.ndarray, b: np.ndarray) -> float:
    return float(np.corrcoef(a.ravel(), b.ravel())[0, 1])


def test_the_same_seed_gives_the_same_landscape_and_another_seed_another(dates: tuple[Scene, Scene]) -> None:
    again = build_landscape(3, "map", SIZE_M, GSD_M)
    assert np.array_equal(again.pixels, dates[0].pixels)
    assert np.array_equal(again.dsm_amsl_m, dates[0].dsm_amsl_m)
    assert correlation(build_landscape(4, "map", SIZE_M, GSD_M).dsm_amsl_m, again.dsm_amsl_m) < 0.9


def test_grid_and_heights_are_shared_by_the_dates(dates: tuple[Scene, Scene]) -> None:
    before, after = dates
    assert before.size_px == after.size_px == (900, 900)
    assert np.array_equal(before.T_map_pix, after.T_map_pix)
    assert np.ptp(before.dsm_amsl_m) > 20
    change = after.dsm_amsl_m - before.dsm_amsl_m
    assert np.median(np.abs(change)) < 0.01, "open ground stays"
    assert (np.abs(change) > 3).mean() > 0.01, "trees grow, fall and lose their leaves"


def test_colours_of_the_fields_change_but_the_directions_of_edges_stay(dates: tuple[Scene, Scene]) -> None:
    before, after = (cv2.cvtColor(scene.pixels, cv2.COLOR_RGB2GRAY).astype(np.float32) for scene in dates)
    lasting = lasting_layers(Grid(900, GSD_M), make_plan(3, SIZE_M))
    fields = (lasting.edge_m > 4) & (lasting.blocked == 0)
    assert abs(correlation(before[fields], after[fields])) < 0.4
    assert agreement(before, after, 0) > 0.15, "the same edges, whichever side is brighter"
    assert abs(agreement(before, after, 40)) < 0.05, "edges agree in place only"


def test_snow_takes_the_fields_colours_and_leaves_the_shape(dates: tuple[Scene, Scene]) -> None:
    bare, snow = dates[1], build_landscape(3, SNOW, SIZE_M, GSD_M)
    assert np.array_equal(snow.dsm_amsl_m, bare.dsm_amsl_m)
    lasting = lasting_layers(Grid(900, GSD_M), make_plan(3, SIZE_M))
    fields = (lasting.edge_m > 4) & (lasting.blocked == 0)
    chroma_bare, chroma_snow = (float(np.median(np.ptp(scene.pixels[fields].astype(int), axis=-1))) for scene in (bare, snow))
    assert np.median(snow.pixels[fields]) > np.median(bare.pixels[fields]) + 40
    assert chroma_snow < 0.6 * chroma_bare


def test_deep_snow_hides_what_lies_on_the_ground_and_leaves_the_shape(dates: tuple[Scene, Scene]) -> None:
    bare, snow = dates[1], build_landscape(3, "snow", SIZE_M, GSD_M)
    assert np.median(np.abs(snow.dsm_amsl_m - bare.dsm_amsl_m)) < 0.2, "drifts"
    assert np.percentile(np.abs(snow.dsm_amsl_m - bare.dsm_amsl_m), 99) < 1.0
    otherwise = replace(DEEP_SNOW, crops=DEEP_SNOW.crops[::-1], asphalt=(60, 60, 60), track=(200, 190, 170))
    apart = np.abs(build_landscape(3, otherwise, SIZE_M, GSD_M).pixels.astype(int) - snow.pixels)
    assert np.percentile(apart, 95) <= 4, "whatever lies under it"


@pytest.mark.parametrize("share", [0.0, 1.0])
def test_snow_lies_where_it_is_said_to(share: float) -> None:
    """Of a bare tree, a conifer, a roof and open ground, only that is white which carries snow."""
    tree = np.full((40, 40), -1, np.int32)
    tree[:20, :20], tree[:20, 20:] = 0, 1
    roof = np.zeros((40, 40), np.uint8)
    roof[20:, :20] = 9
    objects = Objects(np.zeros((40, 40), np.float32), tree, np.full((40, 40), 128, np.uint8), roof)
    dark = np.full((40, 40, 3), 40, np.uint8)
    cover = SnowCover(1 - share, share, 1 - share, share, clump=0.0, grain=0.0)
    white = snowed(1, dark, objects, np.array([False, True]), cover, 1.0)[:, :, 0] > 200
    assert white[:20, :20].all() == white[20:, :20].all() == bool(share), "bare tree, roof"
    assert white[:20, 20:].any() != bool(share), "conifer"
    assert white[20:, 20:].mean() == pytest.approx(1 - share, abs=0.5), "open ground, thinner here and there"


def test_drifts_are_as_high_as_the_wind_makes_them() -> None:
    cover = SnowCover(1.0, 1.0, 1.0, 1.0, drift_m=0.1)
    level = np.full((400, 400), 480.0, np.float32)
    drifts = drifted(1, level, cover, 0.5)
    assert float(drifts.std()) == pytest.approx(0.1, abs=0.03)
    assert float(drifts.mean()) == pytest.approx(480.0, abs=0.02)
    assert np.array_equal(drifts, drifted(1, level, cover, 0.5))


def agreement(a: np.ndarray, b: np.ndarray, shift_px: int) -> float:
    """Mean cosine of twice the angle between the pictures' gradients, one picture shifted along its rows."""
    b = np.roll(b, shift_px, axis=1)
    a_rad, b_rad = (np.arctan2(cv2.Sobel(grey, -1, 0, 1), cv2.Sobel(grey, -1, 1, 0)) for grey in (a, b))
    return float(np.cos(2 * (a_rad - b_rad)).mean())


def test_the_plan_holds_what_a_landscape_has() -> None:
    plan = make_plan(1, 2000.0)
    uses = [parcel.use for parcel in plan.parcels]
    assert all(uses.count(use) >= 5 for use in Use)
    assert {way.kind for way in plan.ways} == set(Line)
    assert any(way.hedge for way in plan.ways)
    area = sum(parcel.area_m2 for parcel in plan.parcels)
    assert area == pytest.approx((2000.0 + 240.0) ** 2, rel=1e-6), "parcels leave no gap and do not overlap"


def test_trees_and_houses_differ_between_the_dates_but_mostly_stay() -> None:
    plan = make_plan(1, 2000.0)
    trees, houses = plant_trees(1, plan), place_buildings(1, plan)
    stay = (trees.at_map & trees.at_flight).mean()
    assert 0.75 < stay < 0.97
    assert 0.01 < (~trees.at_map).mean() < 0.08
    assert 0.05 < np.mean([not house.at_map for house in houses]) < 0.3
    assert 3 < trees.height_m.mean() < 25
    assert 0.1 < trees.conifer.mean() < 0.9


def test_water_lies_lower_than_the_land_around_and_is_level() -> None:
    plan = make_plan(1, 1000.0)
    grid = Grid(1000, 1.0)
    ground = terrain(1, grid, plan)
    lake = grid.blank()
    grid.fill(lake, plan.lake_m, 1)
    if lake.sum() > 1000:
        assert np.ptp(ground[cv2.erode(lake, np.ones((5, 5))) > 0]) < 1.5
    assert np.ptp(ground) > 10


@pytest.mark.parametrize(("azimuth_deg", "elevation_deg"), [(180.0, 45.0), (90.0, 30.0), (225.0, 20.0)])
def test_a_tower_throws_its_shadow_away_from_the_sun_as_long_as_the_sun_is_low(azimuth_deg: float, elevation_deg: float) -> None:
    surface = np.zeros((300, 300), np.float32)
    surface[147:154, 147:154] = 20.0
    depth = cast_shadow(surface, 1.0, azimuth_deg, elevation_deg)
    length = 20.0 / np.tan(np.radians(elevation_deg))
    away = np.array([-np.sin(np.radians(azimuth_deg)), np.cos(np.radians(azimuth_deg))])
    middle = (np.array([150, 150]) + away * length / 2).round().astype(int)
    beyond = (np.array([150, 150]) + away * (length + 9)).round().astype(int)
    sunny = (np.array([150, 150]) - away * 9).round().astype(int)
    assert depth[middle[1], middle[0]] == pytest.approx(10.0, abs=3.0)
    assert depth[beyond[1], beyond[0]] == 0.0
    assert depth[sunny[1], sunny[0]] == 0.0


def test_home_is_open_ground_near_the_middle(dates: tuple[Scene, Scene]) -> None:
    scene = dates[0]
    place = home(scene)
    lat, lon = map_crs(scene.crs).to_geo(*scene.center_map)
    assert distance_m(place, GeoPoint(lat, lon, 0.0)) < 290
    easting, northing = map_crs(scene.crs).to_map(place.lat_deg, place.lon_deg)
    column, row = (np.array([easting, -northing]) - scene.T_map_pix[:, 2] * np.array([1, -1])) / GSD_M
    around = scene.dsm_amsl_m[round(row) - 6 : round(row) + 7, round(column) - 6 : round(column) + 7]
    assert np.ptp(around) < 4.0
    assert around[6, 6] == pytest.approx(place.h_amsl_m, abs=0.5)
