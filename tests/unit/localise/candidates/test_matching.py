"""Candidates are told apart by the ground that they look at."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import pytest

from visloc_companion.localise.answer import Stopwatch
from visloc_companion.localise.candidates.descent import Descended
from visloc_companion.localise.candidates.hypotheses import search_box
from visloc_companion.localise.candidates.matching import SAME_GSD, Task, distinct, refined_candidates
from visloc_companion.localise.candidates.open_places import share_of, weighed
from visloc_companion.localise.candidates.ranking import DEEP_RANK, GRADIENT_RANK
from visloc_companion.localise.features.gradient import GRADIENT, GradientFeatures
from visloc_companion.localise.frame import full_level
from visloc_companion.localise.local_frame import local_frame
from visloc_companion.localise.mapped.window import cropped, map_grid
from visloc_companion.localise.ortho_rectify import CameraPose, MapGrid
from visloc_companion.localise.plan import SearchPlan, make_plan
from visloc_companion.localise.pose import to_view, turned_about_view
from visloc_companion.localise.settings import LocaliserSettings
from visloc_companion.maps.pack import PackMap
from visloc_companion.prepare.build import build_pack
from visloc_companion.types import CameraModel, GeoPoint

MODEL = CameraModel(160, 120, 140.0, 140.0, 79.5, 59.5)

UP_M, GROUND_UP_M = 150.0, 30.0
NADIR = CameraPose(np.array([5.0, -8.0, -UP_M]), np.eye(3))


def candidate(pose, score):
    return Descended(pose, score, np.zeros((6, 6)))


def view_ne_m(pose):
    return (pose.p_ned_m + to_view(pose, GROUND_UP_M))[:2]


def test_two_tilts_at_the_same_ground_are_one_place():
    tilted = turned_about_view(NADIR, GROUND_UP_M, np.array([0.0, 0.1, 0.0]))
    assert np.hypot(*(tilted.p_ned_m - NADIR.p_ned_m)[:2]) > 10.0
    better, worse = candidate(NADIR, 0.5), candidate(tilted, 0.4)
    assert distinct([better, worse], 2.0, view_ne_m) == [better]


def test_other_ground_from_the_same_position_is_another_place():
    elsewhere = turned_about_view(NADIR, GROUND_UP_M, np.array([0.0, 0.1, 0.0]))
    elsewhere = CameraPose(NADIR.p_ned_m, elsewhere.R_ned_cam)
    both = [candidate(NADIR, 0.5), candidate(elsewhere, 0.4)]
    assert distinct(both, 2.0, view_ne_m) == both
    assert distinct(both, 50.0, view_ne_m) == both[:1]


@dataclass(frozen=True, slots=True)
class Counted(GradientFeatures):
    """Gradients that may be resampled as a network's features are; notes each time that they are computed."""

    tolerance: tuple[float, float] | None = (0.2, 0.1)
    computed: list[tuple[int, ...]] = field(default_factory=list)

    def __call__(self, image, valid):
        self.computed.append(image.shape)
        return GradientFeatures.__call__(self, image, valid)


def task_and_grid(flat: Any, support: Any, features: Counted) -> tuple[Task, MapGrid]:
    """A frame of noise, to be matched to the flat map, and the window that is searched."""
    request = support.request_at((0.0, 0.0, -240.0), (0.0, 0.0, 0.0), sigma_h_m=6.0, sigma_yaw_deg=2.0)
    plan = make_plan(request.prior, MODEL, flat, LocaliserSettings())
    assert isinstance(plan, SearchPlan)
    pixels = np.random.default_rng(4).integers(0, 256, (120, 160)).astype(np.uint8)
    full = full_level(pixels, MODEL)
    task = Task(plan, request.prior, full, flat, Stopwatch(), features, features, DEEP_RANK, 0.673)
    return task, cropped(map_grid(flat, plan.frame, *search_box(plan), plan.coarse_gsd_m, GRADIENT))


def test_candidates_that_come_to_one_place_are_no_rivals_of_each_other(flat, support):
    """One peak had the other for a rival as strong as itself: a place that was right was "one of several"."""
    truth, level = (5.0, 8.0, -240.0), (0.0, 0.0, 0.0)
    request = support.request_at((0.0, 0.0, -240.0), level)
    plan = make_plan(request.prior, MODEL, flat, LocaliserSettings())
    assert isinstance(plan, SearchPlan)
    full = full_level(support.render(flat, MODEL, truth, level), MODEL)
    task = Task(plan, request.prior, full, flat, Stopwatch(), GRADIENT, GRADIENT, GRADIENT_RANK, 1.04)
    apart = [(-2.0, 0.0), (2.0, 1.0), (40.0, -30.0)]
    starts = [CameraPose(np.add(truth, (north, east, 0.0)), plan.pose.R_ned_cam) for north, east in apart]
    candidates = [candidate(start, 0.9 - 0.01 * k) for k, start in enumerate(starts)]
    assert len(distinct(candidates, 2 * plan.coarse_gsd_m, task.view_ne_m)) == 3
    here, elsewhere = refined_candidates(task, candidates)
    assert here.descended.pose.p_ned_m[:2] == pytest.approx(truth[:2], abs=0.3)
    assert np.hypot(*(elsewhere.descended.pose.p_ned_m - here.descended.pose.p_ned_m)[:2]) > 20.0
    likely = weighed(task, [here, elsewhere], here, [])
    assert share_of(task, [here, elsewhere], here, likely) > 0.99


@pytest.mark.parametrize(("factor", "times"), [(1 + 3e-7, 1), (1 - 3e-7, 1), (2**0.5, 2)])
def test_features_are_made_once_for_candidates_where_the_maps_scale_differs_a_little(
    flat, support, factor: float, times: int
) -> None:
    features = Counted()
    task, grid = task_and_grid(flat, support, features)
    elsewhere = replace(grid, gsd_m=grid.gsd_m * factor)
    for window in (grid, elsewhere, grid):
        task.frame(window, features).on_surface(task.plan.pose, window)
    assert len(features.computed) == times
    assert len(task.levels) == times
    assert (task.level(elsewhere.gsd_m) is task.level(grid.gsd_m)) == (times == 1)


def test_features_of_another_name_are_others(flat, support) -> None:
    first, second = Counted(), Counted(name="another")
    task, grid = task_and_grid(flat, support, first)
    assert task.frame(grid, first) is not task.frame(grid, second)
    assert len(task.levels) == 1


def test_stored_levels_differ_by_the_maps_scale_from_place_to_place(tmp_path, write_raster) -> None:
    image = np.kron(np.random.default_rng(3).uniform(20, 235, (50, 50)), np.ones((12, 12))).astype(np.uint8)
    write_raster(tmp_path / "a.tif", image, "EPSG:32633", (47.0, 15.3), 0.5)
    build_pack([tmp_path / "a.tif"], None, tmp_path / "pack", ground_h_amsl_m=300.0)
    pack = PackMap.open(tmp_path / "pack", verify_hashes=False)
    frame = local_frame(GeoPoint(47.0, 15.3, 0.0), pack)
    west, east = (map_grid(pack, frame, at - 30.0, at + 30.0, 0.5, GRADIENT) for at in np.array([[0.0, -80.0], [0.0, 80.0]]))
    assert 0.0 < abs(east.gsd_m / west.gsd_m - 1) < SAME_GSD / 100
