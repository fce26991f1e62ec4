"""A filter that drifted further than it knows goes to where fixes agree, not half way; a single wrong one moves it nowhere."""

from __future__ import annotations

import math
from typing import Any

import pytest

from tests.unit.core.flown import near_sighted, started
from tests.unit.core.test_gone_on import BACK_S, drifted, sent
from visloc_companion.core.filter import fusion
from visloc_companion.core.filter.belief import Belief, Position, seeded
from visloc_companion.core.filter.propagation import H_POSITION, POSITION, VELOCITY, Drive
from visloc_companion.core.settings import NavigatorSettings
from visloc_companion.types import Accepted

World = Any
SETTINGS = NavigatorSettings()
SIGMA_M = 20.0
"""1-sigma of the filter's place, on each axis, before its first fix."""


def fix(t_s: float, north_m: float, sigma_m: float = 1.5, *, from_fix: bool = True) -> Position:
    cov = ((sigma_m**2, 0.0), (0.0, sigma_m**2))
    return Position(round(t_s * 1e9), (north_m, 0.0), cov, from_fix=from_fix, method="deep")


def unheld(sigma_m: float = SIGMA_M, drive: Drive = Drive.FED_BACK) -> Belief:
    return seeded(0, (0.0, 0.0), sigma_m, 0.8, drive, SETTINGS)


def after(belief: Belief, *positions: Position) -> tuple[Belief, list[bool]]:
    """The vehicle stands, and so it says. Which of them were taken."""
    taken = []
    for each in positions:
        belief = fusion.propagated(belief, each.t_ns, (0.0, 0.0), SETTINGS)
        belief, outcome = fusion.observed(belief, each, SETTINGS)
        taken.append(isinstance(outcome, Accepted))
    return belief, taken


@pytest.mark.parametrize("off_m", [52.0, 60.0, 70.0, 79.0])
def test_it_goes_where_the_second_fix_says_what_the_first_did(off_m: float) -> None:
    """2.6 to 4 sigma off: the first was believed by half, and the filter was surer of a place where neither is."""
    first, taken = after(unheld(), fix(0.5, off_m))
    assert taken == [False]
    assert float(first.x[0]) == 0.0
    assert math.sqrt(first.P[0, 0]) >= SIGMA_M, "nor are frames looked for less far about it"
    belief, taken = after(first, fix(1.0, off_m + 1.0))
    assert taken == [True]
    assert float(belief.x[0]) == pytest.approx(off_m + 1.0, abs=1.0)
    assert math.sqrt(belief.P[0, 0]) == pytest.approx(1.5, abs=0.3)
    assert belief.rejected == belief.contradicting == ()


@pytest.mark.parametrize("drive", [Drive.FED_BACK, Drive.AUTOPILOT])
def test_a_single_wrong_one_moves_it_nowhere(drive: Drive) -> None:
    honest = [fix(1.0, 11.0), fix(1.5, 10.0)]
    belief, taken = after(unheld(drive=drive), fix(0.5, -70.0), *honest)
    silent, _ = after(unheld(drive=drive), *honest)
    assert taken == [False, True, True]
    assert belief.x[POSITION].tolist() == pytest.approx(silent.x[POSITION].tolist(), abs=1e-6)
    assert float(belief.x[0]) == pytest.approx(10.0, abs=1.0)


def test_two_that_contradict_each_other_move_it_nowhere() -> None:
    belief, taken = after(unheld(), fix(0.5, 70.0), fix(1.0, -70.0))
    assert taken == [False, False]
    assert float(belief.x[0]) == 0.0


def test_one_that_was_too_far_off_to_be_taken_is_remembered() -> None:
    belief, taken = after(unheld(), fix(0.5, 82.0), fix(1.0, 79.0))
    assert taken == [False, True]
    assert float(belief.x[0]) == pytest.approx(79.0, abs=1.0)


def test_the_level_reaches_back_to_where_it_was() -> None:
    """Two looks at one ground err alike."""
    belief, _ = after(unheld(), fix(0.5, 70.0), fix(1.0, 70.0))
    k = int(abs(belief.without.x[:, 0]).argmin())
    assert abs(float(belief.without.x[k, 0])) < 1.0
    assert belief.without.probability[k] >= 1e-3
    assert abs(belief.alike.off_m(H_POSITION)[0][0]).max() > 65.0


def test_the_velocity_is_moved_no_further_than_by_an_ordinary_fix() -> None:
    """What a velocity drifted by and what nobody knew of are not told apart: 20 s on, 3.6 sigma off."""
    belief = fusion.propagated(unheld(1.0, Drive.AUTOPILOT), 20 * 10**9, (0.0, 0.0), SETTINGS)
    sigma_m, sigma_mps = math.sqrt(belief.P[0, 0]), math.sqrt(belief.P[VELOCITY.start, VELOCITY.start])
    off_m = 3.6 * sigma_m
    later, taken = after(belief, fix(20.0, off_m), fix(20.5, off_m))
    assert taken == [False, True]
    assert float(later.x[0]) == pytest.approx(off_m, abs=1.0)
    assert 0.5 * sigma_mps < abs(float(later.x[VELOCITY.start])) < math.sqrt(fusion.ORDINARY_NIS) * sigma_mps


def test_where_fixes_are_rare_none_waits_for_another() -> None:
    belief, _ = after(unheld(1.5), *(fix(6.0 * k, 0.0) for k in range(5)))
    belief = fusion.propagated(belief, 34 * 10**9, (0.0, 0.0), SETTINGS)
    off_m = 3.5 * math.sqrt(belief.P[0, 0])
    later, taken = after(belief, fix(34.0, off_m))
    assert belief.P[0, 0] > 3.0**2 * 1.5**2
    assert taken == [True]
    assert 0.2 * off_m < float(later.x[0]) < 0.8 * off_m


@pytest.mark.parametrize("from_fix", [True, False])
def test_a_filter_that_is_as_sure_as_the_position_takes_it_at_once(from_fix: bool) -> None:
    belief, taken = after(unheld(4.0), fix(0.5, 14.0, sigma_m=1.5 if from_fix else 5.0, from_fix=from_fix))
    assert taken == [True]
    assert 1.0 < float(belief.x[0]) < 9.0


@pytest.mark.parametrize(("speed_mps", "seed"), [(0.0, 1), (10.0, 2)])
@pytest.mark.parametrize(("drift_m", "blind_s"), [(65.0, 0.0), (80.0, 0.0), (80.0, 20.0), (100.0, 20.0)])
def test_a_daemon_that_returns_in_a_jam_sends_no_place_in_between(
    world: type[World], seed: int, drift_m: float, blind_s: float, speed_mps: float
) -> None:
    """The autopilot's position had drifted away meanwhile: positions were 13 to 63 m off, up to 3 s long, for frames were not
    looked for as far as the vehicle was."""
    blind = {"blind": lambda t: BACK_S < t < BACK_S + blind_s}
    w = drifted(near_sighted(world), drift_m, jammed=lambda t: t > 20, speed_mps=speed_mps, seed=seed, **blind)
    w.fly(BACK_S + blind_s + 15.0)
    assert sent(w)[0][0] - BACK_S - blind_s < 3.0
    assert max(off_m for _, off_m, _ in sent(w)) < 8.0
    assert all(off_m <= level_m for _, off_m, level_m in sent(w))


def test_nor_after_long_dead_reckoning(world: type[World]) -> None:
    """40 s with an autopilot that drifts by more than it is believed to: 94 m; the first fix left 29 m."""
    w = started(near_sighted(world), jammed=lambda t: t > 20, blind=lambda t: 40 < t < 80, accel_bias_mps2=(0.08, -0.08))
    w.fly(90.0)
    assert w.status_at(80.0)[1] > 80.0
    first_s = next(t for t, status, _ in w.statuses if t > 80.0 and (status.age_of_fix_s or 99.0) < 1.0)
    assert first_s < 81.5
    assert max(off_m for t, _, off_m in w.statuses if t >= first_s) < 8.0
