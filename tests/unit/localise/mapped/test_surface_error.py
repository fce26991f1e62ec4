"""Ground whose surface model errs, where things stand on it and where not."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import cv2
import numpy as np
import pytest

from visloc_companion.geo.camera import R_FRD_CAM
from visloc_companion.geo.se3 import R_from_quat, quat_from_euler
from visloc_companion.geo.wgs84 import ned_from_geo
from visloc_companion.localise.dense import gradient_localiser
from visloc_companion.localise.features.gradient import GRADIENT
from visloc_companion.localise.mapped.surface_error import (
    GROUND_M,
    LOCAL_SHARE,
    SHARE,
    height_covariance,
    standing_m,
    unresolved_m,
)
from visloc_companion.localise.ortho_rectify import CameraPose, MapGrid
from visloc_companion.localise.pose import PoseEstimate, PriorTerm, solve_pose
from visloc_companion.localise.registry import make_localiser
from visloc_companion.localise.settings import LocaliserSettings
from visloc_companion.types import CameraModel, Fix, FloatArray, ReferencePatch

K = np.array([[400.0, 0, 320], [0, 400.0, 240], [0, 0, 1]])
POSE = CameraPose(np.array([0.0, 0.0, -120.0]), R_from_quat(quat_from_euler(0.0, math.radians(-20.0), 0.0)) @ R_FRD_CAM)
CROWN_M = 14.0
AHEAD = (slice(0, 105), slice(95, 200))
"""Where the grid (pixels) holds a wood: from 5 m west of the camera on to the east."""


def grid_of(surface_up_m: FloatArray) -> MapGrid:
    """One metre a pixel, north up, the origin in the middle."""
    up = surface_up_m.astype(np.float32)
    A = np.array([[0.0, -1.0, 100.0], [1.0, 0.0, -100.0]])
    return MapGrid(np.zeros((*up.shape, 2), np.float32), np.ones_like(up), up, A, 1.0)


def test_what_is_narrow_stands_on_the_ground_and_a_slope_does_not() -> None:
    rows, cols = np.mgrid[:200, :200].astype(float)
    slope = 0.2 * rows + 0.1 * cols
    wood = slope.copy()
    wood[80:116, 60:96] += CROWN_M
    at = np.array([[77.5, 97.5], [150.0, 40.0], [-5.0, 300.0]])
    assert standing_m(grid_of(wood), at, 10.0) == pytest.approx([CROWN_M, 0.0, 0.0], abs=2.0)
    assert standing_m(grid_of(slope), at, 10.0) == pytest.approx(0.0, abs=2.0)
    assert standing_m(grid_of(wood), np.zeros((0, 2)), 10.0).shape == (0,)


def test_neighbours_err_alike_and_woods_err_together() -> None:
    surface = np.zeros((200, 200))
    surface[80:116, 20:56] = surface[80:116, 140:176] = CROWN_M
    at = np.array([[38.0, 98.0], [43.0, 98.0], [158.0, 98.0], [98.0, 20.0], [103.0, 20.0], [98.0, 180.0]])
    covariance = height_covariance(grid_of(surface), at, 10.0)
    sigma = np.sqrt(np.diag(covariance))
    common = covariance / np.outer(sigma, sigma)
    assert sigma[[0, 1, 2]] == pytest.approx(math.hypot(CROWN_M * math.hypot(SHARE, LOCAL_SHARE), GROUND_M), rel=0.1)
    assert sigma[[3, 4, 5]] == pytest.approx(GROUND_M)
    assert min(common[0, 1], common[3, 4]) > 0.9
    assert common[0, 2] > 0.4 > 0.1 > max(common[3, 5], common[0, 3])
    assert np.linalg.eigvalsh(covariance).min() > 0


def solved(seed: int, heights_m2: FloatArray | None, lower_m: FloatArray, points: FloatArray) -> PoseEstimate:
    """A leaning camera over points (N, 3) that are lower than the model by so much (N,)."""
    rng = np.random.default_rng(seed)
    q = (points + np.outer(lower_m, [0.0, 0.0, 1.0]) - POSE.p_ned_m) @ POSE.R_ned_cam
    pix = q[:, :2] / q[:, 2:] * 400 + np.array([320, 240]) + rng.normal(0, 0.8, (len(points), 2))
    prior = PriorTerm(POSE.R_ned_cam, math.radians(0.4), math.radians(5.0), 120.0, 1.6)
    found = solve_pose(points, pix, np.full(len(points), 1.0), K, POSE, prior, 20, heights_m2=heights_m2)
    assert found is not None
    return found


def seen_wood() -> tuple[FloatArray, FloatArray, FloatArray]:
    """Points (40, 3) of a view that half shows a wood, the crowns' heights (40,) and what is said of the model's errors."""
    rng = np.random.default_rng(4)
    points = np.column_stack([rng.uniform(0, 95, 40), rng.uniform(-50, 50, 40), np.zeros(40)])
    crowns = np.where(points[:, 1] > 0.0, CROWN_M, 0.0)
    points[:, 2] = -crowns
    rows, cols = np.mgrid[:200, :200]
    stripes = np.where((cols > 100) & (cols < 155) & (rows < 105), CROWN_M, 0.0)
    at = np.column_stack([points[:, 1] + 100, 100 - points[:, 0]])
    return points, crowns, height_covariance(grid_of(stripes), at, 1.0)


def test_a_bare_wood_under_a_leaning_camera_moves_the_pose_less() -> None:
    points, crowns, heights_m2 = seen_wood()
    off = {
        known: np.mean([solved(s, heights_m2 if known else None, 0.4 * crowns, points).pose.p_ned_m for s in range(30)], axis=0)
        - POSE.p_ned_m
        for known in (False, True)
    }
    assert np.abs(off[True]).max() < 0.5 * np.abs(off[False]).max()
    assert np.abs(off[False]).max() > 1.0


def test_the_claim_holds_for_heights_that_err_as_said_and_not_without() -> None:
    points, _, heights_m2 = seen_wood()
    root, rng = np.linalg.cholesky(heights_m2), np.random.default_rng(9)
    chi2: dict[bool, list[float]] = {True: [], False: []}
    for seed in range(150):
        lower_m = root @ rng.standard_normal(len(points))
        for known, found in chi2.items():
            estimate = solved(seed, heights_m2 if known else None, lower_m, points)
            off = (estimate.pose.p_ned_m - POSE.p_ned_m) * [1.0, 1.0, -1.0]
            found.append(float(off @ np.linalg.solve(estimate.covariance[:3, :3], off)))
    assert 1.5 < np.mean(chi2[True]) < 3.3  # three axes; the prior is right by chance
    assert np.mean(chi2[False]) > 2 * np.mean(chi2[True])


def test_heights_that_do_not_err_change_nothing() -> None:
    points, crowns, _ = seen_wood()
    exact, without = (solved(1, heights, 0.1 * crowns, points) for heights in (np.zeros((40, 40)), None))
    assert exact.pose.p_ned_m == pytest.approx(without.pose.p_ned_m, abs=1e-9)
    assert exact.covariance == pytest.approx(without.covariance, rel=1e-9)


def test_fixes_claim_it_over_a_surface_model_only(flat, hilly, support, monkeypatch) -> None:  # type: ignore[no-untyped-def]
    model, level = CameraModel(160, 120, 140.0, 140.0, 79.5, 59.5), (0.0, 0.35, 0.6)

    def sigma_h_m(ref) -> float:  # type: ignore[no-untyped-def]
        frame = support.render(ref, model, (23.0, -41.0, -235.0), level)
        answer = gradient_localiser(model, LocaliserSettings()).localise(
            support.request_at((12.0, -29.0, -232.0), level), frame, ref
        )
        assert isinstance(answer, Fix)
        return answer.sigma_h_m

    claimed = {"flat": sigma_h_m(flat), "hilly": sigma_h_m(hilly)}
    monkeypatch.setattr(
        "visloc_companion.localise.candidates.block_pose.height_covariance",
        lambda grid, at_px, side_px: np.zeros((len(at_px),) * 2),
    )
    assert sigma_h_m(flat) == claimed["flat"]
    assert sigma_h_m(hilly) < 0.95 * claimed["hilly"]


def test_between_the_samples_of_a_coarse_model_the_land_is_not_known() -> None:
    rows, cols = np.mgrid[:200, :200].astype(float)
    hill = grid_of(0.2 * rows + 10 * np.sin(cols / 30))
    assert unresolved_m(hill) == unresolved_m(replace(hill, dsm_gsd_m=10.0)) == 0
    assert unresolved_m(replace(grid_of(0.2 * rows + 0.1 * cols), dsm_gsd_m=90.0)) == pytest.approx(0.0, abs=1e-3)
    thirty, ninety = (unresolved_m(replace(hill, dsm_gsd_m=m)) for m in (30.0, 90.0))
    assert 0.5 < thirty < 0.5 * ninety < 5.0
    at = np.array([[50.0, 50.0], [55.0, 50.0], [150.0, 150.0]])
    fine, coarse = (height_covariance(replace(hill, dsm_gsd_m=m), at, 10.0) for m in (0.0, 90.0))
    assert (np.diag(coarse) - np.diag(fine)) == pytest.approx(ninety**2)
    assert np.linalg.eigvalsh(coarse).min() > 0


@pytest.mark.parametrize(("method", "most_m"), [("gradient", 2.0), ("keypoint", 4.0), ("iclk", 3.0)])
@pytest.mark.parametrize("place", [(60.0, 40.0), (-20.0, -60.0), (80.0, -20.0)])
def test_hills_between_the_samples_of_a_model_are_no_tilt(place, method, most_m, support) -> None:  # type: ignore[no-untyped-def]
    """Of 88 m: the prior's tilt was given up for them, and fixes were 8 m off, 4.6 to 5.1 times what they claimed; those of key
    points were as surely wrong."""
    pixels = support.texture(1, 700)
    rows, cols = np.mgrid[:700, :700]
    land = (100 + 12 * np.sin(cols / 40) * np.cos(rows / 55)).astype(np.float32)
    coarse = cv2.resize(cv2.resize(land, (8, 8), interpolation=cv2.INTER_AREA), (700, 700), interpolation=cv2.INTER_LINEAR)
    model, truth, level = CameraModel(240, 180, 210.0, 210.0, 119.5, 89.5), (*place, -235.0), (0.02, -0.03, 0.6)
    frame = support.render(support.FlatMap(pixels, land), model, truth, level)
    request = support.request_at((place[0] + 9, place[1] - 7, -233.0), level, model=model)
    localiser = make_localiser(method, model, features=GRADIENT)
    answer = localiser.localise(request, frame, Coarse(support.FlatMap(pixels, coarse)))
    assert isinstance(answer, Fix)
    north, east, _ = ned_from_geo(answer.place, support.HOME)
    off = np.array([north - place[0], east - place[1]])
    assert math.hypot(*off) < most_m
    assert float(off @ np.linalg.solve(answer.cov_ne_m2, off)) < 6.0  # 95 %


@pytest.mark.parametrize("samples_m", [1.0, 87.5])
def test_heights_that_a_plane_is_searched_for_are_claimed_no_better_than_they_are(samples_m, support) -> None:  # type: ignore[no-untyped-def]
    """By `ncc`: they were up to 15 of its sigmas off over hills, known or not, here 9.6 and 8.7."""
    off_sigmas = []
    for seed in range(4):
        rng = np.random.default_rng(seed)
        noise = cv2.GaussianBlur(rng.standard_normal((700, 700)).astype(np.float32), (0, 0), 45)
        land = 100 + noise * np.float32(18 / noise.std())
        coarse = cv2.resize(cv2.resize(land, (8, 8), interpolation=cv2.INTER_AREA), (700, 700), interpolation=cv2.INTER_LINEAR)
        model, level = CameraModel(240, 180, 210.0, 210.0, 119.5, 89.5), (0.0, 0.0, 0.6)
        truth = (*rng.uniform(-80, 80, 2), -260.0)
        pixels = support.texture(seed, 700)
        frame = support.render(support.FlatMap(pixels, land), model, truth, level)
        request = support.request_at((truth[0] + 5, truth[1] - 4, -258.0), level, sigma_m=8.0, sigma_h_m=5.0, model=model)
        known = support.FlatMap(pixels, land) if samples_m <= 1 else Coarse(support.FlatMap(pixels, coarse))
        answer = make_localiser("ncc", model).localise(request, frame, known)
        if isinstance(answer, Fix):
            off_sigmas.append((answer.place.h_amsl_m - 260.0) / answer.sigma_h_m)
    assert len(off_sigmas) >= 3
    assert max(abs(off) for off in off_sigmas) < 3.0


class Coarse:
    """A map that tells its surface model's samples to be 88 m apart."""

    def __init__(self, known: Any) -> None:
        self._known = known

    def __getattr__(self, name: str) -> Any:
        return getattr(self._known, name)

    def patch(self, *window: Any) -> ReferencePatch:
        patch: ReferencePatch = self._known.patch(*window)
        return replace(patch, dsm_gsd_m=87.5)
