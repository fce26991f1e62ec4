from __future__ import annotations

import math

import numpy as np
import pytest

from visloc_companion.errors import Reason
from visloc_companion.geo.camera import R_FRD_CAM, project
from visloc_companion.geo.se3 import R_from_quat, quat_from_euler
from visloc_companion.localise.odometry.base import FlowSettings
from visloc_companion.localise.odometry.below import Reading
from visloc_companion.localise.odometry.follow import first_guess, follow
from visloc_companion.localise.odometry.keyframe import attitude, keyframe_of, with_readings
from visloc_companion.localise.odometry.picture import plane_homography, prepared, shift_between, through

SETTINGS = FlowSettings()


def key_at(odo, ground, p, euler=(0.0, 0.0, 0.0), **other):
    sight = odo.sight(ground.frame(p, euler), 0, p, euler, **other)
    return keyframe_of(sight, prepared(sight.pixels, odo.MODEL), None, np.zeros(2), SETTINGS)


def test_the_planes_homography_is_that_of_its_points() -> None:
    K = np.array([[220.0, 0.0, 159.5], [0.0, 220.0, 119.5], [0.0, 0.0, 1.0]])
    rotations = [R_from_quat(quat_from_euler(*e)) @ R_FRD_CAM for e in ((0.1, -0.2, 0.5), (-0.2, 0.1, 1.4))]
    d, rng = np.array([20.0, -9.0, 3.0]), np.random.default_rng(0)
    points = np.column_stack([rng.uniform(-40, 40, (20, 2)), np.full(20, 100.0)])
    a, b = (points @ rotations[0] @ K.T, (points - d) @ rotations[1] @ K.T)
    H = plane_homography(K, *rotations, d, 100.0)
    assert through(H, a[:, :2] / a[:, 2:]) == pytest.approx(b[:, :2] / b[:, 2:])


@pytest.mark.parametrize("shift", [(24.0, -12.0), (-40.0, 20.0)])
def test_a_pictures_shift_is_found_and_noise_has_none(odo, shift) -> None:
    big = odo.texture(2, 700)
    key = big[100:340, 100:420]
    frame = big[100 - int(shift[1]) : 340 - int(shift[1]), 100 - int(shift[0]) : 420 - int(shift[0])]
    assert shift_between(key, frame) == pytest.approx(shift, abs=1.5)
    rng = np.random.default_rng(1)
    one, other = (rng.integers(0, 255, (240, 320), np.uint8) for _ in range(2))
    assert shift_between(one, other) is None


def test_corners_are_found_where_they_are_after_a_turn_and_a_climb(odo, field) -> None:
    key = key_at(odo, field, (0.0, 0.0, -100.0), (3.0, 0.0, 20.0))
    p, euler = (14.0, -6.0, -104.0), (-4.0, 5.0, 65.0)
    later = odo.sight(field.frame(p, euler, seed=3), 1, p, euler)
    picture = prepared(later.pixels, odo.MODEL)
    d = np.array([14.0, -6.0, -4.0])
    got = follow(key, picture, attitude(later), d + np.array([1.5, -1.0, 0.0]), 0.25)
    true = project(odo.MODEL, (key.ground.at_ned_m[got.number] - d) @ attitude(later))
    off = np.hypot(*(picture.normalised(true) - got.xy).T) * 220
    assert len(got.number) > 25
    assert np.median(off) < 0.15
    assert got.unlike < SETTINGS.max_unlike
    assert 0.5 < got.overlap < 1
    guess = first_guess(key, picture, attitude(later), np.array([0.0, 0.0, -4.0]))
    assert guess == pytest.approx(d, abs=4.0)


def test_nothing_is_followed_where_nothing_overlaps(odo, field) -> None:
    key = key_at(odo, field, (0.0, 0.0, -100.0))
    got = follow(key, key.picture, key.R_ned_cam, np.array([400.0, 0.0, 0.0]), 0.25)
    assert (len(got.number), got.overlap) == (0, 0.0)


def test_a_plain_frame_is_no_keyframe(odo, field) -> None:
    p = (0.0, 0.0, -100.0)
    plain = np.full((240, 320), 120, np.uint8)
    sight = odo.sight(plain, 0, p)
    got = keyframe_of(sight, prepared(plain, odo.MODEL), None, np.zeros(2), SETTINGS)
    assert got[0] is Reason.LOW_TEXTURE


def test_what_a_rangefinder_read_becomes_points_that_are_followed(odo, field) -> None:
    key = key_at(odo, field, (0.0, 0.0, -100.0))
    readings = [Reading((0.0, 0.0), 100.0, 100.0), Reading((20.0, 5.0), 101.0, 97.0), Reading((0.0, 90.0), 100.0, 100.0)]
    got = with_readings(key, readings, SETTINGS)
    assert got.ground.ranged.sum() == 2  # the third lies outside the picture
    assert got.ground.at_ned_m[got.ground.ranged].tolist() == [[0.0, 0.0, 100.0], [20.0, 5.0, 96.0]]
    assert got.corners[got.ground.ranged][0] == pytest.approx([159.5, 119.5])
    assert got.ground.readings[:, 2] == pytest.approx([0.0, -4.0])
    again = with_readings(got, readings[:1], SETTINGS)
    assert again.ground.ranged.sum() == 1
    assert len(again.corners) == len(key.corners) + 1
    height = key_at(odo, field, (0.0, 0.0, -100.0), ranged=False, sigma_height_m=5.0)
    assert with_readings(height, readings, SETTINGS).ground.ranged.sum() == 0
    assert math.isclose(with_readings(height, readings, SETTINGS).ground.reading_m, SETTINGS.relief_m)


def test_a_correction_of_the_altitude_moves_nothing_that_a_rangefinder_read(odo, field) -> None:
    """Of the keyframe's altitude 6 m were added after the distance was read; the instrument stood at 100 m then as now."""
    key = key_at(odo, field, (0.0, 0.0, -100.0), up_m=106.0, up_added_m=6.0)
    got = with_readings(key, [Reading((5.0, 0.0), 100.0, 100.0, 0.3)], SETTINGS)
    assert got.ground.at_ned_m[got.ground.ranged].tolist() == [[5.0, 0.0, 100.0]]
    assert got.ground.sigma_range_m == 0.3


def test_what_a_rangefinder_read_counts_at_a_keyframe_at_which_it_is_silent(odo, field) -> None:
    silent = key_at(odo, field, (0.0, 0.0, -100.0), ranged=False, sigma_height_m=5.0)
    by_altitude = Reading((5.0, 5.0), 100.0, 105.0)
    got = with_readings(silent, [Reading((5.0, 0.0), 100.0, 97.0, 0.3), by_altitude], SETTINGS)
    assert got.ground.at_ned_m[got.ground.ranged].tolist() == [[5.0, 0.0, 97.0]], "a height that was computed is none"
    assert (got.ground.sigma_range_m, got.ground.readings_ranged) == (0.3, True)
    assert got.ground.sigma_up_m == 5.0
