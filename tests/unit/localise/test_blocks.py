from __future__ import annotations

import cv2
import numpy as np
import pytest

from visloc_companion.localise.blocks import (
    BlockMatches,
    correlated,
    match_blocks,
    normalised_correlation,
    share_returning,
    worth,
)
from visloc_companion.localise.ortho_rectify import MapGrid


def test_many_channels_are_correlated_as_a_few_are():
    rng = np.random.default_rng(3)
    window, block = rng.normal(size=(40, 44, 10)).astype(np.float32), rng.normal(size=(18, 20, 10)).astype(np.float32)
    scores = normalised_correlation(window, block)
    part = window[7:25, 11:31]
    want = (part * block).sum() / np.sqrt((part**2).sum() * (block**2).sum())
    assert scores.shape == (23, 25)
    assert scores[7, 11] == pytest.approx(want, abs=1e-4)
    few = normalised_correlation(window[..., :4], block[..., :4])
    padded = [np.dstack([x[..., :4], np.zeros((*x.shape[:2], 2), np.float32)]) for x in (window, block)]
    np.testing.assert_allclose(normalised_correlation(*padded), few, atol=1e-4)


@pytest.mark.parametrize("primitives", [True, False])
@pytest.mark.parametrize("channels", [2, 3, 4, 5, 10])
def test_each_block_is_correlated_with_the_map_about_it(channels, primitives):
    rng = np.random.default_rng(channels)
    features, frame = (rng.normal(size=(70, 80, channels)).astype(np.float32) for _ in range(2))
    known, seen = ((rng.random((70, 80)) < 0.9).astype(np.float32) for _ in range(2))
    seen[:, 60:] = 0
    grid = MapGrid(features, known, np.zeros((70, 80), np.float32), np.eye(2, 3), 1.0)
    before = cv2.ipp.useIPP()
    cv2.ipp.setUseIPP(primitives)
    try:
        found = list(correlated(grid, frame, seen, 15, 12))
    finally:
        cv2.ipp.setUseIPP(before)
    around, masked = np.pad(features * known[..., None], ((12, 12), (12, 12), (0, 0))), frame * seen[..., None]
    assert {left for left, _, _ in found} == {0, 15, 30, 45}
    assert len(found) == 4 * 5
    for left, top, scores in found:
        assert scores.shape == (25, 25)
        block = masked[top : top + 15, left : left + 15].astype(np.float64)
        for v, u in ((0, 0), (12, 12), (24, 3), tuple(rng.integers(0, 25, 2))):
            part = around[top + v : top + v + 15, left + u : left + u + 15].astype(np.float64)
            want = (part * block).sum() / max(np.sqrt((part**2).sum() * (block**2).sum()), 1e-6)
            assert scores[v, u] == pytest.approx(want, abs=1e-5)


@pytest.mark.parametrize("channels", [2, 10])
def test_where_the_map_shows_nothing_a_block_is_like_nothing(channels):
    rng = np.random.default_rng(1)
    features, frame = (rng.normal(size=(60, 60, channels)).astype(np.float32) for _ in range(2))
    features[:, 20:] = 0
    grid = MapGrid(features, np.ones((60, 60), np.float32), np.zeros((60, 60), np.float32), np.eye(2, 3), 1.0)
    beyond = [scores for left, _, scores in correlated(grid, frame, np.ones((60, 60), np.float32), 15, 6) if left >= 30]
    assert beyond
    assert max(float(np.abs(scores).max()) for scores in beyond) < 1e-3


def test_blocks_come_back_where_frame_and_map_show_the_same_and_not_where_they_do_not():
    rng = np.random.default_rng(5)
    a, b = (cv2.GaussianBlur(rng.normal(size=(120, 120, 2)).astype(np.float32), (0, 0), 1.5) for _ in range(2))
    weight = np.zeros((120, 120), np.float32)
    weight[10:110, 10:110] = 1
    grid = MapGrid(a, np.ones_like(weight), np.zeros_like(weight), np.eye(2, 3), 1.0)

    def share(frame):
        return share_returning(match_blocks(grid, frame, weight), grid, frame, weight)

    assert share(np.roll(a, 1, axis=1)) > 0.95
    assert share(b) < 0.1
    assert share_returning(match_blocks(grid, a, weight * 0), grid, a, weight * 0) == 0.0


def matches(peaks, agreeing, side_px=28):
    n = len(peaks)
    agrees = (np.arange(n) < agreeing).astype(float)
    return BlockMatches(np.zeros((n, 2)), np.zeros((n, 2)), np.array(peaks, dtype=float), agrees, side_px)


def test_blocks_of_a_high_peak_tell_more_and_small_ones_alike():
    told = worth(matches([0.2, 0.4, 0.6], 3))
    np.testing.assert_allclose(told, [0.5, 1.0, 1.5])
    np.testing.assert_allclose(worth(matches([0.2, 0.4, 0.6], 3, side_px=14)), 1.0)
    assert 0.5 < worth(matches([0.2, 0.4, 0.6], 3, side_px=20))[0] < 1.0


@pytest.mark.parametrize(("agreeing", "share"), [(10, 1.0), (5, 1.0), (4, 0.64), (2, 0.16), (0, 0.16)])
def test_where_few_agree_all_tell_less(agreeing, share):
    np.testing.assert_allclose(worth(matches([0.4] * 10, agreeing)), share)


def test_where_the_tilt_is_not_known_few_tell_as_much_as_many():
    np.testing.assert_allclose(worth(matches([0.4] * 10, 2), tilt_known=False), 1.0)
    told = worth(matches([0.2, 0.4, 0.6], 0), tilt_known=False)
    np.testing.assert_allclose(told, [0.5, 1.0, 1.5])


def test_where_few_small_blocks_agree_they_tell_what_they_tell():
    """Of blocks of 14 px, a third or less agree at the right place."""
    np.testing.assert_allclose(worth(matches([0.4] * 10, 2, side_px=14)), 1.0)
    assert 0.16 < worth(matches([0.4] * 10, 2, side_px=21))[0] == pytest.approx(0.4)


def test_no_block_and_blocks_without_likeness_are_no_error():
    assert worth(matches([], 0)).shape == (0,)
    told = worth(matches([-0.1, 0.0, -0.2], 0))
    assert np.isfinite(told).all()
    assert (told > 0).all()
