"""Answers that also say how the camera moved."""

from __future__ import annotations

import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from visloc_companion.errors import OutsideMap, Reason
from visloc_companion.geo.se3 import quat_from_euler
from visloc_companion.geo.wgs84 import geo_from_ned
from visloc_companion.localise.around.with_motion import WithMotion
from visloc_companion.localise.around.with_turn import WithTurn
from visloc_companion.localise.asking import Asking
from visloc_companion.localise.local_frame import local_frame
from visloc_companion.localise.odometry.surface_window import REACH_HEIGHTS, SurfaceWindow
from visloc_companion.localise.odometry.true_heading import HEADINGS, TrueHeading
from visloc_companion.protocols import LocalProjection, ReferenceMap
from visloc_companion.types import CameraModel, Fix, GeoPoint, Image, LocaliseRequest, NoFix, ReferencePatch

MS = 1_000_000
MODEL = CameraModel(640, 480, 560.0, 560.0, 319.5, 239.5)


PICTURES: dict[tuple[int, tuple[float, ...]], tuple[object, Image]] = {}
"""Rendered once for all tests; the map is kept beside its pictures, so that no other has its number."""


class Witness:
    """Finds nothing, or that the compass is off by `heading_rad`."""

    method = "witness"

    def __init__(self, heading_rad: float | None = None) -> None:
        self.heading_rad = heading_rad

    def localise(self, request: LocaliseRequest, pixels: Image, ref: ReferenceMap) -> Fix | NoFix:
        t_ns, n = request.frame.t_ns, request.frame.frame_id
        if self.heading_rad is None:
            return NoFix(0, t_ns, request.request_id, n, self.method, Reason.NO_MATCH, 1.0)
        q = quat_from_euler(0.0, 0.0, self.heading_rad)
        return Fix(0, t_ns, 1, n, self.method, request.prior.place, q, ((1.0, 0.0), (0.0, 1.0)), 1.0, 0.01, 0.001, 1.0)


def flown(support, world, localiser, points, compass_rad: float = 0.0, first: int = 0) -> list[Fix | NoFix]:
    """Answers along a way; the vehicle looks north, its compass says `compass_rad`."""
    answers = []
    for k, p in enumerate(points, first):
        key = id(world), tuple(p)
        if key not in PICTURES:
            PICTURES[key] = world, support.render(world, MODEL, tuple(p), (0.0, 0.0, 0.0))
        seen = PICTURES[key][1]
        asked = support.request_at(tuple(p), (0.0, 0.0, compass_rad), sigma_m=2.0, sigma_h_m=1.0, sigma_yaw_deg=5.0, model=MODEL)
        frame = replace(asked.frame, t_ns=1000 * MS + 200 * MS * k, frame_id=k)
        answers.append(localiser.localise(replace(asked, frame=frame), seen, world))
    return answers


def along(n: int, step_m: float = 4.0, start: float = -40.0) -> list[tuple[float, float, float]]:
    return [(start + step_m * k, 10.0 + 0.5 * step_m * k, -200.0) for k in range(n)]


@pytest.mark.parametrize("ground", ["flat", "hilly"])
def test_the_motion_is_that_of_the_camera(support, request, ground: str) -> None:
    world = request.getfixturevalue(ground)
    points = along(6)
    answers = flown(support, world, WithMotion(Witness(), MODEL), points)
    assert answers[0].motion is None
    seen = [a.motion for a in answers if a.motion is not None]
    assert len(seen) >= 4
    for motion in seen:
        k0, k1 = (round((t / MS - 1000) / 200) for t in (motion.t_from_ns, motion.t_to_ns))
        truth = np.array(points[k1]) - np.array(points[k0])
        error = np.array(motion.displacement_ned_m)[:2] - truth[:2]
        assert math.hypot(*error) < 0.05 * math.hypot(*truth[:2]) + 0.3
        assert error @ np.linalg.solve(np.array(motion.cov_ne_m2), error) < 16


def test_a_search_elsewhere_leaves_the_motion_as_it_is(support, hilly) -> None:
    """While the vehicle is searched for where it is not, every other request has another place's ground below its prior."""

    class Elsewhere(Asking):
        def localise(self, request: LocaliseRequest, pixels: Image, ref: ReferenceMap) -> Fix | NoFix:
            place, n = request.prior.place, request.frame.frame_id
            away = replace(request.prior, place=geo_from_ned((150.0, -120.0, 0.0), place), cov_ne_m2=((9e4, 0.0), (0.0, 9e4)))
            searched = replace(request, prior=away, motion_prior=request.prior if self.told else None)
            return self._localiser.localise(request if n % 2 else searched, pixels, ref)

        told = True

    points = along(6)
    usual = [answer.motion for answer in flown(support, hilly, WithMotion(Witness(), MODEL), points)]
    searching = Elsewhere(WithMotion(Witness(), MODEL))
    assert [answer.motion for answer in flown(support, hilly, searching, points)] == usual
    untold = Elsewhere(WithMotion(Witness(), MODEL))
    untold.told = False
    assert [answer.motion for answer in flown(support, hilly, untold, points)] != usual


class EndsAt:
    """A map that ends north of a line: asked for what lies beyond, it raises OutsideMap."""

    def __init__(self, world: ReferenceMap, easting_northing_m: tuple[float, float]) -> None:
        self._world, self._end_m = world, easting_northing_m[1]

    def __getattr__(self, name: str) -> object:
        return getattr(self._world, name)

    def patch(self, center_map_m: tuple[float, float], *more: object) -> object:
        """As that of the map."""
        if center_map_m[1] > self._end_m:
            raise OutsideMap("ends here", where="map", remedy="none")
        return self._world.patch(center_map_m, *more)  # type: ignore[arg-type]


class InDegrees:
    """A map whose CRS has units of 100 km, about as degrees are."""

    UNIT_M = 1e5

    def __init__(self, world: ReferenceMap) -> None:
        self._world = world

    def __getattr__(self, name: str) -> object:
        return getattr(self._world, name)

    def projection_at(self, place: GeoPoint) -> LocalProjection:
        """As that of the map, in its units."""
        metric = self._world.projection_at(place)
        easting, northing = metric.origin_map_m
        J, origin = np.asarray(metric.J_map_ne) / self.UNIT_M, (easting / self.UNIT_M, northing / self.UNIT_M)
        return SimpleNamespace(J_map_ne=J, origin_map_m=origin)

    def patch(self, center_map: tuple[float, float], *more: object) -> ReferencePatch:
        """As that of the map, in its units."""
        easting, northing = center_map
        patch = self._world.patch((easting * self.UNIT_M, northing * self.UNIT_M), *more)  # type: ignore[arg-type]
        return replace(patch, T_map_pix=patch.T_map_pix / self.UNIT_M)


@pytest.mark.parametrize("in_degrees", [False, True])
def test_beyond_the_map_the_ground_goes_on_as_it_was_and_the_claim_is_wide(support, flat, in_degrees: bool) -> None:
    world = InDegrees(flat) if in_degrees else flat
    localiser, points = WithMotion(Witness(), MODEL), along(12, 25.0, -150.0)
    place = support.request_at((0.0, 0.0, -200.0), (0.0, 0.0, 0.0), sigma_m=2.0, sigma_h_m=1.0, sigma_yaw_deg=5.0).prior.place
    east, north = local_frame(place, world).to_map(np.zeros(2))
    middle = (float(east), float(north))
    answers = []
    for k, p in enumerate(points):
        pixels = support.render(flat, MODEL, tuple(p), (0.0, 0.0, 0.0))
        asked = support.request_at(tuple(p), (0.0, 0.0, 0.0), sigma_m=2.0, sigma_h_m=1.0, sigma_yaw_deg=5.0, model=MODEL)
        frame = replace(asked.frame, t_ns=1000 * MS + 1000 * MS * k, frame_id=k)
        answers.append(localiser.localise(replace(asked, frame=frame), pixels, EndsAt(world, middle)))  # type: ignore[arg-type]
    last = answers[-1].motion
    assert last is not None
    k0, k1 = (round((t / MS - 1000) / 1000) for t in (last.t_from_ns, last.t_to_ns))
    truth = np.array(points[k1]) - np.array(points[k0])
    assert np.array(last.displacement_ned_m[:2]) == pytest.approx(truth[:2], rel=0.05, abs=0.5)
    on_the_map = answers[2].motion
    assert on_the_map is not None
    assert last.sigma_scale > 1.3 * on_the_map.sigma_scale
    assert last.sigma_scale == pytest.approx(0.0538, rel=5e-3), "0.0532 where metres of slope are counted in degrees"
    alone = WithMotion(Witness(), MODEL)
    assert alone.localise(replace(asked, frame=frame), pixels, EndsAt(world, (0.0, -1e9))).motion is None  # type: ignore[arg-type]


def test_the_answer_stays_what_it_was(support, flat) -> None:
    answers = flown(support, flat, WithMotion(Witness(), MODEL), along(3))
    bare = flown(support, flat, Witness(), along(3))
    assert [replace(a, motion=None) for a in answers] == bare
    assert WithMotion(Witness(), MODEL).method == "witness"


def test_a_compass_that_fixes_contradict_turns_no_displacement(support, flat) -> None:
    off = math.radians(10.0)
    points = along(HEADINGS + 6)
    with_fixes = flown(support, flat, WithMotion(Witness(0.0), MODEL), points, compass_rad=off)
    motion = with_fixes[-1].motion
    assert motion is not None
    north, east, _ = motion.displacement_ned_m
    assert math.degrees(math.atan2(east, north)) == pytest.approx(math.degrees(math.atan2(1, 2)), abs=2.0)
    alone = flown(support, flat, WithMotion(Witness(), MODEL), points, compass_rad=off)[-1].motion
    assert alone is not None
    assert motion.sigma_heading_rad < 0.5 * alone.sigma_heading_rad


def test_a_heading_that_wanders_after_the_last_fix_turns_no_displacement(support, flat) -> None:
    heading, witness = TrueHeading(), Witness(0.0)
    localiser = WithTurn(WithMotion(witness, MODEL, heading=heading), MODEL, heading=heading)
    points, n = along(HEADINGS + 11, start=-70.0), HEADINGS + 1
    flown(support, flat, localiser, points[:n])
    witness.heading_rad = None
    for k, p in enumerate(points[n:]):
        last = flown(support, flat, localiser, [p], compass_rad=math.radians(0.6 * (k + 1)), first=n + k)[-1]
    assert last.turn is not None
    assert last.motion is not None
    north, east, _ = last.motion.displacement_ned_m
    assert math.degrees(math.atan2(east, north)) == pytest.approx(math.degrees(math.atan2(1, 2)), abs=1.0)


def test_a_climb_asks_for_more_of_the_map_and_a_descent_for_less(support, flat, monkeypatch: pytest.MonkeyPatch) -> None:
    """Above one place: the window that is enough at 70 m is a third of what is wanted at 200 m, and the other way round."""
    reach_m: list[float] = []
    patch = type(flat).patch
    monkeypatch.setattr(type(flat), "patch", lambda *a: reach_m.append(a[2][0] * a[3] / 2) or patch(*a))
    localiser = WithMotion(Witness(), MODEL)
    for k, (height_m, asked) in enumerate(((70.0, 1), (75.0, 0), (200.0, 1), (60.0, 1))):
        before = len(reach_m)
        flown(support, flat, localiser, [(0.0, 0.0, -100.0 - height_m)], first=k)
        assert len(reach_m) - before == 2 * asked  # the ground's height, and the window
        if asked:
            assert reach_m[-1] == pytest.approx(REACH_HEIGHTS * height_m, rel=0.02)


def test_turn_and_motion_read_the_map_once(support, flat, monkeypatch: pytest.MonkeyPatch) -> None:
    reads: list[object] = []
    patch = type(flat).patch
    monkeypatch.setattr(type(flat), "patch", lambda *a: reads.append(a[1]) or patch(*a))
    window = SurfaceWindow()
    answers = flown(support, flat, WithTurn(WithMotion(Witness(), MODEL, window=window), MODEL, window), along(3))
    assert answers[-1].motion is not None
    assert answers[-1].turn is not None
    assert len(reads) == 2  # the ground's height, and the window


def test_over_a_map_in_degrees_the_window_goes_on_with_the_camera(support, hilly) -> None:
    metric, degrees = SurfaceWindow(), SurfaceWindow()
    for north in (-200.0, -190.0, 0.0, 200.0):
        place = support.request_at((north, 0.0, -200.0), (0.0, 0.0, 0.0)).prior.place
        wanted = metric.about(200.0, hilly, local_frame(place, hilly))
        found = degrees.about(200.0, InDegrees(hilly), local_frame(place, InDegrees(hilly)))  # type: ignore[arg-type]
        assert wanted is not None
        assert found is not None
        np.testing.assert_array_equal(found.up_m, wanted.up_m)
        np.testing.assert_allclose(found.A_ne_pix, wanted.A_ne_pix, atol=1e-6)


def test_off_the_map_and_without_texture_there_is_none(support, flat) -> None:
    far = [(90_000.0 + 4 * k, 0.0, -200.0) for k in range(2)]
    localiser = WithMotion(Witness(), MODEL)
    for k, p in enumerate(far):
        asked = support.request_at(p, (0.0, 0.0, 0.0), model=MODEL)
        frame = replace(asked.frame, t_ns=(1 + k) * 200 * MS, frame_id=k)
        assert localiser.localise(replace(asked, frame=frame), support.texture(2, 640)[:480], flat).motion is None
    blank = replace(flat, pixels=np.full_like(flat.pixels, 90))
    assert all(a.motion is None for a in flown(support, blank, WithMotion(Witness(), MODEL), along(3)))


def test_a_place_without_coordinates_in_the_maps_crs_leaves_the_answer_as_it_was(support, flat, elsewhere) -> None:
    p, level = (0.0, 0.0, -200.0), (0.0, 0.0, 0.0)
    asked, pixels = support.request_at(p, level, model=MODEL), support.render(flat, MODEL, p, level)
    assert WithMotion(Witness(), MODEL).localise(asked, pixels, elsewhere) == Witness().localise(asked, pixels, elsewhere)


def test_a_request_for_an_older_frame_is_no_motion(support, flat) -> None:
    localiser = WithMotion(Witness(), MODEL)
    flown(support, flat, localiser, along(3), first=5)
    assert all(a.motion is None for a in flown(support, flat, localiser, along(2), first=0))
