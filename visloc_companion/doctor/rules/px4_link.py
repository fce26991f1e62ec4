"""PX4: MAVLink instances, ports, identities and failsafes. Sources: mavlink_main.cpp, Timesync.hpp, commander parameters."""

from __future__ import annotations

import re

from visloc_companion.doctor.facts import Facts
from visloc_companion.doctor.finding import FASTER_URL, REBOOT, Finding, Level, Rule, amber, green, red, skipped
from visloc_companion.doctor.rules.parameter import one_to_set, own_system, parameter, within
from visloc_companion.types import AutopilotKind

PX4 = AutopilotKind.PX4
ONBOARD = 2
WITH_TIMESYNC = (ONBOARD, 5, 8, 9, 11, 13)
"""The modes with TIMESYNC at 10 Hz: onboard, config, external vision (also minimal), onboard and other low bandwidth."""
ETHERNET = 1000
"""The one value of MAV_n_CONFIG and its like that several may have."""
PORTS = {6: "URT6", 101: "TEL1", 102: "TEL2", 103: "TEL3", 104: "TEL4", 201: "GPS1", 202: "GPS2", 203: "GPS3", 300: "RC"}
PORTS |= {301: "WIFI", 401: "PPB"}
"""Serial ports by the value of MAV_n_CONFIG (Tools/serial/generate_config.py)."""
MAVLINK2 = 2
LEAST_RATE_BPS, LEAST_BAUD, LEAST_TIMESYNC_HZ = 10_000, 115_200, 5.0


def _instances(facts: Facts) -> dict[int, dict[str, float]]:
    """Parameters of the MAVLink instances that run: CONFIG is not 0, or absent as in the simulator."""
    found: dict[int, dict[str, float]] = {}
    for name, value in facts.parameters.items():
        match = re.fullmatch(r"MAV_([0-2])_(CONFIG|MODE|RATE)", name)
        if match is not None:
            found.setdefault(int(match.group(1)), {})[match.group(2)] = value
    return {number: known for number, known in found.items() if known.get("CONFIG", 1.0) != 0}


def _mode(facts: Facts) -> Finding:
    instances = _instances(facts)
    if not instances:
        return skipped("no parameters of MAVLink instances", "give --link URL")
    read = ", ".join(f"MAV_{number}_MODE = {known.get('MODE', -1):g}" for number, known in sorted(instances.items()))
    if any(known.get("MODE") in WITH_TIMESYNC for known in instances.values()):
        return green(read)
    serial = facts.link is None or facts.link.url.startswith("serial:")
    here = [number for number, known in instances.items() if (known.get("CONFIG") == ETHERNET) != serial]
    return red(read, parameters={f"MAV_{max(here or instances)}_MODE": float(ONBOARD)})


def _rate(facts: Facts) -> Finding:
    rates = {n: known["RATE"] for n, known in _instances(facts).items() if known.get("MODE") in WITH_TIMESYNC and "RATE" in known}
    if not rates:
        return skipped("no MAVLink instance is in onboard mode", "see px4-mavlink-mode")
    read = ", ".join(f"MAV_{number}_RATE = {rate:g} B/s" for number, rate in sorted(rates.items()))
    slow = {f"MAV_{number}_RATE": 0.0 for number, rate in rates.items() if 0 < rate < LEAST_RATE_BPS}
    return amber(read, parameters=slow) if slow else green(read)


def _timesync(facts: Facts) -> Finding:
    if facts.link is None:
        return skipped("no link", "give --link URL")
    read = f"{facts.link.timesync_requests_hz:.1f} requests/s"
    return green(read) if facts.link.timesync_requests_hz >= LEAST_TIMESYNC_HZ else red(read)


def _baud(facts: Facts) -> Finding:
    url = facts.link.url if facts.link is not None else ""
    if not url.startswith("serial:"):
        return skipped("the link is not a serial line", "give --link serial:DEVICE:BAUD to judge it")
    bauds = {name: value for name, value in facts.parameters.items() if re.fullmatch(r"SER_\w+_BAUD", name)}
    wanted = int(url.rpartition(":")[2])
    read = f"the link has {wanted}; " + ", ".join(f"{name} = {value:g}" for name, value in sorted(bauds.items()))
    ports = _mavlink_ports(facts) & bauds.keys() or set(bauds)
    same = sorted(name for name in ports if bauds[name] == wanted)
    if not same:
        return amber(read)
    return green(read) if wanted >= LEAST_BAUD else one_to_set(read, dict.fromkeys(same, 921600.0), len(ports), FASTER_URL)


def _mavlink_ports(facts: Facts) -> set[str]:
    """SER_*_BAUD of the ports that MAVLink instances have."""
    configs = (int(known.get("CONFIG", 0.0)) for known in _instances(facts).values())
    return {f"SER_{PORTS[config]}_BAUD" for config in configs if config in PORTS}


def _dds(name: str, value: float, facts: Facts) -> Finding:
    ports = [f"MAV_{number}_CONFIG" for number, known in _instances(facts).items() if known.get("CONFIG") == value]
    read = f"{name} = {value:g}" + (f" = {ports[0]}" if ports and value else "")
    return red(read, parameters={name: 0.0}) if ports and value not in (0, ETHERNET) else green(read)


def _protocol(name: str, value: float, facts: Facts) -> Finding:
    read = f"{name} = {value:g}"
    if value != 1:
        return green(read)
    if facts.link is not None and facts.link.mavlink_version == MAVLINK2:
        return green(f"{read}, and it answers in MAVLink 2")
    return red(read, parameters={name: float(MAVLINK2)})


RULES: tuple[Rule, ...] = (
    Rule(
        "px4-mavlink-mode",
        "MAV_n_CONFIG MAV_n_MODE",
        "Of the usual modes only onboard (2) and external vision (8) send TIMESYNC at 10 Hz, without which time stamps are times "
        "of arrival.",
        f"MAV_n_MODE = 2 of the companion's instance (TELEM2: MAV_1_CONFIG = 102, MAV_1_MODE = 2), {REBOOT}",
        _mode,
        PX4,
    ),
    Rule(
        "px4-mavlink-rate",
        "MAV_n_RATE",
        "A small limit starves the messages that the daemon asks for (0 takes half of the line).",
        f"MAV_n_RATE = 0, {REBOOT}",
        _rate,
        PX4,
    ),
    Rule(
        "px4-timesync-rate",
        "TIMESYNC requests of the autopilot",
        "PX4 believes our time stamps after 500 exchanges; at 10 Hz that takes 50 s, at 1 Hz eight minutes.",
        "put the link's instance into onboard mode: MAV_n_MODE = 2, then reboot the autopilot",
        _timesync,
        PX4,
    ),
    parameter(
        "px4-mavlink-version",
        PX4,
        "MAV_PROTO_VER",
        "What it sends is then MAVLink 1: without the receiver's accuracies and gimbals. Old versions stay with 1, new ones "
        "change to 2 once they hear it.",
        "MAV_PROTO_VER = 2",
        _protocol,
    ),
    Rule(
        "px4-serial-baud",
        "SER_TELn_BAUD, the link's URL",
        "57600 baud does not carry attitude and accelerations at 50 Hz.",
        f"SER_TEL2_BAUD = 921600 (the companion's port), the same in link.url (serial:DEVICE:921600), {REBOOT}",
        _baud,
        PX4,
    ),
    parameter(
        "px4-dds-port",
        PX4,
        "UXRCE_DDS_CFG",
        "The DDS client on the serial port of a MAVLink instance takes that port from it.",
        f"UXRCE_DDS_CFG = 0, or another port, {REBOOT}",
        _dds,
    ),
    parameter(
        "px4-system-id",
        PX4,
        "MAV_SYS_ID",
        "The daemon listens only to the system that it is told.",
        "link.system_id = the autopilot's, or 0",
        own_system,
    ),
    parameter(
        "px4-component-id",
        PX4,
        "MAV_COMP_ID",
        "The daemon listens to component 1, the autopilot.",
        f"MAV_COMP_ID = 1, {REBOOT}",
        within(lambda value: value == 1, 1.0),
    ),
    parameter(
        "px4-position-failsafe",
        PX4,
        "COM_POS_FS_EPH",
        "Beyond 2.5 times this claimed error a hovering vehicle gives a valid position up. Below 3 m vision trips it; -1 "
        "switches it off.",
        "COM_POS_FS_EPH = 5",
        within(lambda value: 3 <= value <= 50, 5.0, Level.AMBER),
    ),
    parameter(
        "px4-low-accuracy",
        PX4,
        "COM_POS_LOW_EPH",
        "Beyond this claimed error the vehicle acts (COM_POS_LOW_ACT). Vision claims 0.5 m and more: a limit below 3 m ends "
        "the mission.",
        "COM_POS_LOW_EPH = -1 (off), or 10 and more",
        within(lambda value: value <= 0 or value >= 3, -1.0, Level.AMBER),
    ),
    parameter(
        "px4-arming-without-gnss",
        PX4,
        "COM_ARM_WO_GPS",
        "2 arms without GNSS and without a warning: the daemon then has nothing to begin from.",
        "COM_ARM_WO_GPS = 1",
        within(lambda value: value != 2, 1.0, Level.AMBER),
    ),
)
"""About the link's parameters and the commander's."""
