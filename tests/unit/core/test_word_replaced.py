"""The operator's word replaces where a filter went on from what the autopilot was sent: either may be wrong, both are looked
at."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from tests.unit.core.conftest import ns, place_of
from tests.unit.core.flown import near_sighted
from tests.unit.core.test_gone_on import BACK_S, drifted, handed_to_gnss, sent, verdicts
from tests.unit.core.test_restart import restarted
from visloc_companion.types import FoundOnVision, OperatorFix, Verdict

World = Any
SAID_S = 55.0


def told(world: type[World], off_ne_m: tuple[float, float], *, sees_s: float, **faults: Any) -> World:
    """A daemon that came back on vision sees nothing at first, and is told a place so far from the vehicle."""
    w = restarted(near_sighted(world), blind=lambda t: BACK_S < t < sees_s, **faults)
    w.send(FoundOnVision(0))
    w.fly(SAID_S)
    w.send(OperatorFix(ns(w.t), place_of(w.p + np.array(off_ne_m)), 20.0))
    assert w.notices("position taken, looking there")
    return w


@pytest.mark.parametrize(("speed_mps", "seed"), [(0.0, 1), (10.0, 2)])
def test_a_wrong_word_at_a_false_gnss_is_believed_no_longer_than_nothing_is_seen(
    world: type[World], speed_mps: float, seed: int
) -> None:
    """Read off a ground station that shows the false GNSS. That was trusted for 11.7 s and more, and the vehicle was found 28 s
    after it saw ground again, or never where it hovered: frames were looked for about both places that were one."""
    w = told(world, (300.0, 0.0), sees_s=70.0, pull_m=lambda t: (300.0 * (t > 20), 0.0), speed_mps=speed_mps, seed=seed)
    w.fly(100.0)
    assert verdicts(w) == {Verdict.DENIED}
    assert sent(w)[0][0] - 70.0 < 5.0
    assert max(off_m for _, off_m, _ in sent(w)) < 8.0
    assert all(off_m <= level_m for _, off_m, level_m in sent(w))
    assert w.notices("operator's position confirmed") == []


@pytest.mark.parametrize("sees_s", [80.0, 100.0])
def test_a_false_gnss_that_came_to_be_trusted_by_it_is_so_until_ground_is_seen(world: type[World], sees_s: float) -> None:
    """In 60 s of sight nothing was found."""
    w = told(world, (300.0, 0.0), sees_s=sees_s, pull_m=lambda t: (300.0 * (t > 20), 0.0), speed_mps=0.0)
    w.fly(sees_s + 15.0)
    assert max(t for t, status, _ in w.statuses if status.verdict is Verdict.OK) - sees_s < 2.0
    assert sent(w)[0][0] - sees_s < 5.0
    assert max(off_m for _, off_m, _ in sent(w)) < 8.0
    assert handed_to_gnss(w) == []


@pytest.mark.parametrize("speed_mps", [0.0, 10.0])
@pytest.mark.parametrize("jammed", [True, False])
def test_a_wrong_word_elsewhere_hides_the_vehicle_no_more(world: type[World], jammed: bool, speed_mps: float) -> None:
    """In a jam, and beside a false GNSS that lies at a third place."""
    faults = {"jammed": lambda t: jammed and t > 20, "pull_m": lambda t: (300.0 * (t > 20), 0.0)}
    w = told(world, (0.0, -250.0), sees_s=70.0, speed_mps=speed_mps, **faults)
    w.fly(90.0)
    assert sent(w)[0][0] - 70.0 < 8.0
    assert max(off_m for _, off_m, _ in sent(w)) < 8.0


@pytest.mark.parametrize("says_more", [False, True])
def test_a_right_word_is_confirmed_as_soon_as_ground_is_seen(world: type[World], *, says_more: bool) -> None:
    """The autopilot had drifted by 300 m; every other question is about where it was, also after a word that is refused."""
    blind = {"blind": lambda t: BACK_S < t < 70.0}
    w = drifted(near_sighted(world), 300.0, jammed=lambda t: t > 20, speed_mps=0.0, **blind)
    w.fly(SAID_S)
    w.send(OperatorFix(ns(w.t), place_of(w.p + np.array([8.0, -6.0])), 20.0))
    if says_more:
        w.send(OperatorFix(ns(w.t), place_of(w.p + np.array([150e3, 0.0])), 20.0))
        assert w.notices("position refused, too far from origin")
    w.fly(85.0)
    near = [off_m < 150.0 for t, _, off_m in w.requests if SAID_S < t < 70.0]
    assert near.count(True) - near.count(False) in (-1, 0, 1)
    assert 70.0 < w.notices("operator's position confirmed")[0] < 71.5
    assert max(off_m for _, off_m, _ in sent(w)) < 8.0
    assert {off_m < 150.0 for t, _, off_m in w.requests if t > 72.0} == {True}, "where it was is looked at no more"
