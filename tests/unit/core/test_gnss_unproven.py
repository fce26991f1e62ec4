"""A GNSS that no fix has shown right yet may be false, which is weighed against a wrong match over one ground."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from tests.unit.core.conftest import place_of
from tests.unit.core.flown import near_sighted
from tests.unit.core.test_gnss import COV, GOOD
from tests.unit.core.test_restart import DOWN_S, restarted
from visloc_companion.core.gnss import GnssMonitor
from visloc_companion.core.satellites import gnss_odds
from visloc_companion.core.satellites.drift import DriftTest
from visloc_companion.core.satellites.gnss_witness import Ground
from visloc_companion.core.settings import GnssSettings
from visloc_companion.types import AutopilotKind, EkfSource, Fix, LocaliseRequest, SwitchSource, Verdict

World = Any
S = 1_000_000_000
BACK_S = 40.0 + DOWN_S
THRESHOLD = GnssSettings().drift_threshold


def claiming(world: type[World], claimed: float, off_m: float = 0.0, until_s: float = 0.0) -> type[World]:
    class Claiming(world):  # type: ignore[misc]
        """Fixes claim to be wrong with a probability; since the restart until a time they are wrong alike."""

        def _localise(self, request: LocaliseRequest) -> None:
            super()._localise(request)
            when, found = self.answers[-1]
            if not isinstance(found, Fix):
                return
            if BACK_S <= self.t < until_s:
                to = self.p + np.array([0.0, off_m]) + self.fix_sigma_m * self.rng.standard_normal(2)
                found = replace(found, place=place_of(to))
            self.answers[-1] = when, replace(found, probability_wrong=claimed)

    return Claiming


def handed_back(w: World) -> list[float]:
    return [t for t, c in w.commands if t > BACK_S and isinstance(c, SwitchSource) and c.source is EkfSource.GNSS]


def not_trusted(w: World, since_s: float) -> list[float]:
    return [t for t, status, _ in w.statuses if t > since_s and status.verdict is not Verdict.OK]


@pytest.mark.parametrize("claimed", [0.002, 0.02])
@pytest.mark.parametrize("speed_mps", [0.0, 10.0])
@pytest.mark.parametrize("off_m", [12.0, 36.0])
def test_a_daemon_that_is_started_in_flight_beside_a_false_gnss_finds_out_over_one_ground(
    world: type[World], off_m: float, speed_mps: float, claimed: float
) -> None:
    """A wrong match over the first ground is far less likely than that the GNSS, which nobody has seen right, is false."""
    w = restarted(
        claiming(world, claimed), pull_m=lambda t: (off_m * min(1.0, max(0.0, t - 10.0) / 20.0), 0.0), speed_mps=speed_mps
    )
    assert w.source is EkfSource.VISION
    w.fly(80.0)
    assert not_trusted(w, 44.8)[0] - BACK_S < 4.0
    assert w.statuses[-1][1].verdict is Verdict.SUSPECT
    assert handed_back(w) == []


@pytest.mark.parametrize("speed_mps", [0.0, 10.0])
@pytest.mark.parametrize("off_m", [30.0, 80.0, 110.0])
def test_a_gnss_that_jumped_while_no_daemon_ran_is_found_out_where_the_filter_starts_from_it(
    world: type[World], off_m: float, speed_mps: float
) -> None:
    """The autopilot flies on it. Where frames were looked for, 0.8 m/s (1-sigma) more about it, they showed nothing: it took 12 s
    (30 m) and 36 s (80 m)."""
    w = restarted(near_sighted(world), pull_m=lambda t: (0.0, off_m * (t > 41.0)), speed_mps=speed_mps)
    assert w.source is EkfSource.GNSS
    w.fly(60.0)
    assert not_trusted(w, 44.8)[0] - BACK_S < 5.0
    sent = [(t, off_m) for t, status, off_m in w.statuses if t > BACK_S and status.injected]
    assert sent[0][0] - BACK_S < 8.0
    assert max(off_m for _, off_m in sent) < 8.0


def test_what_is_neither_shown_right_nor_false_is_not_gone_back_to(world: type[World]) -> None:
    """Fixes that claim to be wrong as often as one in twelve: neither is much likelier."""
    w = restarted(claiming(world, 1 / 12), pull_m=lambda t: (36.0 * min(1.0, max(0.0, t - 10.0) / 20.0), 0.0), speed_mps=0.0)
    w.fly(100.0)
    assert not_trusted(w, 44.8) == []
    assert handed_back(w) == []


def test_beside_a_true_gnss_a_daemon_that_is_started_in_flight_goes_back_to_it(world: type[World]) -> None:
    w = restarted(claiming(world, 0.01), jammed=lambda t: 20 < t < 38)
    w.fly(80.0)
    assert not_trusted(w, 44.8) == []
    assert 0.0 <= handed_back(w)[0] - BACK_S - GnssSettings().probation_s < 3.0  # from the first fix on


@pytest.mark.parametrize(("off_m", "until_s"), [(40.0, 45.6), (14.0, 53.0)])
def test_nor_does_a_wrong_match_over_its_first_ground_part_it_from_gnss_for_long(
    world: type[World], off_m: float, until_s: float
) -> None:
    w = restarted(claiming(world, 0.01, off_m, until_s), jammed=lambda t: 20 < t < 38)
    w.fly(80.0)
    assert not_trusted(w, 44.8)[-1] - until_s < GnssSettings().probation_s + 4.0
    assert handed_back(w)


@pytest.mark.parametrize(("speed_mps", "within_s"), [(10.0, 9.0), (20.0, 6.0)])
def test_a_gnss_that_has_been_false_since_before_take_off_is_found_over_a_few_grounds(
    world: type[World], speed_mps: float, within_s: float
) -> None:
    """It took 30 and 16 s where no attack was reckoned with that began before the first fix."""
    w = world(pull_m=lambda t: (36.0, 0.0), speed_mps=speed_mps)
    w.ekf_p = w.ekf_p + np.array([36.0, 0.0])
    w.start()
    w.fly(within_s)
    assert w.notices("GNSS not trusted, camera says elsewhere")


def off_over_one_ground(test: DriftTest, off_m: float, n: int, since_s: int = 0) -> float:
    ground = Ground("image", (0.0, 0.0), 24.0, 0.01)
    for k in range(since_s, since_s + n):
        test.add(k * S, (off_m, 0.0), 2.0, 1.0, ground=ground)
    return test.log_r


def test_what_came_back_without_a_fix_is_as_likely_to_be_false_as_it_was() -> None:
    """Trust alone shows nothing."""
    weight_s = gnss_odds.first_weight_s(gnss_odds.FALSE_RETURN)
    unseen, seen = DriftTest(2.0), DriftTest(2.0)
    for test in (unseen, seen):
        test.lose()
        test.probation(weight_s)
    assert gnss_odds.probability_false(off_over_one_ground(seen, 0.0, 20)) < 0.01
    for test in (unseen, seen):
        test.regain()
        assert not test.in_probation
    assert unseen.log_r == -math.inf
    assert off_over_one_ground(unseen, 36.0, 5, 20) > THRESHOLD


def test_a_first_fix_that_agrees_speaks_for_a_gnss_that_was_found_in_flight() -> None:
    """Whatever had been false for long would lie elsewhere; half of the weight was on what begins to move just then."""
    monitor = GnssMonitor(GnssSettings())
    monitor.on_vehicle(True, AutopilotKind.ARDUPILOT)
    monitor.on_gnss(replace(GOOD, t_rx_ns=0))
    monitor.on_vision(0, (0.5, -0.5), COV, 1.0, (0.0, 0.0))
    assert monitor.update(0, EkfSource.GNSS).probability_false < gnss_odds.FALSE_FOUND_IN_FLIGHT / 8


@pytest.mark.parametrize("found_in_flight", [False, True])
def test_a_camera_that_was_disowned_has_not_shown_gnss_right_either(found_in_flight: bool) -> None:
    monitor = GnssMonitor(GnssSettings())
    monitor.on_vehicle(found_in_flight, AutopilotKind.ARDUPILOT)
    monitor.on_vehicle(True, AutopilotKind.ARDUPILOT)
    for k in range(10):
        monitor.on_gnss(replace(GOOD, t_rx_ns=k * S))
        assert monitor.update(k * S, EkfSource.GNSS).verdict is (Verdict.OK if k > 1 else Verdict.DENIED)
    monitor.disown_camera()
    for k in range(10, 16):
        monitor.on_gnss(replace(GOOD, t_rx_ns=k * S))
        monitor.on_vision(k * S, (36.0, 0.0), COV, 1.0, (0.0, 0.0), Ground("image", (0.0, 0.0), 24.0, 0.01))
        monitor.update(k * S, EkfSource.GNSS)
    assert monitor.trusted is not found_in_flight
