"""ArduCopter and ArduPlane in their own simulator (SITL)."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from visloc_companion.adapters.mavlink.dialect import Message, mav
from visloc_companion.errors import LinkError
from visloc_companion.geo.wgs84 import ARDUPILOT_M_PER_DEG, geo_from_ned
from visloc_companion.sim.real.ardupilot_parameters import COPTER, PLANE
from visloc_companion.sim.real.pilot import DAEMON_PORT, FIRST_POSITION_S, HOME, SIMULATOR_PORT, STATION_PORT, Route, Truth
from visloc_companion.sim.real.relay import whole
from visloc_companion.sim.real.station import MissionItem, Station
from visloc_companion.types import AutopilotKind, EkfSource, GeoPoint

RATES_HZ = {
    mav.MAVLINK_MSG_ID_ATTITUDE_QUATERNION: 20.0,
    mav.MAVLINK_MSG_ID_ATTITUDE: 125.0,
    mav.MAVLINK_MSG_ID_LOCAL_POSITION_NED: 20.0,
    mav.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: 20.0,
    mav.MAVLINK_MSG_ID_SIM_STATE: 20.0,
    mav.MAVLINK_MSG_ID_EKF_STATUS_REPORT: 10.0,
}
"""ATTITUDE drives the clock."""
_BEFORE_A_POSITION = (mav.MAVLINK_MSG_ID_ATTITUDE, mav.MAVLINK_MSG_ID_ATTITUDE_QUATERNION, mav.MAVLINK_MSG_ID_EKF_STATUS_REPORT)
GUIDED, ALT_HOLD, COPTER_AUTO, COPTER_LAND, BRAKE, PLANE_AUTO, PLANE_RTL = 4, 2, 3, 9, 17, 10, 11
_CLIMB, _HOLD, _MIDDLE, _STICKS_S = 1900, 1500, 1500, 0.2
_GNSS_SET, _VISION_SET = 1, 2
_HAS_ABSOLUTE_POSITION = 16
_ARM_TRIES, _READY_S, _CLIMB_S, _LAND_S = 40, 90.0, 90.0, 180.0
_FAILSAFES = ("failsafe", "ekf variance", "dead reckoning", "potential thrust loss", "crash")


class ArduPilot:
    """pilot.Pilot of both vehicles, standing at `home`. `parameter_file` is laid over the simulated vehicle's own parameters."""

    kind = AutopilotKind.ARDUPILOT
    station_url = f"tcpin:127.0.0.1:{STATION_PORT}"
    daemon_url = f"udpin:127.0.0.1:{DAEMON_PORT}"

    def __init__(self, plane: bool, parameter_file: Path, home: GeoPoint = HOME) -> None:
        self._plane, self._parameter_file, self._home = plane, parameter_file, home

    def command(self, program: Path, folder: Path, speed: float, gnss: bool = True) -> tuple[Sequence[str], Mapping[str, str]]:
        """Links: SERIAL0 to the ground station, SERIAL1 to the daemon."""
        own = folder / "vehicle.parm"
        wanted = (PLANE if self._plane else COPTER) | {"SIM_GPS1_ENABLE": float(gnss)}
        own.write_text("".join(f"{name} {value:g}\n" for name, value in wanted.items()), encoding="ascii")
        told = (
            str(program), "--model", "plane" if self._plane else "quad",
            "--home", f"{self._home.lat_deg},{self._home.lon_deg},{self._home.h_amsl_m},0",
            "--defaults", f"{own},{self._parameter_file.resolve()}", "--speedup", f"{speed:g}", "--wipe", "-I0",
            "--serial0", f"tcpclient:127.0.0.1:{STATION_PORT}", "--serial1", f"udpclient:127.0.0.1:{SIMULATOR_PORT}",
            "--serial2", "none", "--rc-in-port", "15501",
        )  # fmt: skip
        return told, {}

    def passed(self, message: Message) -> bytes:
        """All as they are."""
        return whole(message)

    def truth(self, message: Message) -> Truth | None:
        """SIM_STATE has it."""
        if message.get_type() != "SIM_STATE":
            return None
        place = GeoPoint(message.lat_int * 1e-7, message.lon_int * 1e-7, message.alt)
        return Truth(place, (message.vn, message.ve, message.vd), (message.q1, message.q2, message.q3, message.q4))

    def position_ok(self, station: Station) -> bool | None:
        """EKF_STATUS_REPORT has it."""
        report = station.last.get("EKF_STATUS_REPORT")
        return None if report is None else bool(report.flags & _HAS_ABSOLUTE_POSITION)

    def position_ratio(self, station: Station) -> float | None:
        """EKF_STATUS_REPORT has the root of the test ratio, whose limit is the same."""
        report = station.last.get("EKF_STATUS_REPORT")
        return None if report is None else float(report.pos_horiz_variance)

    async def prepare(self, station: Station, gnss: bool = True) -> None:
        """Streams, then a position or an origin."""
        await station.until("heartbeat", lambda: "HEARTBEAT" in station.last, _READY_S)
        await station.stream({number: RATES_HZ[number] for number in _BEFORE_A_POSITION})
        if not gnss:
            await station.stream({mav.MAVLINK_MSG_ID_SIM_STATE: RATES_HZ[mav.MAVLINK_MSG_ID_SIM_STATE]})
            await station.set_origin(self._home, _READY_S)
            return
        await station.until("position of the EKF", lambda: bool(self.position_ok(station)), _READY_S)
        await station.stream(RATES_HZ)
        await station.command(mav.MAV_CMD_REQUEST_MESSAGE, mav.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN)

    async def take_off(self, station: Station, route: Route) -> None:
        """Copter: take off in GUIDED and go to AUTO above. Plane: the mission begins with the take-off."""
        await station.upload(self._mission(route))
        if self._plane:
            await self._set_mode(station, PLANE_AUTO)
            await station.command(mav.MAV_CMD_COMPONENT_ARM_DISARM, 1.0, tries=_ARM_TRIES)
        else:
            await self._set_mode(station, GUIDED)
            await station.command(mav.MAV_CMD_COMPONENT_ARM_DISARM, 1.0, tries=_ARM_TRIES)
            await station.command(mav.MAV_CMD_NAV_TAKEOFF, 0, 0, 0, 0, 0, 0, route.height_m)
        climbed = 0.9 * route.height_m
        await station.until(f"climb to {climbed:.0f} m", lambda: _height_m(station) > climbed, _CLIMB_S)
        if not self._plane:
            await self._set_mode(station, COPTER_AUTO)

    async def climb_by_hand(self, station: Station, route: Route) -> None:
        """ALT_HOLD with the sticks sent by the ground station; AUTO when there is a position."""
        await station.upload(self._mission(route))
        await self._set_mode(station, ALT_HOLD)
        await station.command(mav.MAV_CMD_COMPONENT_ARM_DISARM, 1.0, tries=_ARM_TRIES)
        await self._steer(station, _CLIMB, lambda: self._true_height_m(station) > 0.9 * route.height_m, _CLIMB_S)
        await self._steer(station, _HOLD, lambda: bool(self.position_ok(station)), FIRST_POSITION_S)
        await station.stream(RATES_HZ)
        await self._set_mode(station, COPTER_AUTO)

    async def _steer(self, station: Station, throttle: int, until: Callable[[], bool], timeout_s: float) -> None:
        sticks = (_MIDDLE, _MIDDLE, throttle, _MIDDLE, 0, 0, 0, 0)
        for _ in range(round(timeout_s / _STICKS_S)):
            station.send(mav.MAVLink_rc_channels_override_message(station.system_id, 1, *sticks))
            if await station.holds(until, _STICKS_S):
                return
        raise LinkError(f"the copter did not do as its sticks said within {timeout_s:g} s", where=station.url)

    def _mission(self, route: Route) -> list[MissionItem]:
        def item(command: int, north_m: float = 0.0, east_m: float = 0.0, **params: float) -> MissionItem:
            place = geo_from_ned((north_m, east_m, 0.0), self._home)
            values = tuple(params.get(f"p{number}", 0.0) for number in range(1, 5))
            four = values[0], values[1], values[2], values[3]
            return MissionItem(command, four, place.lat_deg, place.lon_deg, route.height_m)

        items = [item(mav.MAV_CMD_NAV_WAYPOINT)]
        if self._plane:
            items.append(item(mav.MAV_CMD_NAV_TAKEOFF, 100.0, p1=15.0))
        items.append(item(mav.MAV_CMD_DO_CHANGE_SPEED, p1=0.0 if self._plane else 1.0, p2=route.speed_mps, p3=-1.0))
        first = len(items)
        items += [item(mav.MAV_CMD_NAV_WAYPOINT, leg.north_m, leg.east_m, p1=leg.hold_s) for leg in route.legs]
        return [*items, item(mav.MAV_CMD_DO_JUMP, p1=float(first), p2=-1.0)]

    async def _set_mode(self, station: Station, mode: int) -> None:
        await station.command(mav.MAV_CMD_DO_SET_MODE, 1.0, float(mode))

    async def set_gnss(self, station: Station, on: bool) -> None:
        """The receiver goes on talking, without a fix."""
        await station.set_parameter("SIM_GPS1_ENABLE", float(on))

    async def drag_gnss(self, station: Station, offset_ne_m: tuple[float, float]) -> None:
        """SIM_GPS1_GLTCH is in degrees."""
        north, east = offset_ne_m
        await station.set_parameter("SIM_GPS1_GLTCH_X", north / ARDUPILOT_M_PER_DEG)
        east_deg = east / (ARDUPILOT_M_PER_DEG * math.cos(math.radians(self._home.lat_deg)))
        await station.set_parameter("SIM_GPS1_GLTCH_Y", east_deg)

    async def brake(self, station: Station) -> None:
        """Mode BRAKE."""
        await self._set_mode(station, BRAKE)

    async def resume(self, station: Station) -> None:
        """Mode AUTO."""
        await self._set_mode(station, PLANE_AUTO if self._plane else COPTER_AUTO)

    async def set_source(self, station: Station, source: EkfSource) -> None:
        """Set 2 of the users' parameters is vision."""
        number = float(_VISION_SET if source is EkfSource.VISION else _GNSS_SET)
        await station.command(mav.MAV_CMD_SET_EKF_SOURCE_SET, number)

    async def land(self, station: Station) -> None:
        """Copter: LAND and wait. Plane: RTL."""
        await self._set_mode(station, PLANE_RTL if self._plane else COPTER_LAND)
        if not self._plane:
            armed = mav.MAV_MODE_FLAG_SAFETY_ARMED
            await station.until("landing", lambda: not station.last["HEARTBEAT"].base_mode & armed, _LAND_S)

    def failsafe(self, text: str) -> bool:
        """By the words that ArduPilot uses."""
        return any(word in text.lower() for word in _FAILSAFES)

    def _true_height_m(self, station: Station) -> float:
        state = station.last.get("SIM_STATE")
        return 0.0 if state is None else float(state.alt) - self._home.h_amsl_m


def _height_m(station: Station) -> float:
    position = station.last.get("GLOBAL_POSITION_INT")
    return 0.0 if position is None else float(position.relative_alt) * 1e-3
