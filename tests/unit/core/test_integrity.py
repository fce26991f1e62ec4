from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from visloc_companion.core import integrity
from visloc_companion.core.filter.belief import NEVER_OFF
from visloc_companion.core.filter.separation import EVERY, HELD, NONE, Solutions
from visloc_companion.core.integrity import HEIGHT_SHARE, aged, gaussian, protection_level_m, vertical_protection_level_m
from visloc_companion.core.settings import NavigatorSettings
from visloc_companion.types import FloatArray

SETTINGS = replace(NavigatorSettings(), map_sigma_m=0.0)
P = np.diag([1.0, 0.64, 0.04, 0.04])
ROUND = np.diag([1.0, 1.0, 0.04, 0.04])
ORIGIN = np.zeros(4)
strips = cache(np.polynomial.legendre.leggauss)


def outside(sigma_east: float, radius: float) -> float:
    """Probability that an error of 1-sigma 1 north, and less east, lies beyond a radius, by strips in the other axis than the
    code's directions (Gauss and Legendre)."""
    nodes, weights = strips(200)
    most = min(radius, 9.0 * sigma_east)
    east = most * nodes
    beyond = np.array([math.erfc(half / math.sqrt(2)) for half in np.sqrt(radius**2 - east**2)])
    density = np.exp(-((east / sigma_east) ** 2) / 2) / math.sqrt(2 * math.pi) / sigma_east
    return float(most * weights @ (beyond * density)) + math.erfc(most / sigma_east / math.sqrt(2))


def beside(apart: float, radius: float) -> float:
    """Probability that an error of 1-sigma 1 all round about a place that is so far off lies beyond a radius: by strips, too, and
    all of it where that is more than 0.4."""
    nodes, weights = strips(400)
    if radius <= apart:
        return 1.0
    most = min(radius, 9.0)
    half = np.sqrt(radius**2 - (most * nodes) ** 2)
    beyond = np.array([math.erfc((h - apart) / math.sqrt(2)) + math.erfc((h + apart) / math.sqrt(2)) for h in half]) / 2
    density = np.exp(-((most * nodes) ** 2) / 2) / math.sqrt(2 * math.pi)
    outside = float(most * weights @ (beyond * density)) + math.erfc(most / math.sqrt(2))
    return outside if outside <= 0.4 else 1.0


def bound_beside(apart: float, radius: float) -> float:
    """The same as the level reckons with it."""
    return float(integrity.beside(np.array([apart]), np.array([radius]))[0][0])


def away(north_m: float, sigma_m: float, probability: float) -> Solutions:
    """One solution without the fixes."""
    cov = np.diag([sigma_m**2, sigma_m**2, 0.04, 0.04])[None]
    x = np.array([[north_m, 0.0, 0.0, 0.0]])
    return Solutions(x, cov, np.array([probability]), np.zeros(1, np.int64), (EVERY,), (frozenset({"deep"}),))


def test_where_all_fixes_are_right_it_is_the_radius_of_a_gaussian() -> None:
    level = protection_level_m(ORIGIN, ROUND, NONE, NEVER_OFF, SETTINGS)
    assert math.exp(-(level**2) / 2) == pytest.approx(1e-5, rel=0.05)
    assert protection_level_m(ORIGIN, ROUND, NONE, NEVER_OFF, replace(SETTINGS, integrity_risk=1e-3)) < level


@given(st.floats(0.01, 1.0), st.floats(0.0, math.pi), st.floats(1e-7, 1e-2))
def test_an_error_that_is_smaller_along_one_axis_reaches_less_far(share: float, turned_rad: float, risk: float) -> None:
    """Beyond 4.80 of its largest sigma lies 1e-5 of one that is as large all round; on a line beyond 4.42."""
    c, s = math.cos(turned_rad), math.sin(turned_rad)
    axes = np.array([[c, -s], [s, c]])
    narrow = np.zeros((4, 4))
    narrow[:2, :2] = axes @ np.diag([1.0, share**2]) @ axes.T
    level = protection_level_m(ORIGIN, narrow, NONE, NEVER_OFF, replace(SETTINGS, integrity_risk=risk))
    assert outside(share, level) <= risk * (1 + 2e-6)
    assert outside(share, 0.99 * level) > risk


@given(st.floats(0.0, math.pi), st.floats(1e-3, 1e3))
def test_an_error_on_a_line_reaches_as_far_as_a_gaussian(turned_rad: float, sigma_m: float) -> None:
    along, line = sigma_m * np.array([math.cos(turned_rad), math.sin(turned_rad)]), np.zeros((4, 4))
    line[:2, :2] = np.outer(along, along)
    level = protection_level_m(ORIGIN, line, NONE, NEVER_OFF, SETTINGS)
    assert level == pytest.approx(4.417 * sigma_m, rel=2e-3)


def test_the_registration_of_the_map_is_part_of_it() -> None:
    wider = protection_level_m(ORIGIN, ROUND, NONE, NEVER_OFF, replace(SETTINGS, map_sigma_m=1.0))
    assert wider == pytest.approx(math.sqrt(2) * protection_level_m(ORIGIN, ROUND, NONE, NEVER_OFF, SETTINGS), rel=2e-3)


def test_a_likely_wrong_match_holds_what_would_be_without_it() -> None:
    alone = protection_level_m(ORIGIN, P, NONE, NEVER_OFF, SETTINGS)
    level = protection_level_m(ORIGIN, P, away(8.0, 1.0, 0.01), NEVER_OFF, SETTINGS)
    assert 0.01 * beside(8.0, level) <= 1e-5 < 0.01 * beside(8.0, 0.99 * level)
    assert protection_level_m(ORIGIN, P, away(8.0, 1.0, 1e-7), NEVER_OFF, SETTINGS) == pytest.approx(alone, rel=0.01)


def told_by_gnss(north_m: float, sigma_m: float) -> Solutions:
    return replace(away(north_m, sigma_m, 1.0), leaves=(HELD,), left=(frozenset(),))


@pytest.mark.parametrize(("north_m", "sigma_m", "false"), [(0.0, 0.5, 0.01), (0.3, 0.5, 0.05), (2.0, 0.6, 0.01), (6.0, 0.5, 0.5)])
def test_where_gnss_tells_the_filter_itself_counts_as_often_as_that_is_false(
    north_m: float, sigma_m: float, false: float
) -> None:
    level = protection_level_m(ORIGIN, P, told_by_gnss(north_m, sigma_m), NEVER_OFF, SETTINGS, false)

    def beyond(radius_m: float, tail: Callable[[float, float], float]) -> float:
        return false * outside(0.8, radius_m) + (1 - false) * tail(north_m / sigma_m, radius_m / sigma_m)

    assert beyond(level, beside) <= 1e-5 * (1 + 1e-6)
    assert beyond(0.97 * level, bound_beside) > 1e-5


def test_a_gnss_that_is_false_for_certain_tells_nothing() -> None:
    alone = protection_level_m(ORIGIN, P, away(1.0, 1.0, 1e-4), NEVER_OFF, SETTINGS)
    both = Solutions(
        np.concatenate([away(1.0, 1.0, 1e-4).x, told_by_gnss(0.0, 0.1).x]),
        np.concatenate([away(1.0, 1.0, 1e-4).P, told_by_gnss(0.0, 0.1).P]),
        np.array([1e-4, 1.0]),
        np.zeros(2, np.int64),
        (EVERY, HELD),
        (frozenset({"deep"}), frozenset()),
    )
    assert protection_level_m(ORIGIN, P, both, NEVER_OFF, SETTINGS) == alone
    assert protection_level_m(ORIGIN, P, both, NEVER_OFF, SETTINGS, 0.01) < 0.9 * alone


@example([], 0.0078125)
@given(
    st.lists(st.tuples(st.floats(0, 200), st.floats(0.1, 30), st.floats(1e-8, 1.0)), min_size=0, max_size=12),
    st.floats(1e-7, 1e-2),
)
def test_the_risk_beyond_it_is_what_was_allowed(others: list[tuple[float, float, float]], risk: float) -> None:
    settings = replace(SETTINGS, integrity_risk=risk)
    many = [away(*other) for other in others]
    without = (
        Solutions(
            np.concatenate([m.x for m in many]),
            np.concatenate([m.P for m in many]),
            np.concatenate([m.probability for m in many]),
            np.zeros(len(many), np.int64),
            (EVERY,) * len(many),
            (frozenset({"deep"}),) * len(many),
        )
        if many
        else NONE
    )
    level = protection_level_m(ORIGIN, P, without, NEVER_OFF, settings)

    def beyond(radius_m: float, tail: Callable[[float, float], float]) -> float:
        return outside(0.8, radius_m) + sum(p * tail(d / s, radius_m / s) for d, s, p in others)

    assert beyond(level, beside) <= risk * (1 + 1e-6)
    sigmas = math.sqrt(2 * math.log((len(others) + 1) / risk))
    farthest = max(d + s * sigmas for d, s in [(0.0, 1.0), *((d, s) for d, s, _ in others)])
    assert beyond(level - 0.01 * farthest, bound_beside) > risk


def mixture(seed: int) -> tuple[FloatArray, FloatArray, FloatArray, float]:
    """Places of the filter itself, a circle, and up to 80 others: d, s, p, and a risk. Some are as good as points, far off,
    and their probabilities about the risk: there what is left beyond a radius falls by steps."""
    rng = np.random.default_rng(seed)
    K, risk = int(rng.integers(0, 81)), 10 ** rng.uniform(-7, -2)
    own_m, s = 10 ** rng.uniform(-1, 1), 10 ** rng.uniform(*((-0.2, 0.5), (-1.0, 1.5))[seed % 2], K)
    d = 10 ** rng.uniform(-3, 1.3, K) + rng.uniform(0, 200, K) * (rng.random(K) < 0.3)
    p = np.minimum(1.0, 10 ** rng.uniform(-8, 0, K) if seed % 3 else risk * 10 ** rng.uniform(-2, 2, K))
    return np.array([0.0, *d]), np.array([own_m, *s]), np.array([1.0, *p]), risk


def least(beyond: Callable[[float], float], enough_m: float, risk: float) -> float:
    """The least radius that is enough, by halves."""
    low_m = 0.0
    for _ in range(60):
        middle_m = (low_m + enough_m) / 2
        low_m, enough_m = (low_m, middle_m) if beyond(middle_m) <= risk else (middle_m, enough_m)
    return enough_m


@settings(max_examples=300)
@given(st.integers(0, 2**32))
def test_no_radius_is_below_the_least_one_that_is_enough_and_none_far_above(seed: int) -> None:
    d, s, p, risk = mixture(seed)

    def in_plane(radius_m: float) -> float:
        return float(integrity.beside(d / s, radius_m / s)[0] @ p)

    def on_line(radius_m: float) -> float:
        return float(gaussian(np.maximum((radius_m - d) / s, 0.0)) @ p)

    for found_m, beyond in ((integrity.in_plane_m(d, s, p, risk), in_plane), (integrity.on_line_m(d, s, p, risk), on_line)):
        assert beyond(found_m) <= risk * (1 + 1e-12)
        assert found_m <= 1.002 * least(beyond, found_m, risk)


@pytest.mark.parametrize("which", range(3))
@pytest.mark.parametrize("find", [integrity.in_plane_m, integrity.on_line_m])
def test_what_is_no_number_has_no_radius(find: Callable[..., float], which: int) -> None:
    """Rather no position is good enough than each."""
    places = [np.array([0.0, 2.0, 3.0]), np.array([1.0, 1.0, 1.0]), np.array([1.0, 0.1, 0.1])]
    assert math.isfinite(find(*places, 1e-5))
    places[which][1] = math.nan
    assert find(*places, 1e-5) == math.inf


def test_few_radii_are_tried(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of places as flights have them: some eighty, none far off for its sigma."""
    tried, beside = [], integrity.beside

    def counted(apart: FloatArray, a: FloatArray) -> tuple[FloatArray, FloatArray]:
        tried.append(a.size / apart.size)
        return beside(apart, a)

    monkeypatch.setattr(integrity, "beside", counted)
    for seed in range(100):
        rng = np.random.default_rng(seed)
        d, s, p = np.abs(rng.normal(0.0, 1.0, 80)), rng.uniform(0.7, 1.5, 80), 10 ** rng.uniform(-8, -2, 80)
        integrity.in_plane_m(np.array([0.0, *d]), np.array([0.8, *s]), np.array([1.0, *p]), 1e-5)
    assert sum(tried) / 100 < 3.5


@given(st.floats(0.0, 60.0), st.floats(0.0, 7.0))
def test_what_lies_beyond_beside_a_place_is_bounded_from_near_above(apart: float, past: float) -> None:
    """By at most 0.14 sigmas of radius (where 0.4 lies beyond, 0.9 sigmas off); where the bound is above 0.4 it counts as all."""
    exact, bound = beside(apart, apart + past), bound_beside(apart, apart + past)
    assert exact * (1 - 1e-9) <= bound
    assert bound <= max(beside(apart, apart + max(past - 0.14, 0.0)), 1e-12)


def test_grows_with_the_time_since_the_last_fix() -> None:
    assert aged(5.0, 0.0) == 5.0
    assert aged(5.0, -1.0) == 5.0
    assert aged(5.0, 30.0) == 10.0


# ------------------------------------------------------------------------------------------------------------------ vertical


def vertical(*solutions: tuple[float, float, float], above_m: float = 0.0, risk: float = 1e-5, map_h_m: float = 0.0) -> float:
    offset, sigma, probability = np.array([*solutions]).T
    settings = replace(SETTINGS, integrity_risk=risk, map_sigma_h_m=map_h_m)
    return vertical_protection_level_m(offset, sigma**2, probability, above_m, settings)


@given(st.floats(0.0, 8.0))
@example(1.7360157040364562e-16)  # a rounding from 1
def test_the_tail_is_bounded_from_above_and_closely(a: float) -> None:
    exact = math.erfc(a / math.sqrt(2))
    assert exact * (1 - 1e-15) <= float(gaussian(np.array(a))) <= 1.06 * exact
    assert float(gaussian(np.array(a))) <= math.exp(-a * a / 2) * (1 + 1e-12)


def test_where_all_fixes_are_right_it_is_the_interval_of_a_gaussian() -> None:
    assert math.erfc(vertical((0.0, 1.0, 1.0)) / math.sqrt(2)) == pytest.approx(1e-5, rel=0.05)


def test_an_error_that_is_known_counts_in_full() -> None:
    """What is stated is the autopilot's height: fixes that put it 20 m higher make it 20 m worse, not better."""
    assert vertical((20.0, 0.5, 1.0)) > 20.0
    assert vertical((-20.0, 0.5, 1.0)) == vertical((20.0, 0.5, 1.0))


def test_the_heights_of_the_map_and_of_the_camera_are_part_of_it() -> None:
    alone = vertical((0.0, 1.0, 1.0))
    assert vertical((0.0, 1.0, 1.0), map_h_m=1.0) == pytest.approx(math.sqrt(2) * alone, rel=2e-3)
    assert vertical((0.0, 1.0, 1.0), above_m=1 / HEIGHT_SHARE) == pytest.approx(math.sqrt(2) * alone, rel=2e-3)


solution = st.tuples(st.floats(-100, 100), st.floats(0.1, 30), st.floats(1e-8, 1.0))


@given(st.lists(solution, min_size=1, max_size=12), st.floats(1e-7, 1e-2))
def test_the_vertical_risk_beyond_it_is_what_was_allowed(others: list[tuple[float, float, float]], risk: float) -> None:
    level = vertical((0.0, 1.0, 1.0), *others, risk=risk)
    beyond = sum(
        p * (math.erfc((level - d) / s / math.sqrt(2)) + math.erfc((level + d) / s / math.sqrt(2))) / 2
        for d, s, p in ((0.0, 1.0, 1.0), *others)
    )
    assert beyond <= risk * (1 + 1e-6)


@given(st.lists(solution, min_size=1, max_size=8), st.integers(0, 7), st.floats(1.01, 3.0))
def test_it_never_falls_when_a_solution_gets_worse(others: list[tuple[float, float, float]], at: int, factor: float) -> None:
    d, s, p = others[at % len(others)]
    level = vertical((0.0, 1.0, 1.0), *others)
    coarse_m = max(abs(d) + 7 * s for d, s, _ in [(0.0, 1.0, 1.0), *others]) / 1000
    for worse in ((factor * d, s, p), (d, factor * s, p), (d, s, min(1.0, factor * p))):
        changed = [*others]
        changed[at % len(others)] = worse
        assert vertical((0.0, 1.0, 1.0), *changed) >= level - coarse_m
