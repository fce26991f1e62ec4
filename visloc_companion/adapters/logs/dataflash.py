"""ArduPilot's on-board logs (.bin), those of 2014 as well as today's.

ATT gives the attitude, IMU the accelerations, GPS and GPA (of older logs also GPS2 and GPA2) both receivers, BARO and ARSP
pressures, ORGN the origin, POS with XKF1 (NKF1, EKF1) the autopilot's position and velocity (without an EKF, as on DCM, that
between positions), XKF4 (NKF4, EKF4) its innovation ratios, RFND (since 4.0) distances, EV or ARM arming, MSG the version, PARM
which of several estimators flies (of which XKF4 names the core that does; before 4.1 XKF6 and XKF9 are the second core's). Logs
of before the EKF have NTUN (position and velocity over home, cm) and CTUN (height, climb) instead; home is then the first mission
item or the first fix.
"""

from __future__ import annotations

import math
from pathlib import Path

from visloc_companion.adapters.logs.attitude_rates import rates_between
from visloc_companion.adapters.logs.boots import chosen_boot, logs_of, put_together
from visloc_companion.adapters.logs.dataflash_format import BEGINNING, Fields, Formats, messages
from visloc_companion.adapters.logs.dataflash_times import LEAP_US, stated_time_us, without_belied
from visloc_companion.adapters.logs.gnss_times import Told, gnss_times, unix_minus_boot_ns
from visloc_companion.adapters.logs.lone_leaps import without_lone_leaps
from visloc_companion.adapters.logs.recording import (
    BESIDE_NS,
    BY_GPS_INPUT,
    FIRST_GPS_TYPE,
    FIRST_IS_PLAYED,
    NS_PER_MS,
    NS_PER_S,
    NS_PER_US,
    SECOND_GPS_TYPE,
    LogBytes,
    Losses,
    Recording,
    in_order,
    link_up,
    read_bytes,
)
from visloc_companion.errors import LogError
from visloc_companion.geo.se3 import quat_from_euler
from visloc_companion.geo.wgs84 import geo_from_autopilot_ned, ned_from_geo
from visloc_companion.types import (
    FIX_3D,
    Attitude,
    AutopilotKind,
    Baro,
    EstimatorStatus,
    Event,
    GeoPoint,
    GimbalAttitude,
    GimbalFrame,
    Gnss,
    Imu,
    LocalPose,
    OriginChanged,
    PriorPose,
    Range,
    Vec3,
)

_KIND = AutopilotKind.ARDUPILOT
_POSITIONS = ("POS", "ORGN", "XKF1", "NKF1", "EKF1", "XKF6", "NKF6", "XKF4", "NKF4", "EKF4", "XKF9", "NKF9", "NTUN", "CTUN")
_RECEIVERS = ("GPS", "GPS2", "GPA", "GPA2")
_WANTED = frozenset(("ATT", "MNT", "IMU", "BARO", "ARSP", "RFND", "EV", "ARM", "MSG", "CMD", "PARM", *_RECEIVERS, *_POSITIONS))
_EV_ARMED, _EV_DISARMED = (10, 15), (11,)
_DOWN, _GOOD = 25, 4
"""MAV_SENSOR_ROTATION_PITCH_270, and RangeFinder::Status::Good."""
_HORIZ_VEL, _HORIZ_POS_ABS, _CONST_POS_MODE, _GPS_GLITCHING = 0x2, 0x10, 0x80, 0x4000
"""Of nav_filter_status (AP_Nav_Common.h). Beyond 0x200 they differ from EKF_STATUS_REPORT: 0x8000 is a *good* GPS here."""
_ESTIMATORS = {1: "EKF", 2: "NKF", 3: "XKF"}
"""Of AHRS_EKF_TYPE: how the messages of EKF1, EKF2 and EKF3 begin; with any other value the vehicle flies on none of them."""
_IMU_EVERY_NS = 10 * NS_PER_MS
_LEAP_NS, _MAX_STEP_NS = LEAP_US * NS_PER_US, 3600 * NS_PER_S
_CONFIRMED, _CONFIRMED_LONG = 1, 20
"""So many messages must go on from a leap of the clock, more beyond `_MAX_STEP_NS` (disarmed for hours, not logging)."""
_FEW_EVENTS = 20
_GPS_EPOCH_UNIX_S = 315_964_800
_LEAP_SECONDS = ((1_483_228_800, 18), (1_435_708_800, 17), (1_341_100_800, 16), (1_230_768_000, 15), (0, 14))
"""UTC instants (Unix seconds) from which GPS time is so many seconds ahead of UTC."""


def read_dataflash(path: Path, boot: int = 0) -> Recording:
    """The flight in an on-board log; of several boots in one file, one: `boot` counts from 1, 0 is the one that tells most.

    Raises LogError where nothing in it tells of a flight, or where there are not so many boots.
    """
    losses = Losses()
    boots = _boots(read_bytes(path), losses)
    if not boots:
        what = "holds no ATT, GPS or POS message" + " as ArduPilot writes them" * bool(losses.dropped_messages)
        raise LogError(what, where=str(path), remedy="name a DataFlash log (.bin) of ArduPilot, or PX4's .ulg")
    read, others = chosen_boot(path, boots, boot)
    losses.reboots = len(boots) - 1
    one = boots[read]
    events, leaps = without_lone_leaps(path, in_order([*one.events, *gnss_times(one.utc_told)]), losses)
    return Recording(path, _KIND, events, losses, one.unix_minus_boot_ns, notes=(*others, *leaps, *one.notes))


def _boots(data: LogBytes, losses: Losses) -> list[_Reader]:
    """One reader for each boot."""
    formats: Formats = {}

    def read(log: tuple[int, int]) -> _Reader:
        reader = _Reader(losses)
        for name, fields in without_belied(messages(data, _WANTED, losses, *log, formats), losses):
            reader.take(name, fields)
        return reader

    def join(boot: _Reader, log: _Reader) -> None:
        boot.events += log.events
        boot.utc_told += log.utc_told
        boot.notes = log.notes or boot.notes

    return put_together(map(read, logs_of(data, BEGINNING)), join)


class _Reader:
    def __init__(self, losses: Losses) -> None:
        self.events: list[tuple[int, Event]] = []
        self.utc_told: list[Told] = []
        self._losses = losses
        self._t_ns = 0
        self._leap_ns: int | None = None
        self._n_leapt = 0
        self._last_attitude: Attitude | None = None
        self._last_imu_ns: int | None = None
        self._accuracies_m: dict[int, tuple[int, float | None, float | None]] = {}
        self._dynamic: tuple[int, float] | None = None
        self._n_receivers = 2
        self.notes: tuple[str, ...] = ()
        self._v_ned_mps: Vec3 | None = None
        self._last_place: tuple[int, GeoPoint] | None = None
        self._height: tuple[float, float] | None = None
        self._h_amsl_m: float | None = None
        self._home: GeoPoint | None = None
        self._version, self._armed = "", False
        self._idle: frozenset[str] = frozenset()
        self._core = 0

    @property
    def unix_minus_boot_ns(self) -> int | None:
        """UTC of the boot."""
        return unix_minus_boot_ns(self.utc_told)

    def take(self, name: str, fields: Fields) -> None:
        """One message; those with missing or impossible values are counted and left out."""
        handler = _HANDLERS.get(name)
        if handler is None or name[:3] in self._idle:
            return
        try:
            event = handler(self, fields)
        except (KeyError, TypeError, ValueError, OverflowError):
            self._losses.dropped_messages += 1
            return
        if event is not None:
            if not self.events:
                self.events.append((self._t_ns, link_up(self._t_ns, _KIND, self._version, self._armed)))
            self.events.append((self._t_ns, event))

    def _at(self, fields: Fields, milliseconds: str = "TimeMS") -> int:
        """Boot time of a message. Raises ValueError where it goes back, or leaps and the next messages do not confirm it.

        The format has no checksums: where the very first times were wrong, what follows confirms the way back.
        """
        t_ns = int(stated_time_us(fields, milliseconds) * NS_PER_US)
        if not self.events:
            self._t_ns = t_ns
        elif not -NS_PER_S <= t_ns - self._t_ns <= _LEAP_NS:
            back = t_ns < self._t_ns
            possible = self._leap_ns is not None and not (back and len(self.events) > _FEW_EVENTS)
            goes_on = possible and abs(t_ns - (self._leap_ns or 0)) <= _LEAP_NS
            self._leap_ns, self._n_leapt = t_ns, self._n_leapt + 1 if goes_on else 0
            if self._n_leapt < (_CONFIRMED if 0 < t_ns - self._t_ns <= _MAX_STEP_NS else _CONFIRMED_LONG):
                self._losses.clock_steps += not goes_on
                raise ValueError(t_ns)
            if back:
                self._losses.dropped_messages += len(self.events)
                self.events, self.utc_told, self._t_ns = [], [], t_ns
                self._last_attitude = self._last_imu_ns = None
        self._t_ns = max(self._t_ns, t_ns)
        return self._t_ns

    def _att(self, fields: Fields) -> Event:
        t_ns = self._at(fields)
        q = quat_from_euler(*(math.radians(_finite(fields[name])) for name in ("Roll", "Pitch", "Yaw")))
        last = self._last_attitude
        rates = rates_between(last.q_ned_frd, q, (t_ns - last.t_boot_ns) / NS_PER_S) if last else (0.0, 0.0, 0.0)
        self._last_attitude = Attitude(t_ns, t_ns, q, rates)
        return self._last_attitude

    def _mnt(self, fields: Fields) -> Event:
        """Roll and pitch against horizon, yaw against heading, as in GIMBAL_DEVICE_ATTITUDE_STATUS (AP_Mount, LogStructure.h)."""
        t_ns = self._at(fields)
        q = quat_from_euler(*(math.radians(_finite(fields[name])) for name in ("Roll", "Pitch", "YawB")))
        return GimbalAttitude(t_ns, t_ns, int(fields["I"]) + 1, q, GimbalFrame.HEADING)

    def _imu(self, fields: Fields) -> Event | None:
        if fields.get("I", 0) != 0:
            return None
        t_ns = self._at(fields)
        if self._last_imu_ns is not None and t_ns - self._last_imu_ns < _IMU_EVERY_NS:
            return None
        self._last_imu_ns = t_ns
        return Imu(t_ns, t_ns, (_finite(fields["AccX"]), _finite(fields["AccY"]), _finite(fields["AccZ"])))

    def _baro(self, fields: Fields) -> Event | None:
        """Pascals in the log; the dynamic pressure is that of the airspeed sensor, as in SCALED_PRESSURE."""
        if fields.get("I", 0) != 0 or "Press" not in fields:
            return None
        t_ns = self._at(fields)
        fresh = self._dynamic is not None and t_ns - self._dynamic[0] <= BESIDE_NS
        dynamic_hpa = self._dynamic[1] if self._dynamic is not None and fresh else 0.0
        return Baro(t_ns, t_ns, _finite(fields["Press"]) / 100, _finite(fields["Temp"]), dynamic_hpa)

    def _arsp(self, fields: Fields) -> None:
        if fields.get("I", 0) == 0:
            self._dynamic = self._at(fields), _finite(fields["DiffPress"]) / 100

    def _gpa(self, fields: Fields, receiver: int = 0) -> None:
        """What a receiver states of its accuracy; 0 is written where it states none."""
        h_acc_m, v_acc_m = _finite(fields["HAcc"]) or None, _finite(fields["VAcc"]) or None
        self._accuracies_m[int(fields.get("I", receiver))] = self._at(fields), h_acc_m, v_acc_m

    def _gpa2(self, fields: Fields) -> None:
        self._gpa(fields, 1)

    def _gps2(self, fields: Fields) -> Event | None:
        return self._gps(fields, 1)

    def _gps(self, fields: Fields, receiver: int = 0) -> Event | None:
        """Of the first two receivers, as GPS_RAW_INT and GPS2_RAW; older logs have the second's in a message of its own. A second
        one that a companion plays (GPS_INPUT) is none."""
        receiver = int(fields.get("I", receiver))
        if receiver >= self._n_receivers:
            return None
        t_ns = self._at(fields, "T")
        place = _place(fields["Lat"], fields["Lng"], fields["Alt"])
        status, speed, course = int(fields["Status"]), _finite(fields["Spd"]), math.radians(_finite(fields["GCrs"]))
        if status >= FIX_3D and receiver == 0:
            self._h_amsl_m = place.h_amsl_m
            self._home = self._home or place
            self._set_unix(fields, t_ns)
        v_ned_mps = (speed * math.cos(course), speed * math.sin(course), _finite(fields["VZ"]))
        stated_ns, h_acc_m, v_acc_m = self._accuracies_m.get(receiver, (0, None, None))
        h_acc_m, v_acc_m = (h_acc_m, v_acc_m) if t_ns - stated_ns <= BESIDE_NS else (None, None)
        return Gnss(t_ns, t_ns, status, int(fields["NSats"]), place, h_acc_m, v_acc_m, v_ned_mps, receiver)

    def _set_unix(self, fields: Fields, t_ns: int) -> None:
        week, ms = fields.get("GWk", fields.get("Week")), fields.get("GMS", fields.get("TimeMS"))
        if week and ms is not None:
            gps_ns = (_GPS_EPOCH_UNIX_S + week * 604_800) * NS_PER_S + int(ms) * NS_PER_MS
            leap = next(seconds for since, seconds in _LEAP_SECONDS if gps_ns >= (since + seconds) * NS_PER_S)
            self.utc_told.append((t_ns, gps_ns - leap * NS_PER_S - t_ns))

    def _orgn(self, fields: Fields) -> Event | None:
        return (
            OriginChanged(self._at(fields), _place(fields["Lat"], fields["Lng"], fields["Alt"])) if fields["Type"] == 0 else None
        )

    def _rfnd(self, fields: Fields) -> Event | None:
        if fields.get("Instance") is None or fields["Orient"] != _DOWN:
            return None
        t_ns = self._at(fields)
        return Range(t_ns, t_ns, _finite(fields["Dist"]), fields["Stat"] == _GOOD, int(fields["Instance"]))

    def _kf1(self, fields: Fields, core: int = 0) -> Event | None:
        """`core` is whose it is where it does not say so."""
        if fields.get("C", core) != self._core:
            return None
        t_ns = self._at(fields)
        self._v_ned_mps = (_finite(fields["VN"]), _finite(fields["VE"]), _finite(fields["VD"]))
        return LocalPose(t_ns, t_ns, (_finite(fields["PN"]), _finite(fields["PE"]), _finite(fields["PD"])), self._v_ned_mps)

    def _kf6(self, fields: Fields) -> Event | None:
        return self._kf1(fields, 1)

    def _kf9(self, fields: Fields) -> Event | None:
        return self._kf4(fields, 1)

    def _kf4(self, fields: Fields, core: int = 0) -> Event | None:
        """What the estimator says of itself; 3.2 and older (2014) log its ratios without its status, which alone says little."""
        if (primary := fields.get("PI", -1)) >= 0:
            self._core = primary
        if fields.get("C", core) != self._core or "SS" not in fields:
            return None
        t_ns, flags = self._at(fields), fields["SS"]
        constant = bool(flags & _CONST_POS_MODE)
        return EstimatorStatus(
            t_ns,
            position_ratio=_finite(fields["SP"]),
            velocity_ratio=_finite(fields["SV"]),
            height_ratio=_finite(fields["SH"]),
            horizontal_position_ok=bool(flags & _HORIZ_POS_ABS) and not constant,
            gnss_glitch=bool(flags & _GPS_GLITCHING),
            gnss_in_use=None,
            velocity_ok=bool(flags & _HORIZ_VEL) and not constant if flags else None,
        )

    def _pos(self, fields: Fields) -> Event | None:
        t_ns = self._at(fields)
        place = _place(fields["Lat"], fields["Lng"], fields["Alt"])
        before, self._last_place = self._last_place, (t_ns, place)
        if (v_ned_mps := self._v_ned_mps or _velocity(before, t_ns, place)) is None:
            return None
        h_rel_m = fields.get("RelHomeAlt", fields.get("RelAlt"))
        return PriorPose(t_ns, t_ns, place, v_ned_mps, _finite(h_rel_m))

    def _ctun(self, fields: Fields) -> None:
        if "CRt" in fields and "TimeMS" in fields:
            self._height = (_finite(fields["Alt"]), _finite(fields["CRt"]) / 100)

    def _ntun(self, fields: Fields) -> Event | None:
        if "VelX" not in fields or self._home is None or self._height is None or self._h_amsl_m is None:
            return None
        t_ns = self._at(fields)
        h_rel_m, climb_mps = self._height
        north, east = _finite(fields["PosX"]) / 100, _finite(fields["PosY"]) / 100
        level = geo_from_autopilot_ned(_KIND, (north, east, 0.0), self._home)
        place = GeoPoint(level.lat_deg, level.lon_deg, self._h_amsl_m)
        return PriorPose(t_ns, t_ns, place, (_finite(fields["VelX"]) / 100, _finite(fields["VelY"]) / 100, -climb_mps), h_rel_m)

    def _ev(self, fields: Fields) -> Event | None:
        if fields["Id"] not in (*_EV_ARMED, *_EV_DISARMED):
            return None
        return self._arming(armed=fields["Id"] in _EV_ARMED)

    def _arm(self, fields: Fields) -> Event | None:
        """Of planes and rovers, which wrote no EV of it before 4.1; since then both are there."""
        return self._arming(armed=fields["ArmState"] != 0)

    def _arming(self, *, armed: bool) -> Event | None:
        changed, self._armed = armed != self._armed, armed
        return link_up(self._t_ns, _KIND, self._version, armed) if changed and self.events else None

    def _msg(self, fields: Fields) -> None:
        text = fields["Message"].split(b"\0", 1)[0].decode("ascii", errors="replace")
        words = text.split()
        if not self._version and len(words) > 1 and words[1].startswith("V"):
            self._version = words[1][1:]

    def _parm(self, fields: Fields) -> None:
        name = fields["Name"].split(b"\0", 1)[0].decode("ascii", errors="replace")
        if name in FIRST_GPS_TYPE:
            self.notes = (FIRST_IS_PLAYED,) if fields["Value"] == BY_GPS_INPUT else ()
        if name in SECOND_GPS_TYPE:
            self._n_receivers = 1 if fields["Value"] == BY_GPS_INPUT else 2
        if name == "AHRS_EKF_TYPE" and fields["Value"] in _ESTIMATORS:
            self._idle = frozenset(_ESTIMATORS.values()) - {_ESTIMATORS[int(fields["Value"])]}

    def _cmd(self, fields: Fields) -> None:
        if self._home is None and fields["CNum"] == 0 and (fields["Lat"] or fields["Lng"]):
            self._home = _place(fields["Lat"], fields["Lng"], fields["Alt"])


_HANDLERS = {
    "ATT": _Reader._att,
    "MNT": _Reader._mnt,
    "IMU": _Reader._imu,
    "BARO": _Reader._baro,
    "ARSP": _Reader._arsp,
    "GPS": _Reader._gps,
    "GPS2": _Reader._gps2,
    "GPA": _Reader._gpa,
    "GPA2": _Reader._gpa2,
    "ORGN": _Reader._orgn,
    "RFND": _Reader._rfnd,
    "POS": _Reader._pos,
    "CTUN": _Reader._ctun,
    "NTUN": _Reader._ntun,
    "EV": _Reader._ev,
    "ARM": _Reader._arm,
    "MSG": _Reader._msg,
    "CMD": _Reader._cmd,
    "PARM": _Reader._parm,
    **dict.fromkeys(("XKF1", "NKF1", "EKF1"), _Reader._kf1),
    **dict.fromkeys(("XKF6", "NKF6"), _Reader._kf6),
    **dict.fromkeys(("XKF4", "NKF4", "EKF4"), _Reader._kf4),
    **dict.fromkeys(("XKF9", "NKF9"), _Reader._kf9),
}


def _finite(value: object) -> float:
    if not isinstance(value, int | float) or not math.isfinite(value):
        raise ValueError(value)
    return float(value)


def _velocity(before: tuple[int, GeoPoint] | None, t_ns: int, place: GeoPoint) -> Vec3 | None:
    """Between two positions that follow each other; None further apart than `BESIDE_NS`."""
    if before is None or not 0 < t_ns - before[0] <= BESIDE_NS:
        return None
    north, east, down = ned_from_geo(place, before[1])
    seconds = (t_ns - before[0]) / NS_PER_S
    return north / seconds, east / seconds, down / seconds


def _place(lat_deg: object, lon_deg: object, h_amsl_m: object) -> GeoPoint:
    lat, lon = _finite(lat_deg), _finite(lon_deg)
    if abs(lat) > 90 or abs(lon) > 180:
        raise ValueError(lat, lon)
    return GeoPoint(lat, lon, _finite(h_amsl_m))
