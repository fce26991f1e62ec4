"""ArduPilot: EKF3, its source sets and failsafes. Sources: AP_NavEKF_Source.cpp, AP_NavEKF3_*.cpp, ekf_check.cpp."""

from __future__ import annotations

from collections.abc import Callable

from visloc_companion.doctor.facts import Facts
from visloc_companion.doctor.finding import REBOOT, Finding, Level, Rule, amber, green, red, skipped
from visloc_companion.doctor.rules.parameter import Judge, bit_clear, parameter, unread, within
from visloc_companion.types import AutopilotKind

AP = AutopilotKind.ARDUPILOT
NAMES = {0: "none", 3: "GPS", 4: "beacon", 5: "optical flow", 6: "ExternalNav", 7: "wheels", 8: "GSF"}
HEIGHTS, YAWS = {1: "barometer", 2: "rangefinder"}, {1: "compass", 2: "GPS", 3: "GPS or compass"}
EKF_SWITCH_OPTION = 90


def _of_vision(which: str) -> Callable[[Facts], str]:
    return lambda facts: f"EK3_SRC{facts.assumed.injection.vision_source_set}_{which}"


def _of_gnss(which: str) -> Callable[[Facts], str]:
    return lambda facts: f"EK3_SRC{facts.assumed.injection.gnss_source_set}_{which}"


def _source(wanted: float, others: dict[float, Level], otherwise: Level = Level.AMBER) -> Judge:
    """Green for one source; the level of a few others, and of all that are left."""

    def judge(name: str, value: float, facts: Facts) -> Finding:
        del facts
        read = f"{name} = {value:g} ({_source_name(name, int(value))})"
        if value == wanted:
            return green(read)
        return Finding(others.get(value, otherwise), read, parameters={name: wanted})

    return judge


def _source_name(name: str, value: int) -> str:
    own = YAWS if name.endswith("_YAW") else HEIGHTS if name.endswith("_POSZ") else {}
    return (NAMES | own).get(value, "other")


def _compass(facts: Facts) -> Finding:
    number = facts.assumed.injection.vision_source_set
    yaw, use = facts.parameters.get(f"EK3_SRC{number}_YAW"), facts.parameters.get("COMPASS_USE")
    enabled = facts.parameters.get("COMPASS_ENABLE", 1.0)
    if yaw is None or use is None:
        return unread(facts, "compass or source set")
    others = [n for n in (2, 3) if facts.parameters.get(f"COMPASS_USE{n}") and facts.parameters.get(f"COMPASS_PRIO{n}_ID")]
    read = f"EK3_SRC{number}_YAW = {yaw:g}, COMPASS_ENABLE = {enabled:g}, COMPASS_USE = {use:g}"
    read += "".join(f", COMPASS_USE{n} = {facts.parameters[f'COMPASS_USE{n}']:g}" for n in others)
    wanted = {} if enabled else {"COMPASS_ENABLE": 1.0}
    wanted |= {} if use or others else {"COMPASS_USE": 1.0}
    return red(read, parameters=wanted) if yaw == 1 and wanted else green(read)


def _switch(facts: Facts) -> Finding:
    if facts.config is None or not facts.parameters:
        return skipped("whether the daemon may switch is not known", "give --link URL and --config FILE")
    if facts.config.injection.switch_source:
        return green("injection.switch_source = true")
    channels = [name for name, value in facts.parameters.items() if _is_option(name) and value == EKF_SWITCH_OPTION]
    read = "injection.switch_source = false, " + (f"{channels[0]} = 90" if channels else "no RCn_OPTION is 90")
    return green(read) if channels else amber(read)


def _is_option(name: str) -> bool:
    return name.startswith("RC") and name.endswith("_OPTION")


RULES: tuple[Rule, ...] = (
    parameter(
        "ap-ekf3",
        AP,
        "EK3_ENABLE",
        "Only EKF3 knows source sets.",
        "EK3_ENABLE = 1, then reboot the autopilot",
        within(lambda value: value == 1, 1.0),
    ),
    parameter(
        "ap-ekf-type",
        AP,
        "AHRS_EKF_TYPE",
        "Only with 3 does the vehicle fly on EKF3.",
        "AHRS_EKF_TYPE = 3",
        within(lambda value: value == 3, 3.0),
    ),
    parameter(
        "ap-gnss-set-position",
        AP,
        _of_gnss("POSXY"),
        "The set that is flown while GNSS is trusted must use GPS (3).",
        "EK3_SRC1_POSXY = 3",
        _source(3.0, {6.0: Level.RED, 0.0: Level.RED}),
        "EK3_SRC1_POSXY",
    ),
    parameter(
        "ap-gnss-set-velocity",
        AP,
        _of_gnss("VELXY"),
        "Without GPS velocity the set with GNSS is far less accurate.",
        "EK3_SRC1_VELXY = 3",
        _source(3.0, {}),
        "EK3_SRC1_VELXY",
    ),
    parameter(
        "ap-gnss-set-vertical-velocity",
        AP,
        _of_gnss("VELZ"),
        "GPS velocity holds the climb rate; 6 is never sent.",
        "EK3_SRC1_VELZ = 3",
        _source(3.0, {}),
        "EK3_SRC1_VELZ",
    ),
    parameter(
        "ap-gnss-set-height",
        AP,
        _of_gnss("POSZ"),
        "With GPS height (3) a false GNSS makes a false height; 6 waits for vision.",
        "EK3_SRC1_POSZ = 1",
        _source(1.0, {6.0: Level.RED}),
        "EK3_SRC1_POSZ",
    ),
    parameter(
        "ap-gnss-set-yaw",
        AP,
        _of_gnss("YAW"),
        "The yaw of the set with GNSS must not be the daemon's (6): it sends the autopilot's own back.",
        "EK3_SRC1_YAW = 1",
        _source(1.0, {2.0: Level.GREEN, 3.0: Level.GREEN, 8.0: Level.GREEN, 6.0: Level.RED}),
        "EK3_SRC1_YAW",
    ),
    parameter(
        "ap-vision-set-position",
        AP,
        _of_vision("POSXY"),
        "The set that is flown on vision must use ExternalNav, which is 6. 3 is GPS, whatever other documents say.",
        "EK3_SRC2_POSXY = 6",
        _source(6.0, {}, Level.RED),
        "EK3_SRC2_POSXY",
        poses=True,
    ),
    parameter(
        "ap-vision-set-velocity",
        AP,
        _of_vision("VELXY"),
        "3 fuses the velocity of the GNSS that is not trusted; 6 waits for one, which VISION_POSITION_ESTIMATE lacks.",
        "EK3_SRC2_VELXY = 0",
        _source(0.0, {3.0: Level.RED}),
        "EK3_SRC2_VELXY",
        poses=True,
    ),
    parameter(
        "ap-vision-set-height",
        AP,
        _of_vision("POSZ"),
        "The daemon sends the autopilot's own height back: with 6 that is a loop (a height that was 10 m off became a true "
        "error of 10 m). 3 is the "
        "GNSS that is not trusted.",
        "EK3_SRC2_POSZ = 1",
        _source(1.0, {6.0: Level.RED, 3.0: Level.RED}),
        "EK3_SRC2_POSZ",
    ),
    parameter(
        "ap-vision-set-vertical-velocity",
        AP,
        _of_vision("VELZ"),
        "3 is the velocity of the GNSS that is not trusted; 6 is never sent.",
        "EK3_SRC2_VELZ = 0",
        _source(0.0, {3.0: Level.RED}),
        "EK3_SRC2_VELZ",
    ),
    parameter(
        "ap-vision-set-yaw",
        AP,
        _of_vision("YAW"),
        "6 takes the yaw that the daemon sends, which is the autopilot's own: a loop that drifts. 2, 3 and 8 need GNSS; 0 has no "
        "yaw at all.",
        "EK3_SRC2_YAW = 1",
        _source(1.0, {8.0: Level.AMBER}, Level.RED),
        "EK3_SRC2_YAW",
    ),
    parameter(
        "ap-source-velocities",
        AP,
        "EK3_SRC_OPTIONS",
        "Bit 0 fuses the velocities of all sets at once, so that of a false GNSS too while vision is flown.",
        "EK3_SRC_OPTIONS without bit 0",
        bit_clear(0),
    ),
    parameter(
        "ap-source-per-core",
        AP,
        "EK3_SRC_OPTIONS",
        "Bit 3 gives each EKF core a source set of its own: switching the set then does nothing.",
        "EK3_SRC_OPTIONS without bit 3",
        bit_clear(3),
    ),
    parameter(
        "ap-origin-height",
        AP,
        "EK3_OGN_HGT_MASK",
        "Lets GNSS correct the height of the EKF's origin, on vision too: a false GNSS then moves the height above sea level, by "
        "which pictures are scaled.",
        f"EK3_OGN_HGT_MASK = 0, {REBOOT}",
        within(lambda value: value == 0, 0.0, Level.AMBER),
    ),
    Rule(
        "ap-compass",
        "EK3_SRC2_YAW COMPASS_ENABLE COMPASS_USE COMPASS_USE2 COMPASS_USE3",
        "On vision the heading comes from the compass: one must be in use.",
        f"COMPASS_ENABLE = 1 and COMPASS_USE = 1 (or that of another compass), {REBOOT}, and calibrate it",
        _compass,
        AP,
    ),
    parameter(
        "ap-position-gate",
        AP,
        "EK3_POS_I_GATE",
        "Innovation gate in hundredths of a sigma. A tight gate rejects honest positions; 500 was measured.",
        "EK3_POS_I_GATE = 500",
        within(lambda value: 300 <= value <= 1000, 500.0, Level.AMBER),
    ),
    parameter(
        "ap-glitch-radius",
        AP,
        "EK3_GLITCH_RAD",
        "0 never rejects but de-weights: a jump of 20 m then overshot to 29 m, with lane switches.",
        "EK3_GLITCH_RAD = 25",
        within(lambda value: value > 0, 25.0, Level.AMBER),
    ),
    parameter(
        "ap-ekf-failsafe-threshold",
        AP,
        "FS_EKF_THRESH",
        "0 switches the EKF failsafe off: a vehicle without a position then drifts on. Above 1 it comes late.",
        "FS_EKF_THRESH = 0.8",
        within(lambda value: 0 < value <= 1.0, 0.8, Level.AMBER),
    ),
    parameter(
        "ap-ekf-failsafe-action",
        AP,
        "FS_EKF_ACTION",
        "0 only reports: a copter whose positions stop does not land.",
        "FS_EKF_ACTION = 1",
        within(lambda value: value != 0, 1.0, Level.AMBER),
    ),
    Rule(
        "ap-source-switch",
        "RCn_OPTION, injection.switch_source",
        "ArduPilot never changes its source by itself: with GNSS off, vision healthy and set 1 active it landed after 8.2 s. "
        "Somebody must be able to switch.",
        "injection.switch_source = true, or a switch with RCn_OPTION = 90 that the pilot has practised",
        _switch,
        AP,
    ),
)
"""About EKF3."""
