from __future__ import annotations

import numpy as np
import pytest

from visloc_companion.localise.candidates.pyramid import LEVELS, LowPassed, blurred, low_passed, view, window
from visloc_companion.localise.features.gradient import GRADIENT
from visloc_companion.localise.plan import SearchPlan, make_plan
from visloc_companion.localise.settings import LocaliserSettings
from visloc_companion.types import CameraModel

MODEL = CameraModel(160, 120, 140.0, 140.0, 79.5, 59.5)
LEVEL = (0.0, 0.0, 0.6)


def planned(ref, prior) -> SearchPlan:
    plan = make_plan(prior, MODEL, ref, LocaliserSettings())
    assert isinstance(plan, SearchPlan)
    return plan


@pytest.mark.parametrize("channels", [1, 2, 10])
def test_low_pass_keeps_shape_and_mean_and_lowers_energy(channels):
    values = np.random.default_rng(1).normal(3, 1, (60, 80, channels)).astype(np.float32)
    smooth = low_passed(values, 2.0)
    assert smooth.shape == values.shape
    assert smooth.mean() == pytest.approx(values.mean(), abs=0.05)
    assert smooth.std() < 0.3 * values.std()
    assert low_passed(values, 0.0) is values


def test_frame_and_window_are_low_passed_alike(flat, support):
    prior = support.request_at((5.0, 8.0, -240.0), LEVEL).prior
    plan = planned(flat, prior)
    there = view(support.render(flat, MODEL, (5.0, 8.0, -240.0), LEVEL), MODEL, plan, prior, plan.frame)
    grid = window(there, there.start, LEVELS[0], flat, plan.frame, GRADIENT)
    looks = LowPassed(there.on(grid, GRADIENT), 3.0)
    seen, mask = looks.on_surface(there.start, grid)
    smooth = blurred(grid, 3.0)
    assert seen.shape == smooth.features.shape
    inside = mask > 0
    likeness = np.corrcoef(seen[inside].ravel(), smooth.features[inside].ravel())[0, 1]
    assert likeness > 0.95
    on_plane = looks.on_plane(there.start, grid.A_ne_pix, (mask.shape[1], mask.shape[0]), 100.0)
    np.testing.assert_allclose(on_plane[0], seen, atol=1e-3)


def test_view_is_expressed_about_a_common_origin(flat, support):
    here, there = (support.request_at(p, LEVEL).prior for p in ((0.0, 0.0, -240.0), (30.0, -20.0, -250.0)))
    plan = planned(flat, there)
    moved = view(np.zeros((120, 160), np.uint8), MODEL, plan, there, planned(flat, here).frame)
    np.testing.assert_allclose(moved.start.p_ned_m, [30.0, -20.0, -250.0], atol=0.01)
    assert moved.prior.up_m == pytest.approx(250.0)
    assert moved.gsd_m(LEVELS[1], 5.0) == 5.0
