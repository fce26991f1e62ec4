"""Autopilots of several versions: names that were changed, and values that mean something else or are not there."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import pytest

from tests.unit.doctor.breaks import BREAKS
from tests.unit.doctor.changes import Break, Change, both, config, link, parameters, version, without
from visloc_companion.doctor.facts import Facts
from visloc_companion.doctor.finding import Level, judge
from visloc_companion.doctor.parameter_file import changes
from visloc_companion.doctor.rules.ardupilot_link import baud_of
from visloc_companion.doctor.rules.registry import RULES
from visloc_companion.types import AutopilotKind

AP, PX4 = AutopilotKind.ARDUPILOT, AutopilotKind.PX4
Good = Callable[[AutopilotKind], Facts]

OLD_NAMES = {
    "MAV_SYSID": "SYSID_THISMAV",
    "MAV_GCS_SYSID": "SYSID_MYGCS",
    "MAV1_EXTRA1": "SR0_EXTRA1",
    "GPS1_TYPE": "GPS_TYPE",
    "GPS2_TYPE": "GPS_TYPE2",
    "MNT1_TYPE": "MNT_TYPE",
}
"""What ArduPilot called parameters before 4.3 (MNT1_TYPE), 4.6 (GPS1_TYPE, GPS2_TYPE) and 4.7."""


def older(facts: Facts) -> Facts:
    """The same vehicle as an older version names its parameters."""
    renamed = {OLD_NAMES.get(name, name): value for name, value in facts.parameters.items()}
    return replace(facts, parameters=renamed)


def newest(facts: Facts) -> Facts:
    """The same vehicle with 4.7.0, which has the checks that are left out instead of those that are done."""
    kept = {name: value for name, value in facts.parameters.items() if name != "ARMING_CHECK"}
    return replace(facts, parameters={**kept, "ARMING_SKIPCHK": 262144.0})


def renamed_breaks() -> list[Break]:
    """Those that change a parameter of another name in an older version."""
    named = [case for case in BREAKS if case.kind is AP and any(name in case.names for name in OLD_NAMES)]
    return [case for case in named if not any(name in case.names for name in ("MAV10_EXTRA1", "SR0_EXTRA1"))]


@pytest.mark.parametrize("vehicle", [older, newest])
def test_a_vehicle_of_another_version_that_is_set_up_rightly_is_green(good: Good, vehicle: Change) -> None:
    facts = vehicle(good(AP))
    answers = judge(RULES, facts)
    assert [(a.rule.id, a.read) for a in answers if a.level in (Level.RED, Level.AMBER)] == []
    assert [(a.rule.id, a.read) for a in answers if a.level is Level.SKIPPED and a.rule.only is not PX4] == []
    assert changes(RULES, facts) == {}


@pytest.mark.parametrize("case", renamed_breaks(), ids=lambda case: f"{case.rule} {case.level}")
def test_an_older_version_is_judged_by_its_own_names(good: Good, case: Break) -> None:
    facts = older(case.change(good(AP)))
    (answer,) = [a for a in judge(RULES, facts) if a.rule.id == case.rule]
    assert str(answer.level) == case.level
    assert set(answer.parameters) <= set(facts.parameters)


@pytest.mark.parametrize("case", BREAKS, ids=lambda case: f"{case.rule} {case.level}")
def test_only_what_the_vehicle_has_is_to_be_set(good: Good, case: Break) -> None:
    facts = case.change(good(case.kind))
    assert set(changes(RULES, facts)) <= set(facts.parameters)


def test_a_compass_that_cannot_be_switched_off_is_not_switched_on(good: Good) -> None:
    facts = both(without("COMPASS_ENABLE"), parameters(COMPASS_USE=0))(good(AP))
    assert changes(RULES, facts) == {"COMPASS_USE": 1.0}


@pytest.mark.parametrize("arming", [{"ARMING_SKIPCHK": 0.0}, {"ARMING_CHECK": 1.0}])
def test_the_arming_check_is_left_out_by_the_name_that_the_vehicle_has(good: Good, arming: dict[str, float]) -> None:
    (name,) = arming
    facts = without("ARMING_CHECK", **arming)(good(AP))
    assert changes(RULES, facts) == {name: 262144.0 if name == "ARMING_SKIPCHK" else 786430.0}


def test_what_the_vehicle_lacks_is_named_by_all_its_names(good: Good) -> None:
    facts = without("GPS2_TYPE")(good(AP))
    facts = link(parameters_expected=len(facts.parameters))(facts)
    (answer,) = [a for a in judge(RULES, facts) if a.rule.id == "ap-second-receiver"]
    assert (answer.level, answer.read) == (Level.SKIPPED, "the autopilot has no parameter GPS2_TYPE or GPS_TYPE2")
    assert "another name" in answer.remedy


@pytest.mark.parametrize(("value", "baud"), [(921, 921_600), (1500, 1_500_000), (2000, 2_000_000), (57_600, 57_600), (0, 57_600)])
def test_speeds_of_ports_are_read_as_ardupilot_does(value: float, baud: int) -> None:
    """AP_SerialManager::map_baudrate."""
    assert baud_of(value) == baud


@pytest.mark.parametrize(
    ("rule", "kind", "change"),
    [
        ("ap-compass", AP, parameters(COMPASS_USE=0, COMPASS_USE2=1, COMPASS_PRIO2_ID=97539.0)),
        ("ap-serial-baud", AP, both(parameters(SERIAL1_BAUD=2000), link(url="serial:/dev/ttyS0:2000000"))),
        ("px4-mavlink-mode", PX4, parameters(MAV_1_MODE=8)),
        ("px4-mavlink-rate", PX4, parameters(MAV_1_MODE=8)),
        ("px4-mavlink-mode", PX4, parameters(MAV_1_MODE=11)),
        ("px4-mavlink-version", PX4, parameters(MAV_PROTO_VER=1)),
        ("px4-dds-port", PX4, parameters(MAV_2_CONFIG=1000, MAV_2_MODE=2, UXRCE_DDS_CFG=1000)),
        ("px4-gnss-spoof-check", PX4, version("1.15.4", parameters(EKF2_GPS_CHECK=245))),
    ],
)
def test_what_works_is_not_held_against_the_autopilot(good: Good, rule: str, kind: AutopilotKind, change: Change) -> None:
    (answer,) = [a for a in judge(RULES, change(good(kind))) if a.rule.id == rule]
    assert (answer.level, answer.parameters) == (Level.GREEN, {})


@pytest.mark.parametrize(
    "change",
    [
        parameters(COMPASS_USE=0, COMPASS_USE2=1, COMPASS_PRIO2_ID=0),
        parameters(COMPASS_USE=0, COMPASS_USE2=0, COMPASS_PRIO2_ID=97539.0),
        parameters(COMPASS_ENABLE=0, COMPASS_USE2=1, COMPASS_PRIO2_ID=97539.0),
    ],
)
def test_a_second_compass_that_is_not_there_or_not_in_use_is_none(good: Good, change: Change) -> None:
    (answer,) = [a for a in judge(RULES, change(good(AP))) if a.rule.id == "ap-compass"]
    assert answer.level is Level.RED


def test_a_gimbal_of_an_older_version_is_known(good: Good) -> None:
    """MNT_TYPE 1 before 4.3: a servo, whose angle counts from the airframe."""
    facts = both(config("camera", mount="gimbal"), parameters(MNT_TYPE=1))(good(AP))
    answers = {a.rule.id: a for a in judge(RULES, facts)}
    assert answers["camera-gimbal-frame"].level is Level.RED
    assert answers["camera-gimbal-measured"].read.startswith("MNT_TYPE = 1")
