"""A GNSS that is false since before take-off: the map is searched although it is trusted."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from tests.unit.core.flown import ORIGIN, blinkered, texts
from visloc_companion.core.places import beside_gnss, hypotheses, place_search
from visloc_companion.core.places.beside_gnss import FEWEST, BesideGnss
from visloc_companion.core.settings import CoreSettings, InjectionSettings, NavigatorSettings
from visloc_companion.errors import Reason
from visloc_companion.types import Injection, Mode, NoFix, OperatorFix, Verdict

World = Any
S = 1_000_000_000


class Held:
    """What is asked of a belief."""

    def __init__(self, started_ns: int = 0, last_fix_ns: int | None = None) -> None:
        self.started_ns, self.last_fix_ns = started_ns, last_fix_ns


def refuse(beside: BesideGnss, held: Any, n: int, every_s: float = 1.0, trusted: bool = True, **more: Any) -> None:
    reason = more.get("reason", Reason.NO_MATCH)
    for k in range(n):
        beside.refused(
            NoFix(0, round((more.get("from_s", 0.0) + k * every_s) * S), k, k, "image", reason, 1.0), held, held_there=trusted
        )


@pytest.mark.parametrize("false_m", [(150.0, 0.0), (-300.0, 400.0), (3500.0, 3500.0)])
def test_a_place_that_gnss_has_hidden_since_boot_is_found(world: type[World], false_m: tuple[float, float]) -> None:
    w = blinkered(world, jammed=lambda t: False, pull_m=lambda t: false_m)
    w.ekf_p = np.array(false_m)
    w.fly(130)
    (begun_s,) = w.notices("no fix near GNSS, searching the map")
    (found_s,) = w.notices(" m from GNSS")
    assert 30 <= begun_s < 35
    assert begun_s < found_s < 100
    told_m = float(next(text for text in texts(w) if "m from GNSS" in text).split()[3])
    assert told_m == pytest.approx(math.hypot(*false_m), abs=10)
    (suspect_s,) = w.notices("GNSS not trusted, camera says elsewhere")
    assert found_s < suspect_s < found_s + 12
    assert w.first(Injection) >= suspect_s
    assert max(error for t, _, error in w.statuses if t > found_s + 1) < 8
    assert w.status_at(128)[0].mode is Mode.AIDING


def test_a_good_gnss_over_ground_that_nothing_recognises_stays_trusted(world: type[World]) -> None:
    w = blinkered(world, jammed=lambda t: False, blind=lambda t: t < 100).fly(130)
    assert len(w.notices("no fix near GNSS, searching the map")) == 1
    assert not w.notices("position found")
    assert not w.notices("GNSS not trusted")
    assert w.status_at(128)[0].verdict is Verdict.OK
    first_s = min(t for t, status, _ in w.statuses if (status.age_of_fix_s or math.inf) < 2)
    assert first_s < 103
    wide = [t for t, request, _ in w.requests if request.prior.cov_ne_m2[0][0] > 150**2]
    assert 30 <= min(wide) < 33
    assert max(wide) < 103
    for t, request, _ in w.requests:
        ground = request.motion_prior
        assert (ground is not None) == (t in wide), "only while another place is looked at"
        assert ground is None or ground.cov_ne_m2[0][0] < 150**2
    about_gnss = [t for t, request, _ in w.requests if 40 < t < 100 and request.prior.cov_ne_m2[0][0] < 150**2]
    assert abs(len(about_gnss) - len([t for t in wide if 40 < t < 100])) <= 1, "every other question is about GNSS all the while"


def test_the_search_goes_on_where_gnss_is_lost_meanwhile(world: type[World]) -> None:
    w = blinkered(world, jammed=lambda t: t > 36, pull_m=lambda t: (600.0, 0.0))
    w.ekf_p = np.array((600.0, 0.0))
    w.fly(80)
    (found_s,) = w.notices("position found on the map")
    assert found_s < 60
    assert max(error for t, _, error in w.statuses if t > found_s + 1) < 8


def test_where_it_is_not_wished_or_the_operator_said_the_place_nothing_is_searched(world: type[World]) -> None:
    off = CoreSettings(injection=InjectionSettings(switch_source=True), navigator=NavigatorSettings(start_anywhere=False))
    assert not blinkered(world, off, jammed=lambda t: False, blind=lambda t: True).fly(60).notices("searching the map")
    stated = blinkered(world, blind=lambda t: True).fly(2)
    stated.send(OperatorFix(0, ORIGIN, 20.0))
    assert not stated.fly(60).notices("near GNSS")


def test_it_takes_frames_and_time_and_an_unconfirmed_filter() -> None:
    held: Any = Held()
    few, soon, lost, fixed, dark = (BesideGnss() for _ in range(5))
    refuse(few, held, FEWEST - 1, 5.0)
    refuse(soon, held, FEWEST, 0.1)
    refuse(lost, held, FEWEST, 2.0, trusted=False)
    refuse(fixed, Held(last_fix_ns=1), FEWEST, 2.0)
    refuse(dark, held, FEWEST, 2.0, reason=Reason.TOO_DARK)
    assert not any(beside.due(held) for beside in (few, soon, lost, fixed, dark))
    refuse(soon, held, 1, 0.0, from_s=30.1)
    assert soon.due(held)


def test_a_gnss_that_was_found_false_before_is_near_the_vehicle() -> None:
    """What contradicted it saw it move away, and first fixes about it need every question."""
    beside, held = BesideGnss(), Held()
    refuse(beside, held, FEWEST, 1.0)
    refuse(beside, held, FEWEST, 1.0, trusted=False, from_s=21.0)
    assert not beside.due(held)
    refuse(beside, held, 1, 0.0, from_s=50.0)
    assert beside.due(held)
    refuse(beside, held, 1, 0.0, trusted=False, from_s=51.0)
    assert beside.due(held), "once begun it goes on"


def test_a_fix_or_a_filter_that_starts_anew_ends_it() -> None:
    beside, held = BesideGnss(), Held()
    refuse(beside, held, FEWEST, 2.0)
    assert beside.due(held)
    assert not beside.due(Held(last_fix_ns=59 * S))
    assert not beside.due(Held(started_ns=59 * S))
    assert not beside.due(None)
    anew: Any = Held(started_ns=5 * S)
    refuse(beside, anew, FEWEST - 1, 2.0)
    assert not beside.due(anew), "counted from the beginning"


def test_a_false_place_has_to_agree_once_more_than_where_gnss_says_nothing() -> None:
    """Four answers leave 6 in 100 million, which is no less than that GNSS is false."""
    assert beside_gnss.RISK < 1e-3 * place_search.RISK
    one = hypotheses.born(1, 0, (0.0, 0.0), 10.0, 1.0)
    seen = {}
    for hits in (4, 5):
        h = one
        for k in range(hits):
            there = hypotheses.carried(h, k * S, _moved(40.0 if k else 0.0))
            h = hypotheses.confirmed(there, (40.0 * k, 0.0), ((4.0, 0.0), (0.0, 4.0)), 30.0)
        seen[hits] = h
    assert hypotheses.winner([seen[4]], place_search.RISK) is seen[4]
    assert hypotheses.winner([seen[4]], beside_gnss.RISK) is None
    assert hypotheses.winner([seen[5]], beside_gnss.RISK) is seen[5]


def _moved(north_m: float) -> hypotheses.Travel:
    return hypotheses.Travel((north_m, 0.0), ((1.0, 0.0), (0.0, 1.0)), 4.0, by_velocity=False)
