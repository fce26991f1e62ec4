from __future__ import annotations

import math

import numpy as np
import pytest

from visloc_companion.localise.plan import SearchPlan, make_plan
from visloc_companion.localise.settings import LocaliserSettings
from visloc_companion.types import CameraModel

MODEL = CameraModel(160, 120, 140.0, 140.0, 79.5, 59.5)


def plan_of(ref, support, p=(0.0, 0.0, -240.0), euler=(0.0, 0.0, 0.0), model=MODEL, **prior) -> SearchPlan:
    plan = make_plan(support.request_at(p, euler, **prior).prior, model, ref, LocaliserSettings())
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


def test_working_resolution_is_the_coarser_of_map_and_frame(flat, support):
    sharp = CameraModel(1280, 960, 1120.0, 1120.0, 639.5, 479.5)
    assert plan_of(flat, support, model=sharp).finest_gsd_m == pytest.approx(1.0)
    blunt = CameraModel(40, 30, 35.0, 35.0, 19.5, 14.5)
    assert plan_of(flat, support, model=blunt).finest_gsd_m == pytest.approx(4.0, rel=0.05)


def test_unknown_tilt_widens_the_region(flat, support):
    request = support.request_at((0.0, 0.0, -240.0), (0.0, 0.0, 0.0), sigma_m=1.0)
    plan = make_plan(request.prior, MODEL, flat, LocaliserSettings())
    assert isinstance(plan, SearchPlan)
    assert plan.cov_ne_m2[0, 0] >= 1.0 + (140 * request.prior.sigma_tilt_rad) ** 2
