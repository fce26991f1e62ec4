"""Parts of a source, and their correlation."""

from __future__ import annotations

import numpy as np
import pytest

from visloc_companion.localise.registration import parts
from visloc_companion.localise.registration.correlation import Template
from visloc_companion.localise.registration.pair import make_pair
from visloc_companion.localise.registration.parts import MOST_RARE, _correlation, _split, mean_z, means, z_of
from visloc_companion.localise.registration.search import region


def test_parts_are_correlated_as_by_hand():
    rng = np.random.default_rng(8)
    beside = rng.normal(0, 2.0, (20, 23)).astype(np.float32)
    for h, w in ((6, 7), (7, 6)):
        height = rng.normal(0, 1.0, (h, w)).astype(np.float32)
        part = Template(height - height.mean(), np.ones((h, w), np.bool_), (0, 0))
        found = _correlation(part, beside, h * w)
        assert found.shape == (20 - h + 1, 23 - w + 1)
        for v, u in ((0, 0), (3, 9), (20 - h, 23 - w)):
            by_hand = np.corrcoef(height.ravel(), beside[v : v + h, u : u + w].ravel())[0, 1]
            assert found[v, u] == pytest.approx(by_hand, abs=2e-3)


def test_parts_cover_what_is_known_and_know_at_least_half():
    known = np.zeros((41, 41), np.bool_)
    known[4:36, 6:38] = True
    known[4:12, 6:14] = False
    height = np.arange(41 * 41, dtype=np.float32).reshape(41, 41)
    parts = list(_split(Template(height, known, (0, 0))))
    assert [(row, col) for row, col, _ in parts] == [(r, c) for r in (4, 12, 20, 28) for c in (6, 14, 22, 30)][1:]
    assert all(abs(part.height_m[part.known].mean()) < 1e-3 for _, _, part in parts)
    assert list(_split(Template(height, np.zeros((41, 41), np.bool_), (0, 0)))) == []


def test_z_is_that_of_fisher_and_none_of_what_is_no_agreement():
    found = z_of(np.array([-1.0, -0.3, 0.0, 0.5, 0.98, 1.0], np.float32))
    np.testing.assert_allclose(found, [0, 0, 0, np.arctanh(0.5), np.arctanh(0.98), np.arctanh(0.98)], atol=1e-5)


def test_a_part_counts_in_what_it_has_by_chance(scene, monkeypatch):
    pair = make_pair(scene.source_m, scene.reference_m, scene.prior)
    found = []

    def recorded(correlation):
        found.append(z_of(correlation))
        return found[-1]

    monkeypatch.setattr(parts, "z_of", recorded)
    low, high = region(pair, scene.prior)
    mean, rare = means(pair, scene.T_true, low, high)
    np.testing.assert_array_equal(mean, mean_z(pair, scene.T_true, low, high))
    chance = [np.sqrt(np.mean(np.square(z[z > 0]))) for z in found[: len(found) // 2]]
    by_hand = [np.minimum(z / c, MOST_RARE) for z, c in zip(found, chance, strict=False)]
    assert rare.max() <= np.max(by_hand, axis=0).max() * (1 + 1e-5)
    assert rare.max() == pytest.approx(np.mean(by_hand, axis=0).max(), rel=0.05)  # parts are of 17 m each but for the last
