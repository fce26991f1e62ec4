from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from visloc_companion.core.satellites.shift import (
    COARSE_EVERY,
    FINE_S,
    LONG_S,
    MEDIUM_EVERY,
    MEDIUM_S,
    ShiftModel,
    ShiftTest,
    _kept_s,
)

MODEL = ShiftModel(2.0, 0.02, 1.5, 100.0, 5.0, (5.0, 30.0), (0.3, 1.0), max_constant=4.0)
LINE = replace(MODEL, components=1)
WHITE, QUICK = 1.0, 1.0


def series(rng: np.random.Generator, n: int) -> np.ndarray:
    """Differences exactly as MODEL has them (with a constant that does not walk), one a second."""
    slow, quick = math.exp(-1 / MODEL.slow_s), math.exp(-1 / MODEL.quick_s)
    g, q = MODEL.slow * complex(*rng.standard_normal(2)), math.sqrt(QUICK) * complex(*rng.standard_normal(2))
    constant, out = 1.5 * complex(*rng.standard_normal(2)), []
    for _ in range(n):
        g = slow * g + MODEL.slow * math.sqrt(1 - slow**2) * complex(*rng.standard_normal(2))
        q = quick * q + math.sqrt(QUICK * (1 - quick**2)) * complex(*rng.standard_normal(2))
        out.append(constant + g + q + math.sqrt(WHITE) * complex(*rng.standard_normal(2)))
    return np.array(out)


def run(test: ShiftTest, values: np.ndarray, start_s: float = 0.0) -> list[float]:
    return [test.update(start_s + k, value, WHITE, QUICK).log_r for k, value in enumerate(values)]


def test_innovations_are_white_and_of_unit_size_under_the_model() -> None:
    test, rng = ShiftTest(MODEL), np.random.default_rng(1)
    squares = [test.update(float(k), v, WHITE, QUICK).distance_sigma ** 2 for k, v in enumerate(series(rng, 3000))]
    assert np.mean(squares) == pytest.approx(2.0, abs=0.15)  # two components


def test_the_mean_of_r_grows_no_faster_than_time_while_nothing_shifts() -> None:
    n = 60
    r = np.exp([run(ShiftTest(MODEL), series(np.random.default_rng(seed), n))[-1] for seed in range(150)])
    assert np.mean(r) < 2 * n  # E[R] = t: what bounds the rate of false alarms (heavy tails: the sample mean is mostly less)


def test_a_ramp_and_a_step_are_found_whatever_the_direction() -> None:
    rng = np.random.default_rng(3)
    for angle in (0.0, 1.0, 4.0):
        u = complex(math.cos(angle), math.sin(angle))
        quiet = series(rng, 160)
        ramp = quiet + np.maximum(0, np.arange(160) - 120) * u
        step = quiet + 12.0 * (np.arange(160) >= 120) * u
        assert max(run(ShiftTest(MODEL), quiet)) < 10
        for false, latest in ((ramp, 16), (step, 8)):
            found = [k for k, value in enumerate(run(ShiftTest(MODEL), false)) if value > 10]
            assert found
            assert 120 < found[0] <= 120 + latest


def test_a_ramp_may_weigh_less_at_the_first_difference_than_a_step() -> None:
    same, less = ShiftTest(MODEL, 4000.0), ShiftTest(MODEL, 4000.0, 1000.0)
    quiet, ramp = series(np.random.default_rng(7), 12), 1.5 * np.arange(12)
    assert 1.0 < run(same, quiet)[0] - run(less, quiet)[0] < math.log(4.0)
    for each, weight_s in ((ShiftTest(MODEL, 100.0), 100.0), (ShiftTest(MODEL, 100.0, 20.0), 60.0)):
        assert each.update(0.0, 0.0, 1e9, 1e9).log_r == pytest.approx(math.log(weight_s), abs=0.01)
    assert run(ShiftTest(MODEL, 100.0, 20.0), ramp)[-1] > 10


@pytest.mark.parametrize("every_s", [5, 10, 20, 40, 100])
def test_what_begins_while_differences_are_rare_stands_for_as_long_as_among_many(every_s: int) -> None:
    """Of starts 40 s apart three in four were forgotten by the next one, and with them what spoke for a shift."""
    for quiet in range(1, 9):
        test = ShiftTest(MODEL)
        shifted = (np.arange(quiet + 4) >= quiet) * 60.0
        logs = [test.update(float(every_s * k), value, WHITE, QUICK).log_r for k, value in enumerate(shifted)]
        assert logs[quiet + 1] > max(logs[quiet] + 3.0, 10.0)
        assert logs[quiet + 3] > logs[quiet + 2] > logs[quiet + 1]


def test_one_wild_value_never_decides_and_is_forgotten() -> None:
    test = ShiftTest(MODEL)
    values = series(np.random.default_rng(4), 100)
    values[80] += 1e4
    logs = run(test, values)
    assert max(logs) < 10
    assert logs[95] < 5


def test_the_constant_is_learned_within_its_bound() -> None:
    test = ShiftTest(LINE)
    for k in range(600):
        test.update(float(k), 3.0, WHITE, QUICK)
    assert test.healthy == pytest.approx(3.0, abs=0.3)
    creep = (k for k in range(3000) if test.update(600.0 + k, 3.0 + 0.02 * k, WHITE, QUICK).log_r > 10)
    assert 0.02 * next(creep) < 15.0  # the slowest creep cannot hide in what is learned


def test_a_sum_is_followed_as_well_from_where_it_has_come_to_as_from_its_beginning() -> None:
    """With a factor that is constant both say the same."""
    model = replace(MODEL, factor=0.1, max_constant=math.inf)
    whole, stepwise, rng = ShiftTest(model), ShiftTest(model), np.random.default_rng(6)
    path = 0j
    for k, (healthy, way) in enumerate(zip(series(rng, 200), rng.standard_normal((200, 2)), strict=True)):
        gone = complex(*way)
        path += gone
        value = healthy + 0.07 * path + 9.0 * (k >= 150)
        first, second = (test.update(float(k), value, WHITE, QUICK, by) for test, by in ((whole, path), (stepwise, gone)))
        stepwise.summed(gone)
        assert second.distance_sigma == pytest.approx(first.distance_sigma, rel=1e-6, abs=1e-6)
        assert second.log_r == pytest.approx(first.log_r, rel=1e-6, abs=1e-6)
    assert stepwise.log_r > 10


def test_starts_are_thinned_with_age() -> None:
    test = ShiftTest(LINE)
    sizes = []
    for k in range(2 * LONG_S):
        test.update(float(k), 0.0, WHITE, QUICK)
        sizes.append(test._starts.shape[1])
    assert max(sizes) <= FINE_S + (MEDIUM_S - FINE_S) // 4 + (LONG_S - MEDIUM_S) // 16 + 3


def test_a_start_is_kept_for_as_long_as_its_number_says() -> None:
    age_s, number = np.meshgrid(np.arange(0.0, LONG_S + 2, 0.5), np.arange(40))
    kept = (
        (age_s < FINE_S) | ((age_s < MEDIUM_S) & (number % MEDIUM_EVERY == 0)) | ((age_s < LONG_S) & (number % COARSE_EVERY == 0))
    )
    np.testing.assert_array_equal(age_s < np.vectorize(_kept_s)(number), kept)


def test_a_fork_keeps_what_is_healthy_and_drops_what_a_shift_put_into_it() -> None:
    test, rng = ShiftTest(MODEL), np.random.default_rng(5)
    values = series(rng, 200)
    run(test, values)
    before = test.healthy
    false = values[-1] + np.arange(1, 21) * 1j
    assert run(test, false, 200.0)[-1] > 15
    contaminated = abs(test.healthy - before)
    fork = test.fork(100.0)
    assert abs(fork.healthy - before) < 0.7 * contaminated
    assert fork.log_r == -math.inf
    assert test.log_r > 15  # the original is untouched


def test_the_first_start_of_a_fork_weighs_what_it_is_told() -> None:
    test = ShiftTest(LINE)
    for k in range(100):
        test.update(float(k), 0.0, WHITE, QUICK)
    light, heavy = test.fork(1.0), test.fork(1e4)
    gap = heavy.update(100.0, 8.0, WHITE, QUICK).log_r - light.update(100.0, 8.0, WHITE, QUICK).log_r
    assert gap == pytest.approx(math.log(1e4), abs=1e-6)
    agreed = [heavy.update(101.0 + k, 0.0, WHITE, QUICK).log_r for k in range(30)]
    assert agreed[-1] < agreed[0]


def test_a_hole_in_the_series_widens_what_is_healthy() -> None:
    test = ShiftTest(LINE)
    for k in range(300):
        test.update(float(k), 0.0, WHITE, QUICK)
    soon = test.fork().update(300.0, 3.0, WHITE, QUICK).distance_sigma
    late = test.fork().update(900.0, 3.0, WHITE, QUICK).distance_sigma
    assert late < soon


def test_repeated_times_are_harmless() -> None:
    test = ShiftTest(LINE)
    for _ in range(5):
        assert math.isfinite(test.update(7.0, 1.0, WHITE, QUICK).log_r)
    test.fork()
