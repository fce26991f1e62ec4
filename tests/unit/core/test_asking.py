"""The worker's questions where something that they need is missing."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest

from tests.unit.core.conftest import ns, place_of
from tests.unit.core.flown import S, frame, quiet, requests, started
from tests.unit.core.terrain.test_ranges import measuring
from tests.unit.core.test_without_position import without_position
from visloc_companion.core.settings import CoreSettings
from visloc_companion.errors import Reason
from visloc_companion.types import Attitude, Event, LocalPose, NoFix, PriorPose, Range

World = Any
LEVEL = (1.0, 0.0, 0.0, 0.0)


@pytest.mark.parametrize(("readout_s", "after_s", "known"), [(0.02, 0.0, True), (0.02, 0.095, False), (0.0, 0.0, False)])
def test_a_rolling_shutter_is_told_only_where_the_attitudes_span_its_readout(
    world: type[World], readout_s: float, after_s: float, known: bool
) -> None:
    """No attitude is known further than 0.1 s from a sample; half of the readout comes after the frame's time."""
    w = quiet(lambda **faults: world(settings=CoreSettings(readout_s=readout_s), **faults))  # type: ignore[arg-type]
    (request,) = requests(w.send(frame(w.t + after_s)))
    assert (request.readout is not None) is known


def test_a_vehicle_whose_height_nobody_tells_is_not_looked_for_about_its_receiver(world: type[World]) -> None:
    """Not before its autopilot tells velocity and height."""

    class Silent:
        def __init__(self, heard: Any) -> None:
            self.heard, self.quiet = heard, True

        def on(self, event: Event, now_ns: int) -> list[Any]:
            silent = self.quiet and isinstance(event, LocalPose | PriorPose)
            return [] if silent else list(self.heard.on(event, now_ns))

    w = without_position(world)
    w.navigator = silent = Silent(w.navigator)
    w.fly(8.0)
    assert not w.requests
    silent.quiet = False
    w.fly(9.0)
    assert w.requests
    assert w.requests[0][1].frame.t_ns > 8.0 * S - ns(0.6), "the frame that waited, or a newer one"


def test_after_a_restart_of_the_autopilot_the_map_is_searched_once_its_height_is_told(world: type[World]) -> None:
    """While no frame is recognised about GNSS every other question is the search's; the filter's own ones go on."""
    w = started(world, blind=lambda t: True).fly(60)
    assert w.notices("no fix near GNSS, searching the map")
    for _, answer in w.answers:
        w.navigator.on(replace(answer, t_rx_ns=ns(w.t)), ns(w.t))

    def asked(k: int, *told: Event) -> list[bool]:
        """Of a frame half a second later, whether the map is searched in it."""
        now = ns(w.t + 0.5 * k)
        w.navigator.on(Attitude(now, ns(5.0 + 0.5 * k), LEVEL, (0.0, 0.0, 0.0)), now)
        for event in told:
            w.navigator.on(event, now)
        got = requests(w.navigator.on(frame(w.t + 0.5 * k), now))
        for request in got:
            ids = request.request_id, request.frame.frame_id, "test"
            w.navigator.on(NoFix(now, request.frame.t_ns, *ids, Reason.NO_MATCH, 5.0), now)
        return [request.motion_prior is not None for request in got]

    silent = [each for k in range(1, 7) for each in asked(k)]
    assert set(silent) == {False}
    prior = PriorPose(ns(w.t + 4), ns(9.0), place_of(w.p), (0.0, 0.0, 0.0), 100.0)
    assert any(asked(8, prior) + asked(9))


def test_a_beam_that_says_no_more_than_the_altitude_that_it_may_have_taught_is_left_out(world: type[World]) -> None:
    """A sensor that calls its distances unsure by 40 m."""

    def measured(sigma_m: float) -> set[bool]:
        class Unsure(world):  # type: ignore[misc]
            def send(self, event: Event) -> Any:
                return super().send(replace(event, sigma_m=sigma_m) if isinstance(event, Range) else event)

        w = measuring(Unsure, CoreSettings(rangefinder=True, terrain=True, structure=False), pitch_rad=0.0)
        return {request.beam is not None for _, request, _ in w.requests}

    assert measured(40.0) == {False}
    assert any(measured(0.1))
