"""Fixes that claim too little are believed less; those that are honest are not."""

from __future__ import annotations

import math

import numpy as np
import pytest

from visloc_companion.core.audit import HONEST, LARGEST, audited
from visloc_companion.core.belief import Position, seeded
from visloc_companion.core.driving import Velocity
from visloc_companion.core.estimator import PositionFilter
from visloc_companion.core.fusion import observed
from visloc_companion.core.propagation import Drive
from visloc_companion.core.settings import NavigatorSettings
from visloc_companion.geo import wgs84
from visloc_companion.types import Accepted, Fix, GeoPoint, Rejected

S = 1_000_000_000
SETTINGS = NavigatorSettings(map_sigma_m=0.05)
ORIGIN = GeoPoint(59.3, 18.1, 40.0)


def mean_factor(true_ratio: float, n: int = 4000) -> float:
    rng, factor, total = np.random.default_rng(1), HONEST, 0.0
    for _ in range(n):
        factor = audited(factor, true_ratio * rng.chisquare(2) / factor)
        total += factor
    return total / n


def test_honest_fixes_keep_their_claims() -> None:
    assert mean_factor(0.7) < 1.03
    assert mean_factor(1.0) < 1.08


def test_fixes_that_claim_too_little_are_believed_less() -> None:
    assert 10 < mean_factor(25.0) < 25


def test_one_wrong_match_costs_a_quarter_and_no_number_of_them_everything() -> None:
    assert audited(HONEST, 400.0) == pytest.approx(1.25)
    factor = HONEST
    for _ in range(100):
        factor = audited(factor, math.inf)
    assert factor == LARGEST


def over_sigma(true_m: float, claimed_m: float) -> tuple[float, float]:
    """Error over stated sigma (rms, an axis) and error (m, rms) of a filter on fixes of white noise, four a second."""
    rng = np.random.default_rng(3)
    start = seeded(0, (0.0, 0.0), 1.0, 0.3, Drive.AUTOPILOT, SETTINGS)
    the_filter = PositionFilter(SETTINGS, ORIGIN, start, Velocity(0, (8.0, 0.0, 0.0), 140.0, 0.3, Drive.AUTOPILOT))
    over, off = [], []
    for k in range(1, 600):
        t_ns = k * S // 4
        the_filter.drive(Velocity(t_ns, (8.0, 0.0, 0.0), 140.0, 0.3, Drive.AUTOPILOT))
        north, east = (np.array([2.0 * k, 0.0]) + true_m * rng.standard_normal(2)).tolist()
        cov = ((claimed_m**2, 0.0), (0.0, claimed_m**2))
        place = wgs84.geo_from_ned((north, east, -100.0), ORIGIN)
        the_filter.observe(Fix(t_ns, t_ns, k, k, "deep", place, (1.0, 0.0, 0.0, 0.0), cov, 2.0, 0.1, 0.001, 5.0))
        if k > 100:
            state = the_filter.at(t_ns)
            error = np.array(state.p_ned_m[:2]) - (2.0 * k, 0.0)
            over.append(error / np.sqrt(np.diag(state.cov_ne_m2)))
            off.append(error)
    return float(np.sqrt(np.mean(np.square(over)))), float(np.sqrt(np.mean(np.square(off))))


def test_a_filter_on_fixes_that_claim_a_fifth_states_what_it_is_worth(monkeypatch: pytest.MonkeyPatch) -> None:
    over, off_m = over_sigma(1.0, 0.2)
    assert over < 1.6
    monkeypatch.setattr("visloc_companion.core.fusion.audited", lambda *_: HONEST)
    over_before, off_before_m = over_sigma(1.0, 0.2)
    assert over_before > 1.5 * over
    assert off_m < 0.9 * off_before_m


def test_gnss_is_not_audited_and_what_cannot_be_judged_changes_nothing() -> None:
    belief = seeded(0, (0.0, 0.0), 1.0, 0.3, Drive.AUTOPILOT, SETTINGS)
    cov = ((0.04, 0.0), (0.0, 0.04))
    after, outcome = observed(belief, Position(0, (3.0, 0.0), cov, from_fix=False), SETTINGS)
    assert isinstance(outcome, Accepted)
    assert after.claims_factor == HONEST
    nothing = ((0.0, 0.0), (0.0, 0.0))
    after, outcome = observed(belief, Position(0, (3.0, 0.0), nothing, from_fix=True), SETTINGS)
    assert isinstance(outcome, Rejected)
    assert after.claims_factor == HONEST
