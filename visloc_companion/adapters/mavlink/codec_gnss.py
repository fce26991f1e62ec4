"""What speaks of satellite navigation: GPS_RAW_INT, GPS2_RAW, SYSTEM_TIME, GNSS_INTEGRITY, and PX4's texts about interference."""

from __future__ import annotations

import math
from collections.abc import Callable

from visloc_companion.adapters.mavlink.dialect import Message
from visloc_companion.errors import Reason
from visloc_companion.types import Event, GeoPoint, Gnss, GnssIntegrity, GnssTime

Outcome = Event | Reason | None
"""What a message comes to: an event, why it was dropped, or None where it says nothing to the navigator."""
_MAX_BOOT_US = 100_000_000_000_000
"""About three years: a larger time_usec counts from 1970 or 1980 and says nothing about the autopilot's clock."""
BOOT_PERIOD_NS = 2**32 * 1_000_000
"""Attitudes and positions bear 32 bits of milliseconds, which begin anew after 49.7 days; other times of the same clock go on."""
_MIN_UNIX_US = 1_420_070_400_000_000
"""Before 2015 no calendar time came from a receiver: the autopilot has none yet."""
_UNKNOWN, _DETECTED = 0, 3
_AUTHENTICATION_ERROR, _AUTHENTICATION_OK = 2, 3
"""GPS_JAMMING_STATE and GPS_SPOOFING_STATE: unknown, none, mitigated, detected; GPS_AUTHENTICATION_STATE likewise by name."""
_SPOOFED_TEXTS, _JAMMED_TEXTS = ("signal spoofed",), ("signal jammed", "GPS reports critical jamming")
"""What PX4 says where it has no message for it (estimatorCheck.cpp): of GNSS or, on the ground and in older versions, of GPS."""


def wrapped_ns(t_boot_us: int) -> int:
    """Microseconds of the autopilot's clock as the boot time that attitudes and positions would bear."""
    return t_boot_us * 1000 % BOOT_PERIOD_NS


def place(lat_e7: int, lon_e7: int, alt_mm: int) -> GeoPoint | None:
    """Degrees 1e7 and millimetres as a place; None off the globe."""
    if abs(lat_e7) > 900_000_000 or abs(lon_e7) > 1_800_000_000:
        return None
    return GeoPoint(lat_e7 / 1e7, lon_e7 / 1e7, alt_mm / 1e3)


def _gnss(msg: Message, t_rx_ns: int, receiver: int) -> Outcome:
    where = place(msg.lat, msg.lon, msg.alt)
    if where is None:
        return Reason.BAD_INPUT
    v_ned_mps = None
    if msg.vel != 65535 and msg.cog != 65535:
        speed_mps, course_rad = msg.vel / 100.0, math.radians(msg.cog / 100.0)
        v_ned_mps = (speed_mps * math.cos(course_rad), speed_mps * math.sin(course_rad), 0.0)
    return Gnss(
        t_rx_ns,
        wrapped_ns(msg.time_usec) if msg.time_usec < _MAX_BOOT_US else 0,
        msg.fix_type,
        None if msg.satellites_visible == 255 else msg.satellites_visible,
        where,
        _accuracy_m(msg, "h_acc"),
        _accuracy_m(msg, "v_acc"),
        v_ned_mps,
        receiver,
    )


def _accuracy_m(msg: Message, name: str) -> float | None:
    accuracy_mm = int(getattr(msg, name, 0))
    return None if accuracy_mm in (0, 0xFFFFFFFF) else accuracy_mm / 1e3


def _system_time(msg: Message, t_rx_ns: int) -> Outcome:
    if msg.time_unix_usec < _MIN_UNIX_US:
        return None
    return GnssTime(t_rx_ns, msg.time_boot_ms * 1_000_000, msg.time_unix_usec * 1000)


def _gnss_integrity(msg: Message, t_rx_ns: int) -> Outcome:
    authentic = {_AUTHENTICATION_ERROR: False, _AUTHENTICATION_OK: True}.get(msg.authentication_state)
    return GnssIntegrity(t_rx_ns, msg.id, _detected(msg.jamming_state), _detected(msg.spoofing_state), authentic)


def _detected(state: int) -> bool | None:
    return None if state == _UNKNOWN else state == _DETECTED


def _statustext(msg: Message, t_rx_ns: int) -> Outcome:
    text = str(msg.text)
    spoofed, jammed = (any(words in text for words in texts) for texts in (_SPOOFED_TEXTS, _JAMMED_TEXTS))
    return GnssIntegrity(t_rx_ns, 0, jammed or None, spoofed or None, None) if spoofed or jammed else None


HANDLERS: dict[str, Callable[[Message, int], Outcome]] = {
    "GPS_RAW_INT": lambda msg, t_rx_ns: _gnss(msg, t_rx_ns, 0),
    "GPS2_RAW": lambda msg, t_rx_ns: _gnss(msg, t_rx_ns, 1),
    "SYSTEM_TIME": _system_time,
    "GNSS_INTEGRITY": _gnss_integrity,
    "STATUSTEXT": _statustext,
}
