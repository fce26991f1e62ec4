"""What rangefinders measured near a frame's time, and when it is not believed."""

from __future__ import annotations

import math
from dataclasses import replace
from random import Random
from typing import Any

import pytest

from tests.unit.core.conftest import BOOT_OFFSET_NS, ns
from visloc_companion.app.serialise import from_json, to_json
from visloc_companion.core.navigator import Navigator
from visloc_companion.core.settings import CoreSettings
from visloc_companion.core.terrain.ranges import NEAR_NS, SIGMA_M, SIGMA_SHARE, Ranges
from visloc_companion.geo import se3
from visloc_companion.types import Attitude, Event, LocaliseRequest, Range

World = Any
MS = 1_000_000
FAST = 10.0
LEAN_RAD = math.radians(30.0)


def heard(*readings: tuple[int, float], valid: bool = True, sensor: int = 0, ranges: Ranges | None = None) -> Ranges:
    """Readings (ms, m) of a sensor."""
    ranges = ranges or Ranges()
    for t_ms, distance_m in readings:
        ranges.on_range(Range(t_ms * MS, t_ms * MS, distance_m, valid, sensor), t_ms * MS)
    return ranges


def test_the_reading_nearest_to_the_frame_counts_and_an_old_one_does_not() -> None:
    ranges = heard((1000, 50.0), (1100, 51.0))
    near = ranges.near(1080 * MS, FAST)
    assert near is not None
    assert (near.t_ns, near.distance_m) == (1100 * MS, 51.0)
    assert near.sigma_m == pytest.approx(math.hypot(SIGMA_M, SIGMA_SHARE * 51.0))
    assert ranges.near(1100 * MS + NEAR_NS, FAST) is not None
    assert ranges.near(1100 * MS + NEAR_NS + 1, FAST) is None
    ranges.clear()
    assert ranges.near(1100 * MS, FAST) is None


def test_what_a_sensor_calls_invalid_takes_its_neighbours_with_it() -> None:
    """At the end of its reach a sensor hears crowns between one silence and the next."""
    ranges = heard((1000, 39.0), (1100, 39.5))
    heard((1200, 40.0), valid=False, ranges=ranges)
    heard((1300, 38.0), ranges=ranges)
    assert ranges.near(1300 * MS, FAST) is None
    heard((1400, 37.5), (1500, 37.0), (1600, 36.5), (1700, 36.0), ranges=ranges)
    believed = ranges.near(1600 * MS, FAST)
    assert believed is not None
    assert believed.distance_m == 36.5
    assert heard((1000, 0.0)).near(1000 * MS, FAST) is None


def test_a_sensor_that_is_stuck_is_believed_only_of_a_vehicle_that_stands() -> None:
    stuck = heard(*((1000 + 100 * k, 42.0) for k in range(30)))
    assert stuck.near(3900 * MS, FAST) is None
    hovering = stuck.near(3900 * MS, 0.5)
    assert hovering is not None
    assert stuck.near(2000 * MS, FAST) is not None, "a second of it is no proof"
    rng = Random(1)
    lively = heard(*((1000 + 100 * k, round(42.0 + rng.gauss(0.0, 0.02), 2)) for k in range(30)))
    assert lively.near(3900 * MS, FAST) is not None


def test_rangefinder_has_no_reach_and_is_not_heard_beside_distance_sensor() -> None:
    """ArduPilot sends both of one sensor; of what is beyond its reach the one says so, the other only a distance."""
    ranges = heard((1000, 41.0), valid=False, sensor=3)
    ranges.on_range(Range(1010 * MS, 0, 41.0, True), 1010 * MS)
    assert ranges.near(1010 * MS, FAST) is None
    alone = Ranges()
    alone.on_range(Range(1010 * MS, 0, 41.0, True), 1010 * MS)
    assert alone.near(1010 * MS, FAST) is not None


def test_of_two_sensors_the_surer_one_counts_unless_they_contradict_each_other() -> None:
    ranges = heard((1000, 30.2), sensor=1)
    ranges.on_range(Range(1000 * MS, 1000 * MS, 30.0, True, 2, sigma_m=0.5), 1000 * MS)
    both = ranges.near(1000 * MS, FAST)
    assert both is not None
    assert both.distance_m == 30.2
    heard((1100, 30.2), sensor=1, ranges=ranges)
    heard((1100, 12.0), sensor=2, ranges=ranges)
    assert ranges.near(1100 * MS, FAST) is None
    silent = heard((1100, 30.2), sensor=1)
    heard((1100, 12.0), valid=False, sensor=2, ranges=silent)
    assert silent.near(1100 * MS, FAST) is not None, "the other is out of its reach"


def test_no_more_sensors_are_kept_than_a_vehicle_has() -> None:
    ranges = Ranges()
    for sensor in range(256):
        heard((1000, 30.0), sensor=sensor, ranges=ranges)
    assert len(ranges._of_sensor) == 8


# --------------------------------------------------------------------------------------------------- in the navigator's questions


def measuring(world: type[World], settings: CoreSettings, pitch_rad: float = -LEAN_RAD, **more: Any) -> World:
    """A vehicle that leans, with a rangefinder along its body that reads 80 m and some centimetres ten times a second."""

    class Measures(world):  # type: ignore[misc]
        def send(self, event: Event) -> Any:
            if isinstance(event, Attitude):
                event = replace(event, q_ned_frd=se3.quat_from_euler(0.0, pitch_rad, 0.0))
            return super().send(event)

        def _telemetry(self, t: float, gnss: Any, jammed: bool) -> None:
            super()._telemetry(t, gnss, jammed)
            boot_ns = ns(t) - BOOT_OFFSET_NS + ns(1000)
            self.send(Range(ns(t), boot_ns, 80.0 + 0.01 * (round(10 * t) % 7), True))

    w = Measures(settings=settings, **more)
    w.start()
    return w.fly(12)


def test_a_question_says_where_the_beam_of_a_leaning_vehicle_ends(world: type[World]) -> None:
    """Nose down, the body's down axis points behind."""
    w = measuring(world, CoreSettings(rangefinder=True, structure=False, lever_frd_m=(0.0, 0.0, 1.0)))
    assert len(w.requests) > 10
    lever = se3.rotate(se3.quat_from_euler(0.0, -LEAN_RAD, 0.0), (0.0, 0.0, 1.0))
    for _, request, _ in w.requests:
        beam = request.beam
        assert beam is not None
        north, east, down = (a + b for a, b in zip(beam.end_ned_m, lever, strict=True))
        assert north == pytest.approx(-80.0 * math.sin(LEAN_RAD), abs=1.5), "flown on by less than 0.1 s"
        assert east == pytest.approx(0.0, abs=1.5)
        assert down == pytest.approx(80.0 * math.cos(LEAN_RAD), abs=0.1)
        of_length, of_mounting = math.hypot(SIGMA_M, SIGMA_SHARE * 80.0), math.radians(1.0) * 80.0 * math.sin(LEAN_RAD)
        assert beam.sigma_m == pytest.approx(math.hypot(of_length, of_mounting), rel=2e-3)
        assert from_json(to_json(request)) == request


def test_an_altitude_that_the_same_distances_may_have_taught_is_not_counted_twice(world: type[World]) -> None:
    """Where terrain navigation hears the same rangefinder, altitude and beam together claim what the beam alone is worth."""
    settings = CoreSettings(rangefinder=True, terrain=True, structure=False)
    w = measuring(world, settings, pitch_rad=0.0, blind=lambda t: t > 5.0)
    alone_m = math.hypot(SIGMA_M, SIGMA_SHARE * 80.0)
    asked = [request for _, request, _ in w.requests if request.beam is not None]
    assert len(asked) > 5
    for request in asked:
        assert request.beam is not None
        both = request.beam.sigma_m**-2 + request.prior.sigma_h_m**-2
        assert both**-0.5 == pytest.approx(alone_m, rel=2e-3)
    surer = [request for _, request, _ in w.requests if request.beam is None]
    assert all(request.prior.sigma_h_m <= 1.01 * alone_m for request in surer)


def test_no_question_has_it_unless_it_is_asked_for(world: type[World]) -> None:
    assert {request.beam for _, request, _ in measuring(world, CoreSettings(structure=False)).requests} == {None}


def test_a_flight_replays_with_its_readings_and_an_older_one_without(world: type[World]) -> None:
    settings = CoreSettings(rangefinder=True, structure=False)
    heard_events: list[tuple[Event, int]] = []

    class Recorded(Navigator):
        def on(self, event: Event, now_ns: int) -> Any:
            heard_events.append((event, now_ns))
            return super().on(event, now_ns)

    class Records(world):  # type: ignore[misc]
        def __post_init__(self) -> None:
            super().__post_init__()
            self.navigator = Recorded(self.settings)

    w = measuring(Records, settings)
    flown = [to_json(c) for _, c in w.commands]
    again = Navigator(settings)
    read_back = [(from_json(to_json(event)), now_ns) for event, now_ns in heard_events]
    assert [to_json(c) for event, now_ns in read_back for c in again.on(event, now_ns)] == flown  # type: ignore[arg-type]
    asked = [c for _, c in w.commands if isinstance(c, LocaliseRequest)]
    assert any(c.beam is not None for c in asked)
    plain = to_json(replace(asked[0], beam=None))
    assert from_json(plain.replace(',"beam":null', "")) == replace(asked[0], beam=None)
    assert ',"beam":null' in plain
    older = '{"type":"Range","t_rx_ns":1,"t_boot_ns":1,"distance_m":7.5,"valid":true}'
    assert from_json(older) == Range(1, 1, 7.5, True)


def test_readings_out_of_order_are_left_out() -> None:
    ranges = heard((1000, 50.0), (1100, 51.0), (1050, 12.0), (1100, 13.0))
    near = ranges.near(1060 * MS, FAST)
    assert near is not None
    assert near.distance_m == 51.0
