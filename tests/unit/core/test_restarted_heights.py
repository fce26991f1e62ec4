"""An autopilot that restarts in flight and counts its height from another zero: fixes teach that, and it is no zoom."""

from __future__ import annotations

from dataclasses import fields, replace
from itertools import pairwise
from typing import Any

import pytest

from tests.unit.core.conftest import ORIGIN, World, ns
from visloc_companion.errors import Reason
from visloc_companion.sim.real.oracle import answered_height
from visloc_companion.types import (
    AutopilotKind,
    Event,
    Fix,
    FrameRef,
    LinkChanged,
    LocaliseRequest,
    Mode,
    NoFix,
    OriginChanged,
    PriorPose,
)

RESTART_S, SIGMA_M = 30.0, 2.0


class Restarting(World):
    """From RESTART_S on another boot clock, and heights from another zero, by `zero_m` above the sea and `home_m` above home.
    Fixes know the height to SIGMA_M beside their prior, as a localiser's do."""

    zero_m = home_m = 0.0

    def send(self, event: Event) -> list[object]:
        if isinstance(event, Fix):
            prior = next(request.prior for _, request, _ in self.requests if request.request_id == event.request_id)
            h_amsl_m, sigma_h_m = answered_height(event.place.h_amsl_m, prior, SIGMA_M)
            place = replace(event.place, h_amsl_m=h_amsl_m)
            event = replace(event, place=place, sigma_h_m=sigma_h_m, above_ground_m=100.0)
        if self.t >= RESTART_S and not isinstance(event, FrameRef):
            if any(field.name == "t_boot_ns" for field in fields(event)):
                event = replace(event, t_boot_ns=event.t_boot_ns - ns(1020))
            if isinstance(event, PriorPose):
                place = replace(event.place, h_amsl_m=event.place.h_amsl_m + self.zero_m)
                event = replace(event, place=place, h_rel_m=event.h_rel_m + self.home_m)
        return list(super().send(event))

    def restart(self, *, armed: bool = True) -> None:
        self.send(LinkChanged(0, up=False, armed=armed))
        self.send(LinkChanged(0, up=True, autopilot=AutopilotKind.ARDUPILOT, system_id=1, armed=armed))
        self.send(OriginChanged(0, ORIGIN))

    def asked_since(self, t_s: float) -> list[LocaliseRequest]:
        return [request for t, request, _ in self.requests if t >= t_s]


def flown(zero_m: float, home_m: float) -> Restarting:
    world = Restarting(jammed=lambda t: t > 20)
    world.zero_m, world.home_m = zero_m, home_m
    world.start()
    world.fly(RESTART_S)
    world.restart()
    return world.fly(60.0)  # type: ignore[return-value]


@pytest.mark.parametrize("zero_m", [-100.0, 60.0, 300.0])
def test_what_fixes_teach_of_the_new_height_counts(zero_m: float) -> None:
    """Each fix was taken for one more step of a slow zoom, which let the height loose again, to 3 m at 100 m above ground."""
    world = flown(zero_m, 0.0)
    first, *others = world.asked_since(RESTART_S)
    assert first.prior.sigma_h_m == 20.0
    assert [request.prior.place.h_amsl_m for request in others[2:]] == pytest.approx([140.0] * len(others[2:]), abs=1.0)
    sigmas_m = [request.prior.sigma_h_m for request in others]
    assert all(later <= before + 1e-9 for before, later in pairwise(sigmas_m))
    assert sigmas_m[-1] < 1.5


class Grounded(Restarting):
    """Its autopilot calls the place where it restarted the ground, and what is not within three sigma of the height that a frame
    is asked with is not recognised."""

    zero_m = home_m = -100.0

    def _localise(self, request: LocaliseRequest) -> None:
        super()._localise(request)
        off_m = request.prior.place.h_amsl_m - (ORIGIN.h_amsl_m + 100.0)
        if abs(off_m) > 3 * request.prior.sigma_h_m:
            when, answer = self.answers.pop()
            told = answer.t_ns, request.request_id, request.frame.frame_id, "test"  # type: ignore[attr-defined]
            self.answers.append((when, NoFix(0, *told, Reason.NO_MATCH, 5.0)))


def grounded(*, armed: bool, until_s: float, **faults: Any) -> Grounded:
    world = Grounded(jammed=lambda t: t > 20, **faults)
    world.start()
    world.fly(RESTART_S)
    world.restart(armed=armed)
    return world.fly(until_s)  # type: ignore[return-value]


@pytest.mark.parametrize("armed", [True, False])
def test_an_autopilot_that_calls_the_sky_the_ground_is_placed_all_the_same(armed: bool) -> None:
    """It counts from 0 m, and is disarmed: no frame was ever asked about again."""
    world = grounded(armed=armed, until_s=RESTART_S + 30.0)
    asked = world.asked_since(RESTART_S + 5.0)
    assert len(asked) > 40
    assert [request.prior.place.h_amsl_m for request in asked] == pytest.approx([140.0] * len(asked), abs=2.0)
    assert {s.mode for t, s, _ in world.statuses if t > RESTART_S + 5.0} == {Mode.AIDING}
    assert max(off_m for t, _, off_m in world.statuses if t > RESTART_S + 5.0) < 6.0


def test_what_is_disarmed_and_not_recognised_has_come_down_after_two_minutes() -> None:
    world = grounded(armed=False, until_s=RESTART_S + 130.0, blind=lambda t: t >= RESTART_S)
    assert world.asked_since(RESTART_S + 110.0)
    assert not world.asked_since(RESTART_S + 122.0)
