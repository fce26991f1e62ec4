from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import settings as hypothesis_settings
from hypothesis import strategies as st

from visloc_companion.core import output
from visloc_companion.core.alert import Levels, Limits
from visloc_companion.core.protection import Protected
from visloc_companion.core.settings import InjectionSettings
from visloc_companion.geo import wgs84
from visloc_companion.types import AutopilotKind, Cov2, GeoPoint, GnssVerdict, InjectionPolicy, Mode, NavState, Verdict

S = 1_000_000_000
ORIGIN = GeoPoint(59.3, 18.1, 40.0)
LEVEL = (1.0, 0.0, 0.0, 0.0)
STATE = NavState(S, (1200.0, -3400.0, -80.0), (10.0, 0.0, 0.0), ((4.0, 0.5), (0.5, 1.0)), 3.0, 0.4)
SETTINGS = InjectionSettings()
VERDICT = GnssVerdict(Verdict.SUSPECT, 0, ("vision_disagrees",), ())


@pytest.mark.parametrize("kind", list(AutopilotKind))
def test_position_is_in_the_autopilots_own_projection(kind: AutopilotKind) -> None:
    got = output.injection(STATE, LEVEL, ORIGIN, kind, SETTINGS, 7, 3.5)
    assert got is not None
    assert wgs84.distance_m(wgs84.geo_from_autopilot_ned(kind, got.p_ned_m, ORIGIN), got.place) < 0.001
    assert wgs84.ned_from_geo(got.place, ORIGIN) == pytest.approx(STATE.p_ned_m, abs=1e-6)
    assert got.p_ned_m[2] == -80.0
    assert (got.t_ns, got.reset_counter, got.sigma_d_m) == (S, 7, 3.5)


number = st.floats(allow_nan=True, allow_infinity=True, width=64)


@hypothesis_settings(max_examples=300)
@given(st.tuples(number, number, number), st.tuples(number, number, number), st.tuples(number, number, number, number), number)
def test_never_a_number_that_is_not_finite(
    p_ned_m: tuple[float, float, float], cov: tuple[float, float, float], q: tuple[float, float, float, float], sigma: float
) -> None:
    cov2: Cov2 = ((cov[0], cov[1]), (cov[1], cov[2]))
    state = replace(STATE, p_ned_m=p_ned_m, cov_ne_m2=cov2)
    got = output.injection(state, q, ORIGIN, AutopilotKind.ARDUPILOT, SETTINGS, 0, sigma)
    if got is not None:
        (nn, ne), (en, ee) = got.cov_ne_m2
        numbers = (*got.p_ned_m, got.place.lat_deg, got.place.lon_deg, *got.q_ned_frd, nn, ne, en, ee, got.sigma_d_m)
        assert all(math.isfinite(v) for v in numbers)
        assert min(nn, ee) >= SETTINGS.min_sigma_m**2 * (1 - 1e-9)


@hypothesis_settings(max_examples=200)
@given(st.floats(-1e5, 1e5), st.floats(-1e5, 1e5), st.floats(1e-2, 1e6), st.floats(1e-2, 1e6), st.floats(-0.99, 0.99))
def test_every_sane_state_is_injected(north: float, east: float, nn: float, ee: float, rho: float) -> None:
    ne = rho * math.sqrt(nn * ee)
    state = replace(STATE, p_ned_m=(north, east, -50.0), cov_ne_m2=((nn, ne), (ne, ee)))
    got = output.injection(state, LEVEL, ORIGIN, AutopilotKind.PX4, SETTINGS, 0, 3.0)
    assert got is not None
    assert np.linalg.eigvalsh(np.array(got.cov_ne_m2))[0] >= 0.25 * (1 - 1e-6)


def test_a_wider_sigma_is_claimed_where_that_is_asked_for() -> None:
    got = output.injection(STATE, LEVEL, ORIGIN, AutopilotKind.PX4, SETTINGS, 0, 3.0, 9.0)
    assert got is not None
    assert np.linalg.eigvalsh(np.array(got.cov_ne_m2)) == pytest.approx([81.0, 81.0])


def test_absurd_distances_are_not_sent() -> None:
    far = replace(STATE, p_ned_m=(2e6, 0.0, 0.0))
    assert output.injection(far, LEVEL, ORIGIN, AutopilotKind.PX4, SETTINGS, 0, 3.0) is None


@pytest.mark.parametrize(
    ("policy", "ok", "suspect"),
    [(InjectionPolicy.NEVER, False, False), (InjectionPolicy.WHEN_UNRELIABLE, False, True), (InjectionPolicy.ALWAYS, True, True)],
)
def test_policy(policy: InjectionPolicy, ok: bool, suspect: bool) -> None:
    assert output.is_due(policy, Verdict.OK) is ok
    assert output.is_due(policy, Verdict.SUSPECT) is suspect
    assert output.is_due(policy, Verdict.DENIED) is suspect


def test_the_velocity_goes_with_a_covariance_of_its_own() -> None:
    known = replace(STATE, cov_v_ne_m2ps2=((0.36, 0.02), (0.02, 0.25)))
    got = output.injection(known, LEVEL, ORIGIN, AutopilotKind.PX4, SETTINGS, 0, 3.0)
    assert got is not None
    assert (got.v_ned_mps, got.cov_v_ne_m2ps2) == (STATE.v_ned_mps, known.cov_v_ne_m2ps2)
    sure = output.velocity(replace(STATE, cov_v_ne_m2ps2=((1e-4, 0.0), (0.0, 1e-4))))[1]
    assert sure == pytest.approx(np.diag([output.LEAST_SIGMA_MPS**2] * 2))


@pytest.mark.parametrize(
    "change",
    [
        {"cov_v_ne_m2ps2": None},
        {"cov_v_ne_m2ps2": ((math.nan, 0.0), (0.0, 1.0))},
        {"cov_v_ne_m2ps2": ((1.0, 2.0), (2.0, 1.0))},
        {"v_ned_mps": (math.inf, 0.0, 0.0)},
        {"v_ned_mps": (0.0, 500.0, 0.0)},
    ],
)
def test_a_velocity_that_is_not_known_is_not_made_up(change: dict[str, object]) -> None:
    state = replace(STATE, cov_v_ne_m2ps2=((1.0, 0.0), (0.0, 1.0)))
    assert output.velocity(replace(state, **change)) == (None, None)  # type: ignore[arg-type]


def moving(t_s: float, extra_north: float = 0.0) -> NavState:
    return replace(STATE, t_ns=round(t_s * S), p_ned_m=(10.0 * t_s + extra_north, 0.0, -80.0))


def test_reset_counter_counts_steps_restarts_and_nothing_else() -> None:
    counter = output.ResetCounter(5.0)
    assert counter.follow(moving(0.0), 0) == 0
    assert counter.follow(moving(0.1), 0) == 0
    assert counter.follow(moving(60.0), 0) == 0  # motion is no step
    assert counter.follow(moving(60.1, 4.9), 0) == 0
    assert counter.follow(moving(60.2, 10.0), 0) == 1
    assert counter.follow(moving(60.3, 10.0), 0) == 1
    assert counter.follow(moving(60.4, 10.0), S) == 2
    counter.bump()
    assert counter.follow(moving(60.5, 900.0), S) == 3
    assert counter.count == 3


def test_reset_counter_is_a_byte() -> None:
    counter = output.ResetCounter(5.0)
    for _ in range(257):
        counter.bump()
    assert counter.count == 1


def test_status() -> None:
    protected = Protected(Levels(6.5, 12.0), Limits(25.0, 50.0), -3.0, alert=True)
    got = output.status(STATE, None, protected, ORIGIN, Mode.SHADOW, VERDICT, 3, injected=False)
    assert got.age_of_fix_s is None
    assert got.place is not None
    assert got.reasons == ("vision_disagrees",)
    assert (got.protection_level_m, got.vertical_protection_level_m, got.height_offset_m) == (6.5, 12.0, -3.0)
    assert (got.alert_limit_m, got.vertical_alert_limit_m, got.available, got.alert) == (25.0, 50.0, True, True)
    unknown = Protected(Levels(None, 12.0), Limits(25.0, 50.0))
    fixed = output.status(STATE, S // 2, unknown, ORIGIN, Mode.AIDING, VERDICT, 3, injected=True)
    assert not fixed.available
    assert fixed.age_of_fix_s == pytest.approx(0.5)
    empty = output.empty_status(5, Mode.WAITING, VERDICT, 2)
    assert (empty.place, empty.protection_level_m, empty.age_of_fix_s, empty.injected) == (None, None, None, False)


def test_positions_together_claim_what_their_fixes_are_worth() -> None:
    """Whatever the rate, as much noise (variance times interval) is claimed as the fixes have."""
    for rate_hz in (5.0, 10.0, 30.0):
        assert output.stream_sigma_m(0.1225, 0.05, rate_hz) ** 2 / rate_hz == pytest.approx(0.1225)
    assert output.stream_sigma_m(0.0, 0.05, 10.0) == 0.0


def test_the_autopilot_is_to_follow_sooner_where_its_accelerations_are_worse_than_it_reckons() -> None:
    good = output.stream_sigma_m(0.1225, 0.05, 10.0)
    assert output.stream_sigma_m(0.1225, 0.01, 10.0) == good
    assert output.stream_sigma_m(0.1225, 0.2, 10.0) == pytest.approx(good / 4)
