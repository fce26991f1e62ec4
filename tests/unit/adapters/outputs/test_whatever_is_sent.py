"""Whatever the navigator says, in whatever order: each packet that leaves decodes to finite values inside the fence."""

import math
from itertools import pairwise

import pytest
from hypothesis import event, given, settings
from hypothesis import strategies as st

from visloc_companion.adapters.mavlink.framing import Framer
from visloc_companion.adapters.mavlink.outputs.fence import CATCH_UP_MPS, MAX_AGE_NS, Fence
from visloc_companion.adapters.mavlink.outputs.kinds import Output
from visloc_companion.adapters.mavlink.session import MavlinkSession
from visloc_companion.adapters.mavlink.settings import SessionSettings
from visloc_companion.geo.wgs84 import autopilot_ned_from_geo, distance_m, geo_from_autopilot_ned
from visloc_companion.testing.conversation import Conversation
from visloc_companion.testing.fake_autopilot import FakeAutopilot
from visloc_companion.types import AutopilotKind, GeoPoint, Injection

ORIGIN = GeoPoint(47.3977, 8.5456, 488.0)
FENCE = Fence(47.39, 8.535, 47.405, 8.555, 200.0)
MAX_STEP_M = 5.0
S = 1_000_000_000
POSITIONS = {"VISION_POSITION_ESTIMATE", "ODOMETRY", "GLOBAL_POSITION_SENSOR", "GPS_INPUT", "COMMAND_INT"}
MEANT_NAN = {("COMMAND_INT", "z"), ("GLOBAL_POSITION_SENSOR", "alt_ellipsoid")}
"""NaN is what these fields must hold for "not given"."""
ABLE = {
    Output.VISION_POSITION_ESTIMATE: (AutopilotKind.ARDUPILOT, {}),
    Output.ODOMETRY: (AutopilotKind.PX4, {"EKF2_EV_CTRL": 1}),
    Output.GLOBAL_POSITION_SENSOR: (AutopilotKind.PX4, {"EKF2_AGP0_ID": 1, "EKF2_AGP0_CTRL": 1}),
    Output.GPS_INPUT: (AutopilotKind.ARDUPILOT, {"GPS2_TYPE": 14}),
    Output.EXTERNAL_POSITION_ESTIMATE: (AutopilotKind.ARDUPILOT, {"VISO_TYPE": 0}),
}

any_float = st.floats(width=64)
ground = st.one_of(st.floats(-2500.0, 2500.0), st.floats(-20.0, 20.0))


@st.composite
def steps(draw):
    """One call of `send`: how much later it is, how old the state is, and the state; every third may hold any number at all."""
    wild = draw(st.integers(0, 2)) == 0

    def number(low, high):
        return draw(st.one_of(st.floats(low, high), any_float) if wild else st.floats(low, high))

    def metres():
        return draw(st.one_of(ground, any_float) if wild else ground)

    return {
        "later_ns": draw(st.one_of(st.just(100_000_000), st.integers(0, 3 * S))),
        "age_ns": draw(st.integers(-S, S)) if wild else draw(st.integers(0, MAX_AGE_NS)),
        "p": (metres(), metres(), number(-300.0, 20.0)),
        "var": (number(0.01, 900.0), number(0.01, 900.0)),
        "rho": number(-0.9, 0.9),
        "v": None if wild and draw(st.booleans()) else (number(-30.0, 30.0), number(-30.0, 30.0), number(-5.0, 5.0)),
        "sigmas": (number(0.1, 50.0), number(0.01, 1.0)),
        "counter": draw(st.one_of(st.just(7), st.integers(0, 400))),
        "honest": not wild or draw(st.booleans()),
    }


def made(step, t_ns, kind):
    """The injection of a step; `honest` ones have the place that goes with their local coordinates."""
    p, (nn, ee), v = step["p"], step["var"], step["v"]
    ne = step["rho"] * math.sqrt(abs(nn * ee)) if math.isfinite(nn * ee) else math.nan
    place = ORIGIN
    if step["honest"] and all(map(math.isfinite, p)) and max(map(abs, p)) < 1e5:
        place = geo_from_autopilot_ned(kind, p, ORIGIN)
    cov = ((nn, ne), (ne, ee))
    level = (1.0, 0.0, 0.0, 0.0)
    return Injection(t_ns, p, place, level, cov, *step["sigmas"], step["counter"], v, None if v is None else cov)


def place_of(message, kind, origin):
    match message.get_type():
        case "VISION_POSITION_ESTIMATE" | "ODOMETRY":
            return geo_from_autopilot_ned(kind, (message.x, message.y, message.z), origin)
        case "COMMAND_INT":
            return GeoPoint(message.x * 1e-7, message.y * 1e-7, ORIGIN.h_amsl_m)
        case _:
            return GeoPoint(message.lat * 1e-7, message.lon * 1e-7, message.alt)


def numbers_of(message):
    for name in message.get_fieldnames():
        value = getattr(message, name)
        for number in value if isinstance(value, list | tuple) else [value]:
            if isinstance(number, int | float) and (message.get_type(), name) not in MEANT_NAN:
                yield name, number


def sigma_of(message, kind):
    """1-sigma of the horizontal position as the autopilot reads it."""
    match message.get_type():
        case "VISION_POSITION_ESTIMATE" | "ODOMETRY":
            c = message.covariance if message.get_type().startswith("VISION") else message.pose_covariance
            ardupilot = (c[0] ** 2 + c[6] ** 2 + c[11] ** 2) ** (1 / 3)
            return ardupilot if kind is AutopilotKind.ARDUPILOT else math.sqrt(max(c[0], c[6]))
        case "GLOBAL_POSITION_SENSOR":
            return message.eph
        case "GPS_INPUT":
            return message.horiz_accuracy
        case _:
            return message.param3


@pytest.mark.parametrize("output", list(Output))
@settings(max_examples=60)
@given(sequence=st.lists(steps(), min_size=1, max_size=12))
def test_every_packet_is_finite_inside_the_fence_of_now_and_announces_its_steps(output, sequence):
    kind, params = ABLE[output]
    session = MavlinkSession(SessionSettings(output=output, fence=FENCE, max_step_m=MAX_STEP_M, external_estimate_period_s=0.5))
    plane = output is Output.EXTERNAL_POSITION_ESTIMATE
    talking = Conversation(session, FakeAutopilot(kind=kind, plane=plane, params=params, origin=ORIGIN))
    talking.run(3.0)
    session.outgoing()
    assert session.choice.output is output
    sent, now_ns, framer = [], talking.now_ns, Framer()
    for step in sequence:
        now_ns += step["later_ns"]
        what = made(step, now_ns - step["age_ns"], kind)
        accepted = session.send(what, now_ns)
        messages = [m for m in framer.feed(session.outgoing()) if m.get_type() in POSITIONS]
        assert len(messages) == accepted
        for message in messages:
            sent.append((what, message))
            assert all(math.isfinite(number) for _, number in numbers_of(message))
            assert abs(now_ns - what.t_ns) <= MAX_AGE_NS
            place = place_of(message, kind, ORIGIN)
            assert FENCE.contains(place)
            assert distance_m(place, what.place) < 1.1
            assert 0.005 < sigma_of(message, kind) < 1001.0
    event(f"{min(len(sent), 3)} or more sent")
    for (before, first), (after, second) in pairwise(sent):
        assert after.t_ns >= before.t_ns
        announced(output, kind, (before, first), (after, second))


def announced(output, kind, before, after):
    """A step is told of by the counter, or covered by what is claimed, or each message is a reset."""
    (was, first), (now, second) = before, after
    dt_s = (now.t_ns - was.t_ns) * 1e-9
    v0, v1 = was.v_ned_mps or (0.0, 0.0, 0.0), now.v_ned_mps or was.v_ned_mps or (0.0, 0.0, 0.0)
    here, there = (autopilot_ned_from_geo(kind, place_of(m, kind, ORIGIN), ORIGIN) for m in (first, second))
    step_m = math.hypot(*(there[i] - here[i] - (v0[i] + v1[i]) / 2 * dt_s for i in (0, 1)))
    if step_m <= MAX_STEP_M + 0.1 or output is Output.EXTERNAL_POSITION_ESTIMATE:
        return
    if output in (Output.VISION_POSITION_ESTIMATE, Output.ODOMETRY):
        assert first.reset_counter != second.reset_counter
    else:
        assert sigma_of(second, kind) > min(step_m - 0.1, 999.0) - CATCH_UP_MPS * 0.01
