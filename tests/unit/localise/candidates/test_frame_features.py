"""Which of the ranges of heading and scale a frame's features are computed for, and when."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
import pytest
from numpy.typing import NDArray

from visloc_companion.localise.candidates.frame_features import DescentFeatures, frame_features
from visloc_companion.localise.candidates.hypotheses import search_box, search_window
from visloc_companion.localise.features.base import Float32Array, Mask
from visloc_companion.localise.features.gradient import GradientFeatures
from visloc_companion.localise.frame import full_level, reduced
from visloc_companion.localise.mapped.window import cropped, map_grid
from visloc_companion.localise.ortho_rectify import CameraPose, MapGrid
from visloc_companion.localise.plan import SearchPlan, make_plan, turned
from visloc_companion.localise.settings import LocaliserSettings
from visloc_companion.types import CameraModel

MODEL = CameraModel(160, 120, 140.0, 140.0, 79.5, 59.5)
TURN_RAD, LOG_SCALE = 0.2, 0.1


@dataclass(frozen=True, slots=True)
class Counted(GradientFeatures):
    """Gradients that may be resampled as a network's features are; notes the size each time they are computed."""

    tolerance: tuple[float, float] | None = (TURN_RAD, LOG_SCALE)
    computed: list[tuple[int, ...]] = field(default_factory=list)

    def __call__(self, image: NDArray[np.uint8] | Float32Array, valid: Mask, margin_px: int = 0) -> Float32Array:
        self.computed.append(image.shape)
        return GradientFeatures.__call__(self, image, valid, margin_px)


Frame = tuple[SearchPlan, MapGrid, Callable[[Counted], DescentFeatures]]


@pytest.fixture
def frame(flat, support) -> Frame:
    """A plan over four ranges of heading and two of scale or more, the map's window, and a frame of noise for it."""
    request = support.request_at((0.0, 0.0, -240.0), (0.0, 0.0, 0.0), sigma_h_m=6.0, sigma_yaw_deg=12.0)
    plan = make_plan(request.prior, MODEL, flat, LocaliserSettings())
    assert isinstance(plan, SearchPlan)
    grid = cropped(map_grid(flat, plan.frame, *search_box(plan), plan.coarse_gsd_m, Counted()))
    pixels = np.random.default_rng(4).integers(0, 256, (120, 160)).astype(np.uint8)
    level = reduced(full_level(pixels, MODEL), plan.coarse_gsd_m / plan.frame_gsd_m)
    return plan, grid, lambda features: frame_features(level, plan, grid.A_ne_pix[:, :2], features)


def ranges(plan: SearchPlan) -> int:
    """How many of heading and scale cover what is searched."""
    spread = np.ptp(plan.headings_rad) / (2 * TURN_RAD), np.ptp(np.log(plan.scales)) / (2 * LOG_SCALE)
    return int(np.prod(np.maximum(1, np.ceil(spread))))


def turned_to(plan: SearchPlan, heading_rad: float) -> CameraPose:
    return CameraPose(plan.pose.p_ned_m, turned(plan.pose.R_ned_cam, heading_rad))


def test_what_refines_one_place_computes_the_features_of_its_own_heading_alone(frame: Frame) -> None:
    plan, grid, make = frame
    features = Counted()
    of_frame = make(features)
    assert not features.computed
    pose = turned_to(plan, float(plan.headings_rad[0]))
    of_frame.about(pose, grid, 1)
    of_frame.on_surface(pose, grid)
    of_frame.on_plane(pose, grid.A_ne_pix, (40, 30), plan.ground_up_m)
    assert len(features.computed) == 1
    of_frame.about(turned_to(plan, float(plan.headings_rad[-1])), grid, 1)
    assert len(features.computed) == 2


def test_a_search_computes_all_of_them_once_on_however_many_threads(frame: Frame) -> None:
    plan, grid, make = frame
    assert ranges(plan) > 4
    for threads in (1, 4):
        features = Counted()
        search_window(grid, make(features), plan, threads=threads)
        assert len(features.computed) == ranges(plan)


def test_what_was_asked_for_before_changes_nothing(frame: Frame) -> None:
    plan, grid, make = frame
    fresh, searched = make(Counted()), make(Counted())
    search_window(grid, searched, plan)
    for heading_rad in plan.headings_rad[[0, -1]].tolist():
        pose = turned_to(plan, heading_rad)
        for one, other in zip(fresh.on_surface(pose, grid), searched.on_surface(pose, grid), strict=True):
            np.testing.assert_array_equal(one, other)
