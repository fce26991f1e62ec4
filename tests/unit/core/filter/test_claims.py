"""Fixes that err by more than they claim: the factor alone, and what it does to the filter and the operator."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from visloc_companion.core.filter.claims import MOST, Claim, learned, over
from visloc_companion.core.settings import CoreSettings, InjectionSettings

World = Any


def after(whites: np.ndarray, true_over: float = 1.0) -> list[float]:
    """The factor after each of whitened innovations (N, 2) whose variance is `true_over` times what is claimed and then less by
    what has been learned."""
    claims: tuple[Claim, ...] = ()
    factors = []
    for white in whites:
        scaled = white * np.sqrt(true_over / over(claims, "deep"))
        claims = learned(claims, "deep", (float(scaled[0]), float(scaled[1])))
        factors.append(over(claims, "deep"))
    return factors


def test_honest_claims_stay_as_they_are() -> None:
    factors = after(np.random.default_rng(1).standard_normal((2000, 2)))
    assert max(factors) == 1.0


@pytest.mark.parametrize("true_over", [4.0, 25.0])
def test_claims_that_are_too_small_are_raised_to_what_fixes_err_by(true_over: float) -> None:
    factors = after(np.random.default_rng(2).standard_normal((400, 2)), true_over)
    assert 0.5 < np.median(factors[200:]) / true_over < 1.2


def test_what_is_over_is_forgotten() -> None:
    rng = np.random.default_rng(3)
    claims: tuple[Claim, ...] = (Claim("deep", 25.0, (0.0, 0.0)),)
    for white in rng.standard_normal((150, 2)) / 5:
        claims = learned(claims, "deep", (float(white[0]), float(white[1])))
    assert over(claims, "deep") == 1.0


def test_fixes_that_all_lean_to_one_side_are_no_fixs_fault() -> None:
    whites = np.random.default_rng(4).standard_normal((500, 2)) + np.array([4.0, -3.0])
    assert max(after(whites)) < 1.5


def test_one_that_is_wrong_says_little_of_the_others() -> None:
    assert over(learned((), "deep", (3.9, 0.0)), "deep") == 1.0, "the first one has nothing to be compared with"
    claims = learned(learned((), "deep", (0.3, 0.0)), "deep", (30.0, 0.0))
    assert over(claims, "deep") == 1.0
    assert over(claims, "structure") == 1.0, "each method has a factor of its own"
    assert MOST > 25.0


def flown(world: type[World], fix_sigma_m: float, claimed_share: float) -> World:
    settings = CoreSettings(injection=InjectionSettings(switch_source=True), structure=False)
    w = world(settings=settings, fix_sigma_m=fix_sigma_m, claimed_share=claimed_share, jammed=lambda t: t > 20)
    w.start()
    return w.fly(120)


def errors_and_sigmas(w: World) -> tuple[np.ndarray, np.ndarray]:
    late = [(error, status.cov_ne_m2) for t, status, error in w.statuses if t > 60]
    return np.array([error for error, _ in late]), np.sqrt([np.linalg.eigvalsh(np.array(cov)).max() for _, cov in late])


def test_a_filter_whose_fixes_claim_a_fifth_says_what_it_errs_by(world: type[World]) -> None:
    w = flown(world, 3.0, 0.2)
    errors, sigmas = errors_and_sigmas(w)
    assert np.sqrt(np.mean(errors**2 / sigmas**2) / 2) < 1.0
    assert np.sqrt(np.mean(errors**2)) < 3.0, "3.5 m where it follows each of them"
    assert len(w.notices("their claim")) == 1


def test_a_filter_whose_fixes_are_honest_is_none_the_wiser(world: type[World]) -> None:
    w = flown(world, 1.5, 1.0)
    belief = w.navigator._tracker.belief
    assert belief is not None
    assert max(claim.over for claim in belief.claims) == 1.0
    assert not w.notices("their claim")
