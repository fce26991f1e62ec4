"""PX4 on vision whose daemon was away for too long: it has no position, and a receiver has a good one, or a false one."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from tests.unit.core.conftest import BOOT_OFFSET_NS, HEIGHT_M, ORIGIN, Nobody, ns, place_of
from visloc_companion.core.navigator import Navigator
from visloc_companion.core.settings import CoreSettings, InjectionSettings
from visloc_companion.core.source.steering import UNPROVEN, UNSEEN_S
from visloc_companion.errors import Reason
from visloc_companion.geo import wgs84
from visloc_companion.types import (
    Attitude,
    AutopilotKind,
    EkfSource,
    EstimatorStatus,
    Fix,
    FoundOnVision,
    Gnss,
    Injection,
    LinkChanged,
    LocaliseRequest,
    LocalPose,
    NoFix,
    OperatorFix,
    OriginChanged,
    PriorPose,
    SwitchSource,
    Verdict,
)

World = Any
SETTLES_S, SETTLED_M = 10.0, 8.0
"""Until this autopilot, whose velocity nobody knew, has found it from what it is sent; how far positions are off then."""
BACK_S, COASTS_S, WITHIN_M, MAP_M = 2.0, 4.6, 5.0, 2000.0
"""When the daemon comes back, beside an autopilot that has had no position for long."""


def without_position(world: type[World], **faults: Any) -> World:
    class Px4(world):  # type: ignore[misc]
        """Global positions only while it has one: on GNSS, or COASTS_S after the last that it was sent."""

        sent_s = -math.inf

        def has_position(self) -> bool:
            return self.source is EkfSource.GNSS or self.t - self.sent_s < COASTS_S

        def send(self, event: Any) -> Any:
            commands = super().send(event)
            if any(isinstance(c, Injection) for c in commands):
                self.sent_s = self.t
            return commands

        def _localise(self, request: LocaliseRequest) -> None:
            """Within what it is asked about, as a localiser looks, on a map that ends MAP_M from home."""
            super()._localise(request)
            when, answer = self.answers[-1]
            asked, sigma_m = request.prior.place, math.sqrt(request.prior.cov_ne_m2[0][0])
            reason = Reason.OUTSIDE_MAP if wgs84.distance_m(asked, ORIGIN) > MAP_M else Reason.NO_MATCH
            sees = isinstance(answer, Fix) and wgs84.distance_m(answer.place, asked) <= 3 * sigma_m
            if reason is Reason.OUTSIDE_MAP or not sees:
                told = answer.t_ns, request.request_id, request.frame.frame_id, "test"
                self.answers[-1] = when, NoFix(0, *told, reason, 5.0)

        def _telemetry(self, t: float, gnss: np.ndarray, jammed: bool) -> None:
            now, boot = ns(t), ns(t) - BOOT_OFFSET_NS + ns(1000)
            has = self.has_position()
            v = (float(self.ekf_v[0]), float(self.ekf_v[1]), 0.0) if has else (0.0, 0.0, 0.0)
            self.send(Attitude(now, boot, (1.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0)))
            if self.k % 2 == 0:
                self.send(LocalPose(now, boot, (float(self.ekf_p[0]), float(self.ekf_p[1]), -HEIGHT_M), v))
                if has:
                    self.send(PriorPose(now, boot, place_of(self.ekf_p), v, self.height_m(t)))
            if self.k % 4 == 0:
                self.send(Gnss(now, boot, *((1, 3) if jammed else (3, 14)), place_of(gnss), 1.0, 1.5, None))
            if self.k % 10 == 0:
                ratio = 0.2 + 0.01 * (self.k % 7)
                self.send(EstimatorStatus(now, ratio, 0.2, 0.2, has, False, None, velocity_ok=has))

    settings = CoreSettings(injection=InjectionSettings(switch_source=faults.pop("switches", True)))
    w = Px4(settings=settings, **faults)
    w.source, w.ekf_p = EkfSource.VISION, np.array([40.0, -30.0])
    w.navigator = Nobody()
    w.fly(BACK_S)
    w.navigator = Navigator(w.settings)
    w.send(LinkChanged(0, up=True, autopilot=AutopilotKind.PX4, system_id=1, armed=True))
    w.send(OriginChanged(0, ORIGIN))
    w.send(FoundOnVision(0))
    return w


def sent(w: World) -> list[tuple[float, float, float]]:
    """When positions were sent, how far they were off, and the level."""
    return [(t, off_m, status.protection_level_m or 0.0) for t, status, off_m in w.statuses if status.injected]


def ordered(w: World, source: EkfSource) -> list[float]:
    return [t for t, c in w.commands if isinstance(c, SwitchSource) and c.source is source]


@pytest.mark.parametrize("speed_mps", [0.0, 10.0])
def test_beside_a_good_gnss_and_no_sight_it_is_given_to_that_gnss_in_the_end(world: type[World], speed_mps: float) -> None:
    w = without_position(world, blind=lambda t: True, speed_mps=speed_mps)
    w.fly(BACK_S + UNSEEN_S + 12.0)
    assert sent(w) == []
    assert 0.0 <= ordered(w, EkfSource.GNSS)[0] - BACK_S - UNSEEN_S < 5.0
    assert len(w.notices(UNPROVEN)) == 1
    assert w.has_position()
    assert w.statuses[-1][2] < WITHIN_M, "and the daemon navigates from there"


def test_where_the_operator_switches_he_is_asked(world: type[World]) -> None:
    w = without_position(world, blind=lambda t: True, switches=False)
    w.fly(BACK_S + UNSEEN_S + 12.0)
    asked = w.notices("set EKF position source to GNSS")
    assert len(asked) == 1
    assert 0.0 <= asked[0] - BACK_S - UNSEEN_S < 5.0
    assert w.notices(UNPROVEN) == asked


@pytest.mark.parametrize("speed_mps", [0.0, 10.0])
def test_beside_a_good_gnss_and_sight_positions_are_sent_within_seconds(world: type[World], speed_mps: float) -> None:
    w = without_position(world, speed_mps=speed_mps)
    w.fly(40.0)
    first_s, off_m, _ = sent(w)[0]
    assert first_s - BACK_S < 4.0
    assert off_m < WITHIN_M
    assert all(off_m <= level_m for _, off_m, level_m in sent(w))
    assert max(off_m for t, off_m, _ in sent(w) if t > first_s + SETTLES_S) < SETTLED_M
    assert w.notices(UNPROVEN) == []
    assert 20.0 <= ordered(w, EkfSource.GNSS)[0] - first_s < 26.0, "after its probation"


@pytest.mark.parametrize("false_m", [12.0, 80.0, 300.0])
@pytest.mark.parametrize("seed", [1, 3])
def test_beside_a_false_gnss_and_sight_the_first_position_is_the_cameras(world: type[World], false_m: float, seed: int) -> None:
    w = without_position(world, pull_m=lambda t: (false_m * 0.6, -false_m * 0.8), seed=seed)
    w.fly(55.0)
    first_s, off_m, _ = sent(w)[0]
    assert first_s - BACK_S < 30.0
    assert off_m < WITHIN_M
    assert all(off_m <= level_m for _, off_m, level_m in sent(w))
    assert max(off_m for t, off_m, _ in sent(w) if t > first_s + SETTLES_S) < SETTLED_M
    assert w.statuses[-1][1].verdict is Verdict.SUSPECT
    assert ordered(w, EkfSource.GNSS) == []


def test_one_that_hovers_beside_a_false_gnss_is_not_given_to_it(world: type[World]) -> None:
    """The search of the map needs it to move; what was seen speaks against GNSS."""
    w = without_position(world, pull_m=lambda t: (80.0, 0.0), speed_mps=0.0)
    w.fly(70.0)
    assert sent(w) == []
    assert w.statuses[-1][1].verdict is Verdict.SUSPECT
    assert ordered(w, EkfSource.GNSS) == []


@pytest.mark.parametrize("seed", [1, 2])
def test_nor_is_one_that_hovers_where_only_the_search_of_the_map_sees_it(world: type[World], seed: int) -> None:
    """So far from GNSS no frame is recognised about it; the one ground that is seen elsewhere is too little to be placed by."""
    w = without_position(world, pull_m=lambda t: (300.0, 0.0), speed_mps=0.0, seed=seed)
    w.fly(BACK_S + 2 * UNSEEN_S)
    assert sent(w) == []
    assert ordered(w, EkfSource.GNSS) == []
    assert w.notices(UNPROVEN) == []


@pytest.mark.parametrize("false_m", [12.0, 80.0, 300.0])
def test_beside_a_false_gnss_and_no_sight_nothing_is_sent_and_the_operator_told_what_it_flies_on(
    world: type[World], false_m: float
) -> None:
    w = without_position(world, blind=lambda t: t < 70.0, pull_m=lambda t: (false_m, 0.0))
    w.fly(69.0)
    assert sent(w) == []
    assert w.notices(UNPROVEN) == ordered(w, EkfSource.GNSS)[:1]
    w.fly(110.0)
    assert w.statuses[-1][1].verdict is Verdict.SUSPECT, "the first fixes find out"
    assert ordered(w, EkfSource.VISION)
    assert all(off_m <= level_m for _, off_m, level_m in sent(w))
    assert w.statuses[-1][2] < SETTLED_M


def test_one_fix_after_half_a_minute_is_enough_to_keep_it_from_a_false_gnss(world: type[World]) -> None:
    w = without_position(world, blind=lambda t: t < 30.0, pull_m=lambda t: (80.0, 0.0))
    w.fly(60.0)
    assert ordered(w, EkfSource.GNSS) == []
    assert sent(w)[0][1] < WITHIN_M


@pytest.mark.parametrize("sees_from_s", [0.0, 18.0])
@pytest.mark.parametrize("seed", [1, 2])
def test_the_operators_word_counts_for_more_than_an_unproven_gnss(world: type[World], sees_from_s: float, seed: int) -> None:
    """One that hovers 300 m from where GNSS has it is found where the operator says; until then GNSS moves nothing."""
    w = without_position(world, blind=lambda t: t < sees_from_s, pull_m=lambda t: (300.0, 0.0), speed_mps=0.0, seed=seed)
    w.fly(15.0)
    w.send(OperatorFix(ns(w.t), place_of(w.p + np.array([8.0, -6.0])), 20.0))
    w.fly(60.0)
    assert w.notices("restarted from trusted GNSS") == []
    assert len(w.notices("position taken")) == len(w.notices("operator's position confirmed")) == 1
    first_s, off_m, _ = sent(w)[0]
    assert first_s - max(15.0, sees_from_s) < 5.0
    assert off_m < WITHIN_M
    assert all(off_m <= level_m for _, off_m, level_m in sent(w))
    assert w.statuses[-1][1].verdict is Verdict.SUSPECT
    assert ordered(w, EkfSource.GNSS) == []


def test_fixes_that_wait_after_a_loss_keep_it_from_an_unproven_gnss(world: type[World]) -> None:
    """Nobody knows how far it has drifted since the operator's word, and one that hovers shows no other ground to be sure by."""
    w = without_position(world, blind=lambda t: not 24.0 < t < 42.0, pull_m=lambda t: (300.0, 0.0), speed_mps=0.0)
    w.fly(15.0)
    w.send(OperatorFix(ns(w.t), place_of(w.p), 20.0))
    w.fly(42.0 + UNSEEN_S - 2.0)
    assert w.notices("a place is seen, fly on to confirm it")
    assert w.notices(UNPROVEN) == ordered(w, EkfSource.GNSS) == sent(w) == []


def test_an_autopilot_that_tells_its_receivers_position_has_one_whatever_its_flags_say(world: type[World]) -> None:
    """ArduPilot on its attitude filter reports no flags at all; a filter that waits there has nothing when GNSS goes."""
    w = without_position(world, blind=lambda t: True)
    w.source, told = EkfSource.GNSS, w.send
    w.send = lambda e: told(replace(e, horizontal_position_ok=False) if isinstance(e, EstimatorStatus) else e)
    w.fly(18.0)
    assert w.statuses[-1][2] < WITHIN_M
    assert w.notices(UNPROVEN) == []
