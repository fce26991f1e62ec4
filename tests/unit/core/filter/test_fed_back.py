"""A velocity that rests on our own fixes, and errs by more than the model says: the factor alone, and the filter's claims."""

from __future__ import annotations

import math

import numpy as np
import pytest

from visloc_companion.core.filter import fusion
from visloc_companion.core.filter.belief import Position, seeded
from visloc_companion.core.filter.fed_back import MOST, learned
from visloc_companion.core.filter.propagation import N_STATES, POSITION, VELOCITY, Drive
from visloc_companion.core.settings import NavigatorSettings

SETTINGS = NavigatorSettings()
SIGMA_MPS = SETTINGS.velocity_sigma_aiding_mps
S = 1_000_000_000
RARE_S, OFTEN_S = 7.0, 0.25


def after(squares: np.ndarray, true_over: float = 1.0) -> list[float]:
    """The factor after each of mean squared innovations (N,), which are `true_over` times what the model says and then less by
    what has been learned."""
    P, S_m2, factors = np.eye(N_STATES), RARE_S**2 * np.eye(2), [1.0]
    for squared in squares:
        factors.append(learned(factors[-1], float(squared) * true_over / factors[-1], P, S_m2, RARE_S))
    return factors


def squares(seed: int, n: int) -> np.ndarray:
    return np.asarray(np.square(np.random.default_rng(seed).standard_normal((n, 2))).mean(axis=1))


def test_an_honest_velocity_is_hardly_suspected() -> None:
    factors = after(squares(1, 2000))
    assert np.median(factors) < 1.1
    assert np.percentile(factors, 95) < 2.5


@pytest.mark.parametrize("true_over", [6.0, 20.0])
def test_what_a_velocity_errs_by_is_found_in_a_few_fixes(true_over: float) -> None:
    found = [after(squares(seed, 6), true_over)[-1] / true_over for seed in range(200)]
    assert 0.3 < np.median(found) < 1.2
    assert after(np.full(100, 1e6))[-1] == MOST


def test_fixes_that_come_often_tell_nothing_of_the_velocity() -> None:
    P = np.diag([1.0] * N_STATES)
    assert learned(1.0, 8.0, P, 2 * np.eye(2), OFTEN_S) == 1.0
    assert learned(4.0, 8.0, P, 2 * np.eye(2), OFTEN_S) < 4.0, "they hold it"


def flown(error_ne_mps: tuple[float, float], fix_every_s: float, seconds: float = 90.0) -> list[tuple[np.ndarray, np.ndarray]]:
    """Before each fix, of a vehicle that stands still: the errors (north, east) of position and velocity over their 1-sigmas."""
    rng = np.random.default_rng(5)
    belief = seeded(0, (0.0, 0.0), 1.0, SIGMA_MPS, Drive.FED_BACK, SETTINGS)
    over_sigma = []
    for k in range(1, round(seconds / fix_every_s) + 1):
        t_ns = round(k * fix_every_s * S)
        belief = fusion.propagated(belief, t_ns, error_ne_mps, SETTINGS)
        claimed = np.sqrt(np.diag(belief.P))
        velocity = belief.x[VELOCITY] - np.array(error_ne_mps)
        over_sigma.append((belief.x[POSITION] / claimed[POSITION], velocity / claimed[VELOCITY]))
        seen = rng.standard_normal(2)
        z = Position(t_ns, (float(seen[0]), float(seen[1])), ((1.0, 0.0), (0.0, 1.0)), from_fix=True)
        belief, _ = fusion.observed(belief, z, SETTINGS)
    return over_sigma


def test_a_lasting_error_between_rare_fixes_is_claimed() -> None:
    """A plane's autopilot was 2.5 m/s off for 80 s, through a dozen fixes that it took as resets; 0.85 m/s was claimed."""
    late = flown((2.2, -1.2), RARE_S)[5:]
    for which in (0, 1):
        assert math.sqrt(np.mean([np.mean(np.square(pair[which])) for pair in late])) < 1.5


def test_a_velocity_as_good_as_the_model_says_claims_no_more_than_that() -> None:
    belief = seeded(0, (0.0, 0.0), 1.0, SIGMA_MPS, Drive.FED_BACK, SETTINGS)
    for k in range(1, 400):
        belief = fusion.propagated(belief, round(k * OFTEN_S * S), (0.5, 0.5), SETTINGS)
        at = (3.0 * (-1) ** k, 0.0)
        belief, _ = fusion.observed(belief, Position(belief.t_ns, at, ((1.0, 0.0), (0.0, 1.0)), from_fix=True), SETTINGS)
    assert belief.fed_back_over == 1.0, "fixes that err are no fault of the velocity"


def test_what_was_learned_holds_when_the_autopilots_velocity_drives_again() -> None:
    belief = seeded(0, (0.0, 0.0), 1.0, SIGMA_MPS, Drive.FED_BACK, SETTINGS)
    for k in range(1, 6):
        belief = fusion.propagated(belief, round(k * RARE_S * S), (2.5, 0.0), SETTINGS)
        belief, _ = fusion.observed(belief, Position(belief.t_ns, (0.0, 0.0), ((1.0, 0.0), (0.0, 1.0)), from_fix=True), SETTINGS)
    over = belief.fed_back_over
    assert over > 3.0
    belief = fusion.with_inertial_velocity(belief, 0.1)
    again = fusion.with_velocity_trust(belief, SIGMA_MPS, Drive.FED_BACK)
    assert again.P[VELOCITY.start, VELOCITY.start] == pytest.approx(over * SIGMA_MPS**2)
    trusted = fusion.with_velocity_trust(belief, SIGMA_MPS, Drive.AUTOPILOT)
    assert trusted.P[VELOCITY.start, VELOCITY.start] == pytest.approx(SIGMA_MPS**2)
