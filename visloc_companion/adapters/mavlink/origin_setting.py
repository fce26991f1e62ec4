"""SET_GPS_GLOBAL_ORIGIN (48): gives an autopilot that has no origin, and no GNSS to get one from, the middle of our map.

ArduPilot takes an origin once and ignores any further one in silence. PX4 takes one at any time and moves its frame with it,
so it is never sent to an armed PX4: its origin may only not have been heard yet.
"""

from __future__ import annotations

from visloc_companion.adapters.mavlink.dialect import Message, mav
from visloc_companion.adapters.mavlink.outputs.global_position import e7
from visloc_companion.types import FIX_3D, AutopilotKind, GeoPoint, LinkChanged

_NS_PER_S = 1_000_000_000
PATIENCE_NS, PERIOD_NS = 10 * _NS_PER_S, 5 * _NS_PER_S
"""An autopilot that hears satellites finds its own origin; one that was just heard may have one to tell."""


class OriginSetter:
    """Sans-IO; without a `place` it never speaks."""

    def __init__(self, place: GeoPoint | None) -> None:
        self._place = place
        self._since_ns: int | None = None
        self._next_ns = 0

    def hear(self, msg: Message, now_ns: int) -> None:
        """Take a message of the autopilot."""
        if msg.get_type() == "GPS_RAW_INT" and msg.fix_type >= FIX_3D:
            self._since_ns = now_ns

    def restart(self, now_ns: int) -> None:
        """The autopilot came (back)."""
        self._since_ns = now_ns

    def poll(self, link: LinkChanged, has_origin: bool, now_ns: int) -> Message | None:
        """The message to send now, if any."""
        place, since_ns = self._place, self._since_ns
        if place is None or since_ns is None or has_origin or link.autopilot is AutopilotKind.UNKNOWN:
            return None
        if link.autopilot is AutopilotKind.PX4 and link.armed:
            return None
        if now_ns - since_ns < PATIENCE_NS or now_ns < self._next_ns:
            return None
        self._next_ns = now_ns + PERIOD_NS
        where = e7(place.lat_deg), e7(place.lon_deg), round(place.h_amsl_m * 1e3)
        return mav.MAVLink_set_gps_global_origin_message(link.system_id, *where, now_ns // 1000)
