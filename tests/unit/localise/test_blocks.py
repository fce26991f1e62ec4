from __future__ import annotations

import numpy as np
import pytest

from visloc_companion.localise.blocks import normalised_correlation


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
