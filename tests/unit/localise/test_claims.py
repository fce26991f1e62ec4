from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from visloc_companion.localise.claims import claimed_covariance, horizontal_sigma
from visloc_companion.localise.ortho_rectify import CameraPose
from visloc_companion.localise.pose import PoseEstimate

FORMAL = np.diag([4.0, 9.0, 16.0, 1e-4, 1e-4, 1e-4])


def estimate(scatter: float) -> PoseEstimate:
    return PoseEstimate(CameraPose(np.zeros(3), np.eye(3)), FORMAL.copy(), scatter, np.ones(5))


def test_wider_scatter_claims_more_than_the_formal_covariance_says():
    calm, wide = (claimed_covariance(estimate(s), 0.0) for s in (1.0, 4.0))
    np.testing.assert_allclose(wide / np.where(calm > 0, calm, 1.0), np.eye(6) * 4.0**0.5, atol=1e-12)


def test_agreement_beyond_a_pixel_claims_no_less():
    np.testing.assert_array_equal(claimed_covariance(estimate(0.8), 2.0), claimed_covariance(estimate(1.0), 2.0))


def test_floor_is_horizontal_only_and_follows_the_resolution():
    fine, coarse = (np.diag(claimed_covariance(estimate(1.0), gsd)) for gsd in (1.0, 5.0))
    assert (coarse - fine)[:2] == pytest.approx(0.15**2 * 24)
    np.testing.assert_array_equal(coarse[2:], fine[2:])


def test_estimate_is_left_as_it_was():
    before = estimate(2.0)
    claimed_covariance(before, 1.0)
    np.testing.assert_array_equal(before.covariance, FORMAL)


def test_worst_horizontal_axis_may_lie_across_the_compass():
    turned = np.zeros((6, 6))
    turned[:2, :2] = [[5.0, 4.0], [4.0, 5.0]]
    assert horizontal_sigma(turned) == pytest.approx(3.0)


def test_what_the_slope_leaves_open_is_not_widened_by_the_scatter():
    of_slope = np.diag([3.0, 3.0, 0.0, 0.0, 0.0, 0.0])
    whole = estimate(4.0)
    with_slope = replace(whole, covariance=whole.covariance + of_slope, of_slope=of_slope)
    np.testing.assert_allclose(claimed_covariance(with_slope, 1.0) - claimed_covariance(whole, 1.0), of_slope, atol=1e-12)
