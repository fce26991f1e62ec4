from __future__ import annotations

import numpy as np
import pytest

from visloc_companion.localise.candidates.claims import claimed_covariance, horizontal_sigma, widening
from visloc_companion.localise.ortho_rectify import CameraPose
from visloc_companion.localise.pose import PoseEstimate

FORMAL = np.diag([4.0, 9.0, 16.0, 1e-4, 1e-4, 1e-4])


def estimate(scatter: float) -> PoseEstimate:
    return PoseEstimate(CameraPose(np.zeros(3), np.eye(3)), FORMAL.copy(), scatter, np.ones(5), np.zeros(6), 0.01, 0.0)


def test_wider_scatter_claims_more_than_the_formal_covariance_says():
    assert widening(4.0) / widening(1.0) == pytest.approx(4.0**0.25)
    assert widening(0.8) == widening(1.0)


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
