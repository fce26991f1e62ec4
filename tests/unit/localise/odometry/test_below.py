from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from visloc_companion.localise.mapped.surface_error import LOCAL_SHARE
from visloc_companion.localise.odometry.base import FlowSettings
from visloc_companion.localise.odometry.below import Reading, descends, heights_above, on_plane, on_surface, read_near

SETTINGS = FlowSettings()
RAYS = np.array([[0.0, 0.0, 1.0], [0.5, 0.2, 1.0], [-0.8, 0.1, 1.0]])


def test_a_plane_lies_straight_below(odo) -> None:
    sight = odo.sight(np.zeros((1, 1), np.uint8), 0, (0.0, 0.0, -100.0), height_m=80.0, sigma_height_m=4.0, ranged=False)
    got = on_plane(RAYS, sight, SETTINGS)
    assert got.at_ned_m[1] == pytest.approx([40.0, 16.0, 80.0])
    assert (got.sigma_up_m, got.slope_rad) == (4.0, SETTINGS.slope_rad)
    assert on_plane(RAYS, replace(sight, ranged=True), SETTINGS).sigma_up_m == 0.0


def test_rays_meet_a_sloping_surface_where_it_is(odo) -> None:
    surface = odo.Ground(odo.texture(), slope=0.2).surface()
    sight = odo.sight(np.zeros((1, 1), np.uint8), 0, (0, 0, -100.0), place_ne_m=(50.0, 0.0), sigma_up_m=1.5, sigma_place_m=3.0)
    got = on_surface(RAYS, sight, surface, SETTINGS)
    assert got is not None
    for ray, at in zip(RAYS, got.at_ned_m, strict=True):
        t = (100 - 0.2 * 50) / (1 + 0.2 * ray[0])
        assert at == pytest.approx(ray * t, abs=0.05)
    assert got.sigma_up_m == 1.5
    assert got.level_m == pytest.approx(math.hypot(SETTINGS.surface_m, 0.2 * 3.0), rel=0.2)
    lost = on_surface(RAYS, replace(sight, sigma_place_m=80.0), surface, SETTINGS)
    assert lost.level_m == pytest.approx(0.2 * 80, rel=0.2)  # on a slope, who does not know where knows no height
    assert lost.slope_rad > 5 * got.slope_rad
    assert (got.spread_m > SETTINGS.surface_m).all()


def test_heights_above_a_surface_are_those_of_its_wider_forms(odo) -> None:
    surface = odo.Ground(odo.texture(), slope=0.1).surface()
    got = heights_above(RAYS, 100.0, surface)
    for ray, height in zip(RAYS, got, strict=True):
        assert height == pytest.approx(100 / (1 + 0.1 * ray[0]), abs=0.4)
    up = odo.Ground(odo.texture()).surface().up_m.copy()
    up[:60] += 20.0  # a wood north of 0, and a single tree south of it
    up[80:82, 60:62] += 20.0
    wood, tree, outside = heights_above(
        np.array([[0.9, 0.0, 1.0], [-0.1, 0.0, 1.0], [40.0, 0.0, 1.0]]), 100.0, replace(surface, up_m=up)
    )
    assert (wood, tree) == (pytest.approx(80, abs=0.5), pytest.approx(100, abs=3.5))
    assert math.isnan(outside)
    assert np.isnan(heights_above(RAYS, 5.0, replace(surface, up_m=up + 10))).all()
    assert np.isnan(heights_above(RAYS, 100.0, replace(surface, up_m=np.full_like(up, math.nan)))).all()


def test_an_edge_is_unsure_as_far_as_the_place_is(odo) -> None:
    surface = odo.Ground(odo.texture()).surface()
    up = surface.up_m.copy()
    up[:60] = 20.0  # a step at 0 north, 20 m
    surface = replace(surface, up_m=up)
    rays = np.array([[0.04, 0.0, 1.0], [-0.9, 0.0, 1.0]])
    sight = odo.sight(np.zeros((1, 1), np.uint8), 0, (0, 0, -100.0), sigma_up_m=1.0, sigma_place_m=8.0)
    near, far = on_surface(rays, sight, surface, SETTINGS).spread_m
    assert near > 5
    assert far == pytest.approx(SETTINGS.surface_m, abs=0.05)


def test_what_stands_on_the_ground_is_as_unsure_as_it_is_high(odo) -> None:
    surface = odo.Ground(odo.texture()).surface()
    up = surface.up_m.copy()
    up[60:69, 60:69] = 15.0  # trees, 45 m wide
    surface = replace(surface, up_m=up)
    trees = surface.A_ne_pix @ np.array([64.0, 64.0, 1.0])
    rays = np.array([[*trees / 85, 1.0], [0.5, -0.5, 1.0]])
    sight = odo.sight(np.zeros((1, 1), np.uint8), 0, (0, 0, -100.0), sigma_up_m=1.0)
    wood, field = on_surface(rays, sight, surface, SETTINGS).spread_m
    assert wood == pytest.approx(math.hypot(SETTINGS.surface_m, LOCAL_SHARE * 15.0), rel=0.05)
    assert field == pytest.approx(SETTINGS.surface_m, rel=0.05)


def test_outside_and_below_there_is_no_surface(odo) -> None:
    surface = odo.Ground(odo.texture()).surface(reach_m=60.0)
    sight = odo.sight(np.zeros((1, 1), np.uint8), 0, (0, 0, -100.0), sigma_up_m=1.0)
    got = on_surface(RAYS, sight, surface, SETTINGS)
    assert np.isfinite(got.at_ned_m).all(1).tolist() == [True, True, False]
    assert on_surface(RAYS, replace(sight, up_m=3.0), surface, SETTINGS) is None


def test_readings_count_from_the_keyframe_and_only_near_it() -> None:
    readings = [Reading((10.0, 0.0), 102.0, 95.0), Reading((0.0, 400.0), 100.0, 90.0)]
    got = read_near(readings, np.array([4.0, 0.0]), 100.0, 90.0, np.zeros(2))
    assert got.tolist() == [[6.0, 0.0, 93.0]]
    assert read_near([], np.zeros(2), 0.0, 90.0, np.zeros(2)).shape == (0, 3)


def test_readings_count_where_a_leaning_camera_looks() -> None:
    """100 m above ground: 70 m about its foot, and 70 m about what it sees 80 m behind."""
    readings = [Reading((-20.0 * k, 0.0), 100.0, 90.0 + k) for k in range(10)]
    behind = read_near(readings, np.zeros(2), 100.0, 100.0, np.array([-80.0, 0.0]))
    assert behind.tolist() == [[-20.0 * k, 0.0, 90.0 + k] for k in range(8)]
    assert len(read_near(readings, np.zeros(2), 100.0, 100.0, np.array([-20.0, 0.0]))) == 4


def test_flat_rays_do_not_descend() -> None:
    steep = math.radians(70)
    rays = np.array([[math.tan(steep), 0.0, 1.0], [math.tan(steep + 0.1), 0.0, 1.0], [0.0, 1.0, -0.1]])
    assert descends(rays).tolist() == [True, False, False]
