"""Everything that an autopilot tells over its link."""

from __future__ import annotations

import math
from dataclasses import dataclass

from visloc_companion.adapters.mavlink.codec import decode
from visloc_companion.adapters.mavlink.dialect import Message, mav
from visloc_companion.config import Config
from visloc_companion.doctor.collect.conversation import Conversation
from visloc_companion.doctor.collect.mission import read_mission
from visloc_companion.doctor.collect.parameters import Parameters
from visloc_companion.doctor.collect.rates import measure
from visloc_companion.doctor.facts import LinkFacts
from visloc_companion.errors import LinkError
from visloc_companion.types import FIX_3D, AutopilotKind, EstimatorStatus, GeoPoint, LinkChanged

_ANSWER_S, _TRIES = 1.0, 5
_FIXED_WING = 1
_VTOL = range(19, 26)
_STATUS = ("EKF_STATUS_REPORT", "ESTIMATOR_STATUS")


@dataclass(frozen=True, slots=True)
class Vehicle:
    """What was read, and the parameters as they can be set."""

    link: LinkFacts
    version: str
    parameters: Parameters


async def hear(conversation: Conversation, wait_s: float) -> None:
    """Wait for the first HEARTBEAT. Raises LinkError where none comes."""
    if await conversation.until(lambda: "HEARTBEAT" in conversation.last or bool(conversation.lost), wait_s):
        if "HEARTBEAT" in conversation.last:
            return
        raise LinkError(conversation.lost, where=str(conversation.endpoint), remedy="see that the other side goes on listening")
    garbage = conversation.bytes_in and conversation.garbage_share > 0.5
    heard = ", ".join(f"{system}/{component}" for system, component in sorted(conversation.others))
    if garbage:
        why, remedy = "bytes come that are not MAVLink", "the same baud rate on both sides, MAVLink 2 and no console on the port"
    elif heard or conversation.autopilots:
        systems = ", ".join(map(str, sorted(conversation.autopilots))) or "none"
        why = f"no autopilot of system {conversation.system_id or 'any'} (autopilots: {systems}; others: {heard or 'none'})"
        remedy = "correct link.system_id, or connect the autopilot"
        if not conversation.system_id:
            why = f"no autopilot is heard, only what is none (system/component {heard})"
            remedy = "connect the autopilot, or a port that it speaks on: of a router, one that passes its HEARTBEAT on"
    else:
        why = f"nothing is heard for {wait_s:g} s"
        remedy = (
            "power and wires (TX and RX crossed), the port's protocol (ArduPilot SERIALn_PROTOCOL = 2, PX4 MAV_n_CONFIG), the "
            "baud rate, and the direction of UDP: udpin waits for the autopilot to speak, udpout speaks first"
        )
    raise LinkError(why, where=str(conversation.endpoint), remedy=remedy)


async def read_vehicle(conversation: Conversation, config: Config, seconds: float, wait_s: float) -> Vehicle:
    """Read version, parameters, mission, places and rates. Raises LinkError where no autopilot is heard."""
    await hear(conversation, wait_s)
    parameters = Parameters(conversation)
    await _request(conversation, mav.MAVLINK_MSG_ID_AUTOPILOT_VERSION, "AUTOPILOT_VERSION")
    await parameters.read_all(max(20.0, 4 * seconds))
    mission = await read_mission(conversation)
    await _request(conversation, mav.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN, "GPS_GLOBAL_ORIGIN")
    await _request(conversation, mav.MAVLINK_MSG_ID_HOME_POSITION, "HOME_POSITION")
    measured = await measure(conversation, config, seconds)
    last, status = conversation.last, _status(conversation)
    gnss = last.get("GPS_RAW_INT")
    facts = LinkFacts(
        url=str(conversation.endpoint),
        system_id=conversation.system_id,
        vehicle=_vehicle(int(last["HEARTBEAT"].type)),
        armed=conversation.armed,
        mavlink_version=conversation.mavlink_version,
        garbage_share=conversation.garbage_share,
        parameters_expected=parameters.expected,
        asked_hz=measured.asked_hz,
        rates_hz=measured.rates_hz,
        refused=measured.refused,
        rtt_ms=measured.rtt_ms,
        timesync_requests_hz=measured.timesync_requests_hz,
        drift_ppm=measured.drift_ppm,
        drift_sigma_ppm=measured.drift_sigma_ppm,
        origin=_place(last.get("GPS_GLOBAL_ORIGIN"), "latitude", "longitude", "altitude"),
        home=_place(last.get("HOME_POSITION"), "latitude", "longitude", "altitude"),
        mission=mission,
        position=_place(last.get("GLOBAL_POSITION_INT"), "lat", "lon", "alt"),
        claims_position=_claims_position(conversation),
        position_ratio=None if status is None else status.position_ratio,
        fix_type=None if gnss is None else int(gnss.fix_type),
        signed=conversation.signed,
        another_key=conversation.another_key,
        n_satellites=None if gnss is None or gnss.satellites_visible == 255 else int(gnss.satellites_visible),
        other_autopilots=tuple(sorted(conversation.autopilots - {conversation.system_id})),
        others=tuple(sorted(conversation.others)),
        strangers=tuple(sorted(conversation.strangers)),
        lost_share=conversation.lost_share,
        gimbals=measured.gimbals,
        old_gimbal="MOUNT_ORIENTATION" in last,
        gnss_h_amsl_m=None if gnss is None or gnss.fix_type < FIX_3D else gnss.alt * 1e-3,
        barometer_h_amsl_m=barometer_h_amsl_m(last.get("ALTITUDE")),
    )
    return Vehicle(facts, _version(last.get("AUTOPILOT_VERSION")), parameters)


async def _request(conversation: Conversation, number: int, name: str) -> None:
    for _ in range(_TRIES):
        conversation.command(mav.MAV_CMD_REQUEST_MESSAGE, number)
        if await conversation.until(lambda: name in conversation.last, _ANSWER_S):
            return


def _status(conversation: Conversation) -> EstimatorStatus | None:
    for name in _STATUS:
        for event in decode(conversation.last[name], 0) if name in conversation.last else []:
            if isinstance(event, EstimatorStatus):
                return event
    return None


def _claims_position(conversation: Conversation) -> bool | None:
    """Whether the EKF has an absolute position. PX4 sets the bit of a constant position at rest, too: it is left out there."""
    message = next((conversation.last[name] for name in _STATUS if name in conversation.last), None)
    if message is None:
        return None
    held = conversation.kind is AutopilotKind.ARDUPILOT and bool(message.flags & mav.EKF_CONST_POS_MODE)
    return bool(message.flags & mav.EKF_POS_HORIZ_ABS) and not held


def _version(message: Message | None) -> str:
    events = [] if message is None else decode(message, 0)
    return next((event.version for event in events if isinstance(event, LinkChanged)), "")


def _place(message: Message | None, lat: str, lon: str, height: str) -> GeoPoint | None:
    if message is None or (getattr(message, lat) == 0 and getattr(message, lon) == 0):
        return None
    return GeoPoint(getattr(message, lat) * 1e-7, getattr(message, lon) * 1e-7, getattr(message, height) * 1e-3)


def barometer_h_amsl_m(message: Message | None) -> float | None:
    """What PX4 puts into ALTITUDE.altitude_monotonic (streams/ALTITUDE.hpp): the barometer's height, by SENS_BARO_QNH."""
    return None if message is None or not math.isfinite(message.altitude_monotonic) else float(message.altitude_monotonic)


def _vehicle(mav_type: int) -> str:
    return "plane" if mav_type == _FIXED_WING else "vtol" if mav_type in _VTOL else "copter"
