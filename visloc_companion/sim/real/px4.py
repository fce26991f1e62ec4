"""PX4's multicopter and plane in its own simulator (SIH, simulation in hardware, here on this machine)."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from visloc_companion.adapters.mavlink.dialect import Message, mav
from visloc_companion.errors import ConfigError, LinkError
from visloc_companion.geo.wgs84 import geo_from_ned
from visloc_companion.sim.real.pilot import DAEMON_PORT, FIRST_POSITION_S, HOME, STATION_PORT, Route, Truth
from visloc_companion.sim.real.pitot_tube import with_dynamic_pressure
from visloc_companion.sim.real.relay import whole
from visloc_companion.sim.real.station import MissionItem, Station
from visloc_companion.types import AutopilotKind, EkfSource, GeoPoint

RATES_HZ = {
    mav.MAVLINK_MSG_ID_ATTITUDE_QUATERNION: 20.0,
    mav.MAVLINK_MSG_ID_ATTITUDE: 100.0,
    mav.MAVLINK_MSG_ID_LOCAL_POSITION_NED: 20.0,
    mav.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: 20.0,
    mav.MAVLINK_MSG_ID_HIL_STATE_QUATERNION: 20.0,
    mav.MAVLINK_MSG_ID_ESTIMATOR_STATUS: 10.0,
}
_BEFORE_A_POSITION = (
    mav.MAVLINK_MSG_ID_ATTITUDE,
    mav.MAVLINK_MSG_ID_ATTITUDE_QUATERNION,
    mav.MAVLINK_MSG_ID_HIL_STATE_QUATERNION,
    mav.MAVLINK_MSG_ID_ESTIMATOR_STATUS,
)
_ALTITUDE, _AUTO, _MISSION, _LOITER, _LAND = 2.0, 4.0, 4.0, 3.0, 6.0
"""PX4's main modes ALTCTL and AUTO, and the sub-modes of AUTO."""
_CLIMB, _HOLD, _AHEAD, _STICKS_S = 900, 500, 150, 0.1
_HAS_ABSOLUTE_POSITION = mav.ESTIMATOR_POS_HORIZ_ABS
_ARM_TRIES, _READY_S, _CLIMB_S, _LAND_S = 40, 120.0, 90.0, 180.0
_SATELLITES = 10
_GPS_CTRL = 7
_ALTITUDE_REFERENCE_MPS, _ALTITUDE_SETTLES_S = 3.0, 7.0
"""PX4 begins the altitude that its planes follow (TECS) at 0 m above sea level when it boots without an origin, and lets it rise
by FW_T_CLMB_R_SP: a plane that takes off sooner sinks on its first leg until that has come up to it."""
_SET_SIGMA_M = 10.0
"""An origin alone leaves EKF2 at 0 N 0 E, with the compass of that place: it does not arm ("heading estimate not stable")."""
_OWN: dict[str, str] = {
    "MPC_ACC_HOR": "5.0",
    "COM_RC_IN_MODE": "4",
    "NAV_RCL_ACT": "0",
    "COM_DISARM_LAND": "2.0",
    "EKF2_ACC_NOISE": "1.0",
}
"""What the simulated vehicle needs beside the user's file and home: brisk braking, no remote control, disarming on the ground,
and the noise of its accelerometers: SIH's 1.7 m/s² at 250 Hz is 1.1 m/s² at the filter's 100 Hz; EKF2's default is 0.35."""
_OWN_PLANE = {"MIS_TKO_LAND_REQ": "0", "COM_LOW_BAT_ACT": "0"}
"""A mission that only flies round has no landing, and the simulated battery runs low in flight."""


class Px4:
    """pilot.Pilot of the quadrotor and the plane, which stands at `home`. `parameter_file` is in QGroundControl's format.

    `own`: parameters of the simulated vehicle beside its makers'.
    """

    kind = AutopilotKind.PX4
    station_url = f"udpin:127.0.0.1:{STATION_PORT}"
    daemon_url = f"udpin:127.0.0.1:{DAEMON_PORT}"

    def __init__(self, plane: bool, parameter_file: Path, home: GeoPoint = HOME, own: Mapping[str, str] | None = None) -> None:
        self._plane, self._parameter_file, self._home = plane, parameter_file, home
        self._own = _OWN | (_OWN_PLANE if plane else {}) | dict(own or {})
        self._indicated_mps = 0.0

    def command(self, program: Path, folder: Path, speed: float, gnss: bool = True) -> tuple[Sequence[str], Mapping[str, str]]:
        """Links are those of PX4's start script: 14550 to the ground station, 14540 to the companion."""
        lines = self._parameter_file.read_text(encoding="ascii").splitlines()
        told = dict(line.split("\t")[2:4] for line in lines if not line.startswith("#"))
        home = self._home
        environment = {f"PX4_PARAM_{name}": value for name, value in {**self._own, **told}.items()}
        if not gnss:
            environment |= {"PX4_PARAM_SIM_GPS_USED": "0", "PX4_PARAM_COM_RC_IN_MODE": "1"}
        environment |= {
            "PX4_SIM_MODEL": "sihsim_airplane" if self._plane else "sihsim_quadx",
            "PX4_SIMULATOR": "sihsim",
            "PX4_SIM_SPEED_FACTOR": f"{speed:g}",
            "PX4_HOME_LAT": f"{home.lat_deg}",
            "PX4_HOME_LON": f"{home.lon_deg}",
            "PX4_HOME_ALT": f"{home.h_amsl_m}",
            "PX4_PARAM_SIH_LOC_LAT0": f"{home.lat_deg}",
            "PX4_PARAM_SIH_LOC_LON0": f"{home.lon_deg}",
            "PX4_PARAM_SIH_LOC_H0": f"{home.h_amsl_m}",
        }
        return (str(program), "-d", "-i", "0", "-w", str(folder), str(program.parents[1] / "etc")), environment

    def passed(self, message: Message) -> bytes:
        """All but SYSTEM_TIME, whose calendar is this machine's and does not run at the speed of the simulation: GNSS time would
        seem to be forged. A plane's SCALED_PRESSURE gets the dynamic pressure of the airspeed that PX4 goes by."""
        kind = message.get_type()
        if kind == "SYSTEM_TIME":
            return b""
        if kind == "VFR_HUD":
            self._indicated_mps = message.airspeed if math.isfinite(message.airspeed) else 0.0
        if self._plane and kind == "SCALED_PRESSURE":
            return with_dynamic_pressure(message, self._indicated_mps)
        return whole(message)

    def truth(self, message: Message) -> Truth | None:
        """HIL_STATE_QUATERNION has it."""
        if message.get_type() != "HIL_STATE_QUATERNION":
            return None
        place = GeoPoint(message.lat * 1e-7, message.lon * 1e-7, message.alt * 1e-3)
        w, x, y, z = message.attitude_quaternion
        return Truth(place, (message.vx * 0.01, message.vy * 0.01, message.vz * 0.01), (w, x, y, z))

    def position_ok(self, station: Station) -> bool | None:
        """ESTIMATOR_STATUS has it."""
        report = station.last.get("ESTIMATOR_STATUS")
        return None if report is None else bool(report.flags & _HAS_ABSOLUTE_POSITION)

    def position_ratio(self, station: Station) -> float | None:
        """ESTIMATOR_STATUS has it."""
        report = station.last.get("ESTIMATOR_STATUS")
        return None if report is None else float(report.pos_horiz_ratio)

    async def prepare(self, station: Station, gnss: bool = True) -> None:
        """Streams, then a position or an origin."""
        await station.until("heartbeat", lambda: "HEARTBEAT" in station.last, _READY_S)
        if not gnss:
            await station.stream({number: RATES_HZ[number] for number in _BEFORE_A_POSITION})
            await station.set_origin(self._home, _READY_S)
            place = self._home.lat_deg, self._home.lon_deg, math.nan
            await station.command(mav.MAV_CMD_EXTERNAL_POSITION_ESTIMATE, 0.0, 0.0, _SET_SIGMA_M, 0.0, *place)
            return
        await station.stream(RATES_HZ)
        await station.until("position of the EKF", lambda: bool(self.position_ok(station)), _READY_S)
        await station.command(mav.MAV_CMD_REQUEST_MESSAGE, mav.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN)

    async def take_off(self, station: Station, route: Route) -> None:
        """The mission begins with the take-off. A plane stands until the altitude that it follows is at home."""
        await station.upload(self._mission(route))
        if self._plane:
            await station.holds(lambda: False, self._home.h_amsl_m / _ALTITUDE_REFERENCE_MPS + _ALTITUDE_SETTLES_S)
        await self._set_mode(station, _MISSION)
        await station.command(mav.MAV_CMD_COMPONENT_ARM_DISARM, 1.0, tries=_ARM_TRIES)
        climbed = 0.9 * route.height_m
        await station.until(f"climb to {climbed:.0f} m", lambda: _height_m(station) > climbed, _CLIMB_S)

    async def climb_by_hand(self, station: Station, route: Route) -> None:
        """Altitude mode with the sticks sent by the ground station; the mission when there is a position. The daemon finds no
        vehicle that hovers ("keep moving"), and here is no wind: it is flown ahead."""
        await station.upload(self._mission(route))
        await self._steer(station, _HOLD, lambda: False, 1.0)
        await station.command(mav.MAV_CMD_DO_SET_MODE, 1.0, _ALTITUDE)
        await station.command(mav.MAV_CMD_COMPONENT_ARM_DISARM, 1.0, tries=_ARM_TRIES)
        if not await self._steer(station, _CLIMB, lambda: self._true_height_m(station) > 0.9 * route.height_m, _CLIMB_S):
            raise LinkError("the copter did not climb", where=station.url)
        if not await self._steer(station, _HOLD, lambda: bool(self.position_ok(station)), FIRST_POSITION_S, _AHEAD):
            raise LinkError("the autopilot found no position", where=station.url)
        await station.stream(RATES_HZ)
        await self._set_mode(station, _MISSION)

    async def _steer(self, station: Station, throttle: int, until: Callable[[], bool], timeout_s: float, ahead: int = 0) -> bool:
        for _ in range(round(timeout_s / _STICKS_S)):
            station.send(mav.MAVLink_manual_control_message(station.system_id, ahead, 0, throttle, 0, 0))
            if await station.holds(until, _STICKS_S):
                return True
        return False

    async def _set_mode(self, station: Station, sub_mode: float) -> None:
        await station.command(mav.MAV_CMD_DO_SET_MODE, 1.0, _AUTO, sub_mode)

    async def set_gnss(self, station: Station, on: bool) -> None:
        """The receiver goes on talking; without satellites it has no fix."""
        await station.set_integer("SIM_GPS_USED", _SATELLITES if on else 0)

    async def drag_gnss(self, station: Station, offset_ne_m: tuple[float, float]) -> None:
        """Nothing that a ground station can set moves SIH's receiver. Raises ConfigError."""
        raise ConfigError("PX4's own simulator cannot drag its GNSS receiver", remedy="fly slow_drag with ArduPilot")

    async def brake(self, station: Station) -> None:
        """Hold mode."""
        await self._set_mode(station, _LOITER)

    async def resume(self, station: Station) -> None:
        """Mission mode."""
        await self._set_mode(station, _MISSION)

    async def set_source(self, station: Station, source: EkfSource) -> None:
        """Without GNSS there is vision only."""
        await station.set_integer("EKF2_GPS_CTRL", 0 if source is EkfSource.VISION else _GPS_CTRL)

    async def land(self, station: Station) -> None:
        """Land mode, and wait."""
        await self._set_mode(station, _LAND)
        armed = mav.MAV_MODE_FLAG_SAFETY_ARMED
        await station.until("landing", lambda: not station.last["HEARTBEAT"].base_mode & armed, _LAND_S)

    def _mission(self, route: Route) -> list[MissionItem]:
        def item(command: int, north_m: float = 0.0, east_m: float = 0.0, p1: float = 0.0, p2: float = 0.0) -> MissionItem:
            place = geo_from_ned((north_m, east_m, 0.0), self._home)
            return MissionItem(command, (p1, p2, 0.0, 0.0), place.lat_deg, place.lon_deg, route.height_m)

        items = [
            item(mav.MAV_CMD_NAV_TAKEOFF),
            item(mav.MAV_CMD_DO_CHANGE_SPEED, p1=0.0 if self._plane else 1.0, p2=route.speed_mps),
        ]
        first = len(items)
        items += [item(mav.MAV_CMD_NAV_WAYPOINT, leg.north_m, leg.east_m, p1=leg.hold_s) for leg in route.legs]
        return [*items, item(mav.MAV_CMD_DO_JUMP, p1=float(first), p2=1000.0)]

    def failsafe(self, text: str) -> bool:
        """By the words that PX4 uses."""
        return "failsafe" in text.lower() or "blind land" in text.lower()

    def _true_height_m(self, station: Station) -> float:
        state = station.last.get("HIL_STATE_QUATERNION")
        return 0.0 if state is None else float(state.alt) * 1e-3 - self._home.h_amsl_m


def _height_m(station: Station) -> float:
    position = station.last.get("GLOBAL_POSITION_INT")
    return 0.0 if position is None else float(position.relative_alt) * 1e-3
