"""ArduPilot: how it takes a vision position (VISO_*), and arming. Sources: AP_VisualOdom*.cpp, GCS_Common.cpp, AP_Arming.cpp."""

from __future__ import annotations

import math

from visloc_companion.doctor.facts import Facts
from visloc_companion.doctor.finding import REBOOT, Finding, Level, Rule, amber, green, number, red, skipped
from visloc_companion.doctor.rules.parameter import least_quality, parameter, within
from visloc_companion.types import AutopilotKind

AP = AutopilotKind.ARDUPILOT
MAX_DELAY_MS, LINK_DELAY_MS, WIRE_MS = 250, 50, 10.0
VISION_CHECK = 1 << 18
ALL_CHECKS, ALL_BUT_VISION = 1, 786430
MAX_OFFSET_M = 0.3


def _type(name: str, value: float, facts: Facts) -> Finding:
    del facts
    if value == 1:
        return green(f"{name} = 1 (MAVLink)")
    what = "no external positions" if value == 0 else "re-aligned to the EKF" if value in (2, 3) else "not a MAVLink source"
    return red(f"{name} = {value:g} ({what})", parameters={name: 1.0})


def _delay(name: str, value: float, facts: Facts) -> Finding:
    rtt_ms = facts.link.rtt_ms if facts.link is not None else ()
    latency = f", shortest way here {min(rtt_ms) / 2:.1f} ms" if rtt_ms else ""
    read = f"{name} = {value:g} ms{latency}"
    least = min(rtt_ms) / 2 if rtt_ms else 0.0
    wanted = float(min(MAX_DELAY_MS, round(least))) if least > WIRE_MS + LINK_DELAY_MS else WIRE_MS
    if value > MAX_DELAY_MS or value < 0:
        return red(f"{read}: beyond what the EKF buffers", parameters={name: wanted})
    if least > value + LINK_DELAY_MS:
        slower = "" if value == wanted else f"; or {name} = {number(wanted)}, {REBOOT}"
        return amber(read, f"a faster way (link-round-trip){slower}")
    return green(read) if value <= least + LINK_DELAY_MS else amber(read, parameters={name: wanted})


def _noise(name: str, value: float, facts: Facts) -> Finding:
    claimed = facts.assumed.injection.min_sigma_m
    read = f"{name} = {value:g} m, the daemon claims at least {claimed:g} m"
    fits = 0.99 * claimed <= value <= 1.01 * claimed
    return green(read) if fits else amber(read, parameters={name: claimed})


def _offset(facts: Facts) -> Finding:
    names = [f"VISO_POS_{axis}" for axis in "XYZ"]
    if names[0] not in facts.parameters:
        return skipped("the autopilot has no parameter VISO_POS_X", "set VISO_TYPE to 1 and reboot: it shows the others then")
    values = [facts.parameters.get(name, 0.0) for name in names]
    read = f"VISO_POS_X/Y/Z = {values[0]:g} {values[1]:g} {values[2]:g} m"
    if math.hypot(*values) <= MAX_OFFSET_M:
        return green(read)
    return amber(read, parameters=dict.fromkeys(names, 0.0))


def _arming(name: str, value: float, facts: Facts) -> Finding:
    checks, vision = int(value), facts.parameters.get("VISO_TYPE", 0.0) != 0
    read = f"{name} = {checks}"
    if name == "ARMING_SKIPCHK":
        left_out = bool(checks & VISION_CHECK) or checks < 0
        return green(read) if left_out or not vision else red(read, parameters={name: float(checks | VISION_CHECK)})
    if vision and (checks & 1 or checks & VISION_CHECK):
        return red(read, parameters={name: float(ALL_BUT_VISION if checks & 1 else checks & ~VISION_CHECK)})
    return green(read)


def _other_checks(name: str, value: float, facts: Facts) -> Finding:
    del facts
    checks = int(value)
    read = f"{name} = {checks}"
    if name == "ARMING_SKIPCHK":
        return green(read) if checks & ~VISION_CHECK == 0 else amber(read, parameters={name: float(VISION_CHECK)})
    wanted = (1 << 1) | (1 << 2) | (1 << 3) | (1 << 4)
    whole = checks & 1 or checks & wanted == wanted
    return green(read) if whole else amber(read, parameters={name: float(ALL_BUT_VISION)})


RULES: tuple[Rule, ...] = (
    parameter(
        "ap-viso-type",
        AP,
        "VISO_TYPE",
        "0 takes no external positions; 2 and 3 align them to the EKF, which is wrong for georeferenced positions.",
        f"VISO_TYPE = 1, {REBOOT}",
        _type,
        poses=True,
    ),
    parameter(
        "ap-viso-delay",
        AP,
        "VISO_DELAY_MS",
        "Is subtracted from every time stamp. The daemon sends the position now, so it must be the link's shortest latency; more "
        "makes every position late by the difference, and beyond 250 the EKF keeps no history.",
        f"VISO_DELAY_MS = 10, {REBOOT}",
        _delay,
        poses=True,
    ),
    parameter(
        "ap-viso-position-noise",
        AP,
        "VISO_POS_M_NSE",
        "Floor of the position error, and what is believed if a covariance is ever missing: 0.2 m with a true error of 1 m "
        "led to "
        "errors of 3.8 to 44 m while all flags stayed good.",
        "VISO_POS_M_NSE = injection.min_sigma_m (0.5)",
        _noise,
        poses=True,
    ),
    parameter(
        "ap-viso-quality",
        AP,
        "VISO_QUAL_MIN",
        "VISION_POSITION_ESTIMATE carries no quality and passes 0: any larger value drops every position without a word.",
        "VISO_QUAL_MIN = 0",
        least_quality,
        poses=True,
    ),
    parameter(
        "ap-viso-yaw-noise",
        AP,
        "VISO_YAW_M_NSE",
        "Floor of the yaw error. Yaw is not fused in the recommended source set; a small floor is a trap if it ever is.",
        "VISO_YAW_M_NSE = 0.2",
        within(lambda value: value >= 0.1, 0.2, Level.AMBER),
        poses=True,
    ),
    parameter(
        "ap-viso-scale",
        AP,
        "VISO_SCALE",
        "Multiplies every position: anything but 1 stretches the map about the EKF origin.",
        "VISO_SCALE = 1",
        within(lambda value: math.isclose(value, 1.0, abs_tol=1e-4), 1.0),
        poses=True,
    ),
    Rule(
        "ap-viso-offset",
        "VISO_POS_X VISO_POS_Y VISO_POS_Z",
        "The daemon sends the position of the vehicle, not of the camera: an offset here would be taken off again.",
        "VISO_POS_X = VISO_POS_Y = VISO_POS_Z = 0",
        _offset,
        AP,
        poses=True,
    ),
    parameter(
        "ap-arming-vision",
        AP,
        "ARMING_SKIPCHK ARMING_CHECK",
        "The arming check of visual odometry wants positions within 300 ms on any source set; the daemon sends none on the "
        "ground, "
        "so the vehicle does not arm (VisOdom: not healthy).",
        "ARMING_CHECK without bits 0 and 18 (786430 is all others), or ARMING_SKIPCHK with bit 18 (262144)",
        _arming,
    ),
    parameter(
        "ap-arming-checks",
        AP,
        "ARMING_SKIPCHK ARMING_CHECK",
        "Without the checks of barometer, compass, GNSS and inertial sensors a vehicle takes off with what then fails on vision.",
        "ARMING_CHECK = 786430 (all but visual odometry), or ARMING_SKIPCHK = 262144",
        _other_checks,
    ),
)
"""About the vision input and arming."""
