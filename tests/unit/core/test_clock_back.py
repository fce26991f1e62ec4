"""The companion's clock steps back by less than a second: time stands in the core until it has caught up. Or it leaps."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from typing import Any

import pytest

from tests.unit.core.conftest import BOOT_OFFSET_NS
from tests.unit.core.flown import World, errors, started
from tests.unit.core.test_estimator import fix, made, velocity
from visloc_companion.core.estimator import PositionFilter
from visloc_companion.core.guard import RESTART_AFTER
from visloc_companion.core.navigator import Navigator
from visloc_companion.core.settings import CoreSettings, InjectionSettings, NavigatorSettings
from visloc_companion.types import (
    AutopilotKind,
    Command,
    EkfSource,
    Event,
    Injection,
    LinkChanged,
    Mode,
    Notice,
    RequestMessage,
    Status,
    SwitchSource,
    Tick,
    TimesyncSample,
    TooOld,
)

S = 1_000_000_000
STEP_S, BACK_S, LEAP_S = 60.0, 0.8, 1.5


class SteppedBack:
    """A navigator whose clock steps back; `Fix.t_ns` and the like descend from what it was told and stay."""

    def __init__(self, navigator: Navigator) -> None:
        self._navigator = navigator

    def on(self, event: Event, now_ns: int) -> list[Command]:
        """As Navigator's."""
        step_ns = round(BACK_S * S) if now_ns >= STEP_S * S else 0
        stamps = ("t_rx_ns", "t_ns") if type(event).__name__ in ("FrameRef", "Tick") else ("t_rx_ns",)
        moved: Any = {name: getattr(event, name) - step_ns for name in stamps if hasattr(event, name)}
        return self._navigator.on(replace(event, **moved), now_ns - step_ns)


def flown_for_2_s() -> PositionFilter:
    """A filter that was driven for so long, with a fix at 1.9 s."""
    flown = made()
    for k in range(1, 9):
        flown.drive(velocity(0.25 * k))
    flown.observe(fix(1.9, 19.0, 0.0))
    return flown


def test_a_filter_goes_on_by_what_the_clock_did_not_count() -> None:
    flown = flown_for_2_s()
    before, level_m = flown.at(2 * S), flown.protection_level_m(2 * S)
    flown.stood(2 * S, 8 * S // 10)
    after = flown.at(2 * S)
    assert after.p_ned_m[0] - before.p_ned_m[0] == pytest.approx(8.0, abs=0.3)
    assert after.cov_ne_m2[0][0] - before.cov_ne_m2[0][0] > 2.4**2
    assert flown.protection_level_m(2 * S) > level_m + 5.0
    assert isinstance(flown.observe(fix(1.9, 19.0, 0.0)), TooOld)
    flown.drive(velocity(2.5))
    assert flown.at(round(2.5 * S)).p_ned_m[0] == pytest.approx(33.0, abs=0.5)


def test_a_filter_goes_back_by_what_the_clock_counted_too_much() -> None:
    flown = flown_for_2_s()
    before, level_m = flown.at(4 * S), flown.protection_level_m(4 * S)
    flown.leapt(4 * S, 15 * S // 10, 2 * S)
    after = flown.at(4 * S)
    assert after.p_ned_m[0] - before.p_ned_m[0] == pytest.approx(-15.0, abs=0.5)
    assert after.cov_ne_m2[0][0] - before.cov_ne_m2[0][0] > 4.4**2
    assert flown.protection_level_m(4 * S) > level_m + 5.0
    assert isinstance(flown.observe(fix(3.9, 24.0, 0.0)), TooOld)
    flown.drive(velocity(4.5))
    flown.observe(fix(4.5, 29.0, 0.0))
    told = flown.at(5 * S)
    flown.leapt(5 * S, 15 * S // 10, 2 * S)
    assert flown.at(5 * S) == told, "a fix of after the leap has told where it is"


def test_nothing_is_said_while_time_stands_and_the_level_covers_what_follows(world: type[World]) -> None:
    w = started(world, jammed=lambda t: t > 30)
    w.navigator = SteppedBack(w.navigator)
    w.fly(80)
    told = [t for t, c in w.commands if isinstance(c, Injection) and t >= STEP_S]
    assert STEP_S + BACK_S <= told[0] < STEP_S + BACK_S + 0.2
    after = [(s, e) for t, s, e in w.statuses if t >= STEP_S]
    assert all(s.protection_level_m is not None and e <= s.protection_level_m for s, e in after)
    assert max(e for _, e in after) < max(errors(w, 40.0, STEP_S)) + 3.0
    assert w.first(Status, since_s=STEP_S) >= STEP_S + BACK_S


class Leapt(SteppedBack):
    """Of a navigator whose clock leaps forward, and that asks the autopilot for its time with every Tick."""

    def on(self, event: Event, now_ns: int) -> list[Command]:
        """As Navigator's."""
        step_ns = round(LEAP_S * S) if now_ns >= STEP_S * S else 0
        stamps = ("t_rx_ns", "t_ns") if type(event).__name__ in ("FrameRef", "Tick") else ("t_rx_ns",)
        moved: Any = {name: getattr(event, name) + step_ns for name in stamps if hasattr(event, name)}
        t_ns, commands = now_ns + step_ns, self._navigator.on(replace(event, **moved), now_ns + step_ns)
        asked = isinstance(event, Tick)
        said = TimesyncSample(t_ns, t_ns - 2_000_000, now_ns - 1_000_000 - BOOT_OFFSET_NS + 1000 * S)
        return [*commands, *(self._navigator.on(said, t_ns) if asked else [])]


def test_a_leap_of_our_own_clock_is_no_restart_of_the_autopilot(world: type[World]) -> None:
    """Lost, on vision, nothing seen any more: GNSS comes back, and the autopilot is brought back to it."""
    settings = CoreSettings(navigator=NavigatorSettings(lost_sigma_m=10.0), injection=InjectionSettings(switch_source=True))
    w = started(world, settings=settings, jammed=lambda t: 20 < t < 70, blind=lambda t: t > 25)
    w.send(LinkChanged(0, up=True, autopilot=AutopilotKind.ARDUPILOT, system_id=1, armed=True))
    w.navigator = Leapt(w.navigator)
    w.fly(20)
    while w.statuses[-1][1].mode is not Mode.LOST:
        w.step()
    w.last_injection = None  # the autopilot goes on from its accelerations
    w.fly(STEP_S)
    assert (w.status_at(STEP_S)[0].mode, w.source) == (Mode.LOST, EkfSource.VISION)
    w.fly(100)
    assert len(w.notices("companion clock stepped")) == 1
    assert len(w.notices("GNSS trusted")) == 2
    assert w.source is EkfSource.GNSS


class SetBack(SteppedBack):
    """Of a navigator whose clock is set back by far more than it can wait for."""

    back_ns = 20 * S

    def on(self, event: Event, now_ns: int) -> list[Command]:
        """As Navigator's."""
        step_ns = self.back_ns if now_ns >= STEP_S * S else 0
        stamps = ("t_rx_ns", "t_ns") if type(event).__name__ in ("FrameRef", "Tick") else ("t_rx_ns",)
        moved: Any = {name: getattr(event, name) - step_ns for name in stamps if hasattr(event, name)}
        return self._navigator.on(replace(event, **moved), now_ns - step_ns)


def test_after_a_clock_that_went_back_the_link_and_its_origin_are_still_known(world: type[World]) -> None:
    """Nobody says again what has not changed: it waited for the origin for good, without asking."""
    w = started(world, jammed=lambda t: t > 30)
    w.send(LinkChanged(0, up=True, autopilot=AutopilotKind.ARDUPILOT, system_id=1, armed=True))
    w.navigator = SetBack(w.navigator)
    w.fly(70)
    assert len(w.notices("clock went back, starting anew")) == 1
    assert w.first(Injection, since_s=STEP_S) < STEP_S + 3.0
    assert w.status_at(69)[0].mode is Mode.AIDING
    assert max(errors(w, 65)) < 6.0


@pytest.mark.parametrize("switches", [True, False])
def test_one_on_vision_stays_there_when_a_clock_went_back_until_a_good_gnss_is_proven(world: type[World], switches: bool) -> None:
    """GNSS has just come back, and nobody has brought the autopilot back to it: without positions it lands after 8 s."""
    settings = CoreSettings(injection=InjectionSettings(switch_source=switches))
    w = started(world, settings=settings, jammed=lambda t: 30 < t < STEP_S - 2)
    w.send(LinkChanged(0, up=True, autopilot=AutopilotKind.ARDUPILOT, system_id=1, armed=True))
    w.navigator = SetBack(w.navigator)
    w.fly(STEP_S)
    w.source = EkfSource.VISION
    w.fly(140)
    sent = [(t, c) for t, c in w.commands if isinstance(c, Injection) and t > STEP_S - 1]
    assert max(after - before for (before, _), (after, _) in pairwise(sent)) < 4.0, "PX4's failsafe comes after 4.6 s"
    counters = [{c.reset_counter for t, c in sent if (t < STEP_S) is first} for first in (True, False)]
    assert not counters[0] & counters[1], "its first step is no motion"
    back = [t for t, c in w.commands if t > STEP_S and isinstance(c, SwitchSource) and c.source is EkfSource.GNSS]
    back = back or [t for t in w.notices("source to GNSS") if t > STEP_S]
    assert len(back) == 1
    assert back[0] - STEP_S > settings.gnss.probation_s
    assert sent[-1][0] > back[0] - 1.0, "positions go on until then"


def test_a_clock_that_goes_back_beside_a_good_gnss_sends_nothing(world: type[World]) -> None:
    w = started(world)
    w.send(LinkChanged(0, up=True, autopilot=AutopilotKind.ARDUPILOT, system_id=1, armed=True))
    w.navigator = SetBack(w.navigator)
    w.fly(90)
    assert len(w.notices("clock went back, starting anew")) == 1
    assert not [c for _, c in w.commands if isinstance(c, Injection)]


def test_a_clock_that_goes_back_before_anybody_was_heard_leaves_nobody_known() -> None:
    navigator = Navigator(CoreSettings())
    navigator.on(Tick(30 * S), 30 * S)
    told = [navigator.on(Tick(k), S + k) for k in range(RESTART_AFTER)][-1]
    assert [c.text for c in told if isinstance(c, Notice)] == ["visloc: clock went back, starting anew"]
    asked = [c for k in range(200) for c in navigator.on(Tick(k), 2 * S + k * S // 10) if isinstance(c, RequestMessage)]
    assert asked == []
