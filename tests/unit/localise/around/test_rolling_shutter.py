"""Frames of a rolling shutter, against those of a camera that stands still, as the simulator renders both."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, cast

import numpy as np
import pytest

from tests.unit.level_ground import apart, level_ground, over_its_middle
from visloc_companion.geo.se3 import quat_from_euler
from visloc_companion.localise.around.rectified import rectified
from visloc_companion.localise.around.rolling_shutter import Unrolled, unrolled
from visloc_companion.protocols import ReferenceMap
from visloc_companion.sim.render import CameraSimulator
from visloc_companion.sim.rendering.render_motion import Shot
from visloc_companion.sim.scene import Scene
from visloc_companion.types import CameraModel, FrameRef, Image, LocaliseRequest, PosePrior, Quat, Readout, Vec3

HEIGHT_M = 100.0
MODEL = CameraModel(320, 240, 300.0, 300.0, 159.5, 119.5)
BENT = replace(MODEL, distortion=(-0.2, 0.05, 0.001, -0.001, 0.0))
FISHEYE = CameraModel(320, 240, 190.0, 190.0, 162.0, 117.0, (0.02, -0.01, 0.003, -0.001), "fisheye")
PAST_ITS_PLANE = CameraModel(320, 240, 100.0, 100.0, 159.5, 119.5, (0.0, 0.0, 0.0, 0.0), "fisheye")
LEVEL, LEANING = quat_from_euler(0.0, 0.0, 0.7), quat_from_euler(0.3, -0.25, 2.0)
STILL: Vec3 = (0.0, 0.0, 0.0)
PLACE = over_its_middle(HEIGHT_M)


@pytest.fixture(scope="module")
def scene() -> Scene:
    return level_ground()


def inner_apart(a: Image, b: Image) -> float:
    """How far two pictures are apart without the rim that only one of them saw."""
    inside = (slice(24, -24), slice(24, -24))
    return apart(a[inside], b[inside])


@pytest.mark.parametrize("readout_s", [0.05, -0.03])
@pytest.mark.parametrize(
    ("model", "q", "rate", "v"),
    [
        (MODEL, LEVEL, (0.5, 0.0, 0.0), STILL),
        (MODEL, LEVEL, (0.0, -0.5, 0.0), STILL),
        (MODEL, LEANING, (0.0, 0.0, 0.8), STILL),
        (MODEL, LEVEL, STILL, (25.0, -35.0, 3.0)),
        (BENT, LEANING, (0.3, 0.4, -0.5), (-12.0, 14.0, -4.0)),
        (FISHEYE, LEVEL, (0.5, 0.3, 0.2), (25.0, -35.0, 3.0)),
    ],
)
def test_rows_are_put_where_the_middle_one_would_have_seen_them(
    scene: Scene, model: CameraModel, q: Quat, rate: Vec3, v: Vec3, readout_s: float
) -> None:
    camera = CameraSimulator(scene, model)
    still, rolled = camera.frame(PLACE, q), camera.frame(PLACE, q, shot=Shot(v, rate, readout_s))
    told = unrolled(rolled, model, q, Readout(readout_s, rate, v, HEIGHT_M))
    assert inner_apart(rolled, still) > 2.0, "the shutter shows"
    assert inner_apart(told, still) < 0.25 * inner_apart(rolled, still)
    assert told.shape == rolled.shape
    assert told.dtype == np.uint8


def test_a_lens_that_sees_past_its_own_plane_is_set_right_where_it_is_looked_at(scene: Scene) -> None:
    """Of 229° corner to corner, rays at the rim turn behind the plane, where they have no pixel."""
    rate = (0.6, -0.3, 0.2)
    camera = CameraSimulator(scene, PAST_ITS_PLANE)
    still, rolled = camera.frame(PLACE, LEVEL), camera.frame(PLACE, LEVEL, shot=Shot(STILL, rate, 0.05))
    told = unrolled(rolled, PAST_ITS_PLANE, LEVEL, Readout(0.05, rate, STILL, HEIGHT_M))
    still, rolled, told = (rectified(picture, PAST_ITS_PLANE) for picture in (still, rolled, told))
    assert inner_apart(told, still) < 0.3 * inner_apart(rolled, still)


def test_a_camera_that_hovers_is_left_alone(scene: Scene) -> None:
    picture = CameraSimulator(scene, MODEL).frame(PLACE, LEVEL)
    assert unrolled(picture, MODEL, LEVEL, Readout(0.05, (1e-4, 0.0, 0.0), (0.05, 0.0, 0.0), HEIGHT_M)) is picture


def test_a_horizon_in_view_is_turned_and_not_torn(scene: Scene) -> None:
    """Rays that do not descend have no ground to move over, and the height may not be known at all."""
    q, rate = quat_from_euler(0.0, 1.2, 0.0), (0.5, 0.0, 0.0)
    camera = CameraSimulator(scene, MODEL)
    still, rolled = camera.frame(PLACE, q), camera.frame(PLACE, q, shot=Shot(STILL, rate, 0.05))
    assert inner_apart(unrolled(rolled, MODEL, q, Readout(0.05, rate, (10.0, 0.0, 0.0), 0.0)), still) < inner_apart(rolled, still)


def test_grey_frames_too(scene: Scene) -> None:
    camera, rate = CameraSimulator(scene, MODEL), (0.5, 0.2, 0.0)
    still, rolled = (camera.frame(PLACE, LEVEL, shot=Shot(STILL, rate, s))[..., 1] for s in (0.0, 0.05))
    told = unrolled(np.ascontiguousarray(rolled), MODEL, LEVEL, Readout(0.05, rate, STILL, HEIGHT_M))
    assert inner_apart(told, still) < 0.25 * inner_apart(rolled, still)


class Spy:
    """A localiser that keeps what it was shown."""

    method = "spy"

    def localise(self, request: LocaliseRequest, pixels: Image, ref: ReferenceMap) -> Any:
        self.request, self.pixels = request, pixels


def test_only_requests_that_say_how_the_camera_moved_change_a_frame(scene: Scene) -> None:
    picture = CameraSimulator(scene, MODEL).frame(PLACE, LEVEL)
    prior = PosePrior(PLACE, LEVEL, ((9.0, 0.0), (0.0, 9.0)), 3.0, 0.05, 0.02)
    request = LocaliseRequest(1, FrameRef(0, 0, 1, 0, 320, 240, 3), prior, 1)
    rolled = replace(request, readout=Readout(0.05, (0.5, 0.0, 0.0), STILL, HEIGHT_M))
    spy, nowhere = Spy(), cast("ReferenceMap", None)
    asked = Unrolled(spy, MODEL)
    assert asked.method == "spy"
    asked.localise(request, picture, nowhere)
    assert spy.pixels is picture
    asked.localise(rolled, picture, nowhere)
    assert inner_apart(spy.pixels, picture) > 2.0
    assert spy.request == request, "it is set right once"
    asked.localise(rolled, picture[:100], nowhere)
    assert spy.pixels.shape[0] == 100, "a frame of another size is for the localiser to refuse"
    asked.localise(rolled, picture.astype(np.uint16) * 256, nowhere)
    assert spy.pixels.dtype == np.uint16, "and one of other numbers, which would be taken modulo 256"
