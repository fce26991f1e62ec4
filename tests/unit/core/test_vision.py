"""Frames and answers that are of no use, and what the navigator makes of them."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from tests.unit.core.conftest import ns, place_of
from tests.unit.core.flown import frame, quiet, requests, started, texts
from tests.unit.core.test_open_answers import over_look_alikes
from visloc_companion.core.terrain.terrain_aiding import METHOD as TERRAIN
from visloc_companion.errors import Reason
from visloc_companion.types import Cov2, Fix, NoFix, Odometry, Rejected, Vec2

World = Any
COV = ((1.0, 0.0), (0.0, 1.0))


def fix(w: World, t_s: float, off_ne_m: Vec2 = (0.0, 0.0), cov_ne_m2: Cov2 = COV, **more: Any) -> Fix:
    """Beside the truth."""
    told, level = (ns(w.t), ns(t_s), 999, 1, "test"), (1.0, 0.0, 0.0, 0.0)
    return Fix(*told, place_of(w.p + np.array(off_ne_m)), level, cov_ne_m2, 2.0, 0.05, 0.002, 5.0, **more)


def test_a_picture_that_is_repeated_is_not_asked_about(world: type[World]) -> None:
    w = quiet(world)
    (first,) = requests(w.send(frame(w.t, checksum=7)))
    w.send(NoFix(ns(w.t), first.frame.t_ns, first.request_id, 1, "test", Reason.NO_MATCH, 5.0))
    w.fly(w.t + 0.5)
    assert requests(w.send(frame(w.t, checksum=7))) == []
    assert len(requests(w.send(frame(w.t, checksum=8)))) == 1


def test_a_motion_of_times_to_come_carries_no_open_place_away(world: type[World]) -> None:
    w = over_look_alikes(world, lambda k: [0, 1]).fly(55.0)
    n_open = w.navigator._vision.n_open
    assert n_open > 1
    ahead = Odometry(0, ns(w.t - 0.5), ns(w.t + 20.0), (900.0, 900.0, 0.0), COV, 0.01, 0.02)
    w.send(NoFix(ns(w.t), ns(w.t), 998, 1, "test", Reason.NO_MATCH, 5.0, motion=ahead))
    between = w.navigator._vision._open._travel.between(ns(w.t - 1.0), ns(w.t))
    assert math.hypot(*between.moved_ne_m) < 12.0
    w.fly(62.0)
    assert w.navigator._vision.n_open >= n_open


@pytest.mark.parametrize(("method", "searched"), [("test", True), (TERRAIN, False)])
def test_refusals_of_the_terrain_begin_no_search_of_the_map(world: type[World], method: str, *, searched: bool) -> None:
    """For they may not concern the place: the ground that is told apart by shape is not the picture's."""
    w = quiet(world)
    for k in range(70):
        w.fly(10.5 + 0.5 * k)
        w.send(NoFix(ns(w.t), ns(w.t), k + 1, 1, method, Reason.NO_MATCH, 5.0))
    assert w.navigator._asking.beside_gnss() is searched


@pytest.mark.parametrize(("age_s", "off_m", "says"), [(0.3, 400.0, ["Fix not used: gated"]), (9.0, 0.0, [])])
def test_an_open_place_that_the_filter_cannot_take_ends_the_open_ones(
    world: type[World], monkeypatch: pytest.MonkeyPatch, age_s: float, off_m: float, says: list[str]
) -> None:
    """One far from where the filter has the vehicle, or of a frame that is older than what it remembers."""
    w = over_look_alikes(world, lambda k: [0, 1]).fly(55.0)
    assert w.navigator._vision.n_open > 1
    monkeypatch.setattr(w.navigator._vision._open, "answered", lambda *_: fix(w, w.t - age_s, (off_m, 0.0)))
    before, n_said = w.statuses[-1][1], len(w.commands)
    w.send(NoFix(ns(w.t), ns(w.t - age_s), 998, 1, "test", Reason.AMBIGUOUS, 5.0))
    assert [t for t in texts(w) if "Fix not used" in t] == says
    assert not w.notices("one of the open places is left")
    assert w.navigator._vision.n_open == 0
    monkeypatch.undo()
    w.fly(w.t + 0.15)
    after = w.statuses[-1][1]
    assert len(w.commands) > n_said
    assert after.age_of_fix_s > before.age_of_fix_s
    assert math.dist(*(np.array((s.place.lat_deg, s.place.lon_deg)) for s in (before, after))) < 1e-4


def test_a_fix_that_rounding_makes_nothing_of_does_not_speak_against_gnss(
    world: type[World], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The filter refuses it for its claim (kalman.update), not for its place."""
    w = started(world, blind=lambda t: t > 12).fly(60)
    shown: list[Fix] = []
    monkeypatch.setattr(w.navigator._aiding, "refused", shown.append)
    w.send(fix(w, w.t, (500.0, 0.0)))
    assert len(shown) == 1
    monkeypatch.setattr(w.navigator._tracker, "observe", lambda *_: Rejected(Reason.NOT_FINITE, 0.0))
    w.send(fix(w, w.t, (500.0, 0.0)))
    assert [t for t in texts(w) if "Fix not used" in t] == ["Fix not used: gated", "Fix not used: not_finite"]
    assert len(shown) == 1
