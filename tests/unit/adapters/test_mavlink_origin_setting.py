"""Who is given an origin, and who never."""

import pytest

from visloc_companion.adapters.mavlink.dialect import mav
from visloc_companion.adapters.mavlink.origin_setting import PATIENCE_NS, PERIOD_NS, OriginSetter
from visloc_companion.adapters.mavlink.session import MavlinkSession
from visloc_companion.adapters.mavlink.settings import SessionSettings
from visloc_companion.sim.autopilot import BuiltInAutopilot
from visloc_companion.sim.faults import jam
from visloc_companion.types import AutopilotKind, GeoPoint, LinkChanged, OriginChanged

MIDDLE = GeoPoint(47.4, 8.55, 490.0)
ARDUPILOT, PX4 = AutopilotKind.ARDUPILOT, AutopilotKind.PX4


def link(kind: AutopilotKind, armed: bool = False) -> LinkChanged:
    return LinkChanged(0, True, kind, "", 4, armed)


def setter(place: GeoPoint | None = MIDDLE) -> OriginSetter:
    waiting = OriginSetter(place)
    waiting.restart(0)
    return waiting


@pytest.mark.parametrize("kind", [ARDUPILOT, PX4])
def test_without_origin_and_gnss_it_is_told_the_middle_of_the_map_again_and_again(kind):
    waiting = setter()
    assert waiting.poll(link(kind), False, PATIENCE_NS - 1) is None
    message = waiting.poll(link(kind), False, PATIENCE_NS)
    assert (message.target_system, message.latitude, message.longitude, message.altitude) == (4, 474000000, 85500000, 490000)
    assert waiting.poll(link(kind), False, PATIENCE_NS + PERIOD_NS - 1) is None
    assert waiting.poll(link(kind), False, PATIENCE_NS + PERIOD_NS) is not None
    assert waiting.poll(link(kind), True, 10 * PATIENCE_NS) is None


def test_an_armed_px4_is_never_told_because_its_frame_would_move():
    assert setter().poll(link(PX4, armed=True), False, PATIENCE_NS) is None
    assert setter().poll(link(ARDUPILOT, armed=True), False, PATIENCE_NS) is not None


def test_unknown_autopilots_are_not_told_and_nobody_without_a_map():
    assert setter().poll(link(AutopilotKind.UNKNOWN), False, PATIENCE_NS) is None
    assert setter(None).poll(link(PX4), False, PATIENCE_NS) is None


def test_an_autopilot_that_hears_satellites_finds_its_own():
    waiting = setter()
    packer = mav.MAVLink(None, 4, 1)

    def heard(fix_type: int, now_ns: int) -> None:
        raw = mav.MAVLink_gps_raw_int_message(0, fix_type, 0, 0, 0, 0, 0, 0, 0, 9)
        waiting.hear(packer.decode(bytearray(raw.pack(packer))), now_ns)

    heard(3, PATIENCE_NS)
    heard(1, 2 * PATIENCE_NS - 1)
    assert waiting.poll(link(PX4), False, 2 * PATIENCE_NS - 1) is None
    assert waiting.poll(link(PX4), False, 2 * PATIENCE_NS) is not None


def test_an_autopilot_without_gnss_takes_it_and_tells_it():
    pilot = BuiltInAutopilot(ARDUPILOT, "copter", MIDDLE, [(0, 0, -40)], 5.0, seed=1, faults=jam(0.0), start_airborne=False)
    session = MavlinkSession(SessionSettings(origin_to_set=MIDDLE))
    now_ns, events = 10**9, []
    for _ in range(1500):
        pilot.step(0.01)
        now_ns += 10_000_000
        events += session.receive(pilot.outgoing(), now_ns)
        events += session.poll(now_ns)
        pilot.receive(session.outgoing())
    (origin,) = [e.origin for e in events if isinstance(e, OriginChanged)]
    assert origin == MIDDLE
