from __future__ import annotations

import math

import numpy as np
import pytest

from visloc_companion.errors import Reason
from visloc_companion.geo.camera import R_FRD_CAM
from visloc_companion.geo.se3 import R_from_quat, quat_from_euler
from visloc_companion.localise import plan as plan_module
from visloc_companion.localise.candidates.frame_features import ForEachPose
from visloc_companion.localise.candidates.hypotheses import search_box, search_window
from visloc_companion.localise.features.gradient import GRADIENT
from visloc_companion.localise.frame import full_level, reduced
from visloc_companion.localise.mapped.window import cropped, map_grid
from visloc_companion.localise.ortho_rectify import CameraPose
from visloc_companion.localise.plan import SearchPlan, make_plan, middle_of_view, view_box
from visloc_companion.localise.settings import LocaliserSettings
from visloc_companion.types import CameraModel

MODEL = CameraModel(160, 120, 140.0, 140.0, 79.5, 59.5)


def plan_of(ref, support, p=(0.0, 0.0, -240.0), euler=(0.0, 0.0, 0.0), model=MODEL, most=250_000, **prior) -> SearchPlan:
    settings = LocaliserSettings(most_positions=most)
    plan = make_plan(support.request_at(p, euler, **prior).prior, model, ref, settings)
    assert isinstance(plan, SearchPlan)
    return plan


def test_ground_height_and_area_of_the_footprint(flat, support):
    plan = plan_of(flat, support)
    assert plan.agl_m == pytest.approx(140.0)
    assert plan.area_m2 == pytest.approx(159 * 119, rel=0.01)
    assert plan.frame_gsd_m == pytest.approx(1.0, rel=0.02)


def test_uniform_priors_are_covered(flat, support):
    """A uniform prior of half width a is given as a / sqrt 3."""
    plan = plan_of(flat, support, sigma_h_m=0.25 * 140 / 3**0.5, sigma_yaw_deg=20 / 3**0.5)
    step = np.diff(plan.headings_rad).max()
    assert plan.headings_rad.max() + step / 2 >= math.radians(20)
    assert plan.headings_rad.min() - step / 2 <= -math.radians(20)
    assert plan.scales.max() > 1.25
    assert plan.scales.min() < 0.8


def test_a_sure_prior_searches_one_heading_and_scale(flat, support):
    plan = plan_of(flat, support, sigma_h_m=0.1, sigma_yaw_deg=0.1)
    assert len(plan.headings_rad) == len(plan.scales) == 1


def test_relief_widens_the_scales(flat, support):
    slope = 100 + 0.2 * (np.arange(500, dtype=np.float32)[None, :] - 250) + np.zeros((500, 1), np.float32)
    sloping = support.FlatMap(flat.pixels, slope)
    assert plan_of(sloping, support, sigma_m=60.0).scales.max() > plan_of(flat, support, sigma_m=60.0).scales.max() + 0.1


def test_a_prior_on_a_slope_above_the_vehicle_searches_the_valley_beside_it(flat, support):
    """The prior lies on ground at 300 m, west of it is a valley at 100 m: the vehicle, at 240 m, can be there only."""
    east = np.arange(500, dtype=np.float32) - 250
    valley = np.clip(220 + 2 * (east + 60), 100, 300) + np.zeros((500, 1), np.float32)
    mountains = support.FlatMap(flat.pixels, valley.astype(np.float32))
    plan = plan_of(mountains, support, sigma_m=60.0)
    assert plan.ground_up_m == pytest.approx(120.0, abs=20.0)
    assert plan.agl_m * plan.scales.min() < 140 < plan.agl_m * plan.scales.max()
    request = support.request_at((0.0, 0.0, -240.0), (0.0, 0.0, 0.0), sigma_m=3.0)
    near = make_plan(request.prior, MODEL, mountains, LocaliserSettings())
    assert isinstance(near, tuple)
    assert near[0] is Reason.TOO_LOW


def test_who_is_high_up_sees_past_a_gap_of_the_map_and_into_it_from_beside_it(flat, support):
    """The search for the ground began 100 m up, from where nothing but the gap is seen."""
    known = np.ones(flat.pixels.shape, np.bool_)
    known[110:390, 110:390] = False
    gap = support.FlatMap(flat.pixels, flat.surface, known=known)
    assert plan_of(gap, support, (0.0, 0.0, -800.0)).agl_m == pytest.approx(700.0)
    assert plan_of(flat, support, (0.0, 400.0, -800.0)).agl_m == pytest.approx(700.0)
    for ref, p in ((gap, (0.0, 0.0, -200.0)), (flat, (0.0, 400.0, -200.0))):
        why = make_plan(support.request_at(p, (0.0, 0.0, 0.0)).prior, MODEL, ref, LocaliserSettings())
        assert isinstance(why, tuple)
        assert why[0] is Reason.OUTSIDE_MAP


def test_working_resolution_is_the_coarser_of_map_and_frame(flat, support):
    sharp = CameraModel(1280, 960, 1120.0, 1120.0, 639.5, 479.5)
    assert plan_of(flat, support, model=sharp).finest_gsd_m == pytest.approx(1.0)
    blunt = CameraModel(40, 30, 35.0, 35.0, 19.5, 14.5)
    assert plan_of(flat, support, model=blunt).finest_gsd_m == pytest.approx(4.0, rel=0.05)


def test_a_large_region_is_searched_more_coarsely_within_limits(flat, support):
    near = plan_of(flat, support)
    assert plan_of(flat, support, sigma_m=4.0, most=40_000).coarse_gsd_m == pytest.approx(near.coarse_gsd_m)
    wide = plan_of(flat, support, sigma_m=100.0, most=40_000)
    assert wide.coarse_gsd_m == pytest.approx(500 / 200, rel=0.15)
    widest = plan_of(flat, support, sigma_m=100.0, most=100)
    assert widest.coarse_gsd_m == pytest.approx(math.sqrt(widest.area_m2) / plan_module.COARSEST_PIXELS)
    assert widest.fine_gsd_m == near.fine_gsd_m


def test_a_search_that_is_coarse_for_cost_has_few_templates_and_a_coarse_map_all(flat, support):
    side_px = plan_module.COARSEST_PIXELS
    blunt = CameraModel(52, 39, 45.0, 45.0, 25.5, 19.0)
    of_map = plan_of(flat, support, sigma_m=100.0, sigma_yaw_deg=10.0, model=blunt)
    for_cost = plan_of(flat, support, sigma_m=100.0, sigma_yaw_deg=10.0, most=100)
    assert math.sqrt(of_map.area_m2) / of_map.coarse_gsd_m == pytest.approx(side_px, rel=0.1)
    assert math.sqrt(for_cost.area_m2) / for_cost.coarse_gsd_m == pytest.approx(side_px)
    assert len(for_cost.headings_rad) < 0.65 * len(of_map.headings_rad)
    for plan in (of_map, for_cost):
        step = float(np.diff(plan.headings_rad).max())
        assert plan.headings_rad.max() + step / 2 >= math.radians(30) - 1e-9


def test_unknown_tilt_widens_the_region(flat, support):
    request = support.request_at((0.0, 0.0, -240.0), (0.0, 0.0, 0.0), sigma_m=1.0)
    plan = make_plan(request.prior, MODEL, flat, LocaliserSettings())
    assert isinstance(plan, SearchPlan)
    assert plan.cov_ne_m2[0, 0] >= 1.0 + (140 * request.prior.sigma_tilt_rad) ** 2


def test_middle_of_an_oblique_view_has_half_of_the_frame_to_either_side():
    R = R_from_quat(quat_from_euler(0.0, math.radians(40), 0.0)) @ R_FRD_CAM
    (north, east), pixel_m2 = middle_of_view(MODEL, R)
    assert north == pytest.approx(math.tan(math.radians(40)), abs=0.02)
    assert east == pytest.approx(0.0, abs=1e-6)
    assert pixel_m2 * 140.0**2 == pytest.approx(math.cos(math.radians(40)) ** -3, rel=0.05)


def test_search_goes_wherever_the_middle_of_the_view_is_on_the_map(flat, support):
    """The box about an oblique footprint has its middle far beyond that of the picture: here off the map."""
    plan = plan_of(flat, support, p=(120.0, 0.0, -230.0), euler=(0.0, math.radians(42), 0.0))
    assert plan.footprint_ne_m[:, 0].max() / 2 > plan.looked_at_ne_m[0] + 10
    low, high = search_box(plan)
    grid = cropped(map_grid(flat, plan.frame, low, high, plan.coarse_gsd_m, GRADIENT))
    level = reduced(full_level(np.zeros((120, 160), np.uint8), MODEL), plan.coarse_gsd_m / plan.frame_gsd_m)
    volume = search_window(grid, ForEachPose(level, GRADIENT), plan)
    pix = np.linalg.solve(grid.A_ne_pix[:, :2], plan.pose.p_ned_m[:2] - grid.A_ne_pix[:, 2]) - volume.origin_px
    assert (pix >= 0).all()
    assert (pix < volume.score.shape[::-1]).all()


def test_box_of_a_view_follows_the_tilt_of_the_pose(flat, support):
    plan = plan_of(flat, support, p=(0.0, 0.0, -240.0))
    low, high = view_box(plan, plan.pose)
    np.testing.assert_allclose(high - low, [119, 159], rtol=0.01)
    tilted = CameraPose(plan.pose.p_ned_m, R_from_quat(quat_from_euler(0.0, math.radians(10), 0.0)) @ R_FRD_CAM)
    ahead_low, ahead_high = view_box(plan, tilted)
    half = math.atan(59.5 / 140)
    assert ahead_high[0] == pytest.approx(140 * math.tan(math.radians(10) + half), rel=0.01)
    assert ahead_low[0] == pytest.approx(140 * math.tan(math.radians(10) - half), rel=0.01)
    flat_low, flat_high = view_box(plan, CameraPose(plan.pose.p_ned_m, R_from_quat(quat_from_euler(0, 1.4, 0)) @ R_FRD_CAM))
    assert np.isfinite([flat_low, flat_high]).all()
    assert flat_high[0] <= 3.0 * 140 + 1
