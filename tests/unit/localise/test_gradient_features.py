from __future__ import annotations

import numpy as np
import pytest

from visloc_companion.localise.features.gradient import CLIP, eroded, gradient_features, grey, local_mean

ALL = np.ones((64, 64), np.bool_)


def stripes(angle_rad: float, contrast: float = 50.0) -> np.ndarray:
    v, u = np.mgrid[0:64, 0:64]
    return (120 + contrast * np.sin((u * np.cos(angle_rad) + v * np.sin(angle_rad)) * 0.5)).astype(np.float32)


@pytest.mark.parametrize("angle_deg", [0, 30, 45, 90, 120, 170])
def test_angle_is_doubled_and_contrast_may_turn_round(angle_deg):
    angle = np.radians(angle_deg)
    for contrast in (50.0, -50.0):
        features = gradient_features(stripes(angle, contrast), ALL)[20:44, 20:44]
        mean = features.reshape(-1, 2).mean(0)
        direction = np.arctan2(mean[1], mean[0])
        assert np.cos(direction - 2 * angle) > 0.99


def test_magnitude_is_relative_to_the_neighbourhood_and_clipped():
    faint, strong = (gradient_features(stripes(0.4, c), ALL) for c in (20.0, 80.0))
    assert np.abs(faint - strong).max() < 0.15
    lonely = np.full((64, 64), 100, np.uint8)
    lonely[:, 32:] = 200
    assert np.linalg.norm(gradient_features(lonely, ALL), axis=2).max() == pytest.approx(CLIP, rel=1e-3)


def test_invalid_pixels_and_their_neighbours_are_zero():
    valid = ALL.copy()
    valid[:, 40:] = False
    image = stripes(0.7)
    image[:, 40:] = 0
    features = gradient_features(image, valid)
    assert not features[:, 37:].any()
    assert features[:, :36].any()
    whole = gradient_features(stripes(0.7), ALL)
    assert np.abs(features[:, :30] - whole[:, :30]).mean() < 0.05


def test_types_and_shapes():
    rgb = np.random.default_rng(1).integers(0, 255, (20, 31, 3)).astype(np.uint8)
    features = gradient_features(rgb, np.ones((20, 31), np.bool_))
    assert features.shape == (20, 31, 2)
    assert features.dtype == np.float32
    assert np.isfinite(gradient_features(np.zeros((20, 31), np.uint8), np.zeros((20, 31), np.bool_))).all()
    np.testing.assert_allclose(grey(rgb), rgb @ np.array([0.299, 0.587, 0.114]), atol=1e-3)


def test_local_mean_of_a_constant_is_the_constant_whatever_the_mask():
    weight = np.ones((50, 70), np.float32)
    weight[10:30, 20:50] = 0
    mean = local_mean(np.full((50, 70), 7.0, np.float32), weight, 5.0)
    np.testing.assert_allclose(mean[weight > 0], 7.0, rtol=1e-3)


def test_erosion_leaves_the_image_border():
    valid = ALL.copy()
    valid[30, 30] = False
    weight = eroded(valid, 2)
    assert weight[0, 0] == 1
    assert not weight[28:33, 28:33].any()
    assert weight.sum() == 64 * 64 - 25


def test_the_same_image_gives_the_same_bits_wherever_it_lies_in_memory():
    image = np.random.default_rng(0).integers(0, 255, (80, 88)).astype(np.uint8)
    valid, kept, answers = np.ones(image.shape, bool), [], set()
    for size in np.random.default_rng(1).integers(1, 9000, 100):
        kept.append(np.empty(size, np.uint8))
        answers.add(gradient_features(image, valid).tobytes())
    assert len(answers) == 1
