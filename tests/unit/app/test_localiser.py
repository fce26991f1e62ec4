"""What flies is checked twice where the configuration asks for it."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest

from tests.unit.landing_gear import masked, with_gear
from tests.unit.level_ground import CRS, level_ground, over_its_middle
from visloc_companion.adapters.camera.calibration import camera_model
from visloc_companion.app.localiser import configured_localiser
from visloc_companion.config import CameraConfig, LocaliserConfig
from visloc_companion.errors import OutsideMap
from visloc_companion.geo.se3 import quat_from_euler
from visloc_companion.localise.around.map_shape import OverPlane
from visloc_companion.localise.around.rolling_shutter import Unrolled
from visloc_companion.localise.around.still_picture import MovingFramesOnly
from visloc_companion.localise.around.twice import CheckedTwice
from visloc_companion.localise.around.with_motion import WithMotion
from visloc_companion.localise.around.with_turn import WithTurn
from visloc_companion.localise.around.zoomed import Zoomed
from visloc_companion.maps.crs import map_crs
from visloc_companion.protocols import Localiser
from visloc_companion.sim.render import CameraSimulator
from visloc_companion.sim.rendering.render_motion import Shot
from visloc_companion.types import CameraModel, FrameRef, GeoPoint, LocaliseRequest, PosePrior, Readout

MODEL = camera_model(CameraConfig())
FISHEYE = CameraConfig(
    width_px=320,
    height_px=240,
    fx_px=160,
    fy_px=160,
    cx_px=161,
    cy_px=118,
    distortion_model="fisheye",
    distortion=(0.02, -0.01, 0.003, -0.001),
)


class _NoMap:
    """protocols.ReferenceMap of another continent, which says where it ends."""

    gsd_m = 0.5
    corners_map_m = np.array([[1e7, 1e7], [1.001e7, 1e7], [1e7, 1.001e7], [1.001e7, 1.001e7]])

    def __getattr__(self, name: str) -> Any:
        def outside(*_: object, **__: object) -> Any:
            raise OutsideMap("nothing here")

        return outside

    def projection_at(self, place: GeoPoint) -> Any:
        return map_crs(CRS).linearised_at(place)


def of_frames_set_right(localiser: Localiser) -> WithTurn:
    """A picture that stands still is seen by nobody; everything looks at frames that a rolling shutter no longer bends and knows
    when the ground is a plane, and both computations have the prior that the turn carried on. So it is for every zoom."""
    assert isinstance(localiser, Zoomed)
    localiser = localiser._localiser
    assert isinstance(localiser, MovingFramesOnly)
    assert isinstance(localiser._localiser, Unrolled)
    assert isinstance(localiser._localiser._localiser, OverPlane)
    assert isinstance(localiser._localiser._localiser._localiser, WithTurn)
    return localiser._localiser._localiser._localiser


@pytest.mark.parametrize(("every", "kind"), [(0, WithMotion), (20, CheckedTwice)])
def test_the_second_computation_is_there_where_it_is_wished_for(every: int, kind: type) -> None:
    localiser, features = configured_localiser(LocaliserConfig(method="gradient", check_every=every), MODEL)
    turning = of_frames_set_right(localiser)
    assert type(turning._localiser) is kind
    assert features is None
    assert localiser.method == "gradient"


def test_turns_carry_on_the_heading_that_displacements_are_turned_by() -> None:
    localiser, _ = configured_localiser(LocaliserConfig(method="gradient", check_every=0), MODEL)
    turning = of_frames_set_right(localiser)
    assert isinstance(turning._localiser, WithMotion)
    assert turning._localiser._heading is turning._heading


def test_the_second_computation_has_a_network_of_its_own(network: Path) -> None:
    localiser, features = configured_localiser(LocaliserConfig(model=str(network), threads=2), MODEL)
    again = of_frames_set_right(localiser)._localiser._second._features  # type: ignore[attr-defined]
    assert features is not None
    assert again is not features
    assert again.session.run is not features.session.run
    assert (again.session.provider, again.session.threads) == ("cpu", 1)


def test_a_wide_camera_s_turn_is_told_as_it_was() -> None:
    """Behind the lens all see a pinhole's frames: the turn of a fisheye is not that of bent pixels."""
    model, roll = camera_model(FISHEYE), math.radians(4.0)
    localiser, _ = configured_localiser(LocaliserConfig(method="gradient", structure=False, odometry=False, check_every=0), model)
    camera, place, answers = CameraSimulator(level_ground(), model), over_its_middle(60.0), []
    for number, q in enumerate([quat_from_euler(0.0, 0.0, 0.3), quat_from_euler(roll, 0.0, 0.3)]):
        frame = FrameRef(0, number * 200_000_000, number, 0, 320, 240, 3)
        level = quat_from_euler(0.0, 0.0, 0.3)
        prior = PosePrior(place, level, ((9.0, 0.0), (0.0, 9.0)), 2.0, 0.05, 0.05)
        answers.append(localiser.localise(LocaliseRequest(number, frame, prior, 1), camera.frame(place, q), cast(Any, _NoMap())))
    turn = answers[1].turn
    assert turn is not None
    assert 2 * np.array(turn.q_from_to[1:]) == pytest.approx([roll, 0.0, 0.0], abs=math.radians(0.05))


PINHOLE = CameraConfig(width_px=320, height_px=240, fx_px=250, fy_px=250, cx_px=159.5, cy_px=119.5)


@pytest.mark.parametrize("section", [PINHOLE, FISHEYE], ids=["pinhole", "fisheye"])
def test_gear_in_view_of_a_rolling_shutter_turns_nothing(section: CameraConfig) -> None:
    """Setting the shutter right moves the gear, too: it is gone before that, and what takes its place is not followed."""
    bare, roll, place = camera_model(section), math.radians(4.0), over_its_middle(60.0)
    rate, still, level = (roll / 0.2, 0.0, 0.0), (0.0, 0.0, 0.0), quat_from_euler(0.0, 0.0, 0.3)
    camera = CameraSimulator(level_ground(), bare)
    frames = [camera.frame(place, quat_from_euler(k * roll, 0.0, 0.3), shot=Shot(still, rate, 0.04)) for k in range(2)]

    def turn_rad(model: CameraModel, seed: int) -> list[float] | None:
        localiser, _ = configured_localiser(LocaliserConfig(method="gradient", check_every=0), model)
        prior = PosePrior(place, level, ((9.0, 0.0), (0.0, 9.0)), 2.0, 0.05, 0.05)
        for k, pixels in enumerate(frames):
            frame, readout = FrameRef(0, k * 200_000_000, k, 0, 320, 240, 3), Readout(0.04, rate, still, 60.0)
            asked = LocaliseRequest(k, frame, prior, 1, readout=readout)
            answer = localiser.localise(asked, with_gear(pixels, seed) if seed else pixels, cast(Any, _NoMap()))
        return None if answer.turn is None else (2 * np.array(answer.turn.q_from_to[1:])).tolist()

    told = turn_rad(masked(bare), 5)
    assert told == pytest.approx([roll, 0.0, 0.0], abs=math.radians(0.25))
    assert told == turn_rad(masked(bare), 6) == turn_rad(masked(bare), 0), "whatever the gear looks like"
    untold = turn_rad(bare, 5)
    assert untold is None or abs(untold[0] - roll) > math.radians(0.5)
