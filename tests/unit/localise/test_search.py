from __future__ import annotations

import cv2
import numpy as np
import pytest

from visloc_companion.localise import search as search_module
from visloc_companion.localise.search import ScoreVolume, Template, find_peaks, search

RNG = np.random.default_rng(3)


def direct(features, weight, template: Template, u: int, v: int, zero_mean: bool) -> tuple[float, float]:
    """The score by its definition, and the share of the template on valid map."""
    h, w = template.mask.shape
    top, left = v + template.offset_px[1], u + template.offset_px[0]
    t = template.features * template.mask[..., None]
    if zero_mean:
        features = features - (features[..., 0] * weight).sum() / weight.sum()
        t = t - template.mask[..., None] * t.sum((0, 1)) / template.mask.sum()
    m, seen = np.zeros_like(t), np.zeros((h, w))
    for row in range(h):
        for col in range(w):
            if 0 <= top + row < features.shape[0] and 0 <= left + col < features.shape[1]:
                seen[row, col] = weight[top + row, left + col] * template.mask[row, col]
                m[row, col] = features[top + row, left + col] * seen[row, col]
    energy, product = (m * m).sum(), (t * m).sum()
    if zero_mean:
        energy -= m.sum() ** 2 / max(seen.sum(), 1)
        product -= (t[..., 0] * seen).sum() * m.sum() / max(seen.sum(), 1)
    share = seen.sum() / template.mask.sum()
    if share < 0.5:
        return 0.0, float(share)
    return float(product / np.sqrt((t * t).sum() * share * energy)), float(share)


@pytest.mark.parametrize("zero_mean", [False, True])
def test_scores_equal_the_direct_sum_also_across_the_border(zero_mean):
    channels = 1 if zero_mean else 2
    features = RNG.normal(size=(30, 41, channels)).astype(np.float32)
    if zero_mean:
        features = 120 + 30 * features  # brightness
    weight = np.ones((30, 41), np.float32)
    weight[:, :6] = 0
    features *= weight[..., None]
    mask = np.ones((9, 11), np.float32)
    mask[:3, :4] = 0
    template = Template(RNG.normal(size=(9, 11, channels)).astype(np.float32), mask, (-4, -7))
    volume = search(features, weight, lambda _: template, 1, (-2, 0, 44, 33), (-4, -7, 6, 1), zero_mean)
    for u, v in [(20, 15), (3, 10), (8, 10), (40, 20), (-2, 0), (30, 33), (38, 7)]:
        expected, share = direct(features, weight, template, u, v, zero_mean)
        got = volume.score[v - volume.origin_px[1], u - volume.origin_px[0]]
        assert got == pytest.approx(expected if share >= 0.5 else -1.0, abs=2e-3), (u, v, share)


def test_level_ground_is_like_nothing_and_no_correlation_is_above_one() -> None:
    """The difference of two large sums is noise where brightness hardly varies; divided by its root anything looks alike."""
    rng = np.random.default_rng(5)
    features = (120 + 30 * cv2.GaussianBlur(rng.normal(size=(200, 260)), (0, 0), 2)).astype(np.float32)[..., None]
    features[:, 130:] = 200.0 + rng.normal(0, 0.01, (200, 130, 1))
    template = Template(features[60:110, 40:100].copy(), np.ones((50, 60), np.float32), (0, 0))
    volume = search(features, np.ones((200, 260), np.float32), lambda _: template, 1, (0, 0, 199, 149), (0, 0, 59, 49), True)
    assert volume.score[60, 40] == pytest.approx(1.0, abs=1e-3)
    assert volume.score.max() <= 1.001
    assert np.abs(volume.score[:, 131:]).max() < 0.1


def scene(channels: int) -> tuple[np.ndarray, np.ndarray, list[Template], tuple[int, int, int, int]]:
    """A map with a hole, templates of unlike sizes, masks and offsets, and the extent of all."""
    rng = np.random.default_rng(channels)
    features = rng.normal(size=(57, 74, channels)).astype(np.float32)
    weight = (cv2.GaussianBlur(rng.random((57, 74)), (0, 0), 4) > 0.45).astype(np.float32)
    templates = []
    for k in range(7):
        height, width = 9 + k, 14 - k
        mask = (rng.random((height, width)) > 0.2).astype(np.float32)
        templates.append(Template(rng.normal(size=(height, width, channels)).astype(np.float32), mask, (k - 9, -k)))
    return features, weight, templates, (-9, -6, 8, 13)


@pytest.mark.parametrize("channels", [1, 3, 10])
@pytest.mark.parametrize("size", [None, (24, 24), (32, 40)])
@pytest.mark.parametrize("strips", [False, True])
def test_any_block_size_and_any_strips_give_the_best_direct_score(channels, size, strips, monkeypatch):
    features, weight, templates, extent = scene(channels)
    box = (-5, -4, 80, 60)
    if size:
        monkeypatch.setattr(search_module, "block_size", lambda *_: size)
    if strips:
        monkeypatch.setattr(search_module, "SPECTRA_BYTES", 1)
    volume = search(features, weight, templates.__getitem__, len(templates), box, extent)
    assert volume.score.shape == volume.hypothesis.shape == (65, 86)
    for u, v in np.random.default_rng(1).integers((-5, -4), (81, 61), (40, 2)):
        expected = [direct(features, weight, template, u, v, False) for template in templates]
        scores = [score if share >= 0.5 else -1.0 for score, share in expected]
        assert volume.score[v + 4, u + 5] == pytest.approx(max(scores), abs=1e-4)
        if max(scores) > -1:
            assert scores[volume.hypothesis[v + 4, u + 5]] == pytest.approx(max(scores), abs=1e-4)


def test_the_number_of_threads_changes_nothing():
    features, weight, templates, extent = scene(5)
    templates += templates[::-1]
    one = search(features, weight, templates.__getitem__, 14, (0, 0, 73, 56), extent)
    for threads in (2, 3, 20):
        more = search(features, weight, templates.__getitem__, 14, (0, 0, 73, 56), extent, threads=threads)
        assert np.array_equal(one.score, more.score)
        assert np.array_equal(one.hypothesis, more.hypothesis)
    assert one.hypothesis.max() < 7, "of equal hypotheses the first is named"


def test_the_right_hypothesis_and_place_win():
    features = RNG.normal(size=(60, 60, 2)).astype(np.float32)
    cut = features[20:32, 30:45].copy()
    templates = [
        Template(RNG.normal(size=cut.shape).astype(np.float32), np.ones(cut.shape[:2], np.float32), (2, 3)) for _ in range(3)
    ]
    templates[1] = Template(cut, np.ones(cut.shape[:2], np.float32), (2, 3))
    volume = search(features, np.ones((60, 60), np.float32), templates.__getitem__, 3, (0, 0, 59, 59), (2, 3, 16, 14))
    peak = find_peaks(volume, np.ones(volume.score.shape, np.bool_), 3, 2)[0]
    assert (round(peak.u_px), round(peak.v_px), peak.hypothesis) == (28, 17, 1)
    assert peak.score == pytest.approx(1.0, abs=1e-3)


def test_peaks_are_apart_allowed_and_sub_pixel():
    v, u = np.mgrid[0:40, 0:50]
    score = np.exp(-((u - 12.3) ** 2 + (v - 20.6) ** 2) / 20) + 0.8 * np.exp(-((u - 35) ** 2 + (v - 8) ** 2) / 20)
    volume = ScoreVolume(score.astype(np.float32), np.zeros(score.shape, np.int32), (100, 200))
    first, second = find_peaks(volume, np.ones(score.shape, np.bool_), 8, 2)
    assert (first.u_px, first.v_px) == pytest.approx((112.3, 220.6), abs=0.1)
    assert (second.u_px, second.v_px) == pytest.approx((135, 208), abs=0.1)
    only = find_peaks(volume, u > 25, 8, 1)[0]
    assert only.u_px == pytest.approx(135, abs=0.1)
    assert find_peaks(volume, np.zeros(score.shape, np.bool_), 8, 3) == []


def test_the_slope_of_a_peak_is_no_other_peak():
    """Also where it is higher than a real one further off; at the edge of what is allowed it may lead up to what is not."""
    v, u = np.mgrid[0:40, 0:60]
    score = np.exp(-((u - 15) ** 2 + (v - 20) ** 2) / 200) + 0.3 * np.exp(-((u - 50) ** 2 + (v - 20) ** 2) / 8)
    volume = ScoreVolume(score.astype(np.float32), np.zeros(score.shape, np.int32), (0, 0))
    everywhere = np.ones(score.shape, np.bool_)
    assert [(round(p.u_px), round(p.v_px)) for p in find_peaks(volume, everywhere, 4, 10)] == [(15, 20), (50, 20)]
    assert [round(p.u_px) for p in find_peaks(volume, u > 20, 4, 10)] == [20, 50]
