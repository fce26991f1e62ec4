"""The error of the autopilot's height: learned, carried, doubted; and its level holds where fixes are wrong."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from visloc_companion.core.heights.height import HeightFilter, HeightFix, carried, news_of, observed, started
from visloc_companion.core.settings import NavigatorSettings

S = 1_000_000_000
SETTINGS = NavigatorSettings()


def fix(
    t_s: float, offset_m: float, sigma_m: float = 1.0, method: str = "deep", climbed_m: float = 0.0, gone_by_per_s: float = 1.0
) -> HeightFix:
    at_ne_m = 60.0 * gone_by_per_s * t_s, 0.0  # 100 m up
    numbers = offset_m, sigma_m**2, climbed_m
    return HeightFix(round(t_s * S), round(t_s * 1000), *numbers, method, 1e-3, gone_by_per_s, at_ne_m, 24.0)


def fed(fixes: list[HeightFix], sigma_m: float = 4.0) -> HeightFilter:
    heights = HeightFilter(SETTINGS, 0, 100.0, sigma_m)
    for one in fixes:
        heights.observe(one)
    return heights


def test_a_steady_offset_is_learned_and_stays_in_the_level() -> None:
    heights = fed([fix(t, 6.0) for t in range(1, 40)])
    offset_m, var_m2 = heights.at(40 * S, 100.0)
    assert offset_m == pytest.approx(6.0, abs=0.1)
    assert var_m2 < 0.3
    level_m = heights.protection_level_m(40 * S, 100.0, 50.0)
    assert 6.0 + 4 * SETTINGS.map_sigma_h_m < level_m < 6.0 + 8 * SETTINGS.map_sigma_h_m


def test_many_fixes_over_the_same_ground_tell_little_more_than_one() -> None:
    heights = fed([fix(1 + k / 4, 2.0, gone_by_per_s=0.0) for k in range(40)])
    one = fed([fix(1, 2.0, gone_by_per_s=0.0)])
    assert heights.at(11 * S, 100.0)[1] == pytest.approx(one.at(11 * S, 100.0)[1], rel=0.3)
    flown = fed([fix(1 + k / 4, 2.0, gone_by_per_s=1.0) for k in range(40)])
    assert flown.at(11 * S, 100.0)[1] < 0.5 * heights.at(11 * S, 100.0)[1]


def test_what_one_ground_has_wrong_does_not_stay_beyond_it() -> None:
    """12 s of fixes that are 1.5 m too high (claimed 0.5 m) after 30 s of right ones, over one wood: the height follows by
    less than half of that, and comes back after."""
    right = [fix(k / 4, 0.0, 0.5, gone_by_per_s=0.12) for k in range(1, 120)]
    wood = [fix(30 + k / 4, 1.5, 0.5, gone_by_per_s=0.12) for k in range(48)]
    after = [fix(42 + k / 4, 0.0, 0.5, gone_by_per_s=0.12) for k in range(24)]
    assert abs(fed([*right, *wood]).at(42 * S, 100.0)[0]) < 0.8
    assert abs(fed([*right, *wood, *after]).at(48 * S, 100.0)[0]) < 0.6


def test_fixes_of_one_ground_that_claim_unlike_errors_conclude_nothing_beyond_them() -> None:
    """As the first seconds of a flight: far off and little known, then nearer and better known."""
    said = [(5.4, 5.5), (5.7, 2.4), (6.0, 3.7), (2.7, 2.8), (0.7, 1.5), (-0.5, 1.1)]
    for n in range(1, len(said) + 1):
        heights = fed([fix(k / 4, offset_m, sigma_m, gone_by_per_s=0.1) for k, (offset_m, sigma_m) in enumerate(said[:n])], 4.2)
        assert min(0.0, *(m for m, _ in said[:n])) <= heights.at(n * S // 4, 100.0)[0] <= 6.0


def test_a_shape_shares_nothing_with_pictures() -> None:
    pictures = [fix(1 + k / 4, 2.0, gone_by_per_s=0.0) for k in range(20)]
    both = fed([*pictures, *(fix(6 + k, 0.0, method="structure", gone_by_per_s=0.0) for k in range(20))])
    assert both.at(26 * S, 100.0)[0] == pytest.approx(0.0, abs=0.3)


def test_before_any_fix_the_level_is_that_of_the_barometer() -> None:
    assert fed([]).protection_level_m(1, 100.0, 50.0) == pytest.approx(4.42 * np.hypot(4.0, np.hypot(1.0, 0.25)), rel=0.03)


def test_without_fixes_the_level_grows_as_the_barometer_drifts() -> None:
    heights = fed([fix(t, 0.0) for t in range(1, 20)])
    levels = [heights.protection_level_m((20 + 60 * k) * S, 100.0, 50.0) for k in range(5)]
    assert levels == sorted(levels)
    assert levels[-1] > levels[0] + 1.0


def test_a_climb_stretches_what_is_unknown() -> None:
    heights = fed([fix(t, 0.0) for t in range(1, 20)])
    assert heights.protection_level_m(20 * S, 400.0, 350.0) > 4.42 * 0.03 * 300


def test_the_stretch_of_a_climb_is_learned() -> None:
    fixes = [fix(t, 1.0 + 0.05 * 5 * t, climbed_m=5.0 * t) for t in range(1, 60)]
    offset_m, _ = fed(fixes).at(60 * S, 100.0 + 300.0)
    assert offset_m == pytest.approx(16.0, abs=1.0)


def test_a_jump_of_the_barometer_is_doubted_once_and_then_believed() -> None:
    heights = fed([fix(t, 0.0) for t in range(1, 20)])
    heights.observe(fix(20, 20.0))
    assert abs(heights.at(20 * S, 100.0)[0]) < 2.0
    assert heights.protection_level_m(20 * S, 100.0, 50.0) > 20.0  # this or the fix is wrong
    heights.observe(fix(21, 20.0))
    assert heights.at(21 * S, 100.0)[0] == pytest.approx(20.0, abs=1.0)


def test_a_drift_far_quicker_than_the_walk_is_followed() -> None:
    """20 m within 30 s: without doubt the filter would lag by 5 m before it noticed."""
    heights = fed([fix(t / 2, 0.0) for t in range(1, 40)])
    lags = []
    for k in range(40, 100):
        true_m = -(k / 2 - 20) * 20 / 30
        heights.observe(fix(k / 2, true_m))
        lags.append(abs(heights.at(round(k / 2 * S), 100.0)[0] - true_m))
    assert max(lags) < 4.0


def test_one_odd_fix_moves_nothing_for_long() -> None:
    heights = fed([*(fix(t, 0.0) for t in range(1, 20)), fix(20, -30.0)])
    assert heights.protection_level_m(20 * S, 100.0, 50.0) > 30.0
    heights.observe(fix(21, 0.0))
    assert abs(heights.at(21 * S, 100.0)[0]) < 1.0
    assert heights.protection_level_m(21 * S, 100.0, 50.0) < 12.0


def test_two_odd_fixes_that_disagree_move_nothing() -> None:
    heights = fed([*(fix(t, 0.0) for t in range(1, 20)), fix(20, -30.0), fix(21, 30.0)])
    assert abs(heights.at(21 * S, 100.0)[0]) < 1.0
    assert heights.protection_level_m(21 * S, 100.0, 50.0) > 30.0


def test_the_level_covers_a_vote_that_is_wrong_for_a_while() -> None:
    """Two wrong fixes that pass the gate: where the height would be without them stays within the level."""
    heights = fed([fix(1, 0.0), *(fix(t, 6.0) for t in (2, 2.5))])
    offset_m, var_m2 = heights.at(round(2.5 * S), 100.0)
    assert offset_m > 2.0
    level_m = heights.protection_level_m(round(2.5 * S), 100.0, 50.0)
    assert level_m > abs(offset_m) + 1.02 * 4.42 * np.hypot(np.sqrt(var_m2), 1.0)


@settings(max_examples=60)
@given(st.permutations(range(10)), st.integers(0, 2**31))
def test_the_order_of_arrival_does_not_matter(order: list[int], seed: int) -> None:
    rng = np.random.default_rng(seed)
    methods = ("deep", "structure")
    fixes = [fix(1 + 0.5 * k, float(rng.normal(3, 4)), 1.0, methods[k % 2], float(k)) for k in range(10)]
    late, right = fed([fixes[k] for k in order]), fed(fixes)
    for t_s in (6.0, 9.0):
        assert late.at(round(t_s * S), 104.0) == pytest.approx(right.at(round(t_s * S), 104.0), abs=1e-9)
        levels = [h.protection_level_m(round(t_s * S), 104.0, 60.0) for h in (late, right)]
        assert levels[0] == pytest.approx(levels[1], abs=1e-9)


def test_what_is_older_than_the_memory_is_not_taken() -> None:
    heights = fed([fix(t, 0.0) for t in range(1, 20)])
    assert not heights.observe(fix(5, 3.0))
    assert heights.observe(fix(15, 3.0))


@given(st.floats(0.0, 100.0), st.lists(st.floats(0.0, 1.0), min_size=1, max_size=5))
def test_carrying_is_the_same_for_any_division(seconds: float, parts: list[float]) -> None:
    belief = observed(started(0, 4.0), fix(1, 1.0), SETTINGS)
    end_ns = S + round(seconds * S)
    once = carried(belief, end_ns, SETTINGS)
    stepwise = belief
    for share in sorted(parts):
        stepwise = carried(stepwise, S + round(share * seconds * S), SETTINGS)
    stepwise = carried(stepwise, end_ns, SETTINGS)
    assert pytest.approx(once.P, abs=1e-9) == stepwise.P
    assert pytest.approx(once.without.P, abs=1e-9) == stepwise.without.P


@given(st.floats(-50, 50), st.floats(0.2, 3.0), st.floats(-50, 50), st.floats(0.5, 20.0))
def test_the_prior_is_taken_out_of_a_fix(measured_m: float, sigma_m: float, prior_m: float, prior_sigma_m: float) -> None:
    whole = sigma_m**-2 + prior_sigma_m**-2
    given_m = (measured_m / sigma_m**2 + prior_m / prior_sigma_m**2) / whole
    news = news_of(given_m, whole**-0.5, prior_m, prior_sigma_m)
    if sigma_m**-2 < 0.249 * prior_sigma_m**-2:
        assert news is None
    elif sigma_m**-2 > 0.251 * prior_sigma_m**-2:
        assert news is not None
        assert news[0] == pytest.approx(measured_m, abs=1e-6)
        assert news[1] == pytest.approx(sigma_m**2, rel=1e-6)


def test_a_localiser_that_only_repeats_its_prior_says_nothing() -> None:
    assert news_of(100.0, 1.5, 100.0, 1.5) is None
    assert news_of(100.0, 1.6, 100.0, 1.5) is None


def test_the_level_holds_on_flights_with_wrong_fixes() -> None:
    """15 flights of 100 s, fixes wrong as often as they claim and by metres: no misleading epoch, and a level worth having."""
    errors, levels = [], []
    for seed in range(15):
        rng = np.random.default_rng(seed)
        offset, wrong = 4.0 * rng.standard_normal(), 0.0
        common = SETTINGS.map_sigma_h_m * rng.standard_normal()
        heights = HeightFilter(SETTINGS, 0, 100.0, 4.0)
        for k in range(1, 200):
            offset += 0.1 * np.sqrt(0.5) * rng.standard_normal()
            claim = float(10 ** rng.uniform(-4, -1.5))
            wrong = (wrong or float(rng.uniform(-20, 20))) if rng.random() < (0.5 if wrong else claim) else 0.0
            seen = offset + common + wrong + rng.standard_normal()
            heights.observe(replace(fix(k / 2, seen), probability_wrong=claim))
            errors.append(abs(offset))
            levels.append(heights.protection_level_m(round(k / 2 * S), 100.0, 50.0))
    assert not any(error > level for error, level in zip(errors, levels, strict=True))
    assert np.median(levels) < 5 * np.median(errors)


def test_jumps_without_fixes_do_not_pile_up_and_their_doubt_does_not_depend_on_it() -> None:
    long, short = fed([fix(1, 2.0)]), fed([fix(1, 2.0)])
    for t_s in range(2, 500):
        long.jumped(t_s * S, 0.5)
        assert len(long._jumps) <= 8  # six seconds of history, one merged, one new
    short.jumped(499 * S, 498 * 0.5)
    assert long.at(500 * S, 100.0) == pytest.approx(short.at(500 * S, 100.0))
    for heights in (long, short):
        heights.observe(fix(501, 3.0))
    assert long.at(502 * S, 100.0) == pytest.approx(short.at(502 * S, 100.0))


def said_in_turn(structure_m: float, until_s: float = 60.0) -> list[HeightFix]:
    """Four fixes a second, each fourth by structure, from 5 s on."""
    return [
        fix(k / 4, structure_m if k % 4 == 0 and k > 20 else 0.0, method="structure" if k % 4 == 0 and k > 20 else "deep")
        for k in range(1, round(4 * until_s) + 1)
    ]


@pytest.mark.parametrize("structure_m", [15.0, -40.0])
def test_the_level_covers_what_one_method_says_again_and_again_while_another_decides(structure_m: float) -> None:
    said = said_in_turn(structure_m)
    heights, levels_m = fed(said[:60]), []
    for one in said[60:]:
        heights.observe(one)
        levels_m.append(heights.protection_level_m(one.t_ns + S // 8, 100.0, 50.0))
    assert abs(structure_m) < min(levels_m) <= max(levels_m) < abs(structure_m) + 10.0
    heights.observe(fix(60.1, 0.0))
    assert abs(heights.at(60 * S, 100.0)[0]) < 1.0
    assert heights.protection_level_m(89 * S, 100.0, 50.0) > abs(structure_m)
    assert heights.protection_level_m(91 * S, 100.0, 50.0) < 12.0, "silent for 30 s"


def test_methods_that_agree_on_the_height_leave_its_level_as_it_is() -> None:
    said = said_in_turn(15.0)
    taken_back = fed([*said, fix(60.1, 0.0, method="structure"), fix(60.2, 0.0)])
    assert taken_back.newest.contradicting == ()
    assert taken_back.protection_level_m(61 * S, 100.0, 50.0) < 8.0


def hovered(fixes: int, moving_m: float) -> tuple[float, float]:
    """Error of the height stated and its level: the barometer is 10 m off, of which the first fixes, all wrong in the same way,
    say nothing; each looks at ground so much further on."""
    heights = HeightFilter(SETTINGS, 0, 100.0, 4.0)
    for k in range(1, fixes + 1):
        assert heights.observe(replace(fix(k / 2, 0.0, 0.5, gone_by_per_s=0.0), at_ne_m=(moving_m * k, 0.0), spacing_m=24.0))
    return 10.0, heights.protection_level_m(fixes * S // 2, 100.0, 60.0)


def test_who_hovers_over_a_wrong_match_has_its_height_in_the_level_for_as_long_as_it_lasts() -> None:
    for fixes in (1, 10, 60):
        error_m, level_m = hovered(fixes, 0.1)
        assert error_m < level_m


def test_other_ground_that_agrees_says_that_the_first_was_right() -> None:
    assert hovered(60, 30.0)[1] < 8.0


def test_a_fix_whose_height_is_no_number_changes_nothing() -> None:
    heights = fed([fix(t, 6.0) for t in range(1, 20)])
    known = heights.at(20 * S, 100.0)
    heights.observe(fix(19.5, math.nan))
    assert heights.at(20 * S, 100.0) == pytest.approx(known, rel=1e-3)
