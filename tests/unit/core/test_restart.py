"""The daemon dies in flight and is started again while the receiver has no fix."""

from __future__ import annotations

import math
from collections.abc import Callable
from itertools import pairwise
from typing import Any

import numpy as np
import pytest

from tests.unit.core.conftest import Nobody, place_of
from visloc_companion.core.navigator import Navigator
from visloc_companion.core.settings import CoreSettings, GnssSettings, InjectionSettings
from visloc_companion.core.source.switching import HAND_BACK_NS
from visloc_companion.geo import wgs84
from visloc_companion.types import (
    AutopilotKind,
    EkfSource,
    FoundOnVision,
    GeoPoint,
    Gnss,
    Injection,
    InjectionPolicy,
    LinkChanged,
    Notice,
    OriginChanged,
    SwitchSource,
    Verdict,
)

World = Any
ORIGIN = GeoPoint(59.3, 18.1, 40.0)
DOWN_S = 3.0
FALSE_M = np.array([300.0, 0.0])


def restarted(world: type[World], *, armed: bool = True, **faults: Any) -> World:
    """Jammed at 20 s unless other faults are named; the first daemon dies at 40 s, another one comes up 3 s later."""
    w = world(**(faults or {"jammed": lambda t: t > 20}))
    w.start()
    w.fly(40.0)
    w.navigator, w.last_injection = Nobody(), None
    w.fly(40.0 + DOWN_S)
    w.navigator, w.answers = Navigator(w.settings), []
    w.send(LinkChanged(0, up=True, autopilot=AutopilotKind.ARDUPILOT, system_id=1, armed=armed))
    w.send(OriginChanged(0, ORIGIN))
    return w


def test_it_goes_on_from_the_autopilots_position_within_two_seconds(world: type[World]) -> None:
    w = restarted(world)
    w.fly(60.0)
    first_s = w.first(Injection, since_s=40.0 + DOWN_S)
    assert first_s - 40.0 - DOWN_S < 2.0
    sent = next(command for t, command in w.commands if t == first_s and isinstance(command, Injection))
    assert math.hypot(*wgs84.ned_from_geo(sent.place, ORIGIN)[:2]) > 100  # not home
    assert max(error for t, _, error in w.statuses if t > 46) < 6.0


def test_nothing_is_sent_before_a_fix_has_confirmed_it(world: type[World]) -> None:
    w = restarted(world)
    w.blind = lambda t: t < 50
    w.fly(55.0)
    assert w.first(Injection, since_s=40.0 + DOWN_S) == pytest.approx(51.5, abs=1.6)


def test_on_the_ground_the_map_is_searched(world: type[World]) -> None:
    w = restarted(world, armed=False)
    w.fly(44.0)
    assert math.isinf(w.first(Injection, since_s=40.0 + DOWN_S))


@pytest.mark.parametrize("pull", [lambda t: max(0.0, t - 10.0), lambda t: 300.0 * (t > 20)], ids=["drag", "step"])
def test_amid_a_spoofing_gnss_is_believed_for_seconds_only_and_never_followed(
    world: type[World], pull: Callable[[float], float]
) -> None:
    w = restarted(world, pull_m=lambda t: (pull(t), 0.0))
    assert w.source is EkfSource.VISION
    w.fly(80.0)
    assert w.first(Injection, since_s=40.0 + DOWN_S) - 40.0 - DOWN_S < 6.0
    assert w.status_at(50.0)[0].verdict is Verdict.SUSPECT
    assert max(error for t, _, error in w.statuses if t > 45) < 6.1
    assert not [c for t, c in w.commands if t > 40 and isinstance(c, SwitchSource) and c.source is EkfSource.GNSS]


def test_a_position_that_a_second_receiver_may_have_given_is_not_gone_on_from(world: type[World]) -> None:
    """The first one is jammed, the second sees a false place, on which the autopilot flies: nothing was found from there."""

    class Two(world):
        def _telemetry(self, t: float, gnss: Any, jammed: bool) -> None:
            super()._telemetry(t, gnss, jammed)
            if self.k % 10 == 0 and t > 40:
                now, place = round(t * 1e9), place_of(self.p + FALSE_M)
                self.send(Gnss(now, now + 995 * 10**9, 3, 12, place, 1.0, 1.5, None, receiver=1))

    w = restarted(Two, jammed=lambda t: t > 20)
    w.ekf_p = w.ekf_p + FALSE_M
    w.fly(70.0)
    assert [t for t in w.notices("filter seeded") if t > 40.0] == []
    assert len(w.notices("position found on the map")) == 1
    assert max(error for t, s, error in w.statuses if t > 40.0 and s.place is not None) < 6.0


def test_a_fix_that_is_less_than_was_asked_for_is_what_the_autopilot_flies_on(world: type[World]) -> None:
    """With RTK asked for, a spoofed receiver with a 3-D fix: its position is nobody's word but its own."""
    settings = CoreSettings(injection=InjectionSettings(switch_source=True), gnss=GnssSettings(min_fix_type=5))
    w = world(settings=settings, pull_m=lambda t: (300.0, 0.0))
    w.start()
    w.send(LinkChanged(0, up=True, autopilot=AutopilotKind.ARDUPILOT, system_id=1, armed=True))
    w.fly(40.0)
    assert w.notices("filter seeded") == []
    assert len(w.notices("position found on the map")) == 1
    assert max(error for t, s, error in w.statuses if s.place is not None) < 6.0


@pytest.mark.parametrize("switches", [True, False])
def test_a_vehicle_on_vision_is_given_positions_until_a_good_gnss_is_proven(world: type[World], switches: bool) -> None:
    """The jam is over and GNSS is trusted at once, but nobody has brought the autopilot back to it: without positions ArduPilot
    lands after 8 s."""
    settings = CoreSettings(injection=InjectionSettings(switch_source=switches))
    w = restarted(world, settings=settings, jammed=lambda t: 20 < t < 38)
    w.source = EkfSource.VISION
    w.send(FoundOnVision(0))
    w.fly(140.0)
    sent = [t for t, c in w.commands if isinstance(c, Injection) and t > 39.5]
    assert max(after - before for before, after in pairwise(sent)) < DOWN_S + 1.2, "PX4's failsafe comes after 4.6 s"
    ordered = [t for t, c in w.commands if t > 43 and isinstance(c, SwitchSource)]
    back = ordered or [t for t in w.notices("source to GNSS") if t > 43]
    assert len(back) == 1
    assert not [t for t in w.notices("source to VISION") if t > 43], "it is there"
    assert not [c for t, c in w.commands if t > 43 and isinstance(c, SwitchSource) and c.source is EkfSource.VISION]
    assert back[0] - 40.0 - DOWN_S > settings.gnss.probation_s
    assert sent[-1] - back[0] == pytest.approx(0.0 if switches else HAND_BACK_NS * 1e-9, abs=4.0)
    assert len(w.notices("restarted, EKF may be on VISION")) == 1


@pytest.mark.parametrize("counted", [0, 1, 255])
def test_no_position_bears_the_count_of_those_before(world: type[World], counted: int) -> None:
    """What the autopilot made of its position in between is its own: a step to the first fix must not pass for motion."""
    w = restarted(world)
    w.send(FoundOnVision(0, counted))
    w.fly(60.0)
    sent = {c.reset_counter for t, c in w.commands if isinstance(c, Injection) and t > 40.0 + DOWN_S}
    assert sent
    assert min((counter - counted) % 256 for counter in sent) > 100


def obeyed(world: type[World]) -> type[World]:
    """With an operator who switches to vision at once when he is asked."""

    class Obeyed(world):
        def send(self, event: Any) -> Any:
            commands = super().send(event)
            if any(isinstance(c, Notice) and "source to VISION" in c.text for c in commands):
                self.source = EkfSource.VISION
            return commands

    return Obeyed


@pytest.mark.parametrize("switches", [True, False])
def test_one_found_on_vision_amid_a_spoofing_never_gets_a_gnss_that_is_believed(world: type[World], switches: bool) -> None:
    """Its position is the last daemon's, so fixes are there before GNSS has been trusted, which has to agree with them then."""
    settings = CoreSettings(injection=InjectionSettings(switch_source=switches))
    w = restarted(obeyed(world), settings=settings, pull_m=lambda t: (300.0 * (t > 20), 0.0))
    w.send(FoundOnVision(0))
    w.fly(80.0)
    after = [(s, error) for t, s, error in w.statuses if t > 43 and s.place is not None]
    assert {s.verdict for s, _ in after} == {Verdict.DENIED}
    assert max(error for _, error in after) < 6.0
    assert w.first(Injection, since_s=43.0) - 43.0 < 1.2
    assert not [c for t, c in w.commands if t > 43 and isinstance(c, SwitchSource) and c.source is EkfSource.GNSS]


def test_one_said_to_be_on_vision_that_a_false_gnss_has_led_away_comes_back(world: type[World]) -> None:
    """The operator had not switched yet: the autopilot's position is the false one, and no fix confirms it."""
    settings = CoreSettings(injection=InjectionSettings(switch_source=False))
    w = restarted(world, settings=settings, pull_m=lambda t: (300.0 * (t > 20), 0.0))
    w.send(FoundOnVision(0))
    w.fly(100.0)
    injected = [t for t, c in w.commands if t > 43 and isinstance(c, Injection)]
    assert injected[0] - 43.0 < 6.0
    assert max(error for t, s, error in w.statuses if t > injected[0] and s.place is not None) < 6.0
    assert [t for t in w.notices("source to VISION") if t > 43]


def test_who_sends_no_positions_has_brought_nobody_to_vision(world: type[World]) -> None:
    settings = CoreSettings(injection=InjectionSettings(policy=InjectionPolicy.NEVER))
    w = restarted(world, settings=settings, jammed=lambda t: 20 < t < 38)
    w.send(FoundOnVision(0))
    w.fly(80.0)
    assert not [c for _, c in w.commands if isinstance(c, Injection)]
    assert w.notices("set EKF position source") == []


def test_one_fix_after_a_long_blindness_does_not_prove_a_gnss_that_it_contradicts(world: type[World]) -> None:
    """Restarted amid a spoofing, over land that is not recognised for half a minute: until then nothing contradicts GNSS."""
    w = restarted(world, pull_m=lambda t: (80.0 * (t > 20), 0.0), blind=lambda t: 43.0 < t < 72.0)
    w.send(FoundOnVision(0))
    w.fly(95.0)
    assert w.status_at(70.0)[0].verdict is Verdict.OK, "nobody has told it otherwise"
    assert w.status_at(80.0)[0].verdict is Verdict.SUSPECT
    assert not [t for t, c in w.commands if t > 40 and isinstance(c, SwitchSource) and c.source is EkfSource.GNSS]
