"""The vehicle took off without GNSS and flies on fixes; in flight a receiver has a position for the first time."""

from __future__ import annotations

from typing import Any

import pytest

from visloc_companion.types import AutopilotKind, EkfSource, LinkChanged, Verdict

World = Any
BACK_S, BLIND_S = 60.0, (58.0, 66.0)


def flown(world: type[World], pull_m: float, until_s: float) -> World:
    """Nothing is recognised while GNSS comes."""
    w = world(
        jammed=lambda t: t < BACK_S,
        pull_m=lambda t: (pull_m, 0.0),
        blind=lambda t: BLIND_S[0] < t < BLIND_S[1],
    )
    w.start()
    w.send(LinkChanged(0, up=True, autopilot=AutopilotKind.ARDUPILOT, system_id=1, armed=True))
    return w.fly(until_s)


@pytest.mark.parametrize("pull_m", [25.0, 300.0])
def test_one_that_fixes_contradict_is_never_flown_on(world: type[World], pull_m: float) -> None:
    w = flown(world, pull_m, 100.0)
    assert {status.verdict for t, status, _ in w.statuses if t > BACK_S} == {Verdict.DENIED}
    assert w.source is EkfSource.VISION
    assert max(error for t, _, error in w.statuses if t > 30) < 6.0


def test_one_beside_the_place_by_fixes_says_so(world: type[World]) -> None:
    w = flown(world, 300.0, 64.0)
    assert w.status_at(63.0)[0].reasons == ("out_of_reach",)


def test_a_good_one_is_trusted_once_fixes_have_gone_with_it(world: type[World]) -> None:
    w = flown(world, 0.0, 120.0)
    (trusted_s,) = w.notices("GNSS trusted")
    assert trusted_s - BLIND_S[1] > w.settings.gnss.probation_s
    assert w.source is EkfSource.GNSS
