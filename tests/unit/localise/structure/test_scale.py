import math
from dataclasses import replace

import numpy as np
import pytest

from visloc_companion.localise.structure.bundle import Bundle
from visloc_companion.localise.structure.scale import baseline_sigma, from_heights


@pytest.fixture
def flat(structure):
    """Two frames 90 m above level ground of many points, and the frames' poses."""
    T = np.array([structure.pose(0, 0, 90), structure.pose(0, 27, 90)])
    frames = [structure.posed(np.zeros((4, 4), np.uint8), t, 90.0) for t in T]
    e, n = np.meshgrid(np.arange(-40.0, 40), np.arange(-40.0, 60))
    return frames, T, np.column_stack([e.ravel(), n.ravel(), np.zeros(e.size)])


def test_without_a_height_the_baselines_scale_stays(flat):
    found = from_heights(*flat, 0.01)
    assert (found.factor, found.sigma, found.apart_sigmas) == (1.0, 0.01, 0.0)


def test_heights_and_baselines_are_weighed_by_their_sigmas(flat):
    frames, T, points = flat
    measured = [replace(f, height_m=91.8, sigma_height_m=0.9) for f in frames]  # 2 % more, good to 1 %: all wrong by the same
    for some in (slice(1), slice(2)):
        found = from_heights(measured[some], T[some], points, 0.01)
        assert found.factor == pytest.approx(1.01, rel=1e-3)
        assert found.sigma == pytest.approx(0.01 / math.sqrt(2), rel=1e-2)
        assert found.apart_sigmas == pytest.approx(math.sqrt(2), rel=1e-2)


def test_by_how_much_heights_that_are_all_off_make_the_cloud_too_large(flat):
    frames, T, points = flat
    low, high = (
        from_heights([replace(f, height_m=h, sigma_height_m=0.9) for f in frames], T, points, 0.02) for h in (89.0, 91.0)
    )
    assert low.per_height == pytest.approx((high.factor - low.factor) / 2, rel=1e-6)
    assert 0.5 / 90 < low.per_height < 1 / 90
    assert from_heights(frames, T, points, 0.02).per_height == 0.0


def test_a_beam_among_crowns_says_little(flat):
    frames, T, points = flat
    forest = points.copy()
    forest[::2, 2] = 20.0
    measured = [replace(f, height_m=91.8, sigma_height_m=0.2) for f in frames]
    assert from_heights(measured, T, forest, 0.01).sigma > 0.9 * 0.01
    assert from_heights(measured, T, points, 0.01).sigma < 0.3 * 0.01


def test_the_baseline_s_sigma_is_that_of_its_length(flat):
    _, T, points = flat
    covariance = np.zeros((12, 12))
    covariance[[0, 1, 6, 7], [0, 1, 6, 7]] = 0.2**2
    bundle = Bundle(T, covariance, points, np.ones(len(points), bool), 0.2, 1.0)
    assert baseline_sigma(bundle) == pytest.approx(0.2 * math.sqrt(2) / 27)
    shared = covariance.copy()
    shared[1, 7] = shared[7, 1] = 0.2**2  # both frames shifted alike
    assert baseline_sigma(replace(bundle, covariance=shared)) == pytest.approx(0.0, abs=1e-9)
