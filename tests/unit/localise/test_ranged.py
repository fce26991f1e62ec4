"""Displacements over ground whose height a rangefinder measured, and readings that the map does not explain."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from tests.unit.localise.around.test_with_motion import MODEL, MS, Witness, along
from visloc_companion.geo.se3 import quat_from_euler, rotate
from visloc_companion.localise.around.with_motion import WithMotion
from visloc_companion.localise.odometry.base import Surface
from visloc_companion.localise.ranged import fits, fits_height, is_plane
from visloc_companion.localise.terrain.tallest import TALLEST_M
from visloc_companion.types import Beam, Odometry, Vec3

GROUND_M, TOO_HIGH_M = 100.0, 6.0
SIGMA_M = 0.5
Beams = Callable[[int, Vec3], Beam | None]


def level(k: int, p: Vec3) -> Beam:
    """Straight down to level ground."""
    return Beam((0.0, 0.0, -p[2] - GROUND_M), SIGMA_M)


def motions(
    support: Any, seen: Any, known: Any, points: list[Vec3], beam: Beams, pitch_rad: float = 0.0
) -> list[tuple[Odometry, float]]:
    """Displacements, each with the share by which it is too long, of a vehicle whose altitude is TOO_HIGH_M too high."""
    localiser, found = WithMotion(Witness(), MODEL), []
    for k, p in enumerate(points):
        pixels = support.render(seen, MODEL, p, (0.0, pitch_rad, 0.0))
        asked = support.request_at((p[0], p[1], p[2] - TOO_HIGH_M), (0.0, pitch_rad, 0.0), 2.0, TOO_HIGH_M, 1.0, MODEL)
        frame = replace(asked.frame, t_ns=1000 * MS + 200 * MS * k, frame_id=k)
        answer = localiser.localise(replace(asked, frame=frame, beam=beam(k, p)), pixels, known)
        if answer.motion is not None:
            k0, k1 = (round((t / MS - 1000) / 200) for t in (answer.motion.t_from_ns, answer.motion.t_to_ns))
            true_m = math.hypot(points[k1][0] - points[k0][0], points[k1][1] - points[k0][1])
            found.append((answer.motion, math.hypot(*answer.motion.displacement_ned_m[:2]) / true_m - 1))
    return found


def test_a_distance_to_the_ground_outdoes_an_altitude_that_is_off(support, hilly) -> None:
    """6 m in 100 m of altitude are 6 % of the way; a beam says where the ground is."""

    def below(k: int, p: Vec3) -> Beam:
        return Beam((0.0, 0.0, -p[2] - hilly.height_amsl_m(p[1], p[0])), SIGMA_M)

    points = along(8, 6.0)
    without, measured = (motions(support, hilly, hilly, points, beam)[-1] for beam in (lambda k, p: None, below))
    assert without[1] > 0.04
    assert abs(measured[1]) < 0.015
    assert measured[0].sigma_scale < 0.5 * without[0].sigma_scale


def test_a_leaning_camera_is_told_where_it_looks(support, flat) -> None:
    """The beam of a vehicle that leans by 30 degrees meets the ground 58 m behind it, in the middle of its picture. Over a slope
    of a fifth, that ground is 10 m lower than the one straight below."""
    sloped = _sloped(flat, 0.2)
    pitch = -math.radians(30.0)

    def slanting(k: int, p: Vec3) -> Beam:
        ray = rotate(quat_from_euler(0.0, pitch, 0.0), (0.0, 0.0, 1.0))
        length = (-p[2] - GROUND_M - 0.2 * p[0]) / (ray[2] + 0.2 * ray[0])
        return Beam((length * ray[0], 0.0, length * ray[2]), SIGMA_M)

    points = along(10, 6.0)
    found = motions(support, sloped, flat, points, slanting, pitch)  # over a map without heights
    assert abs(found[-1][1]) < 0.03
    as_if_below: Beams = lambda k, p: replace(slanting(k, p), end_ned_m=(0.0, 0.0, slanting(k, p).end_ned_m[2]))  # noqa: E731
    assert abs(motions(support, sloped, flat, points, as_if_below, pitch)[-1][1]) >= abs(found[-1][1])


def test_what_vegetation_does_not_explain_is_not_believed(support, hilly) -> None:
    wrong: Beams = lambda k, p: Beam((0.0, 0.0, 20.0), SIGMA_M)  # noqa: E731 (80 m above the land)
    points = along(6, 6.0)
    without, contradicted = (motions(support, hilly, hilly, points, beam) for beam in (lambda k, p: None, wrong))
    assert contradicted == without


def test_a_plane_in_place_of_the_land_gives_way_to_what_was_measured(support, flat) -> None:
    """A pack without heights has the land 20 m too low; the altitude is 6 m too high, too."""
    lower = replace(flat, surface=np.full_like(flat.surface, GROUND_M - 20.0))
    points = along(8, 6.0)
    without, measured = (motions(support, flat, lower, points, beam)[-1] for beam in (lambda k, p: None, level))
    assert without[1] > 0.2
    assert abs(measured[1]) < 0.02


def test_where_the_rangefinder_is_silent_what_it_read_before_counts_on(support, hilly, flat) -> None:
    """From the fifth frame on it is out of reach; keyframes after that see ground that it read, until none is left in view."""
    points = along(10, 6.0)
    plain = replace(flat, surface=flat.surface + np.float32(1e-3) * (hilly.surface - GROUND_M))  # a model of level ground
    silent: Beams = lambda k, p: level(k, p) if k < 4 else None  # noqa: E731
    found = [each for each in motions(support, flat, plain, points, silent) if each[0].t_from_ns > 1600 * MS]
    assert len(found) == 5
    assert max(abs(share) for _, share in found[:-1]) < 0.02
    assert found[-1][1] > 0.04
    assert found[-1][0].sigma_scale > 0.05, "and it says so"


# ------------------------------------------------------------------------------------------------------- against the map


def surface(up_m: float, step_m: float = 0.0) -> Surface:
    """60 m x 60 m about the origin, its northern half higher by a step."""
    up = np.full((61, 61), up_m, np.float32)
    up[:20] += step_m
    return Surface(up, np.array([[0.0, -1.0, 30.0], [1.0, 0.0, -30.0]]))


def fit(length_m: float, over: Surface, north_m: float = 0.0, sigma_h_m: float = 1.0, sigma_place_m: float = 1.0) -> bool:
    """Of a camera at 200 m."""
    return fits(Beam((north_m, 0.0, length_m), SIGMA_M), 200.0, sigma_h_m, sigma_place_m, 0.0, over)


@pytest.mark.parametrize("way", [1.0, -1.0])
def test_what_has_grown_or_was_felled_is_believed_and_no_more(way: float) -> None:
    open_m = TALLEST_M + 4 * math.hypot(1.0, SIGMA_M)
    assert fit(100.0 + way * (open_m - 0.1), surface(100.0))
    assert not fit(100.0 + way * (open_m + 0.1), surface(100.0))
    assert fit(100.0 + way * (open_m + 10.0), surface(100.0), sigma_h_m=5.0), "an altitude that is less sure explains more"


def test_heights_as_far_about_as_the_place_leaves_open_explain_a_distance() -> None:
    hill = surface(100.0, 60.0)
    assert not fit(40.0, hill, north_m=-5.0), "17 m from the hill, known to 1 m"
    assert fit(40.0, hill, north_m=-5.0, sigma_place_m=5.0)
    assert fit(40.0, hill, north_m=20.0)


def test_beyond_the_map_the_ground_that_was_known_last_contradicts() -> None:
    open_m = TALLEST_M + 4 * math.hypot(5.0, SIGMA_M)
    assert fits_height(Beam((0.0, 0.0, 100.0 - open_m + 0.1), SIGMA_M), 100.0, 5.0)
    assert not fits_height(Beam((0.0, 0.0, 100.0 - open_m - 0.1), SIGMA_M), 100.0, 5.0)
    assert fits_height(Beam((0.0, 0.0, 30.0), SIGMA_M), math.nan, math.inf), "nothing is known below"


def test_where_the_map_ends_nothing_contradicts() -> None:
    assert fit(10.0, surface(100.0), north_m=90.0)
    unknown = Surface(np.full((61, 61), np.nan, np.float32), surface(0.0).A_ne_pix)
    assert fit(10.0, unknown)
    assert not is_plane(unknown)
    assert is_plane(surface(100.0))
    assert not is_plane(surface(100.0, 0.5))


def _sloped(flat: Any, slope: float) -> Any:
    """The map's picture on ground that rises towards north."""
    rows, _ = flat.surface.shape
    north_m = (rows - 1) / 2 - np.arange(rows)
    return replace(flat, surface=np.repeat((GROUND_M + slope * north_m).astype(np.float32)[:, None], flat.surface.shape[1], 1))
