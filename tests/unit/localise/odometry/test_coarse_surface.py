"""Odometry over a surface model whose samples are so far apart that hills lie between them."""

from __future__ import annotations

import math
from dataclasses import replace

import cv2
import numpy as np
import pytest

from visloc_companion.localise.flow import FrameToFrame
from visloc_companion.localise.mapped.surface_error import unresolved_of, unresolved_parts
from visloc_companion.localise.odometry.base import FlowSettings, Sight, Step, Surface
from visloc_companion.localise.odometry.below import on_surface
from visloc_companion.types import CameraModel

MODEL = CameraModel(320, 240, 280.0, 280.0, 159.5, 119.5)
A_NE_PIX = np.array([[0.0, -1.0, 349.5], [1.0, 0.0, -349.5]])
SAMPLES_M = 87.5


def land_of(seed: int) -> tuple[np.ndarray, np.ndarray]:
    """700 m of land, and what a model with samples 87.5 m apart has of it."""
    noise = cv2.GaussianBlur(np.random.default_rng(seed).standard_normal((700, 700)).astype(np.float32), (0, 0), 30)
    land = 300 + noise * np.float32(20 / noise.std())
    coarse = cv2.resize(cv2.resize(land, (8, 8), interpolation=cv2.INTER_AREA), (700, 700), interpolation=cv2.INTER_LINEAR)
    return land, coarse


def test_a_way_over_hills_that_the_model_does_not_have_is_seen(support) -> None:  # type: ignore[no-untyped-def]
    """Tracks bent by them passed for tracks that do not fit one motion: six of these eight legs were not seen."""
    squared_sigmas = []
    for seed in range(8):
        land, coarse = land_of(seed)
        world, up = support.FlatMap(support.blobs(seed, 700), land), float(land[350, 350]) + 130.0
        flow, found = FrameToFrame(MODEL), None
        for k in range(4):
            frame = support.render(world, MODEL, (10.0 * k, 0.0, -up), (0.0, 0.0, 0.5))
            q = (math.cos(0.25), 0.0, 0.0, math.sin(0.25))
            sight = Sight(frame, k * 500_000_000, q, math.radians(0.5), math.radians(1.0), up, 2.0, (10.0 * k, 0.0), 3.0)
            found = flow.step(sight, Surface(coarse, A_NE_PIX, SAMPLES_M))
        assert isinstance(found, Step), found
        o = found.odometry
        off = np.array(o.displacement_ned_m[:2]) - (20e-9 * (o.t_to_ns - o.t_from_ns), 0.0)
        squared_sigmas.append(float(off @ np.linalg.solve(np.array(o.cov_ne_m2), off)))
    assert np.mean(squared_sigmas) < 3.5  # of two degrees of freedom: 2 is expected, 3.5 once in 30 times


def test_the_land_between_samples_is_open_where_they_are_far_apart() -> None:
    _, coarse = land_of(0)
    rng = np.random.default_rng(1)
    rays = np.column_stack([rng.uniform(-0.6, 0.6, (80, 2)), np.ones(80)])
    sight = Sight(np.zeros((2, 2), np.uint8), 0, (1.0, 0.0, 0.0, 0.0), 0.01, 0.02, 450.0, 2.0, (0.0, 0.0), 3.0)
    surface = Surface(coarse, A_NE_PIX)
    plain, ten, far = (on_surface(rays, sight, replace(surface, dsm_gsd_m=m), FlowSettings()) for m in (0.0, 10.0, SAMPLES_M))
    assert plain is not None and ten is not None and far is not None
    assert (ten.level_m, ten.slope_rad) == (plain.level_m, plain.slope_rad)
    assert np.array_equal(ten.spread_m, plain.spread_m)
    sigma = unresolved_of(coarse, 1.0, SAMPLES_M)
    level, slope, rest = unresolved_parts(far.at_ned_m[:, :2], sigma, SAMPLES_M)
    assert level**2 + rest**2 < sigma**2
    assert far.level_m == pytest.approx(math.hypot(plain.level_m, level))
    assert far.slope_rad == pytest.approx(math.hypot(plain.slope_rad, slope))
    assert far.spread_m == pytest.approx(np.hypot(plain.spread_m, rest))


@pytest.mark.parametrize("at", [np.zeros((0, 2)), np.zeros((2, 2)), np.column_stack([np.arange(9.0), np.arange(9.0)])])
def test_places_that_have_no_plane_have_all_of_it_in_their_level(at) -> None:  # type: ignore[no-untyped-def]
    assert unresolved_parts(at, 4.0, 90.0) == (4.0, 0.0, 0.0)
