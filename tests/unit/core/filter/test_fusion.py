from __future__ import annotations

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest

from visloc_companion.core.filter import fusion, propagation, refused
from visloc_companion.core.filter.belief import Belief, Position, seeded
from visloc_companion.core.filter.doubt import Claim, doubting
from visloc_companion.core.filter.propagation import ACCELERATION, HEADING, POSITION, VELOCITY, Drive
from visloc_companion.core.settings import NavigatorSettings
from visloc_companion.errors import Reason
from visloc_companion.types import Accepted, Rejected

SETTINGS = NavigatorSettings()
S = 1_000_000_000
V, A = VELOCITY.start, ACCELERATION.start


def start(drive: Drive = Drive.AUTOPILOT, sigma_m: float = 2.0) -> Belief:
    return seeded(0, (0.0, 0.0), sigma_m, 0.3, drive, SETTINGS)


def fix(t_s: float, north: float, east: float, sigma: float = 1.0, **more: float) -> Position:
    return Position(round(t_s * S), (north, east), ((sigma**2, 0.0), (0.0, sigma**2)), from_fix=True, **more)


def test_propagation_does_not_depend_on_how_the_interval_is_divided() -> None:
    whole = fusion.propagated(start(), 7 * S, (3.0, -1.0), SETTINGS)
    parts = start()
    for t in (1, 10_000_000, 2 * S, 2 * S + 77, 5 * S, 7 * S):
        parts = fusion.propagated(parts, t, (3.0, -1.0), SETTINGS)
    np.testing.assert_allclose(parts.x, whole.x, atol=1e-9)
    np.testing.assert_allclose(parts.P, whole.P, atol=1e-9)
    assert parts.travel_ne_m == pytest.approx((21.0, -7.0))


def test_growth_is_that_of_an_integrated_gauss_markov_error() -> None:
    """Against Monte-Carlo: 20 s of dead reckoning with the modelled velocity error."""
    rng = np.random.default_rng(3)
    tau, sigma, dt, n = SETTINGS.velocity_correlation_s, 0.3, 0.1, 20_000
    b = sigma * rng.standard_normal(n)
    p = np.zeros(n)
    for _ in range(200):
        following = b * math.exp(-dt / tau) + sigma * math.sqrt(1 - math.exp(-2 * dt / tau)) * rng.standard_normal(n)
        p += (b + following) / 2 * dt
        b = following
    grown = fusion.propagated(start(sigma_m=0.001), 20 * S, (0.0, 0.0), SETTINGS).P
    assert math.sqrt(grown[0, 0] - 20 * propagation.WALK_M_PER_SQRT_S**2) == pytest.approx(float(np.std(p)), rel=0.02)
    assert grown[0, V] == pytest.approx(-float(np.mean(p * b)), rel=0.06)


def test_time_does_not_run_back() -> None:
    belief = start()
    assert fusion.propagated(belief, -5, (1.0, 1.0), SETTINGS) is belief


def test_learns_the_velocity_error_from_fixes_only_without_feedback() -> None:
    """The autopilot says 0, the truth moves north with 0.5 m/s."""
    for drive in (Drive.AUTOPILOT, Drive.FED_BACK):
        belief = start(drive)
        for k in range(1, 61):
            belief = fusion.propagated(belief, k * S, (0.0, 0.0), SETTINGS)
            belief, _ = fusion.observed(belief, fix(k, 0.5 * k, 0.0), SETTINGS)
        if drive is Drive.FED_BACK:
            assert belief.x[V] == 0.0
        else:
            assert belief.x[V] == pytest.approx(-0.5, abs=0.1)
            assert belief.x[0] == pytest.approx(30.0, abs=0.3)


def test_dead_reckoning_on_our_own_injection_grows_faster_the_longer_it_lasts() -> None:
    sigmas = []
    belief = start(Drive.FED_BACK)
    for k in range(1, 61):
        belief = fusion.propagated(belief, k * S, (0.0, 0.0), SETTINGS)
        sigmas.append(math.sqrt(belief.P[0, 0]))
    held = start()
    held = fusion.propagated(held, 60 * S, (0.0, 0.0), SETTINGS)
    assert all(b > a for a, b in itertools.pairwise(sigmas))
    assert sigmas[-1] > 2.5 * math.sqrt(held.P[0, 0])


def test_velocity_trust() -> None:
    learned = start()
    for k in range(1, 31):
        learned = fusion.propagated(learned, k * S, (0.0, 0.0), SETTINGS)
        learned, _ = fusion.observed(learned, fix(k, 0.5 * k, 0.0), SETTINGS)
    assert fusion.with_velocity_trust(learned, 0.3, Drive.AUTOPILOT) is learned
    wider = fusion.with_velocity_trust(learned, 0.8, Drive.AUTOPILOT)
    assert wider.x[V] == learned.x[V]
    assert wider.P[V, V] == pytest.approx(learned.P[V, V] + 0.8**2 - 0.3**2)
    narrower = fusion.with_velocity_trust(wider, 0.3, Drive.AUTOPILOT)
    assert narrower.P[V, V] == wider.P[V, V]
    assert narrower.sigma_v_mps == 0.3
    other = fusion.with_velocity_trust(learned, 0.8, Drive.FED_BACK)
    np.testing.assert_array_equal(other.x[VELOCITY], [0.0, 0.0])
    np.testing.assert_allclose(other.P[VELOCITY, VELOCITY], np.eye(2) * 0.64)
    np.testing.assert_array_equal(other.P[POSITION, VELOCITY], np.zeros((2, 2)))


def test_rejected_fixes_that_agree_restart_the_filter_at_the_fourth() -> None:
    belief = start(sigma_m=1.0)
    outcomes = []
    for k in range(1, 5):
        belief = fusion.propagated(belief, k * S, (10.0, 0.0), SETTINGS)
        belief, outcome = fusion.observed(belief, fix(k, 300.0 + 10 * k, 50.0), SETTINGS)
        outcomes.append(type(outcome))
    assert outcomes == [Rejected, Rejected, Rejected, Accepted]
    np.testing.assert_allclose(belief.x[:2], [340.0, 50.0])
    np.testing.assert_allclose(belief.P[:2, :2], np.eye(2))
    assert belief.started_ns == 4 * S
    assert belief.rejected == ()


def test_rejected_fixes_that_contradict_each_other_never_restart() -> None:
    belief = start(sigma_m=1.0)
    for k in range(1, 20):
        belief = fusion.propagated(belief, k * S, (10.0, 0.0), SETTINGS)
        belief, outcome = fusion.observed(belief, fix(k, 300.0 + 10 * k + 40 * (k % 3), 50.0), SETTINGS)
        assert isinstance(outcome, Rejected)
        assert outcome.reason is Reason.GATED
    assert belief.started_ns == 0


def test_repeated_rejections_that_a_false_velocity_explains_widen_the_search() -> None:
    def after_two(off_m: float) -> Belief:
        belief = start(sigma_m=1.0)
        for k in range(10, 12):
            belief = fusion.propagated(belief, k * S, (0.0, 0.0), SETTINGS)
            belief, outcome = fusion.observed(belief, fix(k, off_m * (k - 8), 0.0), SETTINGS)
            assert isinstance(outcome, Rejected)
        return belief

    assert after_two(50.0).P[V, V] > refused.DOUBT_MPS**2
    assert after_two(5000.0).P[V, V] < 1.0
    belief = after_two(50.0)
    for k in range(12, 60):
        belief, _ = fusion.observed(belief, fix(11, 100.0 + 37 * (k % 3), 0.0), SETTINGS)
    assert belief.P[V, V] < refused.MAX_DOUBT_MPS**2 + refused.DOUBT_MPS**2 + 1


def test_six_fixes_on_a_line_teach_the_velocity_error_unless_it_is_our_own() -> None:
    """The input says 30 m/s, the truth moves with 10 m/s far away."""
    for drive in (Drive.AUTOPILOT, Drive.FED_BACK):
        belief = start(drive, sigma_m=1.0)
        for k in range(1, 7):
            belief = fusion.propagated(belief, k * S // 2, (30.0, 0.0), SETTINGS)
            belief, outcome = fusion.observed(belief, fix(k / 2, -500.0 + 5.0 * k, 0.0), SETTINGS)
        assert isinstance(outcome, Accepted)
        assert belief.x[0] == pytest.approx(-470.0)
        if drive is Drive.FED_BACK:
            assert belief.x[V] == 0.0
            assert belief.P[V, V] >= 20.0**2 - 1
        else:
            assert belief.x[V] == pytest.approx(20.0, abs=0.1)


def test_an_accepted_fix_or_a_long_pause_clears_the_candidates() -> None:
    belief = start(sigma_m=1.0)
    belief, _ = fusion.observed(belief, fix(0.0, 300.0, 0.0), SETTINGS)
    assert len(belief.rejected) == 1
    cleared, _ = fusion.observed(belief, fix(0.0, 0.5, 0.0), SETTINGS)
    assert cleared.rejected == ()
    later = fusion.propagated(belief, 40 * S, (0.0, 0.0), SETTINGS)
    later, _ = fusion.observed(later, fix(40.0, 900.0, 0.0), SETTINGS)
    assert len(later.rejected) == 1


def test_gnss_neither_counts_as_a_fix_nor_as_a_candidate() -> None:
    near = Position(0, (1.0, 0.0), ((25.0, 0.0), (0.0, 25.0)), from_fix=False)
    belief, outcome = fusion.observed(start(), near, SETTINGS)
    assert isinstance(outcome, Accepted)
    assert belief.last_fix_ns is None
    far = Position(0, (1000.0, 0.0), ((25.0, 0.0), (0.0, 25.0)), from_fix=False)
    same, outcome = fusion.observed(belief, far, SETTINGS)
    assert isinstance(outcome, Rejected)
    assert same is belief


def test_a_fix_that_is_not_finite_changes_nothing() -> None:
    belief = start()
    same, outcome = fusion.observed(belief, fix(0.0, math.nan, 0.0), SETTINGS)
    assert same is belief
    assert outcome == Rejected(Reason.NOT_FINITE, 0.0)


def test_a_fix_at_the_edge_of_the_gate_hardly_moves_the_velocity() -> None:
    def after_one(off_m: float) -> Belief:
        belief = fusion.with_inertial_velocity(start(sigma_m=0.5), 0.1)
        for k in range(1, 61):
            belief = fusion.propagated(belief, k * S // 2, (10.0, 0.0), SETTINGS)
            belief, _ = fusion.observed(belief, fix(k / 2, 5.0 * k + (off_m if k == 60 else 0.0), 0.0), SETTINGS)
        return belief

    near, far, beyond = after_one(2.9), after_one(4.8), after_one(20.0)
    assert beyond.rejected
    assert not near.rejected
    assert not far.rejected
    assert near.x[V] < 0
    assert abs(far.x[V]) < abs(near.x[V])
    assert far.P[0, 0] > near.P[0, 0]


def test_a_correction_comes_back_as_an_error_of_the_accelerations_of_every_solution() -> None:
    """The autopilot takes what we send for a measurement, and tilts: by the size of the correction, while accelerations drive."""
    belief = fusion.with_inertial_velocity(start(), 0.05)
    first, _ = fusion.observed(belief, fix(0.0, 3.0, 0.0), SETTINGS)
    corrected_m2 = (belief.P - first.P)[:2, :2]
    assert corrected_m2[0, 0] == pytest.approx(4.0 * 4.0 / 5.0)
    expected = 0.05**2 * np.eye(2) + fusion.TILT_MPS2_PER_M**2 * corrected_m2
    np.testing.assert_allclose(first.P[ACCELERATION, ACCELERATION], expected, atol=1e-9)
    for P in first.without.P:
        assert P[A, A] == pytest.approx(0.05**2 + fusion.TILT_MPS2_PER_M**2 * corrected_m2[0, 0])


def test_a_correction_that_is_sent_as_a_reset_tilts_no_more_than_the_largest_that_is_none() -> None:
    """After a gap of the link of 4 s a correction of 13 m made the acceleration unknown by 2 m/s²; fixes drove the velocity."""
    for sigma_m in (20.0, 100.0):
        belief = fusion.with_inertial_velocity(start(sigma_m=sigma_m), 0.05)
        first, _ = fusion.observed(belief, fix(0.0, 0.7 * sigma_m, 0.0), SETTINGS)
        assert first.P[A, A] == pytest.approx(0.05**2 + (fusion.TILT_MPS2_PER_M * fusion.MAX_STEP_M) ** 2)
        for P in first.without.P:
            assert P[A, A] == pytest.approx(first.P[A, A])


def test_a_reset_is_as_large_as_is_configured() -> None:
    for max_step_m in (1.0, 20.0):
        belief = fusion.with_inertial_velocity(start(sigma_m=100.0), 0.05)
        first, _ = fusion.observed(belief, fix(0.0, 70.0, 0.0), SETTINGS, max_step_m)
        assert first.P[A, A] == pytest.approx(0.05**2 + (fusion.TILT_MPS2_PER_M * max_step_m) ** 2)


def test_a_correction_tilts_nothing_while_the_autopilot_flies_on_gnss_that_is_trusted() -> None:
    for drive in (Drive.AUTOPILOT, Drive.FED_BACK):
        after, _ = fusion.observed(start(drive), fix(0.0, 3.0, 0.0), SETTINGS)
        assert after.P[A, A] == pytest.approx(start(drive).P[A, A])


def test_the_noise_of_fixes_is_their_variance_times_their_interval() -> None:
    """Half as many of half the variance are worth the same; a gap does not make them rare."""
    noises = []
    for every_s, sigma in ((0.25, 1.0), (0.5, math.sqrt(0.5)), (1.0, 1.0)):
        belief = start(Drive.INERTIAL)
        for k in range(1, 30):
            carried = fusion.propagated(belief, round(k * every_s * S), (0.0, 0.0), SETTINGS)
            belief, _ = fusion.observed(carried, fix(k * every_s, 0.0, 0.0, sigma), SETTINGS)
        noises.append(belief.fix_noise_m2s)
    assert noises == pytest.approx([0.25, 0.25, 1.0])
    later = belief.t_ns * 1e-9 + 60.0
    carried = fusion.propagated(belief, round(later * S), (0.0, 0.0), SETTINGS)
    assert fusion.observed(carried, fix(later, 0.0, 0.0), SETTINGS)[0].fix_noise_m2s < 1.3
    assert start().fix_noise_m2s == 0.0


def test_poor_fixes_among_good_ones_do_not_make_those_worth_less() -> None:
    """A fix of 10 m after each of 1 m adds 1 % to what is known."""
    belief = start(Drive.INERTIAL)
    for k in range(1, 61):
        carried = fusion.propagated(belief, round(k * 0.5 * S), (0.0, 0.0), SETTINGS)
        belief, _ = fusion.observed(carried, fix(k * 0.5, 0.0, 0.0, 10.0 if k % 2 else 1.0), SETTINGS)
    assert belief.fix_noise_m2s == pytest.approx(1.0, rel=0.15)


def test_a_heading_that_was_pulled_is_in_what_accelerations_drive() -> None:
    inertial = fusion.with_inertial_velocity(start(), 0.1)
    pulled = fusion.with_inertial_velocity(inertial, 0.1, 0.02)
    assert pulled.P[HEADING, HEADING] == pytest.approx(inertial.P[HEADING, HEADING] + 0.02)
    others = np.delete(np.delete(pulled.P - inertial.P, HEADING, 0), HEADING, 1)
    assert not others.any()
    assert fusion.with_inertial_velocity(inertial, 0.1) is inertial


def test_an_interval_in_which_the_present_velocity_hardly_drove_brings_no_doubt() -> None:
    claim = Claim(np.array([0.5, 0.0]), 0.01 * np.eye(2), 0.0, 0, 10.0)
    belief = start()
    for share, doubts in ((0.09, False), (0.5, True)):
        assert (doubting(belief, replace(claim, share=share)).doubt is not None) is doubts
