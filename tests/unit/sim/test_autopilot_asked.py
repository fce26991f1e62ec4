"""What the simulated autopilot answers to who examines it: all parameters, its mission, home."""

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from visloc_companion.geo.wgs84 import distance_m, geo_from_ned
from visloc_companion.sim.autopilot import BuiltInAutopilot
from visloc_companion.sim.autopilots.autopilot_parameters import PREPARED, TOLD, decode
from visloc_companion.types import AutopilotKind, GeoPoint

HOME = GeoPoint(47.3977, 8.5456, 488.0)
MISSION = [(0.0, 0.0, -100.0), (300.0, -200.0, -80.0)]


class Asker:
    """Sends one message to a simulated autopilot and decodes what comes back at once."""

    def __init__(self, kind):
        self.pilot = BuiltInAutopilot(kind, "copter", HOME, MISSION, 10.0, 1)
        self.pilot.step(2.0)
        self.pilot.outgoing()
        self._mav = mavlink.MAVLink(None, srcSystem=1, srcComponent=191)

    def ask(self, message):
        self.pilot.receive(message.pack(self._mav))
        return self._mav.parse_buffer(self.pilot.outgoing()) or []


@pytest.mark.parametrize("kind", PREPARED)
def test_every_parameter_is_listed_with_its_number(kind):
    answers = Asker(kind).ask(mavlink.MAVLink_param_request_list_message(1, 1))
    wanted = PREPARED[kind] | TOLD[kind]
    assert [answer.param_index for answer in answers] == list(range(len(wanted)))
    assert {answer.param_count for answer in answers} == {len(wanted)}
    found = {answer.param_id: decode(kind, answer.param_id, answer.param_value) for answer in answers}
    assert found == pytest.approx(wanted)


def test_the_mission_is_told_item_by_item():
    asker = Asker(AutopilotKind.PX4)
    (count,) = asker.ask(mavlink.MAVLink_mission_request_list_message(1, 1))
    assert count.count == len(MISSION)
    for number, where in enumerate(MISSION):
        (item,) = asker.ask(mavlink.MAVLink_mission_request_int_message(1, 1, number))
        assert item.seq == number
        assert distance_m(GeoPoint(item.x / 1e7, item.y / 1e7, 0.0), geo_from_ned(where, HOME)) < 0.1
        assert item.z == pytest.approx(-where[2], abs=0.1)
    assert asker.ask(mavlink.MAVLink_mission_request_int_message(1, 1, 2)) == []


def test_home_is_told_to_who_asks():
    request = mavlink.MAVLink_command_long_message(1, 1, mavlink.MAV_CMD_REQUEST_MESSAGE, 0, 242, 0, 0, 0, 0, 0, 0)
    home = next(m for m in Asker(AutopilotKind.ARDUPILOT).ask(request) if m.get_type() == "HOME_POSITION")
    assert (home.latitude, home.longitude) == (473977000, 85456000)
