"""Blocks of two kinds of features, solved together."""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np
import pytest

from visloc_companion.geo.wgs84 import ned_from_geo
from visloc_companion.localise.blocks import curvatures
from visloc_companion.localise.candidates.ranking import GRADIENT_RANK
from visloc_companion.localise.dense import DenseLocaliser, Fitted
from visloc_companion.localise.ortho_rectify import CameraPose
from visloc_companion.localise.pose import PriorTerm, solve_pose
from visloc_companion.localise.settings import LocaliserSettings
from visloc_companion.localise.verify import GRADIENT_WEIGHTS
from visloc_companion.types import CameraModel, Fix, GeoPoint

K = np.array([[400.0, 0, 320], [0, 400.0, 240], [0, 0, 1]])
ABOVE = CameraPose(np.array([0.0, 0.0, -100.0]), np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]]))
KNOWN = PriorTerm(ABOVE.R_ned_cam, math.radians(0.02), math.radians(0.02), 100.0, 0.1)
MODEL = CameraModel(160, 120, 140.0, 140.0, 79.5, 59.5)
LEVEL = (0.0, 0.0, 0.6)


def on_ground(n, rng):
    points = np.column_stack([rng.uniform(-60, 60, (n, 2)), np.zeros(n)])
    q = (points - ABOVE.p_ned_m) @ ABOVE.R_ned_cam
    return points, q[:, :2] / q[:, 2:] * 400 + np.array([320, 240])


def test_a_channel_that_scatters_more_counts_less():
    off_m: dict[str, list[float]] = {"apart": [], "alike": []}
    for seed in range(30):
        rng = np.random.default_rng(seed)
        points, pix = on_ground(48, rng)
        seen = pix + rng.normal(0, 1, pix.shape) * np.repeat([[1.0], [4.0]], [12, 36], axis=0)
        for name, channel in (("apart", np.repeat([0, 1], [12, 36])), ("alike", np.zeros(48, dtype=np.int64))):
            found = solve_pose(points, seen, np.ones(48), K, ABOVE, KNOWN, cauchy=1.5, channel=channel)
            assert found is not None
            off_m[name].append(float(np.hypot(*found.pose.p_ned_m[:2])))
    assert np.mean(off_m["apart"]) < 0.85 * np.mean(off_m["alike"])


def test_points_known_across_a_line_alone_say_nothing_along_it():
    rng = np.random.default_rng(4)
    points, pix = on_ground(60, rng)
    along = np.repeat([0.2, 1.2], 30)
    lines = np.column_stack([np.cos(along), np.sin(along)])
    seen = pix + 5 * rng.normal(size=(60, 1)) * lines + 0.3 * rng.normal(size=(60, 2))
    across = np.eye(2) - 0.95 * lines[:, :, None] * lines[:, None, :]
    told = solve_pose(points, seen, np.full(60, 0.3), K, ABOVE, KNOWN, whitening=across)
    plain = solve_pose(points, seen, np.full(60, 0.3), K, ABOVE, KNOWN)
    assert told is not None
    assert plain is not None
    assert np.hypot(*told.pose.p_ned_m[:2]) < 0.3 * np.hypot(*plain.pose.p_ned_m[:2])
    assert np.trace(told.covariance[:2, :2]) < 0.25 * np.trace(plain.covariance[:2, :2])


def test_a_correlation_falls_off_across_a_line_and_not_along_it():
    v, u = np.mgrid[-6:7, -6:7].astype(np.float32)
    across = (u * math.cos(0.4) + v * math.sin(0.4)) / 2.0
    line, corner = np.exp(-(across**2) / 2), np.exp(-((u - 6) ** 2 + (v + 6) ** 2) / 8)
    found, at_border = curvatures([line.astype(np.float32), corner.astype(np.float32)])
    values, axes = np.linalg.eigh(found)
    assert values[0] == pytest.approx(0.0, abs=0.01)
    assert values[1] == pytest.approx(0.25, abs=0.03)
    assert abs(axes[:, 1] @ [math.cos(0.4), math.sin(0.4)]) > 0.99
    assert np.isfinite(at_border).all()


@dataclass
class Grey:
    """Another kind of features than gradients: how bright a pixel is beside its surroundings, and how much."""

    name: str = "grey"
    recipe: str = "difference of Gaussians, 1 and 4 px, and of 2 and 8 px"
    channels: int = 2
    oriented: int = 0
    bound: float = 4.0
    context_px: int = 24
    tolerance: tuple[float, float] | None = None

    def __call__(self, image, valid):
        grey = np.where(valid, image.astype(np.float32).reshape(*valid.shape, -1).mean(2), 110.0)
        bands = [cv2.GaussianBlur(grey, (0, 0), s) - cv2.GaussianBlur(grey, (0, 0), 4 * s) for s in (1.0, 2.0)]
        return np.stack([np.clip(band / 25, -4, 4) for band in bands], axis=2).astype(np.float32) * valid[..., None]


def changed(support, seed):
    """The same land with what grows on it that year."""
    land = support.texture(1, 400).astype(np.float32)
    grown = cv2.GaussianBlur(np.random.default_rng(seed).standard_normal(land.shape).astype(np.float32), (0, 0), 1.5)
    pixels = np.clip(land + 22 * grown / grown.std(), 0, 255).astype(np.uint8)
    return support.FlatMap(pixels, np.full(pixels.shape, 100.0, np.float32))


def fixes(support, agl_m, n):
    """Fixes and truths over land that has changed, from so far up, with no limit on what they may claim."""
    known, rng = changed(support, 0), np.random.default_rng(9)
    fitted, settings = Fitted(GRADIENT_WEIGHTS, GRADIENT_RANK, 1.04), LocaliserSettings(max_probability_wrong=1.0)
    localiser = DenseLocaliser("deep", MODEL, settings, Grey(), fitted)
    for k in range(n):
        truth = (*rng.uniform(-90, 90, 2).tolist(), -100.0 - agl_m)
        frame = support.render(changed(support, 1 + k), MODEL, truth, LEVEL)
        near = tuple((np.array(truth) + rng.normal(size=3) * (4.0, 4.0, 2.0)).tolist())
        yield localiser.localise(support.request_at(near, LEVEL, 6.0, 3.0), frame, known), np.array(truth)


def errors(found):
    """Horizontal error (m) and half of its squared Mahalanobis distance of each fix."""
    rows = []
    for fix, truth in found:
        assert isinstance(fix, Fix)
        off = np.subtract(ned_from_geo(fix.place, GeoPoint(47.0, 8.0, 0.0)), truth)[:2]
        rows.append((float(np.hypot(*off)), float(off @ np.linalg.solve(np.array(fix.cov_ne_m2), off)) / 2))
    return np.array(rows)


@pytest.mark.parametrize("agl_m", [64.0, 96.0])
def test_solved_together_fixes_are_nearer_and_claim_what_they_err_by(support, monkeypatch, agl_m):
    together = errors(fixes(support, agl_m, 12))
    monkeypatch.setattr("visloc_companion.localise.dense.solved_together", lambda *_: None)
    apart = errors(fixes(support, agl_m, 12))
    assert np.sqrt((together[:, 0] ** 2).mean()) < 0.85 * np.sqrt((apart[:, 0] ** 2).mean())
    assert together[:, 1].mean() < 1.3
