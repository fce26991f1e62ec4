"""Rows exposed one after the other, and smear, against the geometry of a moving camera."""

from __future__ import annotations

import math

import numpy as np

from tests.unit.level_ground import apart, level_ground, over_its_middle
from visloc_companion.geo.se3 import quat_from_euler
from visloc_companion.sim.camera import SimulatedCamera
from visloc_companion.sim.render import CameraSimulator
from visloc_companion.sim.rendering.render_effects import CameraEffects
from visloc_companion.sim.rendering.render_motion import Shot, row_times_s
from visloc_companion.sim.rendering.render_water import rippled
from visloc_companion.types import CameraModel, GeoPoint, Image

MODEL = CameraModel(320, 240, 270.0, 270.0, 159.5, 119.5)
LEVEL = quat_from_euler(0.0, 0.0, 0.0)
GOOD = CameraEffects(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


SIMULATOR = CameraSimulator(level_ground(), MODEL)


def at(north_m: float = 0.0, east_m: float = 0.0) -> GeoPoint:
    return over_its_middle(120.0, north_m, east_m)


def test_every_row_is_seen_from_where_the_camera_was_at_its_time() -> None:
    """At 25 m/s and 40 ms the first row is seen from half a metre behind, the last from half a metre ahead, turned so far."""
    shot = Shot(v_ned_mps=(0.0, 25.0, 0.0), rate_frd_radps=(0.0, 0.0, 0.5), readout_s=0.04, effects=GOOD)
    rolled = SIMULATOR.frame(at(), LEVEL, shot=shot)
    for row in (0, 119, 239):
        t_s = row_times_s(240, 0.04)[row]
        still = SIMULATOR.frame(at(east_m=25.0 * t_s), quat_from_euler(0.0, 0.0, 0.5 * t_s))
        assert apart(rolled[row], still[row]) < 1.0
    assert apart(rolled[0], SIMULATOR.frame(at(), LEVEL)[0]) > 3.0


def test_a_shutter_that_does_not_roll_is_the_still_picture() -> None:
    shot = Shot(v_ned_mps=(0.0, 25.0, 0.0), rate_frd_radps=(0.1, 0.2, 0.5), effects=GOOD)
    assert np.array_equal(SIMULATOR.frame(at(), LEVEL, shot=shot), SIMULATOR.frame(at(), LEVEL))


def test_smear_is_the_mean_of_the_pictures_of_the_exposure() -> None:
    velocity, exposure_s = (15.0, 8.0, 0.0), 0.2
    shot = Shot(velocity, (0.02, -0.01, 0.1), exposure_s=exposure_s, effects=GOOD)
    smeared = SIMULATOR.frame(at(), LEVEL, shot=shot)
    moments = [
        SIMULATOR.frame(at(15.0 * t, 8.0 * t), quat_from_euler(0.02 * t, -0.01 * t, 0.1 * t))
        for t in np.linspace(-0.5, 0.5, 15) * exposure_s
    ]
    mean = np.mean(moments, axis=0)
    inside = (slice(20, -20), slice(20, -20))
    assert apart(smeared[inside], mean[inside]) < 1.5
    assert apart(smeared[inside], moments[7][inside]) > 3.0


def test_the_vehicles_rates_are_turned_into_the_cameras() -> None:
    """A camera that is mounted turned by 90 degrees sees the vehicle's roll as its own (negative) pitch."""
    seen: list[Shot] = []

    class Spy(CameraSimulator):
        def frame(self, place, q_ned_frd, seed=0, shot=None):  # type: ignore[no-untyped-def,override]
            seen.append(shot)
            return np.zeros((1, 1, 3), np.uint8)

    camera = SimulatedCamera(Spy(SIMULATOR.scene, MODEL), MODEL, quat_from_euler(0.0, 0.0, math.pi / 2))
    camera.render(at(), LEVEL, 1, Shot(rate_frd_radps=(0.3, 0.0, 0.1)))
    assert np.allclose(seen[0].rate_frd_radps, (0.0, -0.3, 0.1), atol=1e-9)


def test_night_drowns_the_picture_in_noise() -> None:
    def seen(light: float) -> Image:
        return SIMULATOR.frame(at(), LEVEL, 3, Shot(effects=CameraEffects(light=light, max_gain=40.0)))

    def likeness(a: Image, b: Image) -> float:
        return float(np.corrcoef(a[:, :, 1].ravel(), b[:, :, 1].ravel())[0, 1])

    day = SIMULATOR.frame(at(), LEVEL)
    assert likeness(seen(1.0), day) > 0.9
    assert likeness(seen(0.0005), day) < 0.1
    assert seen(0.0005).mean() < 30


def test_water_is_another_in_every_frame_and_leaves_the_land_alone() -> None:
    water = np.zeros((1200, 1200), np.uint8)
    water[:, 600:] = 255
    simulator = CameraSimulator(SIMULATOR.scene, MODEL, water=water)
    one, two = (simulator.frame(at(), LEVEL, seed) for seed in (1, 2))
    assert apart(one[:, 180:], two[:, 180:]) > 4.0
    assert np.array_equal(one[:, :140], two[:, :140])
    assert np.array_equal(one, simulator.frame(at(), LEVEL, 1))
    assert rippled(one, np.zeros((240, 320), np.float32), 1) is one
