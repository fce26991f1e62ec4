"""A velocity is believed as far as the autopilot vouches for it."""

from __future__ import annotations

import pytest

from visloc_companion.core.filter.propagation import Drive
from visloc_companion.core.velocity.vouching import DRIFT_MPS2, MOST_MPS, Vouching
from visloc_companion.types import EstimatorStatus

S = 1_000_000_000
V = (9.0, -24.0, 0.5)


def status(at_s: float, velocity_ok: bool | None, position_ok: bool = False) -> EstimatorStatus:
    return EstimatorStatus(round(at_s * S), None, None, None, position_ok, False, None, velocity_ok=velocity_ok)


def test_before_the_estimator_says_anything_its_velocity_is_believed() -> None:
    got = Vouching().judged(V, S, 0.8, Drive.AUTOPILOT)
    assert (got.v_ned_mps, got.sigma_mps, got.drive) == (V, 0.8, Drive.AUTOPILOT)


@pytest.mark.parametrize("position_ok", [True, False])
def test_a_velocity_that_is_vouched_for_needs_no_position(position_ok: bool) -> None:
    vouching = Vouching()
    vouching.on_status(status(1, True, position_ok))
    assert vouching.judged(V, S, 0.8, Drive.FED_BACK).sigma_mps == 0.8


def test_a_velocity_that_was_never_vouched_for_is_none() -> None:
    vouching = Vouching()
    vouching.on_status(status(1, False, position_ok=True))
    got = vouching.judged(V, 2 * S, 0.8, Drive.FED_BACK)
    assert (got.v_ned_mps, got.sigma_mps, got.drive) == ((0.0, 0.0, 0.5), MOST_MPS, Drive.NONE)


def test_one_that_was_vouched_for_is_believed_less_and_less_and_then_not_at_all() -> None:
    vouching = Vouching()
    vouching.on_status(status(10, True))
    vouching.on_status(status(11, False))
    first, later = (vouching.judged(V, t * S, 0.8, Drive.AUTOPILOT) for t in (11, 31))
    assert first.v_ned_mps == later.v_ned_mps == V
    assert later.sigma_mps - first.sigma_mps == pytest.approx(20 * DRIFT_MPS2)
    assert first.sigma_mps > 3.0
    assert vouching.judged(V, 60 * S, 0.8, Drive.AUTOPILOT).drive is Drive.NONE
    vouching.on_status(status(61, True))
    assert vouching.judged(V, 61 * S, 0.8, Drive.AUTOPILOT).sigma_mps == 0.8


def test_what_an_autopilot_vouched_for_before_it_restarted_is_past() -> None:
    vouching = Vouching()
    vouching.on_status(status(10, True))
    vouching.on_status(status(11, False))
    vouching.forget()
    assert vouching.judged(V, 11 * S, 0.8, Drive.AUTOPILOT).drive is Drive.NONE


@pytest.mark.parametrize(("position_ok", "sigma_mps"), [(True, 0.8), (False, 3.0)])
def test_a_log_that_says_nothing_of_the_velocity_is_judged_by_the_position(position_ok: bool, sigma_mps: float) -> None:
    vouching = Vouching()
    vouching.on_status(status(1, None, position_ok))
    got = vouching.judged(V, 100 * S, 0.8, Drive.AUTOPILOT)
    assert (got.v_ned_mps, got.sigma_mps, got.drive) == (V, sigma_mps, Drive.AUTOPILOT)


def test_an_autopilot_that_begins_to_vouch_on_our_positions_is_given_time() -> None:
    vouching = Vouching()
    vouching.on_status(status(1, False))
    assert vouching.judged(V, S, 0.8, Drive.AUTOPILOT, settled=False).drive is Drive.NONE
    vouching.on_status(status(2, True))
    assert vouching.judged(V, 2 * S, 0.8, Drive.FED_BACK, settled=False).drive is Drive.NONE
    assert vouching.judged(V, 7 * S, 0.8, Drive.FED_BACK, settled=True).v_ned_mps == V
    assert vouching.judged(V, 8 * S, 0.8, Drive.FED_BACK, settled=False).v_ned_mps == V  # after another seed


def test_one_that_vouches_by_itself_needs_no_time() -> None:
    vouching = Vouching()
    vouching.on_status(status(1, False))
    vouching.judged(V, S, 0.8, Drive.AUTOPILOT, settled=False)
    vouching.on_status(status(2, True))
    assert vouching.judged(V, 2 * S, 0.8, Drive.AUTOPILOT, settled=False).v_ned_mps == V
