"""No covariance that claims nothing, or too much, leaves: whatever the numbers are."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from visloc_companion.adapters.mavlink.outputs.covariance import (
    MAX_SIGMA_M,
    MIN_SIGMA_M,
    pose_triangle,
    sigma_m,
    velocity_triangle,
    vertical_sigma_m,
)
from visloc_companion.adapters.mavlink.outputs.encoding import encode
from visloc_companion.adapters.mavlink.outputs.kinds import Output, Vehicle
from visloc_companion.types import AutopilotKind

ANY = st.floats(width=64)
DIAGONAL = (0, 6, 11)


@given(nn=ANY, ne=ANY, ee=ANY, sigma_d_m=ANY, sigma_yaw_rad=ANY)
def test_every_variance_that_is_sent_is_finite_and_no_smaller_than_a_centimetre_squared(
    injection, nn, ne, ee, sigma_d_m, sigma_yaw_rad
):
    cov = ((nn, ne), (ne, ee))
    what = injection(cov_ne_m2=cov, sigma_d_m=sigma_d_m, sigma_yaw_rad=sigma_yaw_rad)
    for entries in (pose_triangle(what, AutopilotKind.PX4), velocity_triangle(cov)):
        assert all(map(math.isfinite, entries))
        assert all(MIN_SIGMA_M**2 <= entries[k] <= MAX_SIGMA_M**2 for k in DIAGONAL)
        assert entries[1] ** 2 < entries[0] * entries[6]
    believed = math.cbrt(sum(pose_triangle(what, AutopilotKind.ARDUPILOT)[k] ** 2 for k in DIAGONAL))
    assert MIN_SIGMA_M * 0.999 <= believed <= MAX_SIGMA_M * 1.001


def test_what_is_no_number_claims_nothing(injection):
    nothing = ((math.nan, 0.0), (0.0, 1.0))
    assert sigma_m(nothing) == MAX_SIGMA_M
    assert vertical_sigma_m(injection(sigma_d_m=math.nan)) == MAX_SIGMA_M
    assert pose_triangle(injection(cov_ne_m2=nothing), AutopilotKind.PX4)[0] == MAX_SIGMA_M**2


@pytest.mark.parametrize(("stream_m", "believed_m"), [(0.0, 2.0), (1.5, 2.0), (3.0, 3.0)])
def test_one_of_many_positions_claims_at_least_what_the_stream_is_worth(injection, stream_m, believed_m):
    what = injection(cov_ne_m2=((4.0, 0.0), (0.0, 1.0)), stream_sigma_m=stream_m)
    believed = math.cbrt(sum(pose_triangle(what, AutopilotKind.ARDUPILOT)[k] ** 2 for k in DIAGONAL))
    assert believed == pytest.approx(believed_m)
    north_m2, east_m2 = (pose_triangle(what, AutopilotKind.PX4)[k] for k in (0, 6))
    assert (north_m2, east_m2) == pytest.approx((max(4.0, stream_m**2), max(1.0, stream_m**2)))


def test_only_a_filter_is_told_of_the_stream(injection):
    alone, stream = injection(), injection(stream_sigma_m=9.0)
    vehicle = Vehicle(AutopilotKind.ARDUPILOT)
    for output in (Output.GLOBAL_POSITION_SENSOR, Output.GPS_INPUT, Output.EXTERNAL_POSITION_ESTIMATE):
        assert encode(output, stream, vehicle).to_dict() == encode(output, alone, vehicle).to_dict()
    odometry = encode(Output.ODOMETRY, stream, vehicle)
    assert odometry.quality == encode(Output.ODOMETRY, alone, vehicle).quality
    assert odometry.pose_covariance[0] == pytest.approx(math.sqrt(9.0**3 / 3))


def test_a_covariance_of_zero_claims_a_centimetre(injection):
    zero = ((0.0, 0.0), (0.0, 0.0))
    assert sigma_m(zero) == MIN_SIGMA_M
    assert pose_triangle(injection(cov_ne_m2=zero), AutopilotKind.PX4)[:1] == [pytest.approx(MIN_SIGMA_M**2)]
