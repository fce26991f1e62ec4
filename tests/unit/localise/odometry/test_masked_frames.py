"""Turns and motion where landing gear is in view: it stands still, and a mask says so."""

from __future__ import annotations

import math

import cv2
import numpy as np

from tests.unit.landing_gear import legs, masked, with_gear
from visloc_companion.geo.camera import R_FRD_CAM
from visloc_companion.geo.se3 import R_from_quat, quat_from_euler
from visloc_companion.localise.flow import FrameToFrame
from visloc_companion.localise.masked import painted_over, with_margin
from visloc_companion.localise.odometry.base import Step
from visloc_companion.localise.odometry.rotation import TurnWatch
from visloc_companion.localise.odometry.turn_follow import Follower
from visloc_companion.types import CameraModel


def test_turns_are_those_of_the_ground_not_of_the_gear(odo, field) -> None:
    """Gear that stands still looks as if the camera did not turn at all."""
    eulers = [(0.0, 0.0, 0.0), (3.0, -2.0, 4.0), (5.0, 1.0, 7.0), (2.0, 3.0, 9.0)]

    def off_deg(model: CameraModel, shown: CameraModel) -> list[float]:
        watch, off = TurnWatch(with_margin(model)), []
        for k, euler in enumerate(eulers):
            pixels = painted_over(with_gear(field.frame((2.0 * k, 0.0, -100.0), euler, seed=k)), shown)
            turn = watch.step(pixels, k * odo.PERIOD_NS, quat_from_euler(0.0, 0.0, 0.0)).since_last
            if k and turn is not None:
                a, b = (quat_from_euler(*np.radians(e)) for e in (eulers[k - 1], euler))
                true = cv2.Rodrigues(R_from_quat(a).T @ R_from_quat(b))[0].ravel()
                seen = cv2.Rodrigues(R_from_quat(turn.q_from_to))[0].ravel()
                off.append(float(np.degrees(np.linalg.norm(true - seen))))
        return off

    told, untold = off_deg(masked(odo.MODEL), masked(odo.MODEL)), off_deg(odo.MODEL, odo.MODEL)
    assert len(told) == 3
    assert max(told) < 0.15
    assert len(untold) >= 2
    assert max(untold) < 0.15, "what stands still where the ground moves far is left out without a mask, too"
    only_left_out = off_deg(masked(odo.MODEL), odo.MODEL)
    assert len(only_left_out) == 3
    assert max(told) < max(only_left_out) < 0.4, "corners at the gear's edge see it, unless it is painted over"


def test_no_corner_is_found_again_under_the_mask(odo, field) -> None:
    """Ground that goes out of sight behind the gear is not followed there, whatever is drawn in its place."""
    m = odo.MODEL
    frames = [field.frame((north_m, 0.0, -100.0)) for north_m in (0.0, 12.0)]
    gear = legs(m.width_px, m.height_px)
    found_under = []
    for model in (m, masked(m)):
        follower = Follower(model)
        a, b = (follower.seen(pixels, k, R_FRD_CAM) for k, pixels in enumerate(frames))
        assert a is not None
        assert b is not None
        _, found = follower._followed(a, b, np.eye(3), a.rays - np.array([0.0, -0.12, 0.0]))
        assert len(found) > 10
        column, row = found.astype(int).T
        found_under.append(int(gear[row, column].sum()))
    assert found_under[0] > 5
    assert found_under[1] == 0


def test_odometry_follows_the_ground_beside_the_gear(odo, field) -> None:
    points, model = odo.path(10, (5.0, 2.0, 0.1)), masked(odo.MODEL)

    def off_m(shown: CameraModel, gear: bool) -> list[float]:
        flow, off = FrameToFrame(with_margin(shown)), []
        for k, p in enumerate(points):
            pixels = field.frame(p, seed=k)
            step = flow.step(odo.sight(painted_over(with_gear(pixels) if gear else pixels, shown), k, p), None)
            if isinstance(step, Step):
                o = step.odometry
                true = points[o.t_to_ns // odo.PERIOD_NS] - points[o.t_from_ns // odo.PERIOD_NS]
                off.append(math.dist(o.displacement_ned_m[:2], true[:2]))
        return off

    told, bare, untold = off_m(model, gear=True), off_m(odo.MODEL, gear=False), off_m(odo.MODEL, gear=True)
    assert len(told) == len(bare) == 9
    assert max(bare) < max(told) < 0.25
    assert told == off_m(model, gear=False), "whatever is under the mask"
    assert len(untold) < 9
    assert max(untold) > 1.0
