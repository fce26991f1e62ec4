from __future__ import annotations

import numpy as np
import pytest

from visloc_companion.localise.registration.correlation import NO_SCORE, HeightCorrelator, Scores, Template, peaks
from visloc_companion.localise.registration.height_map import HeightMap

RNG = np.random.default_rng(2)


def direct(reference: HeightMap, template: Template, u: int, v: int) -> float:
    """The score by its definition."""
    pairs = []
    for row, col in np.argwhere(template.known):
        r, c = v + template.offset[1] + row, u + template.offset[0] + col
        inside = 0 <= r < reference.known.shape[0] and 0 <= c < reference.known.shape[1]
        if inside and reference.known[r, c]:
            pairs.append((template.height_m[row, col], reference.height_m[r, c]))
    overlap = len(pairs) / template.known.sum()
    return float(np.corrcoef(np.array(pairs).T)[0, 1] * np.sqrt(overlap)) if overlap >= 0.25 else NO_SCORE


def test_scores_equal_the_direct_sum_also_over_holes_and_borders():
    known = RNG.random((40, 50)) > 0.2
    reference = HeightMap(np.where(known, 250 + 5 * RNG.normal(size=(40, 50)), 0).astype(np.float32), known, np.zeros(2), 1.0)
    mask = RNG.random((11, 13)) > 0.3
    template = Template(np.where(mask, 90 + 3 * RNG.normal(size=(11, 13)), 0).astype(np.float32), mask, (-6, -5))
    scores = HeightCorrelator(reference, (0, 0, 49, 39), (-6, -5, 6, 5), 1).scores([template])
    for u, v in [(20, 20), (3, 4), (49, 39), (0, 30), (44, 2)]:
        assert scores.score[v, u] == pytest.approx(direct(reference, template, u, v), abs=2e-3), (u, v)


def test_a_height_between_the_clouds_does_not_matter_and_the_better_template_is_named():
    heights = RNG.normal(size=(40, 40)).astype(np.float32)
    reference = HeightMap(heights, np.ones((40, 40), bool), np.zeros(2), 1.0)
    part = np.ones((9, 9), bool)
    templates = [Template(RNG.normal(size=(9, 9)).astype(np.float32), part, (-4, -4))]
    templates.append(Template(2 * heights[10:19, 20:29] + 1000, part, (-4, -4)))
    scores = HeightCorrelator(reference, (0, 0, 39, 39), (-4, -4, 4, 4), 2).scores(templates)
    u, v, which, score = peaks(scores, 5, 1)[0]
    assert (u, v, which) == (24, 14, 1)
    assert score == pytest.approx(1, abs=1e-3)


def test_peaks_are_local_maxima_apart_from_each_other():
    score = np.full((20, 20), 0.1, np.float32)
    score[5, 5], score[5, 7], score[15, 15] = 0.9, 0.8, 0.5
    found = peaks(Scores(score, np.zeros((20, 20), np.int32), (100, 200)), 4, 2)
    assert [(u, v) for u, v, _, _ in found] == [(105, 205), (115, 215)]
    assert peaks(Scores(np.full((3, 3), NO_SCORE, np.float32), np.zeros((3, 3), np.int32), (0, 0)), 4, 2) == []


def test_a_plane_scores_nothing():
    reference = HeightMap(np.zeros((30, 30), np.float32), np.ones((30, 30), bool), np.zeros(2), 1.0)
    template = Template(np.zeros((9, 9), np.float32), np.ones((9, 9), bool), (-4, -4))
    scores = HeightCorrelator(reference, (0, 0, 29, 29), (-4, -4, 4, 4), 1).scores([template])
    assert np.abs(scores.score[scores.score > NO_SCORE]).max() < 0.01
