"""A daemon that returns in flight goes on from what the autopilot was sent: a GNSS that lies elsewhere does not replace it."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from tests.unit.core.conftest import Nobody, ns, place_of
from tests.unit.core.flown import near_sighted
from tests.unit.core.test_restart import DOWN_S, ORIGIN, restarted
from visloc_companion.core.navigator import Navigator
from visloc_companion.errors import Reason
from visloc_companion.geo import wgs84
from visloc_companion.types import (
    AutopilotKind,
    EkfSource,
    FoundOnVision,
    LinkChanged,
    LocaliseRequest,
    NoFix,
    OperatorFix,
    OriginChanged,
    SwitchSource,
    Verdict,
)

World = Any
BACK_S = 40.0 + DOWN_S
SEES_S = BACK_S + 20.0


def verdicts(w: World, since_s: float = BACK_S) -> set[Verdict]:
    return {status.verdict for t, status, _ in w.statuses if t > since_s}


def sent(w: World) -> list[tuple[float, float, float]]:
    """Since the daemon is back: when positions were sent, how far they were off, and the level."""
    return [(t, off_m, status.protection_level_m or 0.0) for t, status, off_m in w.statuses if t > BACK_S and status.injected]


def handed_to_gnss(w: World) -> list[float]:
    return [t for t, c in w.commands if t > BACK_S and isinstance(c, SwitchSource) and c.source is EkfSource.GNSS]


def drifted(world: type[World], drift_m: float, **faults: Any) -> World:
    """On vision, with a position that has drifted away meanwhile; the daemon before left word."""
    w = world(**faults)
    w.start()
    w.fly(40.0)
    w.navigator, w.last_injection = Nobody(), None
    w.fly(BACK_S)
    assert w.source is EkfSource.VISION
    w.ekf_p = w.ekf_p + np.array([0.0, drift_m])
    w.navigator, w.answers = Navigator(w.settings), []
    w.send(LinkChanged(0, up=True, autopilot=AutopilotKind.ARDUPILOT, system_id=1, armed=True))
    w.send(OriginChanged(0, ORIGIN))
    w.send(FoundOnVision(0))
    return w


@pytest.mark.parametrize("found", [True, False])
@pytest.mark.parametrize("speed_mps", [0.0, 10.0])
@pytest.mark.parametrize(("off_m", "seed"), [(150.0, 1), (300.0, 2)])
def test_a_false_gnss_does_not_take_the_place_of_what_the_autopilot_was_sent(
    world: type[World], off_m: float, seed: int, speed_mps: float, found: bool
) -> None:
    """Nothing is recognised for 20 s; where the daemon before left no word, GNSS has no fix when this one comes up. It was
    trusted after 1.5 s, and the filter began there: a vehicle that hovered was never found again, one at 10 m/s 28 s later."""
    faults = {"jammed": lambda t: not found and 20 < t < 48, "pull_m": lambda t: (off_m * (t > 20), 0.0)}
    w = restarted(near_sighted(world), **faults, blind=lambda t: BACK_S < t < SEES_S, speed_mps=speed_mps, seed=seed)
    assert w.source is EkfSource.VISION
    if found:
        w.send(FoundOnVision(0))
    w.fly(90.0)
    assert verdicts(w) == {Verdict.DENIED}
    assert w.notices("restarted from trusted GNSS") == []
    assert handed_to_gnss(w) == []
    assert sent(w)[0][0] - SEES_S < 2.0
    assert all(off_m <= level_m for _, off_m, level_m in sent(w))
    assert max(off_m for _, off_m, _ in sent(w)) < 8.0


def test_over_ground_that_is_never_recognised_nothing_moves_it_either(world: type[World]) -> None:
    w = restarted(near_sighted(world), pull_m=lambda t: (300.0 * (t > 20), 0.0), blind=lambda t: t > BACK_S)
    w.send(FoundOnVision(0))
    w.fly(100.0)
    assert verdicts(w) == {Verdict.DENIED}
    assert w.status_at(100.0)[0].reasons == ("out_of_reach",)
    assert w.status_at(100.0)[1] < 60.0, "by what its velocity drifted"
    assert handed_to_gnss(w) == []


def test_nor_does_a_drift_that_grows_let_it_in_at_once(world: type[World]) -> None:
    """After half a minute 150 m are 4 sigma, which a false GNSS is by far the likelier cause of."""
    w = restarted(near_sighted(world), pull_m=lambda t: (150.0 * (t > 20), 0.0), blind=lambda t: BACK_S < t < BACK_S + 60.0)
    w.send(FoundOnVision(0))
    w.fly(BACK_S + 80.0)
    assert verdicts(w) == {Verdict.DENIED}
    assert sent(w)[0][0] - BACK_S - 60.0 < 4.0
    assert all(off_m <= level_m for _, off_m, level_m in sent(w))


def test_a_gnss_that_was_trusted_before_the_filter_could_begin_is_so_no_longer(world: type[World]) -> None:
    """The autopilot tells its origin 5 s late. GNSS was trusted for 50 s."""
    w = world(pull_m=lambda t: (300.0 * (t > 20), 0.0), blind=lambda t: BACK_S < t < SEES_S)
    w.start()
    w.fly(40.0)
    w.navigator, w.last_injection = Nobody(), None
    w.fly(BACK_S)
    w.navigator, w.answers = Navigator(w.settings), []
    w.send(LinkChanged(0, up=True, autopilot=AutopilotKind.ARDUPILOT, system_id=1, armed=True))
    w.send(FoundOnVision(0))
    w.fly(BACK_S + 5.2)
    w.send(OriginChanged(ns(w.t), ORIGIN))
    w.fly(90.0)
    assert verdicts(w, BACK_S + 5.6) == {Verdict.SUSPECT}
    assert sent(w)[0][0] - SEES_S < 2.0


@pytest.mark.parametrize("speed_mps", [0.0, 10.0])
@pytest.mark.parametrize("drift_m", [150.0, 300.0])
@pytest.mark.parametrize("sees_s", [BACK_S, SEES_S])
def test_beside_a_true_gnss_a_position_that_had_drifted_away_gives_way(
    world: type[World], sees_s: float, drift_m: float, speed_mps: float
) -> None:
    """Frames are looked for about both."""
    faults = {"jammed": lambda t: 20 < t < 38, "blind": lambda t: BACK_S < t < sees_s, "speed_mps": speed_mps}
    w = drifted(near_sighted(world), drift_m, **faults)
    w.fly(110.0)
    assert sent(w)[0][0] - sees_s < 6.0
    assert max(off_m for _, off_m, _ in sent(w)) < 8.0
    assert 20.0 <= handed_to_gnss(w)[0] - sent(w)[0][0] < 40.0, "after its probation"
    assert w.statuses[-1][1].verdict is Verdict.OK


def test_every_other_question_is_about_gnss_and_motion_is_measured_where_the_filter_is(world: type[World]) -> None:
    """Hills about the one would make the other one move unlike the camera."""
    w = drifted(near_sighted(world), 300.0, jammed=lambda t: 20 < t < 38, blind=lambda t: t > BACK_S, speed_mps=0.0)
    w.fly(BACK_S + 20.0)
    asked = [(request, off_m < 150.0) for t, request, off_m in w.requests if t > BACK_S + 1.0]
    about_gnss = [request.motion_prior for request, near in asked if near]
    assert abs(len(about_gnss) - len(asked) / 2) <= 1.0
    assert all(ground is not None and wgs84.distance_m(ground.place, place_of(w.p)) > 250.0 for ground in about_gnss)
    assert all(request.motion_prior is None for request, near in asked if not near)


@pytest.mark.parametrize(("drift_m", "within_s"), [(150.0, 35.0), (300.0, 50.0)])
def test_without_gnss_one_that_had_drifted_away_is_found_sooner(world: type[World], drift_m: float, within_s: float) -> None:
    """It took 40 and 83 s, until the position was as unsure as a search is wide."""
    w = drifted(near_sighted(world), drift_m, jammed=lambda t: t > 20)
    w.fly(110.0)
    assert bool(w.notices("searching the map, keep moving")) is (drift_m > 200.0), "else it is looked for so far about it"
    assert sent(w)[0][0] - BACK_S < within_s
    assert max(off_m for _, off_m, _ in sent(w)) < 8.0


@pytest.mark.parametrize("true", [True, False])
def test_the_operators_word_frees_no_gnss_that_lies_elsewhere(world: type[World], true: bool) -> None:
    """His right word was refused as far from trusted GNSS."""
    off_ne_m = np.array([300.0, 0.0])
    w = restarted(near_sighted(world), pull_m=lambda t: (300.0 * (t > 20), 0.0), blind=lambda t: BACK_S < t < 70.0)
    w.send(FoundOnVision(0))
    w.fly(55.0)
    w.send(OperatorFix(ns(w.t), place_of(w.p + (np.array([8.0, -6.0]) if true else off_ne_m)), 20.0))
    w.fly(74.0)
    assert verdicts(w) == {Verdict.DENIED}
    w.fly(115.0)
    assert len(w.notices("operator's position confirmed")) == true
    assert all(off_m <= level_m for _, off_m, level_m in sent(w))
    assert w.statuses[-1][2] < 8.0
    assert handed_to_gnss(w) == []


@pytest.mark.parametrize("seed", [1, 2])
@pytest.mark.parametrize("off_m", [150.0, 300.0])
def test_one_that_hovers_beside_a_gnss_that_jumped_while_no_daemon_ran_hears_of_it(
    world: type[World], off_m: float, seed: int
) -> None:
    """The autopilot flies on it, and no frame is recognised about it. The search of the map sees one ground elsewhere, which is
    too little to be placed by, and it was trusted for as long as the vehicle hovered."""
    w = restarted(near_sighted(world), pull_m=lambda t: (0.0, off_m * (t > 41.0)), speed_mps=0.0, seed=seed)
    assert w.source is EkfSource.GNSS
    w.fly(BACK_S + 60.0)
    first_s = w.first(SwitchSource, since_s=BACK_S)
    assert math.isinf(first_s), "there is nothing else to fly on"
    (told_s,) = w.notices("GNSS not trusted, camera says elsewhere")
    assert 30.0 < told_s - BACK_S < 45.0
    assert sent(w) == []
    w.send(OperatorFix(ns(w.t), place_of(w.p + np.array([8.0, -6.0])), 20.0))
    w.fly(BACK_S + 75.0)
    assert max(off_m for _, off_m, _ in sent(w)) < 8.0


def test_what_is_seen_where_gnss_is_speaks_for_it(world: type[World]) -> None:
    """Nothing is recognised until the search of the map has begun."""
    w = restarted(near_sighted(world), jammed=lambda t: False, blind=lambda t: BACK_S < t < BACK_S + 34.0, speed_mps=0.0)
    w.fly(BACK_S + 60.0)
    assert w.notices("no fix near GNSS, searching the map")
    assert w.notices("GNSS not trusted") == []


@pytest.mark.parametrize("off_m", [5000.0, 12_000.0])
def test_from_a_gnss_that_jumped_off_the_map_the_search_begins_at_the_origin(world: type[World], off_m: float) -> None:
    """It went about there, in rings that show no map: 5 km off it took 79 s, 12 km off more than 155 s."""

    class Edge(near_sighted(world)):  # type: ignore[misc]
        """A map of 3 x 3 km about the EKF origin."""

        def _localise(self, request: LocaliseRequest) -> None:
            super()._localise(request)
            when, found = self.answers[-1]
            north, east, _ = wgs84.ned_from_geo(request.prior.place, ORIGIN)
            if max(abs(north), abs(east)) - 3 * math.sqrt(request.prior.cov_ne_m2[0][0]) > 1500.0:
                told = found.t_ns, found.request_id, found.frame_id, found.method
                self.answers[-1] = when, NoFix(0, *told, Reason.OUTSIDE_MAP, 5.0)

    w = restarted(Edge, pull_m=lambda t: (0.0, off_m * (t > 41.0)))
    w.fly(BACK_S + 60.0)
    assert w.notices("position found")[0] - BACK_S < 55.0
    assert max(off_m for _, off_m, _ in sent(w)) < 8.0
