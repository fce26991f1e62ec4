"""ArduPilot: ports, identities, rates and receivers. Sources: GCS_Common.cpp, AP_GPS_MAV.cpp."""

from __future__ import annotations

import re

from visloc_companion.adapters.mavlink.outputs.kinds import Output
from visloc_companion.doctor.facts import Facts
from visloc_companion.doctor.finding import FASTER_URL, REBOOT, Finding, Level, Rule, amber, green, red, skipped
from visloc_companion.doctor.rules.parameter import one_to_set, own_system, parameter, unread, within
from visloc_companion.types import AutopilotKind

AP = AutopilotKind.ARDUPILOT
MAVLINK1, MAVLINK2 = 1, 2
MAV_INPUT = 14
LEAST_LOOP_HZ, LEAST_BAUD, BUSY_HZ = 50, 115_200, 50
_ODD_BAUDS = {1: 1200, 2: 2400, 4: 4800, 9: 9600, 19: 19_200, 38: 38_400, 57: 57_600, 111: 111_100, 115: 115_200}
_ODD_BAUDS |= {230: 230_400, 460: 460_800, 921: 921_600}
"""What AP_SerialManager makes of a SERIALn_BAUD that is not a round number of thousands."""
_SECOND = "put our positions on the second one: GPS2_TYPE = 14 (before 4.6 GPS_TYPE2)"
_STREAM = re.compile(r"SR[0-9]_EXTRA1|MAV([1-9]|10)_EXTRA1")
"""The links in the order of their ports: SR0 is MAV1 of 4.7 and later."""


def baud_of(value: float) -> int:
    """Bits a second of a SERIALn_BAUD: thousands, or a few names, or above 2000 the number itself; 57600 where it is none."""
    rate = int(value) if value > 0 else 57
    return _ODD_BAUDS.get(rate, rate * 1000 if rate <= 2000 else rate)


def _ports(facts: Facts, protocols: tuple[int, ...]) -> list[int]:
    found = (re.fullmatch(r"SERIAL([1-9])_PROTOCOL", name) for name in facts.parameters)
    numbers = [int(match.group(1)) for match in found if match is not None]
    return sorted(number for number in numbers if facts.parameters[f"SERIAL{number}_PROTOCOL"] in protocols)


def _serial_baud_of_link(facts: Facts) -> int | None:
    url = facts.link.url if facts.link is not None else ""
    return int(url.rpartition(":")[2]) if url.startswith("serial:") else None


def _protocol(facts: Facts) -> Finding:
    if "SERIAL1_PROTOCOL" not in facts.parameters:
        return unread(facts, "serial ports")
    ports, old = _ports(facts, (MAVLINK2,)), _ports(facts, (MAVLINK1,))
    read = f"MAVLink 2 on {_names(ports)}, MAVLink 1 on {_names(old)}"
    spoken = MAVLINK2 if facts.link is None else facts.link.mavlink_version
    if ports and (spoken == MAVLINK2 or not old):
        return green(read)
    if old:
        return one_to_set(read, {f"SERIAL{number}_PROTOCOL": float(MAVLINK2) for number in old}, of=len(ports) + len(old))
    if _serial_baud_of_link(facts) is None:
        return green(f"{read}; the link is no serial line")
    return green(f"{read}; the link is on another") if facts.link is not None and spoken == MAVLINK2 else red(read)


def _names(ports: list[int]) -> str:
    return ", ".join(f"SERIAL{number}" for number in ports) or "no port"


def _baud(facts: Facts) -> Finding:
    wanted = _serial_baud_of_link(facts)
    if wanted is None:
        return skipped("the link is not a serial line", "give --link serial:DEVICE:BAUD to judge it")
    ports = _ports(facts, (MAVLINK1, MAVLINK2))
    bauds = {f"SERIAL{number}_BAUD": facts.parameters.get(f"SERIAL{number}_BAUD", 0.0) for number in ports}
    read = ", ".join(f"{name} = {value:g}" for name, value in bauds.items()) + f"; the link has {wanted}"
    same = [name for name, value in bauds.items() if baud_of(value) == wanted]
    if not same:
        return amber(read)
    return one_to_set(read, dict.fromkeys(same, 921.0), len(ports), FASTER_URL) if wanted < LEAST_BAUD else green(read)


def _stream_rates(facts: Facts) -> Finding:
    rates = {name: value for name, value in facts.parameters.items() if _STREAM.fullmatch(name)}
    if not rates:
        return unread(facts, "streams")
    read = ", ".join(f"{name} = {value:g}" for name, value in sorted(rates.items()))
    busy = {name: 10.0 for name, value in rates.items() if value > BUSY_HZ}
    return amber(read, parameters=busy) if busy else green(read)


def _station_id(name: str, value: float, facts: Facts) -> Finding:
    own = facts.parameters.get("MAV_SYSID", facts.parameters.get("SYSID_THISMAV", 1.0))
    last = facts.parameters.get("MAV_GCS_SYSID_HI", 0.0)
    read = f"{name} = {value:g}" + (f" to {last:g}" if last > value else "") + f", the vehicle is {own:g}"
    if not value <= own <= max(value, last):
        return green(read)
    return amber(read, parameters={name: 255.0})


def _receiver(name: str, value: float, facts: Facts) -> Finding:
    read = f"{name} = {value:g}"
    if value == MAV_INPUT and facts.choice.output is Output.GPS_INPUT:
        return amber(f"{read}: no receiver of its own to compare with", _SECOND)
    if value == MAV_INPUT:
        return red(f"{read} (positions by MAVLink)", parameters={name: 1.0})
    return amber(f"{read} (no receiver)", parameters={name: 1.0}) if value == 0 else green(read)


def _second_receiver(name: str, value: float, facts: Facts) -> Finding:
    read = f"{name} = {value:g}"
    if value == MAV_INPUT and facts.choice.output is Output.GPS_INPUT:
        return green(f"{read}, and positions are sent as GPS_INPUT")
    return amber(f"{read} (positions by MAVLink)", parameters={name: 0.0}) if value == MAV_INPUT else green(read)


RULES: tuple[Rule, ...] = (
    Rule(
        "ap-serial-protocol",
        "SERIALn_PROTOCOL",
        "What it sends is then MAVLink 1: without the receiver's accuracies, gimbals and signatures. Ours it reads as MAVLink 2 "
        "all the same.",
        "SERIALn_PROTOCOL = 2 of the companion's port, then reboot the autopilot",
        _protocol,
        AP,
    ),
    Rule(
        "ap-serial-baud",
        "SERIALn_BAUD, the link's URL",
        "57600 baud does not carry attitude and accelerations at 50 Hz.",
        f"SERIALn_BAUD = 921 of the companion's port, the same in link.url (serial:DEVICE:921600), {REBOOT}",
        _baud,
        AP,
    ),
    Rule(
        "ap-stream-rates",
        "SRn_EXTRA1 or MAVn_EXTRA1",
        "The daemon asks for each message itself; fast streams beside them fill the line.",
        f"SRn_EXTRA1 (MAVn_EXTRA1) at most 10, {REBOOT}",
        _stream_rates,
        AP,
    ),
    parameter(
        "ap-loop-rate",
        AP,
        "SCHED_LOOP_RATE",
        "Messages faster than 0.8 of the loop are denied: at 50 Hz ArduPlane streams attitude at 37.5 Hz, below that too "
        "seldom to time frames.",
        "SCHED_LOOP_RATE = 50 or more, then reboot the autopilot",
        within(lambda value: value >= LEAST_LOOP_HZ, float(LEAST_LOOP_HZ), Level.AMBER),
    ),
    parameter(
        "ap-system-id",
        AP,
        "MAV_SYSID SYSID_THISMAV",
        "The daemon listens only to the system that it is told.",
        "link.system_id = the autopilot's, or 0",
        own_system,
    ),
    parameter(
        "ap-station-id",
        AP,
        "MAV_GCS_SYSID SYSID_MYGCS",
        "The ground station's failsafe counts heartbeats of this system (of all up to MAV_GCS_SYSID_HI, where that is more): if "
        "the vehicle's own is among them, the companion keeps it quiet.",
        "MAV_GCS_SYSID (SYSID_MYGCS) = 255",
        _station_id,
    ),
    parameter(
        "ap-receiver",
        AP,
        "GPS1_TYPE GPS_TYPE",
        "14 takes positions from MAVLink for a receiver's: without velocity the EKF failed within 1.2 s. 0 has no GNSS to "
        "compare with.",
        "GPS1_TYPE = 1 (automatic), then reboot the autopilot",
        _receiver,
    ),
    parameter(
        "ap-second-receiver",
        AP,
        "GPS2_TYPE GPS_TYPE2",
        "14 waits for GPS_INPUT, which this daemon sends only where it is told to, and hides from the EKF that it is not GNSS.",
        "GPS2_TYPE = 0, then reboot the autopilot",
        _second_receiver,
    ),
)
"""About ports, identities and receivers."""
