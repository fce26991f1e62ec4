"""An autopilot that restarts in flight and counts its height from another zero: fixes teach that, and it is no zoom."""

from __future__ import annotations

from dataclasses import fields, replace
from itertools import pairwise

import pytest

from tests.unit.core.conftest import ORIGIN, World, ns
from visloc_companion.types import (
    AutopilotKind,
    Event,
    Fix,
    FrameRef,
    LinkChanged,
    LocaliseRequest,
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
            own, known = SIGMA_M**-2, prior.sigma_h_m**-2
            h_amsl_m = (own * event.place.h_amsl_m + known * prior.place.h_amsl_m) / (own + known)
            place = replace(event.place, h_amsl_m=h_amsl_m)
            event = replace(event, place=place, sigma_h_m=(own + known) ** -0.5, above_ground_m=100.0)
        if self.t >= RESTART_S and not isinstance(event, FrameRef):
            if any(field.name == "t_boot_ns" for field in fields(event)):
                event = replace(event, t_boot_ns=event.t_boot_ns - ns(1020))
            if isinstance(event, PriorPose):
                place = replace(event.place, h_amsl_m=event.place.h_amsl_m + self.zero_m)
                event = replace(event, place=place, h_rel_m=event.h_rel_m + self.home_m)
        return list(super().send(event))

    def restart(self) -> None:
        self.send(LinkChanged(0, up=False))
        self.send(LinkChanged(0, up=True, autopilot=AutopilotKind.ARDUPILOT, system_id=1, armed=True))
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
