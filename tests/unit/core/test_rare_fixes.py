"""Fixes that are rarer than GNSS waits for: it holds the filter in between, and they must speak against it all the same."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from tests.unit.core.conftest import place_of
from visloc_companion.types import Fix, LocaliseRequest, Vec2, Verdict

World = Any
FROM_S = 60.0


def dragged(t_s: float) -> Vec2:
    return 0.0, 3.0 * max(0.0, t_s - FROM_S)


def stepped(t_s: float) -> Vec2:
    return 0.0, 60.0 if t_s > FROM_S else 0.0


@pytest.mark.parametrize(("every_s", "latency_s", "within_s"), [(8.0, 2.0, 25.0), (12.0, 3.0, 30.0)])
@pytest.mark.parametrize("pull_m", [dragged, stepped])
def test_a_false_gnss_that_holds_the_filter_has_fixes_for_a_witness(
    world: type[World], pull_m: Callable[[float], Vec2], every_s: float, latency_s: float, within_s: float
) -> None:
    """The filter, which follows GNSS, refuses each of them: a drag was named after 38 s, a step or fixes every 12 s never."""
    w = world(fix_period_s=every_s, latency_s=latency_s, pull_m=pull_m)
    w.start()
    w.fly(FROM_S + within_s)
    assert w.status_at(FROM_S)[0].verdict is Verdict.OK
    assert w.notices("GNSS not trusted, camera says elsewhere")


@pytest.mark.parametrize("speed_mps", [0.3, 10.0])
def test_a_wrong_match_that_is_found_again_over_the_same_ground_speaks_once(world: type[World], speed_mps: float) -> None:
    """40 m beside, two in a row of every 8 s where the vehicle hovers, and one amid the way where it flies."""

    class Wrong(world):  # type: ignore[misc]
        def _localise(self, request: LocaliseRequest) -> None:
            super()._localise(request)
            when, found = self.answers[-1]
            if FROM_S <= self.t < FROM_S + (16.0 if speed_mps < 1 else 8.0) and isinstance(found, Fix):
                self.answers[-1] = when, replace(found, place=place_of(self.p + np.array([40.0, 0.0])), probability_wrong=0.02)

    w = Wrong(fix_period_s=8.0, latency_s=2.0, speed_mps=speed_mps)
    w.start()
    w.fly(120)
    assert {status.verdict for t, status, _ in w.statuses if t > FROM_S} == {Verdict.OK}
