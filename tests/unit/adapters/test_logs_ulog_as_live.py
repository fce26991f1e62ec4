"""Expected: a ULog tells what PX4 would have sent over MAVLink at that time."""

from __future__ import annotations

import struct
import tracemalloc
from pathlib import Path
from typing import Any

import pytest

from visloc_companion.adapters.logs.open import open_log
from visloc_companion.adapters.logs.recording import Losses
from visloc_companion.adapters.logs.ulog_format import read_instances
from visloc_companion.types import Attitude, Baro, EstimatorStatus, Event, Gnss, GnssIntegrity, Imu, PriorPose, Range

CODES = {"uint64_t": "Q", "uint32_t": "I", "float": "f", "double": "d", "int32_t": "i", "uint8_t": "B", "bool": "?"}
LOCAL = (
    "ref_lat",
    "ref_lon",
    "ref_alt",
    "x",
    "y",
    "z",
    "vx",
    "vy",
    "vz",
    "xy_valid",
    "z_valid",
    "v_xy_valid",
    "xy_global",
    "z_global",
)
FORMATS: dict[str, list[tuple[str, str]]] = {
    "vehicle_attitude": [("float", f"q{k}") for k in range(4)],
    "vehicle_local_position": [("double" if k < 2 else "float" if k < 9 else "bool", name) for k, name in enumerate(LOCAL)],
    "vehicle_global_position": [
        ("double", "lat"),
        ("double", "lon"),
        ("float", "alt"),
        ("bool", "lat_lon_valid"),
        ("bool", "alt_valid"),
    ],
    "vehicle_acceleration": [("float", f"xyz{k}") for k in range(3)],
    "vehicle_air_data": [("float", "baro_pressure_pa"), ("float", "baro_temp_celcius")],
    "differential_pressure": [("float", "differential_pressure_pa")],
    "home_position": [("float", "z"), ("bool", "valid_alt")],
    "distance_sensor": [*[("float", f"{name}_distance") for name in ("min", "max", "current")], ("uint8_t", "orientation")],
    "estimator_status": [("float", "pos_test_ratio"), ("uint32_t", "control_mode_flags"), ("uint32_t", "solution_status_flags")],
    "estimator_selector_status": [("uint8_t", "primary_instance")],
    "sensor_gps": [
        *[("double", name) for name in ("latitude_deg", "longitude_deg", "altitude_msl_m")],
        *[("float", name) for name in ("eph", "epv", "vel_n_m_s", "vel_e_m_s", "vel_d_m_s")],
        *[("uint8_t", name) for name in ("fix_type", "satellites_used", "jamming_state", "spoofing_state")],
    ],
}
FORMATS["vehicle_gps_position"] = [*FORMATS["sensor_gps"], ("uint8_t", "authentication_state")]


def block(kind: bytes, body: bytes) -> bytes:
    return struct.pack("<Hc", len(body), kind) + body


def log(path: Path, *messages: tuple[str, int, float, tuple[Any, ...]]) -> list[Event]:
    """Events of a log with these (topic, instance, seconds, values)."""
    parts = [b"ULog\x01\x12\x35\x01" + struct.pack("<Q", 0)]
    for name, fields in FORMATS.items():
        listed = "uint64_t timestamp;" + "".join(f"{kind} {field};" for kind, field in fields)
        listed = {
            "vehicle_attitude": "uint64_t timestamp;float[4] q;",
            "vehicle_acceleration": "uint64_t timestamp;float[3] xyz;",
        }.get(name, listed)
        parts.append(block(b"F", f"{name}:{listed}".encode()))
    streams = sorted({(name, instance) for name, instance, _, _ in messages})
    parts += [block(b"A", struct.pack("<BH", instance, k) + name.encode()) for k, (name, instance) in enumerate(streams)]
    for name, instance, t_s, values in messages:
        code = "<HQ" + "".join(CODES[kind] for kind, _ in FORMATS[name])
        parts.append(block(b"D", struct.pack(code, streams.index((name, instance)), round(t_s * 1e6), *values)))
    path.write_bytes(b"".join(parts))
    return [event for _, event in open_log(path).events]


def attitude(t_s: float) -> tuple[str, int, float, tuple[Any, ...]]:
    return "vehicle_attitude", 0, t_s, (1.0, 0.0, 0.0, 0.0)


def local(t_s: float, z: float, vx: float = 0.0) -> tuple[str, int, float, tuple[Any, ...]]:
    return "vehicle_local_position", 0, t_s, (47.4, 8.55, 488.0, 1.0, 2.0, z, vx, 0.0, 0.0, *(True,) * 5)


def place(t_s: float, valid: tuple[bool, bool] = (True, True)) -> tuple[str, int, float, tuple[Any, ...]]:
    return "vehicle_global_position", 0, t_s, (47.4, 8.55, 518.0, *valid)


@pytest.mark.parametrize("valid", [(False, True), (True, False)])
def test_a_position_that_px4_calls_not_valid_is_none(tmp_path: Path, valid: tuple[bool, bool]) -> None:
    """Since 1.16 it is written on while GNSS is jammed."""
    events = log(tmp_path / "a.ulg", attitude(1.0), local(1.0, -30.0), place(1.0), place(1.5, valid), place(2.0))
    assert [event.t_rx_ns for event in events if isinstance(event, PriorPose)] == [1_000_000_000, 2_000_000_000]


def test_heights_are_above_home(tmp_path: Path) -> None:
    """Home was set 12 m below the origin of the estimator, and anew later; one without a height is none."""
    homes = [
        ("home_position", 0, t_s, (z, valid))
        for t_s, z, valid in ((2.0, 12.0, True), (3.0, 99.0, False), (3.2, 1e9, True), (4.0, 5.0, True))
    ]
    times = (1.0, 2.5, 3.5, 4.5)
    events = log(tmp_path / "a.ulg", attitude(1.0), *(local(t, -30.0) for t in times), *(place(t) for t in times), *homes)
    assert [event.h_rel_m for event in events if isinstance(event, PriorPose)] == [30.0, 42.0, 42.0, 35.0]


def test_the_velocity_is_that_of_the_nearest_time(tmp_path: Path) -> None:
    locals_ = [local(1.0, -30.0, 1.0), local(2.0, -30.0, 2.0)]
    events = log(tmp_path / "a.ulg", attitude(1.0), *locals_, place(1.1), place(1.9), place(5.0))
    assert [event.v_ned_mps[0] for event in events if isinstance(event, PriorPose)] == [1.0, 2.0, 2.0]


def test_pressures_are_in_hectopascals_with_that_of_the_airspeed_sensor(tmp_path: Path) -> None:
    air = [("vehicle_air_data", 0, t_s, (95_400.0, 21.5)) for t_s in (1.0, 2.0, 3.0, 6.0)]
    pitot = [("differential_pressure", 0, t_s, (value,)) for t_s, value in ((1.5, 245.0), (2.5, 250.0))]
    events = log(tmp_path / "a.ulg", attitude(1.0), *air, *pitot, ("vehicle_air_data", 0, 6.5, (float("nan"), 0.0)))
    read = [(event.pressure_hpa, event.temperature_c, event.dynamic_hpa) for event in events if isinstance(event, Baro)]
    assert read == [(954.0, 21.5, 0.0), (954.0, 21.5, 2.45), (954.0, 21.5, 2.5), (954.0, 21.5, 0.0)]


def test_accelerations_are_read_at_no_more_than_a_hundred_hertz(tmp_path: Path) -> None:
    forces = [("vehicle_acceleration", 0, 1.0 + k / 250, (0.5, -0.25, -9.75 if k else float("nan"))) for k in range(250)]
    read = [event for event in log(tmp_path / "a.ulg", attitude(1.0), *forces) if isinstance(event, Imu)]
    assert 80 <= len(read) <= 100
    assert {event.force_frd_mps2 for event in read} == {(0.5, -0.25, -9.75)}


def test_a_beam_as_long_as_it_may_be_has_met_nothing(tmp_path: Path) -> None:
    rows = [("distance_sensor", 0, 1.0 + k, (0.5, 50.0, m, 25)) for k, m in enumerate((0.25, 0.5, 49.5, 50.0, 51.0))]
    read = [event for event in log(tmp_path / "a.ulg", attitude(1.0), *rows) if isinstance(event, Range)]
    assert [(event.distance_m, event.valid) for event in read] == [
        (0.0, False),
        (0.5, True),
        (49.5, True),
        (0.0, False),
        (0.0, False),
    ]


def test_the_sensor_that_looks_down_is_found_behind_one_that_looks_ahead(tmp_path: Path) -> None:
    ahead = [("distance_sensor", 0, t_s, (0.5, 50.0, 7.0, 0)) for t_s in (1.0, 2.0)]
    down = [("distance_sensor", 1, t_s, (0.5, 50.0, 20.0 + t_s, 25)) for t_s in (1.0, 2.0)]
    events = log(tmp_path / "a.ulg", attitude(1.0), *ahead, *down)
    assert [event.distance_m for event in events if isinstance(event, Range)] == [21.0, 22.0]


def test_of_several_estimators_that_counts_which_flies(tmp_path: Path) -> None:
    times = (1.0, 2.0, 3.0)
    status = [("estimator_status", k, t_s, (0.1 + k, 4, 0x12)) for t_s in times for k in (0, 1)]
    chosen = [("estimator_selector_status", 0, t_s, (k,)) for t_s, k in ((0.5, 0), (1.5, 1))]

    def ratios(*more: tuple[str, int, float, tuple[Any, ...]]) -> list[float | None]:
        events = log(tmp_path / "a.ulg", attitude(1.0), *status, *more)
        return [round(e.position_ratio or 0.0, 3) for e in events if isinstance(e, EstimatorStatus)]

    assert ratios(*chosen) == [0.1, 1.1, 1.1]
    assert ratios() == [0.1, 0.1, 0.1]
    assert ratios(*chosen, ("estimator_selector_status", 0, 2.5, (7,))) == [0.1, 0.1, 0.1], "one that is not in the log"


@pytest.mark.parametrize(
    ("topic", "authentication", "spoofed"), [("vehicle_gps_position", (0,), False), ("sensor_gps", (), True)]
)
def test_what_the_receiver_says_of_interference(
    tmp_path: Path, topic: str, authentication: tuple[int, ...], spoofed: bool
) -> None:
    """State 2 of spoofing is mitigated, and in logs of before 1.14, which know no authentication, indicated."""

    def gnss(t_s: float, jamming: int, spoofing: int) -> tuple[str, int, float, tuple[Any, ...]]:
        values = (47.4, 8.55, 488.0, 0.9, 1.4, 0.0, 0.0, 0.0, 3, 17, jamming, spoofing, *authentication)
        return topic, 0, t_s, values

    states = [(1.0, 0, 0), (1.2, 1, 1), (1.4, 1, 1), (1.6, 3, 2), (2.0, 3, 2), (2.6, 3, 2), (3.0, 1, 3)]
    events = log(tmp_path / "a.ulg", attitude(1.0), *(gnss(*state) for state in states))
    told = [(e.t_rx_ns / 1e9, e.jammed, e.spoofed, e.authentic) for e in events if isinstance(e, GnssIntegrity)]
    assert told == [
        (1.2, False, False, None), (1.6, True, spoofed, None), (2.6, True, spoofed, None), (3.0, False, True, None)
    ]  # fmt: skip
    assert any(isinstance(event, Attitude) for event in events)


DEVICES = {
    "one": {("vehicle_gps_position", 0): 7, ("sensor_gps", 0): 7},
    "two": {("vehicle_gps_position", 0): 7, ("sensor_gps", 0): 7, ("sensor_gps", 1): 9},
    "the second flies": {("vehicle_gps_position", 0): 9, ("sensor_gps", 0): 7, ("sensor_gps", 1): 9},
    "blended": {("vehicle_gps_position", 0): 0, ("sensor_gps", 0): 7, ("sensor_gps", 1): 9},
    "before 1.12": {("vehicle_gps_position", 0): 0, ("vehicle_gps_position", 1): 0},
    "those alone": {("sensor_gps", 0): 7, ("sensor_gps", 1): 9},
}


@pytest.mark.parametrize(
    ("which", "read"),
    [
        ("one", {0: 7}),
        ("two", {0: 7, 1: 9}),
        ("the second flies", {0: 9, 1: 7}),
        ("blended", {0: 0}),
        ("before 1.12", {0: 0, 1: 1}),
        ("those alone", {0: 7, 1: 9}),
    ],
)
def test_of_two_receivers_each_is_read_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, which: str, read: dict[int, int]
) -> None:
    """In flight PX4 sends both, and one that is led astray is told by the other: in a replay it stood alone."""
    for topic in ("vehicle_gps_position", "sensor_gps"):
        monkeypatch.setitem(FORMATS, topic, [*FORMATS["sensor_gps"], ("uint32_t", "device_id")])
    messages = [
        (topic, instance, t_s, (47.4, 8.5, 10.0 * (device or instance), 0.9, 1.4, 0.0, 0.0, 0.0, 3, 17, 1, 1, device))
        for t_s in (1.0, 2.0)
        for (topic, instance), device in DEVICES[which].items()
    ]
    events = log(tmp_path / "a.ulg", attitude(1.0), *messages)
    found = [(e.receiver, e.place.h_amsl_m / 10) for e in events if isinstance(e, Gnss)]
    assert (len(found), dict(found)) == (2 * len(read), read)
    assert {e.receiver for e in events if isinstance(e, GnssIntegrity)} == set(read)


def test_rows_take_little_more_memory_than_the_log(tmp_path: Path) -> None:
    """As numbers by name they took 11.5 times its size."""
    path = tmp_path / "a.ulg"
    moving = [local(0.1 * k, -40.0) for k in range(5_000)]
    log(path, attitude(1.0), *moving)
    tracemalloc.start()
    topics = read_instances(path.read_bytes(), ("vehicle_local_position",), Losses())
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    rows = topics["vehicle_local_position"][0]
    assert len(rows) == 5_000
    assert dict(rows[7]).keys() == {"timestamp", *LOCAL}
    assert (rows[7]["z"], "z" in rows[7], "w" in rows[7], rows[7].get("w", 3)) == (-40.0, True, False, 3)
    assert peak < 5 * path.stat().st_size
