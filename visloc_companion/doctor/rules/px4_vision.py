"""PX4: how EKF2 takes a vision position. Sources: params_external_vision.yaml, ev_control.cpp, ev_pos_control.cpp, EKF2.cpp."""

from __future__ import annotations

import math

from visloc_companion.adapters.mavlink.outputs.kinds import Output
from visloc_companion.doctor.facts import Facts
from visloc_companion.doctor.finding import REBOOT, Finding, Level, Rule, amber, green, red, skipped
from visloc_companion.doctor.rules.firmware import version_of
from visloc_companion.doctor.rules.parameter import bit_clear, least_quality, parameter, within
from visloc_companion.types import AutopilotKind

PX4 = AutopilotKind.PX4
MAX_DELAY_MS, LEAST_BUFFER_MS, MOST_BUFFER_MS, MAX_OFFSET_M = 50, 200, 1000, 0.3
GPS_HEIGHT, RANGE_HEIGHT = 1, 2
SPOOF_CHECK, SPOOF_CHECKED = 1 << 9, (1, 16)
"""Bit of EKF2_GPS_CHECK, and since which version it is there."""
VISION_ENABLED = 1 << 3
"""Bit of EKF2_SENS_EN (of 1.18; in the order of EstimatorFusionControl.msg)."""
MAG_NONE, MAG_INIT = 5, 6


def _control(name: str, value: float, facts: Facts) -> Finding:
    del facts
    read = f"{name} = {value:g} (bit 0, horizontal position, is {int(value) & 1})"
    return green(read) if int(value) & 1 else red(read, parameters={name: float(int(value) | 1)})


def _noise(name: str, value: float, facts: Facts) -> Finding:
    claimed = facts.assumed.injection.min_sigma_m
    read = f"{name} = {value:g} m, the daemon claims at least {claimed:g} m"
    return green(read) if value <= claimed else amber(read, parameters={name: 0.1})


def _delay_max(name: str, value: float, facts: Facts) -> Finding:
    worst_ms = max(facts.link.rtt_ms, default=0.0) if facts.link is not None else 0.0
    read = f"{name} = {value:g} ms" + (f", worst round trip {worst_ms:.0f} ms" if worst_ms else "")
    if worst_ms > MOST_BUFFER_MS:
        return red(read, f"a faster way (link-round-trip): {name} is at most {MOST_BUFFER_MS}")
    if value < worst_ms:
        return red(read, parameters={name: float(min(MOST_BUFFER_MS, 100 * math.ceil(2 * worst_ms / 100)))})
    return green(read) if value >= LEAST_BUFFER_MS else amber(read, parameters={name: float(LEAST_BUFFER_MS)})


def _height(name: str, value: float, facts: Facts) -> Finding:
    del facts
    read = f"{name} = {value:g}"
    if value == 0:
        return green(f"{read} (barometer)")
    level = Level.AMBER if value == RANGE_HEIGHT else Level.RED
    what = {1: "GPS", 2: "rangefinder", 3: "vision"}.get(int(value), "other")
    return Finding(level, f"{read} ({what})", parameters={name: 0.0})


def _gps(name: str, value: float, facts: Facts) -> Finding:
    wanted = facts.assumed.injection.px4_gps_ctrl
    read = f"{name} = {value:g}, injection.px4_gps_ctrl = {wanted}"
    if value == 0:
        return red(f"{read}: GNSS is off", parameters={name: float(wanted)})
    return green(read) if value == wanted else amber(read, parameters={name: float(wanted)})


def _enabled(name: str, value: float, facts: Facts) -> Finding:
    del facts
    read = f"{name} = {value:g} (bit 3, external vision, is {int(value) >> 3 & 1})"
    return green(read) if int(value) & VISION_ENABLED else red(read, parameters={name: float(int(value) | VISION_ENABLED)})


def _spoof_check(name: str, value: float, facts: Facts) -> Finding:
    read, version = f"{name} = {value:g}", version_of(facts.version)
    if int(value) & SPOOF_CHECK:
        return green(read)
    if version is not None and (0, 0) < version < SPOOF_CHECKED:
        return green(f"{read}, and {facts.version} has no such check")
    return amber(read, parameters={name: float(int(value) | SPOOF_CHECK)})


def _compass(name: str, value: float, facts: Facts) -> Finding:
    del facts
    read = f"{name} = {value:g}"
    if value not in (MAG_NONE, MAG_INIT):
        return green(read)
    what = "none" if value == MAG_NONE else "until the heading is found, not in flight"
    return Finding(Level.RED if value == MAG_NONE else Level.AMBER, f"{read} ({what})", parameters={name: 0.0})


def _offset(facts: Facts) -> Finding:
    names = [f"EKF2_EV_POS_{axis}" for axis in "XYZ"]
    if names[0] not in facts.parameters:
        return skipped("the autopilot has no parameter EKF2_EV_POS_X", "give --link URL")
    values = [facts.parameters.get(name, 0.0) for name in names]
    read = f"EKF2_EV_POS_X/Y/Z = {values[0]:g} {values[1]:g} {values[2]:g} m"
    return green(read) if math.hypot(*values) <= MAX_OFFSET_M else amber(read, parameters=dict.fromkeys(names, 0.0))


def _agp(facts: Facts) -> Finding:
    fused = {name: value for name, value in facts.parameters.items() if name.startswith("EKF2_AGP") and name.endswith("_CTRL")}
    if not fused:
        return skipped("this version has no auxiliary global position", "nothing to do")
    on = {name: 0.0 for name, value in fused.items() if value != 0}
    read = ", ".join(f"{name} = {fused[name]:g}" for name in sorted(fused))
    meant = facts.choice.output is Output.GLOBAL_POSITION_SENSOR
    return amber(read, parameters=on) if on and not meant else green(read)


RULES: tuple[Rule, ...] = (
    parameter(
        "px4-ev-control",
        PX4,
        "EKF2_EV_CTRL",
        "0, the default since 1.16, fuses nothing: positions are sent and not used.",
        "EKF2_EV_CTRL = 1",
        _control,
        poses=True,
    ),
    parameter(
        "px4-ev-enabled",
        PX4,
        "EKF2_SENS_EN",
        "From 1.18 a ground station can switch a sensor off here, and it stays so: without bit 3 vision is not fused, whatever "
        "EKF2_EV_CTRL says.",
        "EKF2_SENS_EN with bit 3 (8)",
        _enabled,
        poses=True,
    ),
    parameter(
        "px4-ev-height",
        PX4,
        "EKF2_EV_CTRL",
        "Bit 1 fuses the height that is sent, which is the autopilot's own: a loop.",
        "EKF2_EV_CTRL without bit 1 (1 is horizontal position only)",
        bit_clear(1),
    ),
    parameter(
        "px4-ev-velocity",
        PX4,
        "EKF2_EV_CTRL",
        "Bit 2 waits for velocities, which VISION_POSITION_ESTIMATE does not carry.",
        "EKF2_EV_CTRL without bit 2",
        bit_clear(2, Level.AMBER),
    ),
    parameter(
        "px4-ev-yaw",
        PX4,
        "EKF2_EV_CTRL",
        "Bit 3 fuses the yaw that is sent, which is the autopilot's own: a loop that drifts.",
        "EKF2_EV_CTRL without bit 3",
        bit_clear(3),
    ),
    parameter(
        "px4-ev-quality",
        PX4,
        "EKF2_EV_QMIN",
        "VISION_POSITION_ESTIMATE carries no quality: any larger value rejects every position.",
        "EKF2_EV_QMIN = 0",
        least_quality,
        poses=True,
    ),
    parameter(
        "px4-ev-noise-mode",
        PX4,
        "EKF2_EV_NOISE_MD",
        "1 ignores the covariance that is sent and believes a fixed one.",
        "EKF2_EV_NOISE_MD = 0",
        within(lambda value: value == 0, 0.0),
        poses=True,
    ),
    parameter(
        "px4-ev-noise",
        PX4,
        "EKF2_EVP_NOISE",
        "Floor of the claimed sigma: above what the daemon claims it hides how good a position is.",
        "EKF2_EVP_NOISE = 0.1",
        _noise,
        poses=True,
    ),
    parameter(
        "px4-ev-gate",
        PX4,
        "EKF2_EVP_GATE",
        "Innovation gate in sigma. A tight gate rejects honest positions; 5 was measured.",
        "EKF2_EVP_GATE = 5",
        within(lambda value: 3 <= value <= 10, 5.0, Level.AMBER),
        poses=True,
    ),
    parameter(
        "px4-ev-delay",
        PX4,
        "EKF2_EV_DELAY",
        "Is subtracted from time stamps that TIMESYNC already makes right; what is sent is the position now.",
        f"EKF2_EV_DELAY = 0, {REBOOT}",
        within(lambda value: 0 <= value <= MAX_DELAY_MS, 0.0, Level.AMBER),
        poses=True,
    ),
    parameter(
        "px4-delay-max",
        PX4,
        "EKF2_DELAY_MAX",
        "Older samples are dropped without a word: with 250 ms of latency and the default 200 fusion came and went until the "
        "failsafe.",
        f"EKF2_DELAY_MAX above the link's worst latency (200 to 1000), {REBOOT}",
        _delay_max,
    ),
    parameter(
        "px4-height",
        PX4,
        "EKF2_HGT_REF",
        "1 (the default) takes the height from GNSS, so that a false GNSS makes a false height; 3 takes the one that is sent, "
        "a loop.",
        f"EKF2_HGT_REF = 0, {REBOOT}",
        _height,
    ),
    parameter(
        "px4-barometer",
        PX4,
        "EKF2_BARO_CTRL",
        "On vision the height rests on the barometer.",
        "EKF2_BARO_CTRL = 1",
        within(lambda value: value == 1, 1.0),
    ),
    parameter(
        "px4-gnss-control",
        PX4,
        "EKF2_GPS_CTRL",
        "The daemon sets 0 while it flies on vision, and PX4 stores parameters: a flight that ended so leaves GNSS off at the "
        "next boot.",
        "EKF2_GPS_CTRL = injection.px4_gps_ctrl (7)",
        _gps,
    ),
    parameter(
        "px4-gnss-spoof-check",
        PX4,
        "EKF2_GPS_CHECK",
        "Bit 9 (from 1.16) drops samples that the receiver itself calls spoofed.",
        "EKF2_GPS_CHECK with bit 9 (512)",
        _spoof_check,
    ),
    parameter(
        "px4-no-aid",
        PX4,
        "EKF2_NOAID_TOUT",
        "Time without any aiding until the position is invalid. 5 s was measured; less leaves no room for a gap, more flies "
        "on drift.",
        "EKF2_NOAID_TOUT = 5000000",
        within(lambda value: 2e6 <= value <= 1e7, 5e6, Level.AMBER),
    ),
    parameter(
        "px4-compass",
        PX4,
        "EKF2_MAG_TYPE",
        "On vision the heading comes from the compass: 5 uses none, 6 only to find the heading before the flight.",
        f"EKF2_MAG_TYPE = 0, {REBOOT}",
        _compass,
    ),
    Rule(
        "px4-ev-offset",
        "EKF2_EV_POS_X EKF2_EV_POS_Y EKF2_EV_POS_Z",
        "The daemon sends the position of the vehicle, not of the camera: an offset here would be taken off again.",
        "EKF2_EV_POS_X = EKF2_EV_POS_Y = EKF2_EV_POS_Z = 0",
        _offset,
        PX4,
        poses=True,
    ),
    Rule(
        "px4-auxiliary-position",
        "EKF2_AGPn_CTRL",
        "A second source of global positions is fused beside vision. Its delay is its own, and it drops out below 4 Hz with "
        "the default gate of 3.",
        "EKF2_AGPn_CTRL = 0, unless GLOBAL_POSITION_SENSOR is what you send on purpose",
        _agp,
        PX4,
    ),
)
"""About EKF2."""
