"""The model of our filter and EKF2's in a row says what its page says of it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.two_filters import FLIGHTS, SENSORS, Ekf2, ekf2_gains, flown, least_sigma_m

POOR, QUIET = SENSORS["PX4's simulator"], SENSORS["quiet"]


def rms_m(told: Ekf2, flight: str = "late_pictures") -> tuple[float, float]:
    sent_m, flown_m = np.sqrt(np.mean(flown(FLIGHTS[flight], POOR, told, 0, n=16, seconds=100.0) ** 2, axis=(0, 2)))
    return float(sent_m), float(flown_m)


def test_what_px4_flies_by_is_worse_than_what_it_is_sent_and_no_filter_is_better_than_the_best() -> None:
    sent_m, flown_m = rms_m(Ekf2())
    assert 0.95 * least_sigma_m(FLIGHTS["late_pictures"], POOR, 0) < sent_m < flown_m


@pytest.mark.parametrize("better", [Ekf2(tau_s=0.1), Ekf2(acc_noise=1.0), Ekf2(age_s=0.15)])
def test_what_brings_px4_nearer_to_what_it_is_sent(better: Ekf2) -> None:
    assert rms_m(better)[1] < 0.97 * rms_m(Ekf2())[1]


def test_velocities_that_rest_on_the_same_fixes_do_not_help() -> None:
    assert rms_m(Ekf2(claimed_mps=0.5))[1] > rms_m(Ekf2())[1]


def test_a_position_that_claims_more_moves_ekf2_less() -> None:
    assert ekf2_gains(Ekf2(claimed_m=2.0))[0][0] < ekf2_gains(Ekf2(claimed_m=0.5))[0][0]
    assert not ekf2_gains(Ekf2())[1].any()


def test_with_noisy_sensors_late_fixes_cost_any_filter() -> None:
    on_time, late = (least_sigma_m(FLIGHTS[name], POOR, 0) for name in ("jam", "late"))
    assert late > 1.5 * on_time
    assert least_sigma_m(FLIGHTS["late"], QUIET, 0) < 0.8 * late
    soon = replace(FLIGHTS["late"], late_s=0.0)
    assert least_sigma_m(soon, POOR, 0) < late
