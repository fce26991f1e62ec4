"""Levels, limits and alerts in simulated flights: what the Status says, what the operator reads, and what is sent."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from visloc_companion.core.settings import CoreSettings, InjectionSettings, NavigatorSettings
from visloc_companion.types import (
    AutopilotKind,
    BeyondLimit,
    Command,
    EkfSource,
    Injection,
    LinkChanged,
    Mode,
    Notice,
    Status,
    SwitchSource,
)

World = Any
BLIND_S = 60.0


def flown(world: type[World], *, policy: BeyondLimit = BeyondLimit.INJECT, until_s: float = 125.0, **limits: float) -> World:
    """Jammed from 40 s on, armed; no fixes from 60 s to 95 s, so that the level grows and falls again."""
    settings = CoreSettings(
        navigator=replace(NavigatorSettings(), **limits),
        injection=InjectionSettings(switch_source=True, beyond_alert_limit=policy),
    )
    w = world(settings=settings, jammed=lambda t: t > 40, blind=lambda t: BLIND_S < t < 95)
    w.start()
    w.send(LinkChanged(0, up=True, autopilot=AutopilotKind.ARDUPILOT, system_id=1, armed=True))
    return w.fly(until_s)


def statuses(w: World, since_s: float = 0.0) -> list[Status]:
    return [status for t, status, _ in w.statuses if t >= since_s]


def told(w: World, part: str) -> list[tuple[float, str]]:
    return [(t, c.text) for t, c in w.commands if isinstance(c, Notice) and c.to_operator and part in c.text]


def per_tick(w: World) -> dict[float, list[Command]]:
    ticks: dict[float, list[Command]] = {}
    for t, command in w.commands:
        ticks.setdefault(t, []).append(command)
    return ticks


def test_the_operator_is_told_within_two_seconds_of_the_level_and_once(world: type[World]) -> None:
    w = flown(world, alert_limit_m=20.0)
    beyond_s = next(t for t, s, _ in w.statuses if t > BLIND_S and s.protection_level_m > 20.0)
    unsure, sure = told(w, "POSITION may be off"), told(w, "position sure again")
    assert len(unsure) == len(sure) == 1
    assert unsure[0][0] - beyond_s <= 2.0
    assert sure[0][0] > 95
    assert all(sum(isinstance(c, Notice) and c.to_operator for c in commands) <= 2 for commands in per_tick(w).values())


def test_the_status_carries_levels_limits_and_what_follows(world: type[World]) -> None:
    w = flown(world, alert_limit_m=20.0)
    assert all(s.alert_limit_m == 20.0 and s.vertical_alert_limit_m == 50.0 for s in statuses(w, 10))
    assert all(s.available == (s.protection_level_m <= 20.0) for s in statuses(w, 10))
    assert not any(s.alert for s in statuses(w, 10) if s.t_ns < BLIND_S * 1e9)
    assert sum(s.alert for s in statuses(w)) > 100
    assert all(s.vertical_protection_level_m > abs(s.height_offset_m) for s in statuses(w, 10))


def test_low_over_the_ground_the_low_limits_hold(world: type[World]) -> None:
    w = flown(world, until_s=20.0, low_height_m=150.0)
    settings = NavigatorSettings()
    assert {s.alert_limit_m for s in statuses(w, 10)} == {settings.alert_limit_low_m}
    assert {s.vertical_alert_limit_m for s in statuses(w, 10)} == {settings.vertical_alert_limit_low_m}


def test_nothing_is_told_where_positions_are_not_injected_or_the_vehicle_is_not_armed(world: type[World]) -> None:
    w = world()
    w.start()
    w.fly(30)
    assert told(w, "may be off") == []
    disarmed = world(settings=CoreSettings(navigator=replace(NavigatorSettings(), alert_limit_m=2.0)), jammed=lambda t: t > 20)
    disarmed.start()
    disarmed.fly(40)
    assert any(s.alert for s in statuses(disarmed))
    assert told(disarmed, "may be off") == []


@pytest.mark.parametrize("policy", list(BeyondLimit))
def test_what_is_sent_beyond_the_limit(world: type[World], policy: BeyondLimit) -> None:
    w = flown(world, policy=policy, alert_limit_m=20.0)
    sent = {t: command for t, command in w.commands if isinstance(command, Injection)}
    during = [(t, s) for t, s, _ in w.statuses if s.alert and BLIND_S < t < 95]
    assert len(during) > 50
    if policy is BeyondLimit.STOP:
        assert not any(t in sent for t, _ in during)
        assert not any(s.injected for _, s in during)
        assert len(told(w, "NOT SENT")) == 1
        return
    assert all(s.injected for _, s in during)
    sigmas = {t: math.sqrt(float(np.linalg.eigvalsh(np.array(sent[t].cov_ne_m2))[0])) for t, _ in during}
    fits = [sigmas[t] >= 0.999 * s.protection_level_m / math.sqrt(2 * math.log(1e5)) for t, s in during]
    assert all(fits) if policy is BeyondLimit.WIDEN else not any(fits[5:])


def test_a_barometer_that_is_off_shows_in_the_vertical_level(world: type[World], monkeypatch: pytest.MonkeyPatch) -> None:
    """Fixes put the camera 15 m above the autopilot's height: that much is in the level, and the operator is told when low."""
    w = world(
        settings=CoreSettings(
            navigator=replace(NavigatorSettings(), low_height_m=150.0, alert_limit_low_m=25.0, vertical_alert_limit_low_m=18.0)
        ),
        jammed=lambda t: t > 20,
    )
    ask = w._localise

    def higher(request: Any) -> None:
        ask(request)
        at, answer = w.answers[-1]
        place = replace(answer.place, h_amsl_m=answer.place.h_amsl_m + 15.0)
        w.answers[-1] = (at, replace(answer, place=place, sigma_h_m=0.8))

    monkeypatch.setattr(w, "_localise", higher)
    w.start()
    w.send(LinkChanged(0, up=True, autopilot=AutopilotKind.ARDUPILOT, system_id=1, armed=True))
    w.fly(60)
    last = statuses(w)[-1]
    assert last.height_offset_m == pytest.approx(15.0, abs=2.0)
    assert last.vertical_protection_level_m > 15.0
    assert len(told(w, "HEIGHT may be off")) == 1


@pytest.mark.parametrize("may_switch", [True, False])
def test_nobody_is_sent_to_a_vision_that_the_alert_keeps_back(world: type[World], *, may_switch: bool) -> None:
    """The level is beyond the limit before GNSS is lost."""

    def to_vision(policy: BeyondLimit) -> tuple[World, int]:
        settings = CoreSettings(
            navigator=replace(NavigatorSettings(), alert_limit_m=14.0),
            injection=InjectionSettings(switch_source=may_switch, beyond_alert_limit=policy),
        )
        w = world(settings=settings, jammed=lambda t: t > 40, blind=lambda t: t > 20)
        w.start()
        w.send(LinkChanged(0, up=True, autopilot=AutopilotKind.ARDUPILOT, system_id=1, armed=True))
        w.fly(46)
        orders = [c for _, c in w.commands if c == SwitchSource(EkfSource.VISION)]
        return w, len(orders) + len(told(w, "set EKF position source to VISION"))

    w, asked = to_vision(BeyondLimit.STOP)
    assert any(s.alert and s.mode is Mode.DEAD_RECKONING for s in statuses(w, 40))
    assert not any(isinstance(c, Injection) for _, c in w.commands)
    assert asked == 0
    assert to_vision(BeyondLimit.INJECT)[1] == 1
