from __future__ import annotations

import struct
import time
from pathlib import Path

import pytest

from visloc_companion.adapters.logs.open import open_log
from visloc_companion.errors import LogError
from visloc_companion.geo.se3 import euler_from_quat, quat_from_euler
from visloc_companion.types import Attitude, AutopilotKind, Gnss, LinkChanged, LocalPose, OriginChanged, PriorPose, Range

MAGIC = b"ULog\x01\x12\x35\x01"
TYPES = {"uint64_t": "Q", "float": "f", "double": "d", "int32_t": "i", "uint8_t": "B", "bool": "?"}
TOPICS = {
    "vehicle_attitude": [("uint64_t", "timestamp"), ("float[4]", "q")],
    "vehicle_gps_position": [
        *[("uint64_t", "timestamp"), ("uint64_t", "time_utc_usec"), ("int32_t", "lat"), ("int32_t", "lon"), ("int32_t", "alt")],
        *[("float", "eph"), ("float", "epv"), ("float", "vel_n_m_s"), ("float", "vel_e_m_s"), ("float", "vel_d_m_s")],
        *[("uint8_t", "fix_type"), ("bool", "vel_ned_valid"), ("uint8_t", "satellites_used")],
    ],
    "vehicle_local_position": [
        *[("uint64_t", "timestamp"), ("double", "ref_lat"), ("double", "ref_lon"), ("float", "ref_alt")],
        *[("float", name) for name in ("x", "y", "z", "vx", "vy", "vz")],
        *[("bool", name) for name in ("xy_valid", "z_valid", "v_xy_valid", "xy_global", "z_global")],
    ],
    "vehicle_global_position": [("uint64_t", "timestamp"), ("double", "lat"), ("double", "lon"), ("float", "alt")],
    "vehicle_status": [("uint64_t", "timestamp"), ("uint8_t", "arming_state")],
    "distance_sensor": [
        *[("uint64_t", "timestamp"), ("float", "min_distance"), ("float", "max_distance"), ("float", "current_distance")],
        *[("uint8_t", "orientation")],
    ],
}


def block(kind: bytes, body: bytes) -> bytes:
    return struct.pack("<Hc", len(body), kind) + body


def packed(topic: str, *values: object) -> bytes:
    code = "<" + "".join(TYPES[name.split("[")[0]] * (4 if "[4]" in name else 1) for name, _ in TOPICS[topic])
    return block(b"D", struct.pack("<H", list(TOPICS).index(topic)) + struct.pack(code, *values))


def header() -> bytes:
    parts = [MAGIC + struct.pack("<Q", 0)]
    for name, fields in TOPICS.items():
        parts.append(block(b"F", f"{name}:{';'.join(' '.join(field) for field in fields)};".encode()))
    parts += [block(b"A", struct.pack("<BH", 0, k) + name.encode()) for k, name in enumerate(TOPICS)]
    return b"".join(parts)


def flight(n: int = 30, nan_at: int = -1) -> bytes:
    parts = [header()]
    for k in range(n):
        us = 20_000_000 + 100_000 * k
        q = quat_from_euler(0.1, 0.0, 0.02 * k) if k != nan_at else (float("nan"),) * 4
        parts += [
            packed("vehicle_attitude", us, *q),
            packed("vehicle_local_position", us, 47.4, 8.55, 488.0, 1.0 * k, 2.0, -30.0, 10.0, 0.5, 0.0, *(k > 2,) * 5),
            packed("vehicle_global_position", us, 47.4 + k * 1e-5, 8.55, 518.0),
            packed("vehicle_status", us, 2 if k >= 5 else 1),
            packed("distance_sensor", us, 0.5, 100.0, 30.0 if k else 200.0, 25 if k < 20 else 0),
        ]
        utc = 1_600_000_000_000_000 + us
        parts.append(
            packed("vehicle_gps_position", us, utc, 474_000_000, 85_500_000, 518_000, 0.9, 1.4, 10.0, 0.5, 0.1, 3, True, 17)
        )
    return b"".join(parts)


def write(path: Path, data: bytes) -> Path:
    path.write_bytes(data)
    return path


def test_a_flight_is_read(tmp_path: Path) -> None:
    recording = open_log(write(tmp_path / "a.ulg", flight()))
    assert recording.kind is AutopilotKind.PX4
    assert recording.unix_minus_boot_ns == 1_600_000_000 * 10**9
    attitude = [e for _, e in recording.events if isinstance(e, Attitude)][9]
    assert euler_from_quat(attitude.q_ned_frd) == pytest.approx((0.1, 0.0, 0.18), abs=1e-5)
    assert (attitude.t_boot_ns, attitude.t_rx_ns) == (20_900_000_000, 20_900_000_000)
    assert sum(rate**2 for rate in attitude.rate_frd_radps) ** 0.5 == pytest.approx(0.2, abs=1e-3)
    gnss = next(e for _, e in recording.events if isinstance(e, Gnss))
    assert (gnss.fix_type, gnss.n_satellites, gnss.place.h_amsl_m) == (3, 17, 518.0)
    assert gnss.v_ned_mps == pytest.approx((10.0, 0.5, 0.1))
    assert gnss.h_acc_m == pytest.approx(0.9)
    poses = [e for _, e in recording.events if isinstance(e, PriorPose)]
    assert poses[4].v_ned_mps == pytest.approx((10.0, 0.5, 0.0))
    assert poses[4].h_rel_m == pytest.approx(30.0)
    locals_ = [e for _, e in recording.events if isinstance(e, LocalPose)]
    assert [e.p_ned_m[0] for e in locals_][:2] == [3.0, 4.0], "positions that are not valid make no event"
    (origin,) = [e for _, e in recording.events if isinstance(e, OriginChanged)]
    assert (origin.t_rx_ns, origin.origin.lat_deg) == (20_300_000_000, 47.4)
    ranges = [e for _, e in recording.events if isinstance(e, Range)]
    assert [(e.distance_m, e.valid) for e in ranges[:2]] == [(0.0, False), (30.0, True)]
    assert len(ranges) == 20, "what does not look down is left out"
    links = [(e.t_rx_ns, e.armed) for _, e in recording.events if isinstance(e, LinkChanged)]
    assert links == [(20_000_000_000, False), (20_500_000_000, True)]


def test_utc_is_what_most_rows_say(tmp_path: Path) -> None:
    data = flight()
    for wrong_us in (1_600_000_000_000_000 - 1024 * 604_800_000_000, 1):
        first = struct.pack("<QQ", 20_000_000, 1_600_000_020_000_000)
        damaged = data.replace(first, struct.pack("<QQ", 20_000_000, wrong_us), 1)
        assert damaged != data
        assert open_log(write(tmp_path / "a.ulg", damaged)).unix_minus_boot_ns == 1_600_000_000 * 10**9


def test_not_finite_values_are_left_out(tmp_path: Path) -> None:
    recording = open_log(write(tmp_path / "a.ulg", flight(nan_at=4)))
    assert recording.losses.dropped_messages == 1
    assert sum(isinstance(e, Attitude) for _, e in recording.events) == 29


def test_an_origin_of_one_row_alone_is_left_out_and_one_that_stays_is_taken(tmp_path: Path) -> None:
    def local(k: int, ref_lat: float) -> bytes:
        us = 20_000_000 + 100_000 * k
        return packed("vehicle_local_position", us, ref_lat, 8.55, 488.0, 1.0 * k, 2.0, -30.0, 10.0, 0.5, 0.0, *(True,) * 5)

    data = flight()
    for k in (10, *range(20, 30)):
        data = data.replace(local(k, 47.4), local(k, 49.0 if k == 10 else 47.5))
    recording = open_log(write(tmp_path / "a.ulg", data))
    origins = [(e.t_rx_ns, e.origin.lat_deg) for _, e in recording.events if isinstance(e, OriginChanged)]
    assert origins == [(20_300_000_000, 47.4), (22_000_000_000, 47.5)]
    assert recording.losses.dropped_messages == 1


def test_truncation_and_garbage(tmp_path: Path) -> None:
    whole = flight()
    cut = open_log(write(tmp_path / "a.ulg", whole[: len(whole) * 2 // 3]))
    assert sum(isinstance(e, Attitude) for _, e in cut.events) in range(15, 25)
    middle = whole.index(packed("vehicle_status", 21_000_000, 2))
    noisy = open_log(write(tmp_path / "e.ulg", whole[:middle] + b"\xff\x00garbage" * 9 + whole[middle:]))
    assert sum(isinstance(e, Attitude) for _, e in noisy.events) >= 28
    assert noisy.losses.garbage_bytes > 50
    with pytest.raises(LogError, match=r"b\.ulg: "):
        open_log(write(tmp_path / "b.ulg", MAGIC + b"\xff" * 500))
    with pytest.raises(LogError, match="does not start as a ULog"):
        open_log(write(tmp_path / "c.ulg", b"nothing of the kind"))
    with pytest.raises(LogError, match="no attitude and no position"):
        open_log(write(tmp_path / "d.ulg", header()))


def test_what_px4_could_not_log_in_time_is_told_as_that(tmp_path: Path) -> None:
    """It counted as pieces of garbage, however long it lasted."""
    dropouts = [block(b"O", struct.pack("<H", ms)) for ms in (120, 900)]
    recording = open_log(write(tmp_path / "a.ulg", header() + b"".join(dropouts) + flight()[len(header()) :]))
    assert {name: n for name, n in recording.losses.as_dict().items() if n} == {"dropouts": 2, "dropouts_ms": 1020}


def test_a_tail_of_zeros_takes_no_time(tmp_path: Path) -> None:
    """As a loss of power leaves it: 4 MB took 13 s, each byte being tried for a message."""
    whole = flight()
    cut = open_log(write(tmp_path / "a.ulg", whole[:-5]))
    begun_s = time.process_time()
    zeros = open_log(write(tmp_path / "b.ulg", whole[:-5] + bytes(30_000_000)))
    assert time.process_time() - begun_s < 20.0
    assert zeros.losses.garbage_bytes >= 30_000_000 and len(zeros.events) in range(len(cut.events) - 1, len(cut.events) + 1)


def test_a_size_gone_wrong_leads_nowhere(tmp_path: Path) -> None:
    """The size of a format leads 4 kB on, to where one byte is a type by chance: what lies between holds all subscriptions."""
    padding = block(b"P", b"\x05int32_t A" + bytes(4)) * 300
    data = bytearray(header() + padding + flight()[len(header()) :])
    other = data.index(b"Fvehicle_status") - 2
    data[other + 1] += 0x10
    landing = other + 3 + struct.unpack_from("<H", data, other)[0]
    data[landing : landing + 3] = b"\x40\x00D"
    recording = open_log(write(tmp_path / "a.ulg", bytes(data)))
    assert sum(isinstance(e, Attitude) for _, e in recording.events) >= 28
    assert recording.losses.garbage_pieces >= 1


ATTITUDE = b"\x00\x00\x00vehicle_attitude"
"""The body of its subscription: instance, number, topic."""


@pytest.mark.parametrize(
    ("at", "bit"),
    [(-1, 1), (-1, 2), (-1, 16), (1, 1), (1, 64), (2, 1), (3, 1), (10, 1)],
    ids=[
        "type to none",
        "type to C",
        "type to Q",
        "number to that of another",
        "number",
        "number's high byte",
        "name's first",
        "name",
    ],
)
def test_a_bit_that_hides_a_subscription_is_a_loss(tmp_path: Path, at: int, bit: int) -> None:
    """Expected: the attitudes are gone, and the 30 are counted; of an undamaged log none is."""
    data = bytearray(flight())
    assert open_log(write(tmp_path / "whole.ulg", bytes(data))).losses.unknown_messages == 0
    data[data.index(ATTITUDE) + at] ^= bit
    recording = open_log(write(tmp_path / "a.ulg", bytes(data)))
    assert not any(isinstance(event, Attitude) for _, event in recording.events)
    assert recording.losses.unknown_messages >= 30


def test_a_bit_in_a_format_is_a_loss(tmp_path: Path) -> None:
    data = flight().replace(b"vehicle_attitude:uint64_t", b"vehicle_attitude:uint74_t")
    recording = open_log(write(tmp_path / "a.ulg", data))
    assert recording.losses.unknown_messages == 31


def test_a_bit_in_the_instance_costs_nothing(tmp_path: Path) -> None:
    """Expected: the only instance there is is read, whatever its number."""
    data = bytearray(flight())
    data[data.index(ATTITUDE)] ^= 4
    recording = open_log(write(tmp_path / "a.ulg", bytes(data)))
    assert sum(isinstance(event, Attitude) for _, event in recording.events) == 30


def another(n: int, start_us: int, lat_deg: float, boot_unix_us: int) -> bytes:
    parts = [header()]
    for k in range(n):
        us = start_us + 100_000 * k
        place = (round(lat_deg * 1e7), 85_500_000, 518_000)
        parts += [
            packed("vehicle_attitude", us, 1.0, 0.0, 0.0, 0.0),
            packed("vehicle_local_position", us, lat_deg, 8.55, 488.0, 1.0 * k, 2.0, -30.0, 10.0, 0.5, 0.0, *(True,) * 5),
            packed("vehicle_global_position", us, lat_deg, 8.55, 518.0),
            packed("vehicle_gps_position", us, boot_unix_us + us, *place, 0.9, 1.4, 10.0, 0.5, 0.1, 3, True, 17),
        ]
    return b"".join(parts)


def flown(path: Path, boot: int = 0) -> tuple[set[float], list[int], tuple[str, ...]]:
    """Latitudes, first and last time (s) of the positions, and what is told."""
    recording = open_log(path, boot=boot)
    poses = [(t_ns, event.place.lat_deg) for t_ns, event in recording.events if isinstance(event, PriorPose)]
    times = sorted(t_ns // 10**9 for t_ns, _ in poses)
    return {lat_deg for _, lat_deg in poses}, [times[0], times[-1]], recording.notes


@pytest.mark.parametrize(("start_us", "n"), [(20_000_000, 90), (5_000_000, 90), (200_000_000, 90), (20_000_000, 40)])
def test_of_logs_of_several_boots_in_one_file_one_is_read(tmp_path: Path, start_us: int, n: int) -> None:
    """Read as one log, the second flight went on where the first one ended, 11 km away, or was lost."""
    boot_us, day_us = 1_600_000_000_000_000, 86_400_000_000
    joined = another(60, 20_000_000, 47.4, boot_us) + another(n, start_us, 47.5, boot_us + day_us)
    path = write(tmp_path / "a.ulg", joined)
    first, second = ({47.4}, [20, 25]), ({47.5}, [start_us // 10**6, (start_us + 100_000 * (n - 1)) // 10**6])
    longer = 2 if n > 60 else 1
    told = f"The log holds 2 boots of the autopilot (1 of 6 s, 2 of {n / 10:.0f} s); read was {{}}, --boot reads another."
    assert flown(path) == (*(second if longer == 2 else first), (told.format(longer),))
    assert flown(path, boot=1) == (*first, (told.format(1),))
    assert flown(path, boot=2) == (*second, (told.format(2),))
    assert open_log(path).losses.as_dict() == dict.fromkeys(open_log(path).losses.as_dict(), 0) | {"reboots": 1}
    with pytest.raises(LogError, match=r"a\.ulg: holds no boot 3 of the autopilot; remedy: name one of 1 to 2$"):
        open_log(path, boot=3)


def test_logs_of_one_boot_in_one_file_are_one(tmp_path: Path) -> None:
    """PX4 begins another log with each arming."""
    boot_us = 1_600_000_000_000_000
    joined = another(60, 20_000_000, 47.4, boot_us) + another(40, 90_000_000, 47.5, boot_us)
    assert flown(write(tmp_path / "a.ulg", joined)) == ({47.4, 47.5}, [20, 93], ())
