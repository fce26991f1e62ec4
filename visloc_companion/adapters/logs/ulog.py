"""PX4's logs (.ulg): vehicle_attitude, vehicle_gps_position and sensor_gps, vehicle_local_position, vehicle_global_position,
home_position, estimator_status (and which of several flies), distance_sensor, vehicle_acceleration, pressures and
vehicle_status.
"""

from __future__ import annotations

import bisect
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from visloc_companion.adapters.logs.attitude_rates import rates_between
from visloc_companion.adapters.logs.boots import chosen_boot, logs_of, put_together
from visloc_companion.adapters.logs.gnss_times import Told, gnss_times, unix_minus_boot_ns
from visloc_companion.adapters.logs.lone_leaps import without_lone_leaps
from visloc_companion.adapters.logs.recording import (
    BESIDE_NS,
    NS_PER_US,
    LogBytes,
    Losses,
    Recording,
    in_order,
    link_up,
    read_bytes,
)
from visloc_companion.adapters.logs.ulog_format import MAGIC, Instances, Row, of_first, read_instances
from visloc_companion.adapters.logs.ulog_interference import interference
from visloc_companion.adapters.logs.ulog_receivers import GNSS_TOPICS, receivers
from visloc_companion.adapters.mavlink.codec_gimbal import frame_of, has_failed
from visloc_companion.errors import LogError
from visloc_companion.geo.se3 import normalised
from visloc_companion.types import (
    FIX_3D,
    Attitude,
    AutopilotKind,
    Baro,
    EstimatorStatus,
    Event,
    GeoPoint,
    GimbalAttitude,
    Gnss,
    Imu,
    LinkChanged,
    LocalPose,
    OriginChanged,
    PriorPose,
    Range,
)

_TOPICS = (
    "vehicle_attitude",
    *GNSS_TOPICS,
    "vehicle_local_position",
    "vehicle_global_position",
    "home_position",
    "estimator_status",
    "estimator_selector_status",
    "vehicle_status",
    "distance_sensor",
    "vehicle_acceleration",
    "vehicle_air_data",
    "differential_pressure",
    "gimbal_device_attitude_status",
)
_ARMED = 2
_DOWN = 25
"""distance_sensor.orientation ROTATION_DOWNWARD_FACING."""
_KIND = AutopilotKind.PX4
Topic = list[Row]
_IMU_EVERY_US = 10_000
_MAX_HOME_M = 10_000.0
_HOUR_US, _HALF_DAY_US = 3_600_000_000, 43_200_000_000


@dataclass(slots=True)
class _Boot:
    """Events of one boot in time order, and its UTC (Unix minus boot time) where a receiver says so."""

    events: list[tuple[int, Event]]
    unix_minus_boot_ns: int | None


def read_ulog(path: Path, boot: int = 0) -> Recording:
    """The flight in a ULog; of several boots in one file, one: `boot` counts from 1, 0 is the one that tells most.

    Raises LogError for a file that is none or that tells nothing of a flight, or where there are not so many boots.
    """
    data, losses = read_bytes(path), Losses()
    if data[: len(MAGIC)] != MAGIC:
        raise LogError("does not start as a ULog does", where=str(path), remedy="name a .ulg file of PX4")
    boots = _boots(data, losses)
    if not boots:
        raise LogError("holds no attitude and no position", where=str(path), remedy="log vehicle_attitude and the positions")
    read, others = chosen_boot(path, boots, boot)
    losses.reboots = len(boots) - 1
    events, leaps = without_lone_leaps(path, boots[read].events, losses)
    opening = (events[0][0], link_up(events[0][0], _KIND))
    changes = list(_changes([opening, *events]))
    return Recording(path, _KIND, changes, losses, boots[read].unix_minus_boot_ns, notes=(*others, *leaps))


def _boots(data: LogBytes, losses: Losses) -> list[_Boot]:
    def join(boot: _Boot, log: _Boot) -> None:
        boot.events = in_order([*boot.events, *log.events])

    parts = logs_of(data, MAGIC)
    logs = (data if len(parts) == 1 else data[start:end] for start, end in parts)
    return put_together((_read(log, losses) for log in logs), join)


def _read(data: LogBytes, losses: Losses) -> _Boot:
    """What a single log tells."""
    instances = read_instances(data, _TOPICS, losses)
    topics = {name: of_first(rows) for name, rows in instances.items()}
    events: list[tuple[int, Event]] = []
    for name, convert in _CONVERTERS.items():
        if name in topics:
            events += _converted(topics[name], convert, losses)
    for rows in instances.get("distance_sensor", {}).values():  # which of them looks down each says itself
        events += _converted(rows, _distance, losses)
    status = _of_primary(instances.get("estimator_status", {}), topics.get("estimator_selector_status", []), losses)
    events += _converted(status, _estimator_status, losses)
    heard = receivers(instances)
    for number, rows in enumerate(heard):
        events += _converted(rows, partial(_gnss, receiver=number), losses)
        events += interference(_rows(rows), number)
    events += _pressures(topics, losses)
    events += _converted(_thinned(topics.get("vehicle_acceleration", [])), _imu, losses)
    events += _attitudes(topics.get("vehicle_attitude", []), losses)
    events += _origins(topics.get("vehicle_local_position", []), losses)
    events += _global_positions(topics, losses)
    utc_told = _utc_told(heard[0]) if heard else []
    return _Boot(in_order([*events, *gnss_times(utc_told)]), unix_minus_boot_ns(utc_told))


def _changes(events: list[tuple[int, Event]]) -> Iterator[tuple[int, Event]]:
    """The events without those LinkChanged that repeat what is known."""
    armed: bool | None = None
    for t_ns, event in events:
        if isinstance(event, LinkChanged):
            if event.armed == armed:
                continue
            armed = event.armed
        yield t_ns, event


def _rows(topic: Topic, losses: Losses | None = None) -> Iterator[tuple[int, Row]]:
    """(t_ns, row) of a topic in time order. The format has no checksums: a time that the rows around it belie is left out."""
    times_us = [row["timestamp"] for row in topic]
    middle_us = sorted(times_us)[len(times_us) // 2] if times_us else 0
    last_us: int | None = None
    for i, row in enumerate(topic):
        t_us = times_us[i]
        least_us, most_us = (
            (middle_us - _HALF_DAY_US, middle_us + _HALF_DAY_US) if last_us is None else (last_us, last_us + _HOUR_US)
        )
        belied = i + 1 < len(topic) and least_us <= times_us[i + 1] < t_us
        if belied or not least_us <= t_us <= most_us:
            if losses is not None:
                losses.dropped_messages += 1
            continue
        last_us = t_us
        yield t_us * NS_PER_US, row


def _of_primary(instances: Instances, selector: Topic, losses: Losses) -> Topic:
    """Rows of estimator_status of whichever of several estimators flies; of the first where the log does not say."""
    chosen = [(t_ns // NS_PER_US, row["primary_instance"]) for t_ns, row in _rows(selector) if "primary_instance" in row]
    if not instances or not chosen or not {instance for _, instance in chosen} <= instances.keys():
        return of_first(instances) if instances else []
    since_us = [t_us for t_us, _ in chosen]

    def primary(t_us: int) -> int:
        return int(chosen[max(bisect.bisect_right(since_us, t_us) - 1, 0)][1])

    of_each = ((instance, t_ns // NS_PER_US, row) for instance, rows in instances.items() for t_ns, row in _rows(rows, losses))
    return [row for instance, t_us, row in sorted(of_each, key=lambda one: one[1]) if primary(t_us) == instance]


def _converted(topic: Topic, convert: Callable[[int, Row], Event | None], losses: Losses) -> list[tuple[int, Event]]:
    made: list[tuple[int, Event]] = []
    for t_ns, row in _rows(topic, losses):
        try:
            event = convert(t_ns, row)
        except (KeyError, ValueError, TypeError):
            losses.dropped_messages += 1
            continue
        if event is not None:
            made.append((t_ns, event))
    return made


def _attitudes(topic: Topic, losses: Losses) -> list[tuple[int, Event]]:
    made: list[tuple[int, Event]] = []
    last: Attitude | None = None
    for t_ns, row in _rows(topic, losses):
        try:
            q = normalised((row["q[0]"], row["q[1]"], row["q[2]"], row["q[3]"]))
        except (KeyError, ValueError):
            losses.dropped_messages += 1
            continue
        rates = rates_between(last.q_ned_frd, q, (t_ns - last.t_boot_ns) / 1e9) if last else (0.0, 0.0, 0.0)
        last = Attitude(t_ns, t_ns, q, rates)
        made.append((t_ns, last))
    return made


def _gnss(t_ns: int, row: Row, receiver: int) -> Event:
    if "latitude_deg" in row:
        place = _place(row["latitude_deg"], row["longitude_deg"], row["altitude_msl_m"])
    else:
        place = _place(row["lat"] / 1e7, row["lon"] / 1e7, row["alt"] / 1e3)
    velocity = (row["vel_n_m_s"], row["vel_e_m_s"], row["vel_d_m_s"])
    known = bool(row.get("vel_ned_valid", True)) and all(map(math.isfinite, velocity))
    return Gnss(
        t_ns,
        t_ns,
        int(row["fix_type"]),
        int(row["satellites_used"]),
        place,
        _positive(row["eph"]),
        _positive(row["epv"]),
        velocity if known else None,
        receiver,
    )


def _local_position(t_ns: int, row: Row) -> Event | None:
    if not (row["xy_valid"] and row["z_valid"] and row["v_xy_valid"]):
        return None
    return LocalPose(t_ns, t_ns, _vec3(row, "x", "y", "z"), _vec3(row, "vx", "vy", "vz"))


def _estimator_status(t_ns: int, row: Row) -> Event:
    return EstimatorStatus(
        t_ns,
        position_ratio=_ratio(row.get("pos_test_ratio")),
        velocity_ratio=_ratio(row.get("vel_test_ratio")),
        height_ratio=_ratio(row.get("hgt_test_ratio")),
        horizontal_position_ok=bool(row.get("solution_status_flags", 0) & 0x10),
        gnss_glitch=bool(row.get("solution_status_flags", 0) & 0x400),
        gnss_in_use=bool(row["control_mode_flags"] & 0x4),
        velocity_ok=bool(row["solution_status_flags"] & 0x2) if "solution_status_flags" in row else None,
    )


def _origins(topic: Topic, losses: Losses) -> list[tuple[int, Event]]:
    """Where the origin changes. Every row states it; one that is back in the next row never was (there are no checksums)."""
    stated: list[tuple[int, GeoPoint]] = []
    for t_ns, row in _rows(topic, losses):
        if not (row.get("xy_global") and row.get("z_global")):
            continue
        try:
            stated.append((t_ns, _place(row["ref_lat"], row["ref_lon"], row["ref_alt"])))
        except (KeyError, ValueError):
            losses.dropped_messages += 1
    last: GeoPoint | None = None
    made: list[tuple[int, Event]] = []
    for number, (t_ns, origin) in enumerate(stated):
        if origin == last:
            continue
        if last is not None and number + 1 < len(stated) and stated[number + 1][1] == last:
            losses.dropped_messages += 1
            continue
        last = origin
        made.append((t_ns, OriginChanged(t_ns, origin)))
    return made


def _global_positions(topics: dict[str, Topic], losses: Losses) -> list[tuple[int, Event]]:
    """vehicle_global_position with the velocity of the nearest vehicle_local_position (newer logs have none of its own).

    PX4 since 1.16 goes on with it while it is not valid, and says so. Heights are above home as in GLOBAL_POSITION_INT, which is
    set at arming; above the estimator's origin, set at boot, before.
    """
    local, places = list(_rows(topics.get("vehicle_local_position", []))), topics.get("vehicle_global_position", [])
    if not local or not places:
        return []
    local_ns = np.array([t_ns for t_ns, _ in local])
    homes = [(t_ns, float(row["z"])) for t_ns, row in _rows(topics.get("home_position", [])) if _states_height(row)]
    homes_ns = [t_ns for t_ns, _ in homes]

    def convert(t_ns: int, row: Row) -> Event | None:
        if not (row.get("lat_lon_valid", True) and row.get("alt_valid", True)):
            return None
        after = int(np.searchsorted(local_ns, t_ns))
        near = min(local[max(after - 1, 0) : after + 1], key=lambda one: abs(one[0] - t_ns))[1]
        known = bisect.bisect_right(homes_ns, t_ns)
        home_down_m = homes[known - 1][1] if known else 0.0
        v_ned_mps, h_rel_m = _vec3(near, "vx", "vy", "vz"), home_down_m - float(near["z"])
        return PriorPose(t_ns, t_ns, _place(row["lat"], row["lon"], row["alt"]), v_ned_mps, h_rel_m)

    return _converted(places, convert, losses)


def _thinned(topic: Topic) -> Topic:
    """The rows of a topic, no more than a hundred a second of those in order."""
    kept: Topic = []
    for row in topic:
        if not kept or not 0 <= row["timestamp"] - kept[-1]["timestamp"] < _IMU_EVERY_US:
            kept.append(row)
    return kept


def _imu(t_ns: int, row: Row) -> Event:
    return Imu(t_ns, t_ns, _vec3(row, "xyz[0]", "xyz[1]", "xyz[2]"))


def _pressures(topics: dict[str, Topic], losses: Losses) -> list[tuple[int, Event]]:
    """vehicle_air_data with the newest differential_pressure, as in SCALED_PRESSURE; pascals in the log."""
    named = ("differential_pressure_pa", "differential_pressure_filtered_pa")
    rows = _rows(topics.get("differential_pressure", []))
    dynamic = [(t_ns, value) for t_ns, row in rows if (value := next((row[n] for n in named if n in row), None)) is not None]
    dynamic_ns = [t_ns for t_ns, _ in dynamic]

    def convert(t_ns: int, row: Row) -> Event:
        known = bisect.bisect_right(dynamic_ns, t_ns)
        fresh = known > 0 and t_ns - dynamic_ns[known - 1] <= BESIDE_NS
        pressure_pa, dynamic_pa = float(row["baro_pressure_pa"]), float(dynamic[known - 1][1]) if fresh else 0.0
        celsius = next((float(row[name]) for name in ("ambient_temperature", "baro_temp_celcius") if name in row), math.nan)
        if not (math.isfinite(pressure_pa) and math.isfinite(dynamic_pa)):
            raise ValueError(pressure_pa, dynamic_pa)
        return Baro(t_ns, t_ns, pressure_pa / 100, celsius, dynamic_pa / 100)

    return _converted(topics.get("vehicle_air_data", []), convert, losses)


def _states_height(home: Row) -> bool:
    return bool(home.get("valid_alt", False)) and abs(home.get("z", math.nan)) < _MAX_HOME_M


def _vehicle_status(t_ns: int, row: Row) -> Event:
    return link_up(t_ns, _KIND, armed=row["arming_state"] == _ARMED)


def _distance(t_ns: int, row: Row) -> Event | None:
    if row["orientation"] != _DOWN:
        return None
    distance_m = float(row["current_distance"])
    known = math.isfinite(distance_m) and row["min_distance"] <= distance_m < row["max_distance"]  # as the link's are judged
    valid = known and row.get("signal_quality", -1) != 0
    return Range(t_ns, t_ns, distance_m if known else 0.0, valid, int(row.get("device_id", 0)))


def _gimbal(t_ns: int, row: Row) -> Event | None:
    """Gimbals that speak MAVLink themselves are numbered as PX4 numbers them here, and stamped with its clock."""
    frame = frame_of(int(row["device_flags"]))
    if frame is None:
        raise ValueError(row["device_flags"])
    q = normalised((row["q[0]"], row["q[1]"], row["q[2]"], row["q[3]"]))
    return GimbalAttitude(t_ns, t_ns, int(row.get("gimbal_device_id", 0)) or 1, q, frame, has_failed(int(row["failure_flags"])))


_CONVERTERS: dict[str, Callable[[int, Row], Event | None]] = {
    "vehicle_local_position": _local_position,
    "vehicle_status": _vehicle_status,
    "gimbal_device_attitude_status": _gimbal,
}


def _utc_told(gnss: Topic) -> list[Told]:
    return [
        (t_ns, int(row["time_utc_usec"]) * NS_PER_US - t_ns)
        for t_ns, row in _rows(gnss)
        if row.get("time_utc_usec", 0) > 0 and row.get("fix_type", 0) >= FIX_3D
    ]


def _place(lat_deg: float, lon_deg: float, h_amsl_m: float) -> GeoPoint:
    if not (abs(lat_deg) <= 90 and abs(lon_deg) <= 180 and math.isfinite(h_amsl_m)):
        raise ValueError(lat_deg, lon_deg, h_amsl_m)
    return GeoPoint(lat_deg, lon_deg, h_amsl_m)


def _vec3(row: Row, *names: str) -> tuple[float, float, float]:
    x, y, z = (float(row[name]) for name in names)
    if not all(map(math.isfinite, (x, y, z))):
        raise ValueError(names)
    return x, y, z


def _ratio(value: float | None) -> float | None:
    return float(value) if value is not None and math.isfinite(value) else None


def _positive(value: float) -> float | None:
    return float(value) if math.isfinite(value) and value > 0 else None
