"""What is known of versions. Only what was read in the autopilots' sources and issue threads, or measured, stands here."""

from __future__ import annotations

import re
from collections.abc import Callable

from visloc_companion.doctor.facts import Facts
from visloc_companion.doctor.finding import Finding, Rule, amber, green, red, skipped
from visloc_companion.doctor.rules.parameter import unread
from visloc_companion.types import AutopilotKind

AP, PX4 = AutopilotKind.ARDUPILOT, AutopilotKind.PX4
MEASURED = {AP: ((4, 7),), PX4: ((1, 17),)}
"""Lines of the development trees that the daemon was flown with (docs/autopilots.md)."""
EXTNAV_REPORTED, HEIGHT_REPORTED = (4, 6), (4, 7)


def version_of(text: str) -> tuple[int, int] | None:
    """Major and minor of a version as the link knows it (`4.7.0-dev`), None where there is none."""
    match = re.match(r"(\d+)\.(\d+)", text)
    return None if match is None else (int(match.group(1)), int(match.group(2)))


def _rule(
    rule_id: str,
    reads: str,
    why: str,
    remedy: str,
    judge: Callable[[tuple[int, int], Facts], Finding],
    only: AutopilotKind | None,
) -> Rule:
    def check(facts: Facts) -> Finding:
        known = version_of(facts.version)
        if known is None:
            return skipped("the version is not known", "give --link URL to an autopilot that sends AUTOPILOT_VERSION")
        if known == (0, 0):
            return skipped(f"{facts.version}: a build that states no version", "build from a checkout with its tags")
        return judge(known, facts)

    return Rule(rule_id, reads, why, remedy, check, only)


def _measured(known: tuple[int, int], facts: Facts) -> Finding:
    lines = MEASURED.get(facts.autopilot, ())
    read = f"{facts.autopilot} {facts.version}"
    return green(read) if known in lines else amber(read)


def _has(name: str) -> Callable[[Facts], Finding]:
    def check(facts: Facts) -> Finding:
        if not facts.parameters:
            return unread(facts, "this autopilot")
        if name not in facts.parameters and not facts.parameters_complete:
            return skipped("not all parameters were read", "see link-parameters")
        if name not in facts.parameters and facts.autopilot is AP and facts.parameters.get("EK3_ENABLE", 1.0) != 1:
            return skipped("EK3_ENABLE is not 1, which hides the source sets", "see ap-ekf3")
        read = f"{facts.version or 'no version'}, {'has' if name in facts.parameters else 'lacks'} {name}"
        return green(read) if name in facts.parameters else red(read)

    return check


def _takes_positions(facts: Facts) -> Finding:
    if any(name.startswith("VISO_") for name in facts.parameters):
        return green(f"{facts.version or 'no version'}, has VISO_*")
    if facts.parameters and "EK3_SRC1_POSXY" not in facts.parameters:
        return skipped("neither VISO_* nor source sets are there", "see firmware-ardupilot-source-sets")
    return _has("VISO_TYPE")(facts)


def _both_fused(known: tuple[int, int], facts: Facts) -> Finding:
    return amber(facts.version) if known <= EXTNAV_REPORTED else green(facts.version)


def _height_snaps(known: tuple[int, int], facts: Facts) -> Finding:
    number = facts.assumed.injection.vision_source_set
    height = facts.parameters.get(f"EK3_SRC{number}_POSZ")
    if height is None:
        return unread(facts, "the source set")
    read = f"{facts.version}, EK3_SRC{number}_POSZ = {height:g}"
    return (
        amber(read, parameters={f"EK3_SRC{number}_POSZ": 1.0})
        if known <= HEIGHT_REPORTED and height not in (1, 6)
        else green(read)
    )


RULES: tuple[Rule, ...] = (
    _rule(
        "firmware-measured",
        "AUTOPILOT_VERSION",
        "What these rules state was read in development trees (ArduPilot V4.7.0-dev of July 2025, PX4 main of 2025 and 2026). "
        "Other versions may differ.",
        "fly the same checks in that version's simulator first (docs/simulation.md, Real simulators)",
        _measured,
        None,
    ),
    Rule(
        "firmware-px4-external-vision",
        "EKF2_EV_CTRL",
        "PX4 rewrote external vision between 1.13 and 1.14 (PX4 issue 22016): before, EKF2_EV_CTRL does not exist and what is "
        "said here does not hold.",
        "update PX4 to 1.14 or newer",
        _has("EKF2_EV_CTRL"),
        PX4,
    ),
    Rule(
        "firmware-ardupilot-source-sets",
        "EK3_SRC1_POSXY",
        "A version without source sets of EKF3 has nothing to switch.",
        "update ArduPilot: 4.1 and newer have them",
        _has("EK3_SRC1_POSXY"),
        AP,
    ),
    Rule(
        "firmware-ardupilot-external-positions",
        "VISO_TYPE",
        "Builds for small boards leave visual odometry out (HAL_VISUALODOM_ENABLED 0): every position is dropped without a word.",
        "a build with visual odometry (custom.ardupilot.org), or a board with more flash; injection.output = "
        '"external_position_estimate" for a plane, "gps_input" for a copter',
        _takes_positions,
        AP,
        poses=True,
    ),
    _rule(
        "firmware-ardupilot-gps-beside-vision",
        "AUTOPILOT_VERSION",
        "Up to 4.6 GPS data are reported to be fused beside ExternalNav while both arrive (ArduPilot issue 30076). In 4.7-dev "
        "of July 2025 a "
        "dragged GNSS did not move an estimate on set 2 (docs/autopilots.md, slow_drag).",
        "update ArduPilot to 4.7, or try a dragged GNSS in that version's simulator first",
        _both_fused,
        AP,
    ),
    _rule(
        "firmware-ardupilot-height-snaps",
        "AUTOPILOT_VERSION EK3_SRC2_POSZ",
        "EKF3 resets its height to the vision height when external positions begin, whatever POSZ says (ArduPilot issue "
        "32506, reported for 4.6.2). What "
        "the daemon sends is the autopilot's own height, so it shows only where POSZ is neither barometer nor vision.",
        "EK3_SRC2_POSZ = 1",
        _height_snaps,
        AP,
    ),
)
"""About versions."""
