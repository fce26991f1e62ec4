"""An autopilot whose height steps in flight without a restart, as EKFs do where another sensor takes over: it is no zoom."""

from __future__ import annotations

from dataclasses import replace

import pytest

from tests.unit.core.conftest import World
from visloc_companion.sim.real.oracle import answered_height
from visloc_companion.types import Event, Fix, Mode, PriorPose

STEP_S, SIGMA_M = 40.0, 2.0


class Stepping(World):
    """From STEP_S on the autopilot states heights that are higher by `step_m`. Fixes know the height to SIGMA_M beside their
    prior, as a localiser's do, and the camera leans, so that a lens in doubt counts."""

    step_m = 0.0

    def send(self, event: Event) -> list[object]:
        if isinstance(event, Fix):
            prior = next(request.prior for _, request, _ in self.requests if request.request_id == event.request_id)
            h_amsl_m, sigma_h_m = answered_height(event.place.h_amsl_m, prior, SIGMA_M)
            place = replace(event.place, h_amsl_m=h_amsl_m)
            more = {"sigma_h_m": sigma_h_m, "above_ground_m": 100.0, "per_focal_ne_m": (30.0, 20.0)}
            event = replace(event, place=place, **more)
        if isinstance(event, PriorPose) and self.t >= STEP_S:
            place = replace(event.place, h_amsl_m=event.place.h_amsl_m + self.step_m)
            event = replace(event, place=place, h_rel_m=event.h_rel_m + self.step_m)
        return list(super().send(event))


def flown(step_m: float) -> Stepping:
    world = Stepping(jammed=lambda t: t > 20)
    world.step_m = step_m
    world.start()
    return world.fly(75.0)  # type: ignore[return-value]


@pytest.mark.parametrize("step_m", [-15.0, -6.0, 6.0, 15.0])
def test_a_height_that_steps_is_no_zoom(step_m: float) -> None:
    """It was taken for a lens that zooms or for ground: heights were let loose, and the lens was doubted."""
    still, stepped = flown(0.0), flown(step_m)
    for until_s, wider in ((60.0, 1.5), (75.0, 1.3)):
        asked, before = (
            [request.prior for t, request, _ in world.requests if until_s - 5 < t < until_s] for world in (stepped, still)
        )
        assert asked[-1].place.h_amsl_m == pytest.approx(140.0, abs=2.0)
        assert asked[-1].sigma_h_m < wider * before[-1].sigma_h_m
    levels, right = (
        [s.protection_level_m for t, s, _ in world.statuses if STEP_S < t < 75 and s.mode is Mode.AIDING]
        for world in (stepped, still)
    )
    assert len(levels) == len(right)
    assert max(levels) < 1.15 * max(right)
