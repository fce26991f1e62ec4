"""A picture that was compressed anew shows the same: where the camera moved meanwhile, it is none."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import cast

import cv2
import numpy as np
import pytest

from tests.unit.localise.witness import Witness
from visloc_companion.errors import OutsideMap, Reason
from visloc_companion.geo.wgs84 import geo_from_ned
from visloc_companion.localise.around.still_picture import MovingFramesOnly, is_same, small
from visloc_companion.protocols import ReferenceMap
from visloc_companion.types import CameraModel, FrameRef, GeoPoint, Image, LocaliseRequest, NoFix, PosePrior, Vec3

HOME = GeoPoint(47.0, 8.0, 500.0)
MODEL = CameraModel(640, 480, 554.26, 554.26, 319.5, 239.5)
GROUND_M = 400.0


class Ground:
    """A map whose ground lies at one height, and which has nothing north of its edge."""

    def to_map(self, lat_deg: float, lon_deg: float) -> tuple[float, float]:
        if lat_deg > 47.5:
            raise OutsideMap("beyond the edge")
        return lon_deg, lat_deg

    def height_amsl_m(self, easting_m: float, northing_m: float) -> float:
        return GROUND_M


class Flight:
    """Asks about pictures one after the other, `every_s` apart."""

    def __init__(self, every_s: float = 0.5) -> None:
        self.witness, self.every_s, self.n = Witness(), every_s, 0
        self.localiser = MovingFramesOnly(self.witness, MODEL)

    def ask(
        self,
        pixels: Image,
        at_ned_m: Vec3 = (0.0, 0.0, 0.0),
        roll_deg: float = 0.0,
        place: GeoPoint = HOME,
        again: bool = False,
        searched_ned_m: Vec3 | None = None,
    ) -> Reason:
        self.n += not again
        half = math.radians(roll_deg) / 2
        attitude = (math.cos(half), math.sin(half), 0.0, 0.0)
        prior = PosePrior(geo_from_ned(at_ned_m, place), attitude, ((1.0, 0.0), (0.0, 1.0)), 1.0, 0.1, 0.1)
        t_ns = round(self.n * self.every_s * 1e9)
        request = LocaliseRequest(self.n, FrameRef(t_ns, t_ns, self.n, 0, 640, 480, 3), prior, 1)
        if searched_ned_m is not None:
            request = replace(request, prior=replace(prior, place=geo_from_ned(searched_ned_m, place)), motion_prior=prior)
        answer = self.localiser.localise(request, pixels, cast("ReferenceMap", Ground()))
        assert isinstance(answer, NoFix)
        assert answer.frame_id == self.n
        return answer.reason


def ground(seed: int, slope_px: float = 3.0) -> Image:
    """Something like ground from above, with detail of that size."""
    rng = np.random.default_rng(seed)
    grey = cv2.GaussianBlur(rng.normal(0.0, 1.0, (480, 640)), (0, 0), slope_px)
    return cv2.cvtColor(np.clip(120 + 40 * grey / grey.std(), 0, 255).astype(np.uint8), cv2.COLOR_GRAY2RGB)


def compressed(pixels: Image, seed: int, quality: int = 60, noise: float = 2.0) -> Image:
    noisy = np.clip(pixels + np.random.default_rng(seed).normal(0, noise, pixels.shape), 0, 255).astype(np.uint8)
    decoded = cv2.imdecode(cv2.imencode(".jpg", noisy, [cv2.IMWRITE_JPEG_QUALITY, quality])[1], cv2.IMREAD_COLOR)
    return np.asarray(decoded, np.uint8)


def shifted(pixels: Image, by_px: float) -> Image:
    matrix = np.array([[1.0, 0.0, by_px], [0.0, 1.0, 0.0]])
    return np.asarray(cv2.warpAffine(pixels, matrix, (640, 480), borderMode=cv2.BORDER_REFLECT), np.uint8)


@pytest.mark.parametrize("quality", [95, 60, 25])
def test_what_was_compressed_anew_is_the_same_and_what_moved_by_a_pixel_and_a_half_is_not(quality: int) -> None:
    still = ground(1)
    first = small(still)
    assert is_same(first, small(compressed(still, 2, quality)))
    assert not is_same(first, small(shifted(still, 1.5)))
    assert not is_same(first, small(ground(2)))
    assert not is_same(first, first[:, :80]), "another camera"


def test_a_picture_that_shows_nothing_is_not_the_same_as_another() -> None:
    """Fog and night: what differs is noise, and nothing tells whether the camera moved. Shade of the lens is no ground."""
    v, u = np.mgrid[:480, :640]
    shade = (200 - 0.0006 * ((u - 320) ** 2 + (v - 240) ** 2)).astype(np.uint8)
    fog = cv2.cvtColor(shade, cv2.COLOR_GRAY2RGB)
    assert not is_same(small(compressed(fog, 1)), small(compressed(fog, 2)))
    assert not is_same(small(fog), small(fog))


def with_gear(pixels: Image) -> Image:
    """Legs at both sides, a text below and the rim of a wide lens, all of which stay where they are."""
    seen = pixels.copy()
    v, u = np.mgrid[:480, :640]
    seen[:, :76], seen[:, 564:], seen[408:] = 20, 20, 200
    seen[408:, ::53] = 0
    seen[np.hypot(u - 320, v - 240) > 305] = 0
    return np.asarray(seen, np.uint8)


def test_what_the_vehicle_carries_into_the_picture_does_not_make_it_stand() -> None:
    first = small(with_gear(ground(1)))
    assert is_same(first, small(with_gear(compressed(ground(1), 2))))
    assert not is_same(first, small(with_gear(shifted(ground(1), 4.0))))
    flight = Flight()
    assert {flight.ask(with_gear(shifted(ground(1), 4.0 * n)), (0.8 * n, 0.0, 0.0)) for n in range(6)} == {Reason.NO_MATCH}


def test_rows_that_are_flown_along_do_not_stand() -> None:
    """Vines and furrows look the same for long along them."""
    rows = 40 * np.sin(np.arange(640) / 3.0)[None, :] + 15 * (ground(1)[:, :, 0].astype(np.float64) - 120) / 40
    seen = [np.clip(np.roll(rows, 12 * n, axis=0) + 120, 0, 255).astype(np.uint8) for n in range(2)]
    assert is_same(small(seen[0]), small(compressed(cv2.cvtColor(seen[0], cv2.COLOR_GRAY2RGB), 1)))
    assert not is_same(small(seen[0]), small(seen[1]))


def test_a_camera_that_is_stuck_while_the_vehicle_flies_is_refused_at_once() -> None:
    flight, still = Flight(), ground(1)
    reasons = [flight.ask(compressed(still, n), (5.0 * n, 0.0, 0.0)) for n in range(6)]
    assert reasons == [Reason.NO_MATCH] + [Reason.FROZEN] * 5
    assert flight.witness.asked == [1]
    assert flight.ask(ground(3), (30.0, 0.0, 0.0)) is Reason.NO_MATCH


def test_a_slow_flight_and_a_fast_camera_take_some_pictures() -> None:
    """1.2 m/s at 100 m above ground, ten frames a second: 0.66 pixels of the frame a picture."""
    flight, still = Flight(0.1), ground(1)
    reasons = [flight.ask(compressed(still, n), (0.12 * n, 0.0, 0.0)) for n in range(40)]
    assert reasons.index(Reason.FROZEN) <= 16
    assert set(reasons[16:]) == {Reason.FROZEN}


def test_a_turn_is_enough() -> None:
    flight, still = Flight(), ground(1)
    reasons = [flight.ask(compressed(still, n), roll_deg=0.15 * n) for n in range(5)]
    assert reasons == [Reason.NO_MATCH] * 3 + [Reason.FROZEN] * 2
    assert flight.ask(compressed(still, 9), roll_deg=0.0) is Reason.FROZEN, "it was frozen, and shows the same"


def test_a_hover_is_no_frozen_camera() -> None:
    """The place wanders by GNSS' noise, the attitude by the estimator's, and the picture stands nearly still."""
    flight, still, rng = Flight(0.25), ground(1), np.random.default_rng(4)
    for n in range(200):
        north, east, roll = rng.normal(0.0, 1.0, 3) * np.array([0.15, 0.15, 0.05])
        assert flight.ask(compressed(still, n), (north, east, 0.0), roll) is Reason.NO_MATCH


def test_a_search_of_other_places_does_not_freeze_a_hover() -> None:
    flight, still = Flight(), ground(1)
    for n in range(12):
        elsewhere = (1000.0 * n, -500.0, 0.0) if n % 2 else None
        assert flight.ask(compressed(still, n), searched_ned_m=elsewhere) is Reason.NO_MATCH


def test_a_place_that_leaps_costs_one_picture() -> None:
    """A hover, and GNSS is spoofed by 30 m: the camera that shows that it did not move must be heard."""
    flight, still = Flight(), ground(1)
    reasons = [flight.ask(compressed(still, n), (30.0 if n >= 5 else 0.0, 0.0, 0.0)) for n in range(12)]
    assert reasons == [Reason.NO_MATCH] * 5 + [Reason.FROZEN] + [Reason.NO_MATCH] * 6


def test_an_attitude_that_drifts_for_a_minute_is_no_turn() -> None:
    flight, still = Flight(1.0), ground(1)
    assert {flight.ask(compressed(still, n), roll_deg=0.03 * n) for n in range(60)} == {Reason.NO_MATCH}


@pytest.mark.parametrize("down_m", [95.0, 99.9])
def test_on_the_ground_nothing_is_judged(down_m: float) -> None:
    flight, still = Flight(), ground(1)
    assert {flight.ask(compressed(still, n), (2.0 * n, 0.0, down_m), 3.0 * n) for n in range(9)} == {Reason.NO_MATCH}


def test_beside_the_map_the_height_above_sea_level_serves() -> None:
    flight, still, north = Flight(), ground(1), GeoPoint(48.0, 8.0, 500.0)
    reasons = [flight.ask(compressed(still, n), (15.0 * n, 0.0, 0.0), place=north) for n in range(3)]
    assert reasons == [Reason.NO_MATCH, Reason.FROZEN, Reason.FROZEN]


def test_a_frame_is_judged_once_however_often_it_is_asked_about() -> None:
    flight, still = Flight(), ground(1)
    assert [flight.ask(still), flight.ask(still, (9.0, 0.0, 0.0), again=True)] == [Reason.NO_MATCH] * 2
    assert flight.ask(compressed(still, 1), (9.0, 0.0, 0.0)) is Reason.FROZEN
    assert flight.ask(compressed(still, 1), again=True) is Reason.FROZEN


def test_pixels_that_are_no_frame_are_left_to_the_localiser() -> None:
    flight = Flight()
    assert [flight.ask(np.zeros((10, 10), np.uint8)) for _ in range(2)] == [Reason.NO_MATCH] * 2


def test_a_grey_camera_is_looked_at_too() -> None:
    flight, still = Flight(), ground(1)
    reasons = [flight.ask(compressed(still, n)[:, :, 0], (5.0 * n, 0.0, 0.0)) for n in range(3)]
    assert reasons == [Reason.NO_MATCH, Reason.FROZEN, Reason.FROZEN]
