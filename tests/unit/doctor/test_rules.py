"""Every rule: green on good facts, broken by one change, with a remedy that names what to set; skipped without facts."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest

from tests.unit.doctor.breaks import BREAKS
from tests.unit.doctor.changes import SLOW_LINE, Break, Change, both, config, link, parameters, without, without_all
from visloc_companion.doctor.facts import Facts, GimbalHeard
from visloc_companion.doctor.finding import Level, agree, judge
from visloc_companion.doctor.parameter_file import changes
from visloc_companion.doctor.rules.px4_height import qnh_hpa
from visloc_companion.doctor.rules.registry import RULES, THEMES
from visloc_companion.types import AutopilotKind

KINDS = [AutopilotKind.ARDUPILOT, AutopilotKind.PX4]
Good = Callable[[AutopilotKind], Facts]


def test_there_are_enough_rules_each_with_its_own_name_and_words() -> None:
    assert len(RULES) >= 45
    assert len({rule.id for rule in RULES}) == len(RULES)
    for rule in RULES:
        assert re.fullmatch(r"[a-z0-9]+(-[a-z0-9]+)+", rule.id)
        assert rule.reads and rule.why.endswith(".") and rule.remedy


def test_every_rule_is_broken_by_a_test() -> None:
    assert {case.rule for case in BREAKS} == {rule.id for rule in RULES}


@pytest.mark.parametrize("kind", KINDS)
def test_all_is_green_where_nothing_is_wrong(good: Good, kind: AutopilotKind) -> None:
    answers = judge(RULES, good(kind))
    assert [(a.rule.id, a.read) for a in answers if a.level in (Level.RED, Level.AMBER)] == []
    assert {a.rule.only for a in answers if a.level is Level.SKIPPED} == {other for other in KINDS if other is not kind}
    assert all(not a.remedy and not a.parameters for a in answers if a.level is Level.GREEN)


@pytest.mark.parametrize("case", BREAKS, ids=lambda case: f"{case.rule} {case.level}")
def test_a_change_breaks_the_rule(good: Good, case: Break) -> None:
    (answer,) = [a for a in judge(RULES, case.change(good(case.kind))) if a.rule.id == case.rule]
    assert (str(answer.level), answer.read != "") == (case.level, True)
    assert case.names in answer.remedy


@pytest.mark.parametrize(
    ("kind", "more"),
    [
        (KINDS[0], parameters(MNT1_TYPE=8)),
        (KINDS[0], both(parameters(MNT1_TYPE=1), config("camera", mount="gimbal", gimbal_frame="airframe"))),
        (KINDS[1], parameters(MNT_MODE_IN=0, MNT_MODE_OUT=2)),
    ],
)
def test_a_gimbal_that_is_set_up_is_green(good: Good, kind: AutopilotKind, more: Change) -> None:
    """But that ArduPilot knows of servos only what it told them."""
    heard = link(gimbals=(GimbalHeard(1, 25.0, frozenset({"heading"})),))
    facts = more(heard(config("camera", mount="gimbal")(good(kind))))
    worse = {a.rule.id for a in judge(RULES, facts) if a.level in (Level.RED, Level.AMBER)}
    assert worse == ({"camera-gimbal-measured"} if facts.parameters.get("MNT1_TYPE") == 1 else set())


def test_what_cannot_be_read_of_a_gimbal_is_skipped(good: Good) -> None:
    facts = replace(config("camera", mount="gimbal")(good(KINDS[0])), link=None, parameters={})
    answers = {a.rule.id: a.level for a in judge(RULES, facts)}
    rules = ("camera-gimbal", "camera-gimbal-rate", "camera-gimbal-frame", "camera-gimbal-measured")
    assert [answers[rule] for rule in rules] == [Level.GREEN, Level.SKIPPED, Level.SKIPPED, Level.SKIPPED]


def test_the_gimbal_that_carries_the_camera_is_judged(good: Good) -> None:
    """Another one on the same vehicle may be as slow as it likes."""
    slow, ours = GimbalHeard(1, 1.0, frozenset()), GimbalHeard(154, 20.0, frozenset({"north"}))
    facts = link(gimbals=(slow, ours))(config("camera", mount="gimbal", gimbal_id=154)(good(KINDS[1])))
    answers = {a.rule.id: a for a in judge(RULES, facts)}
    assert answers["camera-gimbal-rate"].level is Level.GREEN
    assert answers["camera-gimbal-frame"].level is Level.GREEN


def test_the_pressure_that_mends_a_barometer_is_the_days() -> None:
    """PX4's simulator at 488 m on a standard day, SENS_BARO_QNH 10 hPa below it: 405.5 m (docs/px4.md)."""
    assert qnh_hpa(405.5, 488.0, 1003.25) == pytest.approx(1013.25, abs=0.1)
    assert qnh_hpa(0.0, 0.0, 990.0) == 990.0


def test_what_a_measured_height_asks_for_is_not_set_by_itself(good: Good) -> None:
    """Judged again with the new pressure and the old height it asked for ever more: 1172 hPa in PX4's simulator."""
    facts = both(parameters(SENS_BARO_QNH=1003.25), link(barometer_h_amsl_m=405.5))(good(KINDS[1]))
    assert "SENS_BARO_QNH" not in changes(RULES, facts)


SLOW = link(url=SLOW_LINE)
TWO_OLD = parameters(SERIAL1_PROTOCOL=1, SERIAL1_BAUD=57, SERIAL2_PROTOCOL=1, SERIAL2_BAUD=57)


@pytest.mark.parametrize(
    ("kind", "change", "rule", "words"),
    [
        (KINDS[0], both(SLOW, TWO_OLD), "ap-serial-baud", "SERIAL1_BAUD = 921 or SERIAL2_BAUD = 921, whichever"),
        (
            KINDS[0],
            both(SLOW, parameters(SERIAL1_BAUD=921, SERIAL2_PROTOCOL=2, SERIAL2_BAUD=57)),
            "ap-serial-baud",
            "SERIAL2_BAUD",
        ),
        (KINDS[0], both(link(mavlink_version=1), TWO_OLD), "ap-serial-protocol", "SERIAL1_PROTOCOL = 2 or SERIAL2_PROTOCOL = 2"),
        (KINDS[0], link(rtt_ms=(700.0,) * 9), "ap-viso-delay", "VISO_DELAY_MS = 250"),
        (
            KINDS[1],
            both(SLOW, parameters(MAV_0_CONFIG=101, SER_TEL1_BAUD=57600, SER_TEL2_BAUD=57600, SER_GPS1_BAUD=57600)),
            "px4-serial-baud",
            "SER_TEL1_BAUD = 921600 or SER_TEL2_BAUD = 921600, whichever is the companion's port, then reboot the autopilot; ",
        ),
        (KINDS[1], link(rtt_ms=(1500.0,) * 9), "px4-delay-max", "a faster way (link-round-trip): EKF2_DELAY_MAX is at most 1000"),
    ],
)
def test_what_only_one_of_several_ports_needs_is_told_and_not_set(
    good: Good, kind: AutopilotKind, change: Change, rule: str, words: str
) -> None:
    """What was measured stays as parameters change: each round set the next port, the pilot's radio and the receiver's, too."""
    facts = change(good(kind))
    (answer,) = [a for a in judge(RULES, facts) if a.rule.id == rule]
    assert (answer.level in (Level.RED, Level.AMBER), words in answer.remedy, answer.parameters) == (True, True, {})
    assert changes(RULES, facts) == {}


def test_the_port_of_the_only_mavlink_instance_is_set(good: Good) -> None:
    """A receiver's port with the same speed is none of it; the URL must follow."""
    facts = both(SLOW, parameters(SER_TEL2_BAUD=57600, SER_GPS1_BAUD=57600))(good(KINDS[1]))
    (answer,) = [a for a in agree(judge(RULES, facts), changes(RULES, facts)) if a.parameters]
    assert changes(RULES, facts) == {"SER_TEL2_BAUD": 921600.0}
    reboot = "set SER_TEL2_BAUD = 921600, then reboot the autopilot"
    assert answer.remedy == f"{reboot}; from then on link.url = serial:DEVICE:921600"


def test_mavlink_2_on_a_port_that_is_not_counted_sets_no_other(good: Good) -> None:
    """USB is SERIAL0; SERIAL1 may be the radio control's."""
    facts = parameters(SERIAL1_PROTOCOL=23)(good(KINDS[0]))
    (answer,) = [a for a in judge(RULES, facts) if a.rule.id == "ap-serial-protocol"]
    assert answer.level is Level.GREEN


@pytest.mark.parametrize("least_ms", [2.0, 49.0, 60.4, 60.6, 80.6, 120.4, 260.0, 320.0])
@pytest.mark.parametrize("value", [0, 10, 60, 90, 200, 251])
def test_a_delay_that_was_set_as_told_stands(good: Good, value: float, least_ms: float) -> None:
    """81 ms were told at 80.6, and then 10, and then 81."""
    facts = both(link(rtt_ms=(2 * least_ms,) * 9), parameters(VISO_DELAY_MS=value))(good(KINDS[0]))
    set_to = parameters(**changes(RULES, facts))(facts)
    (answer,) = [a for a in judge(RULES, set_to) if a.rule.id == "ap-viso-delay"]
    told = re.search(r"VISO_DELAY_MS = (\d+)", answer.remedy)
    if told is not None:
        set_to = parameters(VISO_DELAY_MS=float(told.group(1)))(set_to)
        (answer,) = [a for a in judge(RULES, set_to) if a.rule.id == "ap-viso-delay"]
    assert "VISO_DELAY_MS" not in answer.remedy
    assert (answer.level is Level.GREEN) == (least_ms <= 300)


@pytest.mark.parametrize(("url", "instance"), [("udpin:0.0.0.0:14540", 2), ("serial:/dev/ttyAMA0:921600", 1)])
def test_the_mavlink_instance_of_the_links_kind_is_set(good: Good, url: str, instance: int) -> None:
    facts = both(parameters(MAV_1_MODE=0, MAV_2_CONFIG=1000, MAV_2_MODE=0), link(url=url))(good(KINDS[1]))
    assert changes(RULES, facts) == {f"MAV_{instance}_MODE": 2.0}


@pytest.mark.parametrize(("cx_px", "level"), [(319.5, Level.RED), (321.7, Level.GREEN)])
def test_a_lens_that_was_calibrated_may_have_the_defaults_focal_length(good: Good, cx_px: float, level: Level) -> None:
    """500 px are a lens of 65° like another; what nobody measured is a whole lens of defaults."""
    facts = config("camera", fx_px=500.0, fy_px=500.0, cx_px=cx_px)(good(AutopilotKind.PX4))
    (answer,) = [a for a in judge(RULES, facts) if a.rule.id == "camera-calibrated"]
    assert answer.level is level


@pytest.mark.parametrize("output", ["auto", "gps_input"])
def test_a_build_without_visual_odometry_is_red_where_positions_go_that_way(good: Good, output: str) -> None:
    """Boards with little flash: everything else may be set up rightly, and no position is taken."""
    wished = both(config("injection", output=output), without_all("VISO_"))(good(AutopilotKind.ARDUPILOT))
    facts = link(parameters_expected=len(wished.parameters))(wished)
    answers = {a.rule.id: a.level for a in judge(RULES, facts)}
    assert answers["firmware-ardupilot-external-positions"] is (Level.RED if output == "auto" else Level.SKIPPED)
    assert answers["ap-viso-type"] is Level.SKIPPED


def test_a_barometer_that_says_nothing_is_not_judged(good: Good) -> None:
    (answer,) = [a for a in judge(RULES, link(barometer_h_amsl_m=None)(good(KINDS[1]))) if a.rule.id == "px4-barometer-qnh"]
    assert (answer.level, answer.read) == (Level.SKIPPED, "the barometer's height did not come (ALTITUDE)")
    assert "MAV_n_MODE 2" in answer.remedy


def test_without_facts_every_rule_is_skipped_and_says_what_to_give() -> None:
    answers = judge(RULES, Facts())
    assert {answer.level for answer in answers} == {Level.SKIPPED}
    assert all(answer.read and answer.remedy for answer in answers)


@pytest.mark.parametrize("kind", KINDS)
def test_rules_about_parameters_that_the_autopilot_lacks_are_skipped(kind: AutopilotKind) -> None:
    answers = judge(RULES, Facts(autopilot=kind, parameters={"SOMETHING": 1.0}))
    too_old = {"firmware-ardupilot-source-sets", "firmware-px4-external-vision"}
    assert {answer.level for answer in answers if answer.rule.id not in too_old} == {Level.SKIPPED}


@pytest.mark.parametrize(
    ("kind", "output", "change", "skipped"),
    [
        (
            KINDS[0],
            "gps_input",
            parameters(GPS2_TYPE=14, VISO_TYPE=0, EK3_SRC2_POSXY=3),
            {"ap-viso-type", "ap-vision-set-position"},
        ),
        (KINDS[1], "global_position_sensor", parameters(EKF2_AGP0_ID=1, EKF2_AGP0_CTRL=1, EKF2_EV_CTRL=0), {"px4-ev-control"}),
    ],
)
def test_another_output_that_is_wished_is_not_held_against_the_autopilot(
    good: Good, kind: AutopilotKind, output: str, change: Change, skipped: set[str]
) -> None:
    facts = change(config("injection", output=output)(good(kind)))
    answers = judge(RULES, facts)
    assert [(a.rule.id, a.read) for a in answers if a.level in (Level.RED, Level.AMBER)] == []
    assert skipped <= {a.rule.id for a in answers if a.level is Level.SKIPPED}


def test_a_parameter_that_was_lost_is_not_taken_for_an_old_version(good: Good) -> None:
    facts = without("EKF2_EV_CTRL")(good(AutopilotKind.PX4))
    answers = judge(RULES, link(parameters_expected=1000)(facts))
    assert next(a.level for a in answers if a.rule.id == "firmware-px4-external-vision") is Level.SKIPPED


def test_a_rule_about_a_parameter_that_was_lost_says_so(good: Good) -> None:
    """Of a part of the parameters the doctor must not say that all is well."""
    facts = link(parameters_expected=1000)(without("VISO_TYPE")(good(AutopilotKind.ARDUPILOT)))
    answers = {a.rule.id: a for a in judge(RULES, facts)}
    assert (answers["ap-viso-type"].level, answers["ap-viso-type"].read) == (Level.SKIPPED, "VISO_TYPE was not read")
    assert answers["ap-viso-type"].remedy == "see link-parameters"
    assert answers["link-parameters"].level is Level.RED


def test_source_sets_that_a_switched_off_filter_hides_are_not_taken_for_an_old_version(good: Good) -> None:
    """ArduPilot 4.7 with EK3_ENABLE 0 has no parameter EK3_SRC1_POSXY."""
    shown = {name for name in good(AutopilotKind.ARDUPILOT).parameters if name.startswith("EK3_")}
    facts = good(AutopilotKind.ARDUPILOT)
    for name in shown:
        facts = without(name, EK3_ENABLE=0.0)(facts)
    answers = {a.rule.id: a for a in judge(RULES, link(parameters_expected=len(facts.parameters))(facts))}
    assert (answers["ap-ekf3"].level, answers["ap-ekf3"].remedy) == (Level.RED, "set EK3_ENABLE = 1, then reboot the autopilot")
    assert answers["firmware-ardupilot-source-sets"].level is Level.SKIPPED
    assert answers["firmware-ardupilot-source-sets"].remedy == "see ap-ekf3"


@pytest.mark.parametrize(
    ("kind", "wrong", "remedy"),
    [
        (AutopilotKind.ARDUPILOT, {"ARMING_CHECK": 262144}, "set ARMING_CHECK = 786430"),
        (AutopilotKind.ARDUPILOT, {"EK3_SRC_OPTIONS": 9}, "set EK3_SRC_OPTIONS = 0"),
        (AutopilotKind.PX4, {"EKF2_EV_CTRL": 14}, "set EKF2_EV_CTRL = 1"),
    ],
)
def test_rules_that_share_a_parameter_tell_the_same_value(
    good: Good, kind: AutopilotKind, wrong: dict[str, float], remedy: str
) -> None:
    """Each alone would say another one: of ARMING_CHECK even 0, which is no check at all."""
    facts = parameters(**wrong)(good(kind))
    answers = [a for a in agree(judge(RULES, facts), changes(RULES, facts)) if a.parameters]
    assert len(answers) >= 2
    assert {a.remedy for a in answers} == {remedy}


def test_the_worst_comes_first(good: Good) -> None:
    case = next(case for case in BREAKS if case.level == "red")
    order = [answer.level for answer in judge(RULES, case.change(good(case.kind)))]
    assert order[0] is Level.RED
    assert order == sorted(order, key=[Level.RED, Level.AMBER, Level.GREEN, Level.SKIPPED].index)


def test_no_file_of_rules_is_forgotten() -> None:
    folder = Path(__file__).resolve().parents[3] / "visloc_companion" / "doctor" / "rules"
    defined = sum(path.read_text(encoding="utf-8").count("\nRULES: ") for path in folder.glob("*.py"))
    assert defined == len([path for path in folder.glob("*.py") if path.stem not in ("__init__", "parameter")])
    assert sum(len(rules) for rules in THEMES.values()) == len(RULES)


def test_a_link_that_was_given_is_not_asked_for(good: Good) -> None:
    """What lacks a parameter beside a link that lost some points to those that were lost, and without any link to the link."""
    facts = good(AutopilotKind.ARDUPILOT)
    lost = replace(facts, parameters={"SOMETHING": 1.0})

    def remedies(of: Facts) -> dict[str, str]:
        return {a.rule.id: a.remedy for a in judge(RULES, of) if a.level is Level.SKIPPED}

    assert not [rule for rule, remedy in remedies(lost).items() if "--link URL" in remedy]
    assert remedies(lost)["ap-compass"] == remedies(lost)["firmware-ardupilot-height-snaps"] == "see link-parameters"
    bare = remedies(replace(facts, link=None, parameters={}))
    assert {bare["ap-compass"], bare["ap-viso-type"], bare["config-output"]} == {"give --link URL"}
