"""Which output is sent to which autopilot, and why not another."""

import pytest

from visloc_companion.adapters.mavlink.outputs.choice import RULES, choose_output, parameter_names
from visloc_companion.adapters.mavlink.outputs.kinds import Output, Vehicle
from visloc_companion.types import AutopilotKind

ARDUPILOT, PX4, UNKNOWN = AutopilotKind.ARDUPILOT, AutopilotKind.PX4, AutopilotKind.UNKNOWN
VPE, ODOMETRY, SENSOR, GPS, ESTIMATE = Output
PREPARED = {"VISO_TYPE": 1, "VISO_QUAL_MIN": 0, "EK3_SRC2_POSXY": 6, "GPS1_TYPE": 1, "GPS2_TYPE": 0}
PREPARED_PX4 = {"EKF2_EV_CTRL": 1, "EKF2_EV_QMIN": 0, "EKF2_AGP0_ID": 0, "EKF2_AGP0_CTRL": 0}


def vehicle(kind: AutopilotKind, plane: bool | None = False, **changes: float) -> Vehicle:
    prepared = {ARDUPILOT: PREPARED, PX4: PREPARED_PX4, UNKNOWN: {}}[kind]
    return Vehicle(kind, 1, plane, {**prepared, **changes}, True)


@pytest.mark.parametrize(
    ("what", "expected"),
    [
        (vehicle(ARDUPILOT), VPE),
        (vehicle(PX4), VPE),
        (vehicle(UNKNOWN), VPE),
        (Vehicle(), VPE),
        (Vehicle(ARDUPILOT), VPE),
        (Vehicle(PX4, complete=True), VPE),
        (vehicle(ARDUPILOT, VISO_QUAL_MIN=50), ODOMETRY),
        (vehicle(PX4, EKF2_EV_QMIN=50), ODOMETRY),
        (vehicle(ARDUPILOT, GPS2_TYPE=14, EK3_SRC2_POSXY=3), GPS),
        (vehicle(ARDUPILOT, GPS2_TYPE=14), VPE),
        (vehicle(ARDUPILOT, plane=True), VPE),
        (vehicle(ARDUPILOT, plane=True, VISO_TYPE=0), ESTIMATE),
        (vehicle(ARDUPILOT, plane=True, EK3_SRC2_POSXY=0), ESTIMATE),
        (vehicle(PX4, EKF2_EV_CTRL=0, EKF2_AGP0_ID=1, EKF2_AGP0_CTRL=1), SENSOR),
        (vehicle(PX4, EKF2_EV_CTRL=0, EKF2_AGP2_ID=1, EKF2_AGP2_CTRL=3), SENSOR),
        (vehicle(PX4, EKF2_AGP0_ID=1, EKF2_AGP0_CTRL=1), VPE),
    ],
)
def test_auto_takes_what_the_vehicle_is_prepared_for(what, expected):
    choice = choose_output(None, what)
    assert choice.output is expected
    assert expected.value.upper() in str(choice)


@pytest.mark.parametrize(
    ("wanted", "what", "remedy"),
    [
        (GPS, vehicle(PX4, GPS2_TYPE=14), "auto"),
        (GPS, vehicle(ARDUPILOT), "GPS2_TYPE 14"),
        (SENSOR, vehicle(ARDUPILOT), "auto"),
        (SENSOR, Vehicle(PX4, 1, False, {"EKF2_EV_CTRL": 1}, True), "update PX4"),
        (SENSOR, vehicle(PX4), "EKF2_AGP0_ID"),
        (SENSOR, vehicle(PX4, EKF2_AGP0_ID=2, EKF2_AGP0_CTRL=1), "EKF2_AGP0_ID"),
        (SENSOR, vehicle(PX4, EKF2_AGP0_ID=1, EKF2_AGP0_CTRL=0), "EKF2_AGP0_CTRL 1"),
        (ESTIMATE, vehicle(ARDUPILOT), "auto"),
        (ESTIMATE, vehicle(PX4), "auto"),
        (ODOMETRY, vehicle(UNKNOWN), "auto"),
        (VPE, vehicle(ARDUPILOT, VISO_TYPE=0), "VISO_TYPE 1"),
        (ODOMETRY, vehicle(ARDUPILOT, VISO_TYPE=2), "VISO_TYPE 1"),
        (VPE, vehicle(ARDUPILOT, VISO_TYPE=3), "VISO_TYPE 1"),
        (VPE, vehicle(ARDUPILOT, VISO_QUAL_MIN=1), "odometry"),
        (VPE, vehicle(PX4, EKF2_EV_QMIN=1), "odometry"),
        (ODOMETRY, vehicle(PX4, EKF2_EV_CTRL=14), "EKF2_EV_CTRL 1"),
        (None, vehicle(PX4, EKF2_EV_CTRL=0), "EKF2_EV_CTRL 1"),
        (None, vehicle(ARDUPILOT, VISO_TYPE=0), "VISO_TYPE 1"),
    ],
)
def test_what_cannot_work_is_refused_with_a_remedy(wanted, what, remedy):
    choice = choose_output(wanted, what)
    assert choice.output is None
    assert remedy in choice.remedy
    assert "no positions are sent" in str(choice)


@pytest.mark.parametrize(
    ("wanted", "what"),
    [
        (VPE, vehicle(PX4)),
        (ODOMETRY, vehicle(PX4)),
        (ODOMETRY, vehicle(ARDUPILOT, VISO_QUAL_MIN=50)),
        (GPS, vehicle(ARDUPILOT, GPS2_TYPE=14)),
        (GPS, Vehicle(ARDUPILOT, 1, False, {"GPS_TYPE": 1, "GPS_TYPE2": 14}, True)),
        (SENSOR, vehicle(PX4, EKF2_AGP0_ID=1, EKF2_AGP0_CTRL=1)),
        (ESTIMATE, vehicle(ARDUPILOT, plane=True)),
        (GPS, Vehicle(ARDUPILOT)),
        (SENSOR, Vehicle(PX4, complete=True)),
        (ESTIMATE, Vehicle(ARDUPILOT)),
    ],
)
def test_what_the_configuration_names_is_sent_unless_something_speaks_against_it(wanted, what):
    assert choose_output(wanted, what).output is wanted


def test_the_receiver_that_we_play_is_the_one_of_type_14():
    assert vehicle(ARDUPILOT).gps_instance is None
    assert vehicle(ARDUPILOT, GPS2_TYPE=14).gps_instance == 1
    assert vehicle(ARDUPILOT, GPS1_TYPE=14).gps_instance == 0


def test_the_rules_ask_only_for_what_is_read():
    """A misspelt name would never be known, and its rule never fit."""
    for kind in (ARDUPILOT, PX4):
        asked: list[str] = []

        class Spy(dict[str, float]):
            def __contains__(self, name: object) -> bool:
                asked.append(str(name))  # noqa: B023
                return False

        choose_output(None, Vehicle(kind, 1, True, Spy(), True))
        for wanted in Output:
            choose_output(wanted, Vehicle(kind, 1, True, Spy(), True))
        own = {name for name in asked if name.startswith("EKF2") is (kind is PX4)}
        assert own <= set(parameter_names(Vehicle(kind)))
        assert len(parameter_names(Vehicle(kind))) <= 10
    assert parameter_names(Vehicle()) == ()
    assert RULES[-1][1](Vehicle())
