from __future__ import annotations

import math
import struct
import tracemalloc
from pathlib import Path

import pytest

from visloc_companion.adapters.logs.open import open_log
from visloc_companion.adapters.logs.recording import Losses
from visloc_companion.errors import LogError
from visloc_companion.geo.se3 import euler_from_quat
from visloc_companion.geo.wgs84 import distance_m
from visloc_companion.types import (
    Attitude,
    AutopilotKind,
    EstimatorStatus,
    GeoPoint,
    Gnss,
    Imu,
    LinkChanged,
    LocalPose,
    OriginChanged,
    PriorPose,
    Range,
)

HEAD = b"\xa3\x95"
CODES = {
    "B": "B",
    "Q": "Q",
    "c": "h",
    "C": "H",
    "L": "i",
    "e": "i",
    "f": "f",
    "I": "I",
    "H": "H",
    "i": "i",
    "E": "I",
    "Z": "64s",
    "N": "16s",
    "b": "b",
}
MODERN = {
    "ATT": (1, "Qccc", "TimeUS,Roll,Pitch,Yaw"),
    "IMU": (11, "QBffffff", "TimeUS,I,GyrX,GyrY,GyrZ,AccX,AccY,AccZ"),
    "GPS": (2, "QBBIHBcLLeffff", "TimeUS,I,Status,GMS,GWk,NSats,HDop,Lat,Lng,Alt,Spd,GCrs,VZ,Yaw"),
    "POS": (3, "QLLfff", "TimeUS,Lat,Lng,Alt,RelHomeAlt,RelOriginAlt"),
    "XKF1": (4, "QBffffff", "TimeUS,C,VN,VE,VD,PN,PE,PD"),
    "XKF4": (5, "QBcccI", "TimeUS,C,SV,SP,SH,SS"),
    "ORGN": (6, "QBLLe", "TimeUS,Type,Lat,Lng,Alt"),
    "EV": (7, "QB", "TimeUS,Id"),
    "MSG": (8, "QZ", "TimeUS,Message"),
    "BARO": (9, "Qf", "TimeUS,Alt"),
    "RFND": (10, "QBCBB", "TimeUS,Instance,Dist,Stat,Orient"),
}
OLD = {
    "ATT": (1, "Iccc", "TimeMS,Roll,Pitch,Yaw"),
    "IMU": (6, "Iffffff", "TimeMS,GyrX,GyrY,GyrZ,AccX,AccY,AccZ"),
    "GPS": (2, "BIHBcLLeeEefI", "Status,TimeMS,Week,NSats,HDop,Lat,Lng,RelAlt,Alt,Spd,GCrs,VZ,T"),
    "NTUN": (3, "Iffff", "TimeMS,PosX,PosY,VelX,VelY"),
    "CTUN": (4, "Ifh", "TimeMS,Alt,CRt"),
    "EV": (5, "B", "Id"),
}
CODES |= {"h": "h", "b": "b", "N": "16s"}


def layout(code: str) -> struct.Struct:
    return struct.Struct("<" + "".join(CODES[letter] for letter in code))


def formats(table: dict[str, tuple[int, str, str]]) -> bytes:
    return b"".join(
        HEAD + b"\x80" + struct.pack("<BB4s16s64s", kind, layout(code).size + 3, name.encode(), code.encode(), columns.encode())
        for name, (kind, code, columns) in table.items()
    )


def message(table: dict[str, tuple[int, str, str]], name: str, *values: object) -> bytes:
    kind, code, _ = table[name]
    return HEAD + bytes([kind]) + layout(code).pack(*values)


def modern_flight(n: int = 20, week: int = 2200) -> bytes:
    parts = [formats(MODERN), message(MODERN, "MSG", 900_000, b"ArduCopter V4.5.7 (abc)")]
    parts += [
        message(MODERN, "ORGN", 1_000_000, 0, 474_000_000, 85_500_000, 50_000),
        message(MODERN, "ORGN", 1_000_000, 1, 1, 1, 1),
    ]
    for k in range(n):
        us = 1_000_000 + k * 100_000
        lat = 474_000_000 + k * 90
        parts += [
            message(MODERN, "ATT", us, 1000, -500, 9000 + 100 * k),
            message(MODERN, "XKF1", us, 0, 10.0, 0.5, -0.1, float(k), 0.0, -40.0),
            message(MODERN, "XKF1", us, 1, 99.0, 99.0, 99.0, 99.0, 99.0, 99.0),
            message(MODERN, "XKF4", us, 0, 12, 34, 5, 0x1A33F),
            message(MODERN, "POS", us, lat, 85_500_000, 540.0, 40.0, 40.0),
            message(MODERN, "GPS", us, 0, 3, 3_600_000 + 100 * k, week, 15, 80, lat, 85_500_000, 54_000, 10.0, 90.0, -0.1, 0.0),
            message(MODERN, "GPS", us, 2, 3, 3_600_000, week, 5, 80, 0, 0, 0, 0.0, 0.0, 0.0, 0.0),
            message(MODERN, "BARO", us, 40.0),
            message(MODERN, "RFND", us, 0, 4000, 4 if k else 3, 25),
            message(MODERN, "RFND", us, 1, 1234, 4, 0),
        ]
        parts += [message(MODERN, "EV", us, 10)] if k == 10 else []
    return b"".join(parts)


def write(path: Path, data: bytes) -> Path:
    path.write_bytes(data)
    return path


def test_a_log_of_today(tmp_path: Path) -> None:
    recording = open_log(write(tmp_path / "a.bin", modern_flight()))
    by_type = {kind: [e for _, e in recording.events if isinstance(e, kind)] for kind in (Attitude, Gnss, PriorPose, LocalPose)}
    assert {kind.__name__: len(found) for kind, found in by_type.items()} == {
        "Attitude": 20, "Gnss": 20, "PriorPose": 20, "LocalPose": 20
    }  # fmt: skip
    attitude = by_type[Attitude][3]
    assert isinstance(attitude, Attitude)
    assert euler_from_quat(attitude.q_ned_frd) == pytest.approx([0.1745, -0.0873, 1.6232], abs=1e-3)
    assert attitude.rate_frd_radps[2] == pytest.approx(0.1745 * 0.98, abs=0.01), "1 degree in 0.1 s about the down axis"
    gnss, pose = by_type[Gnss][0], by_type[PriorPose][5]
    assert isinstance(gnss, Gnss)
    assert isinstance(pose, PriorPose)
    assert gnss.v_ned_mps == pytest.approx((0.0, 10.0, -0.1), abs=1e-6)
    assert (gnss.fix_type, gnss.n_satellites, gnss.t_boot_ns) == (3, 15, 1_000_000_000)
    assert gnss.place.lat_deg == pytest.approx(47.4)
    assert pose.v_ned_mps == pytest.approx((10.0, 0.5, -0.1))
    assert pose.h_rel_m == 40.0
    (origin,) = [e.origin for _, e in recording.events if isinstance(e, OriginChanged)]
    assert origin == GeoPoint(pytest.approx(47.4), pytest.approx(8.55), 500.0)
    assert not recording.origin_inferred
    status = next(e for _, e in recording.events if isinstance(e, EstimatorStatus))
    assert (status.position_ratio, status.velocity_ratio, status.gnss_glitch) == (pytest.approx(0.34), pytest.approx(0.12), False)
    links = [e for _, e in recording.events if isinstance(e, LinkChanged)]
    assert [(e.autopilot, e.version, e.armed) for e in links] == [
        (AutopilotKind.ARDUPILOT, "4.5.7", False),
        (AutopilotKind.ARDUPILOT, "4.5.7", True),
    ]
    ranges = [e for _, e in recording.events if isinstance(e, Range)]
    assert [(e.distance_m, e.valid) for e in ranges[:2]] == [(pytest.approx(40.0), False), (pytest.approx(40.0), True)]
    assert len(ranges) == 20, "what looks forward is left out"
    assert recording.losses == Losses()
    gps_week_start_unix_s = 315_964_800 + 2200 * 604_800 - 18
    assert recording.unix_minus_boot_ns == (gps_week_start_unix_s + 3600 - 1) * 10**9


def test_a_log_of_before_the_ekf(tmp_path: Path) -> None:
    parts = [formats(OLD), message(OLD, "EV", 10)]
    for k in range(10):
        ms = 300_000 + 100 * k
        parts += [
            message(OLD, "ATT", ms, 0, 0, 9000),
            message(OLD, "GPS", 3, 1000, 1815, 9, 150, 301_557_000, -979_575_000, 0, 29_700, 0, 0, 0.0, ms),
            message(OLD, "CTUN", ms, 8.0, 50),
            message(OLD, "NTUN", ms, 1000.0 + 100 * k, -500.0, 1000.0, 0.0),
        ]
    recording = open_log(write(tmp_path / "a.bin", b"".join(parts)))
    poses = [e for _, e in recording.events if isinstance(e, PriorPose)]
    home = GeoPoint(30.1557, -97.9575, 297.0)
    assert len(poses) == 10
    assert distance_m(poses[0].place, home) == pytest.approx((10**2 + 5**2) ** 0.5, rel=0.005)
    assert poses[0].v_ned_mps == pytest.approx((10.0, 0.0, -0.5))
    assert poses[0].h_rel_m == 8.0
    assert poses[0].t_boot_ns == 300_000_000_000
    assert recording.origin_inferred
    assert all(e.armed for _, e in recording.events if isinstance(e, LinkChanged))


def test_garbage_and_truncation_cost_only_what_they_hit(tmp_path: Path) -> None:
    whole = modern_flight()
    clean = open_log(write(tmp_path / "a.bin", whole))
    middle = whole.index(message(MODERN, "BARO", 1_500_000, 40.0))
    noisy = open_log(write(tmp_path / "b.bin", whole[:middle] + b"\x00\xa3\x95\xee garbage" * 5 + whole[middle:]))
    assert noisy.losses.garbage_bytes > 50
    assert len(noisy.events) >= len(clean.events) - 1
    cut = open_log(write(tmp_path / "c.bin", whole[: len(whole) * 2 // 3]))
    assert len(clean.events) / 2 < len(cut.events) < len(clean.events)


BEGINNING = HEAD + b"\x80" + struct.pack("<BB4s16s64s", 0x80, 89, b"FMT", b"BBnNZ", b"Type,Length,Name,Format,Columns")


def boot(n: int, north_m: float, start_us: int = 1_000_000) -> bytes:
    """A log with its own beginning: attitudes and local positions, ten a second."""
    parts = [BEGINNING, formats(MODERN)]
    for us in range(start_us, start_us + n * 100_000, 100_000):
        parts += [message(MODERN, "ATT", us, 1000, -500, 9000)]
        parts += [message(MODERN, "XKF1", us, 0, 10.0, 0.5, -0.1, north_m, 0.0, -40.0)]
    return b"".join(parts)


@pytest.mark.parametrize(("chosen", "north_m", "n"), [(0, 2.0, 90), (1, 1.0, 40), (2, 2.0, 90), (3, 3.0, 30)])
def test_one_of_several_boots_is_read_and_the_others_are_named(tmp_path: Path, chosen: int, north_m: float, n: int) -> None:
    """Three logs one after another. Expected: all of one and nothing of the others, although its clock goes over theirs; the one
    that tells most where none is chosen."""
    path = write(tmp_path / "a.bin", boot(40, 1.0) + boot(90, 2.0) + boot(30, 3.0))
    recording = open_log(path, boot=chosen)
    norths_m = [event.p_ned_m[0] for _, event in recording.events if isinstance(event, LocalPose)]
    assert norths_m == [north_m] * n
    assert (recording.losses.reboots, recording.losses.dropped_messages, recording.losses.clock_steps) == (2, 0, 0)
    read = f"read was {chosen or 2}, --boot reads another."
    assert recording.notes == (f"The log holds 3 boots of the autopilot (1 of 4 s, 2 of 9 s, 3 of 3 s); {read}",)


@pytest.mark.parametrize("n_before", [3, len(MODERN)])
def test_the_format_of_formats_need_not_be_the_first(tmp_path: Path, n_before: int) -> None:
    """Programs that write a log anew put the formats in an order of their own; what lay before it counted as a log of itself."""
    items, data = list(MODERN.items()), modern_flight()
    of_formats = HEAD + b"\x80" + struct.pack("<BB4s16s64s", 0x80, 89, b"FMT", b"BBnNZ", b"Type,Length,Name,Format,Columns")
    in_order = formats(dict(items[:n_before])) + of_formats + formats(dict(items[n_before:]))
    anew = open_log(write(tmp_path / "a.bin", in_order + data[len(formats(MODERN)) :]))
    assert anew.events == open_log(write(tmp_path / "b.bin", data)).events
    assert not any(anew.losses.as_dict().values())


def test_formats_of_one_log_are_not_those_of_the_next(tmp_path: Path) -> None:
    """It may be of another version, in which the same number is another message."""
    of_formats = HEAD + b"\x80" + struct.pack("<BB4s16s64s", 0x80, 89, b"FMT", b"BBnNZ", b"Type,Length,Name,Format,Columns")
    no_attitude = {name: item for name, item in MODERN.items() if name != "ATT"}
    data = modern_flight()
    both = of_formats + data + of_formats + formats(no_attitude) + data[len(formats(MODERN)) :]
    recording = open_log(write(tmp_path / "a.bin", both), boot=2)
    assert any(isinstance(event, Gnss) for _, event in recording.events)
    assert not any(isinstance(event, Attitude) for _, event in recording.events)


def test_a_boot_that_is_not_there_is_named(tmp_path: Path) -> None:
    with pytest.raises(LogError, match=r"holds no boot 3 of the autopilot; remedy: name one of 1 to 2$"):
        open_log(write(tmp_path / "a.bin", boot(40, 1.0) + boot(90, 2.0)), boot=3)


def test_logs_of_one_boot_go_on(tmp_path: Path) -> None:
    """Two logs of one boot: the clock goes on. Expected: both, without a word."""
    recording = open_log(write(tmp_path / "a.bin", boot(40, 1.0) + boot(50, 2.0, start_us=9_000_000)))
    assert sum(isinstance(event, LocalPose) for _, event in recording.events) == 90
    assert (recording.notes, recording.losses) == ((), Losses())


def test_a_later_start_is_another_boot_though_the_clock_goes_on(tmp_path: Path) -> None:
    """Armed 4 s after the first start, and on the next day 9 s after the second: GPS time tells them apart."""

    def gps(us: int, ms: int) -> bytes:
        return message(MODERN, "GPS", us, 0, 3, ms, 2200, 15, 80, 474_000_000, 85_500_000, 54_000, 10.0, 90.0, -0.1, 0.0)

    first = boot(40, 1.0) + gps(5_000_000, 3_600_000)
    for later_ms, chosen, n, reboots in ((86_400_000, 1, 40, 1), (3_600_000 + 9_000, 0, 90, 0)):
        second = boot(50, 2.0, start_us=9_000_000) + gps(14_000_000, later_ms)
        recording = open_log(write(tmp_path / "a.bin", first + second), boot=chosen)
        assert sum(isinstance(event, LocalPose) for _, event in recording.events) == n
        assert recording.losses.reboots == reboots


def test_a_message_that_lost_its_end_to_a_block_of_zeros_is_left_out(tmp_path: Path) -> None:
    """As cards leave them. Its longitude would be 0, and the format has no checksums."""
    whole = modern_flight()
    at = whole.rindex(HEAD + bytes([MODERN["POS"][0]])) + 16
    recording = open_log(write(tmp_path / "a.bin", whole[:at] + bytes(512) + whole[at + 512 :]))
    places = [event.place for _, event in recording.events if isinstance(event, PriorPose)]
    assert len(places) == 19
    assert [place.lon_deg for place in places] == pytest.approx([8.55] * 19)
    assert sum(isinstance(event, PriorPose) for _, event in open_log(write(tmp_path / "b.bin", whole + bytes(4096))).events) == 20


def test_impossible_values_and_times_are_left_out(tmp_path: Path) -> None:
    bad = [
        message(MODERN, "XKF1", 1_100_000, 0, float("nan"), 0.0, 0.0, 0.0, 0.0, 0.0),
        message(MODERN, "POS", 1_100_000, 2_000_000_000, 0, 0.0, 0.0, 0.0),
        message(MODERN, "ATT", 10**15, 0, 0, 0),
    ]
    recording = open_log(write(tmp_path / "a.bin", modern_flight(2) + b"".join(bad) + message(MODERN, "ATT", 1_200_000, 0, 0, 0)))
    assert recording.losses.dropped_messages == 3
    assert recording.losses.clock_steps == 1
    assert recording.events[-1][0] == 1_200_000_000


def test_a_first_time_that_is_wrong_does_not_cost_the_flight(tmp_path: Path) -> None:
    stray = message(MODERN, "GPS", 10**15, 0, 3, 0, 2200, 15, 80, 474_000_000, 85_500_000, 54_000, 0.0, 0.0, 0.0, 0.0)
    clean = open_log(write(tmp_path / "a.bin", modern_flight(20)))
    head = formats(MODERN)
    recording = open_log(write(tmp_path / "b.bin", head + stray + modern_flight(20)[len(head) :]))
    attitudes = [event.t_boot_ns for _, event in recording.events if isinstance(event, Attitude)]
    assert attitudes[-1] == 2_900_000_000
    assert len(attitudes) >= 16
    assert recording.losses.clock_steps == 1
    assert recording.unix_minus_boot_ns is not None
    assert clean.unix_minus_boot_ns is not None
    assert abs(recording.unix_minus_boot_ns - clean.unix_minus_boot_ns) < 10**9, "not by the stray time"


@pytest.mark.parametrize(("week", "ms"), [(152, 3_600_000), (2199, 3_600_000), (2200, 500_000_000)])
def test_utc_is_what_most_messages_say(tmp_path: Path, week: int, ms: int) -> None:
    """A bit that is turned in a log, which has no checksums, and what a receiver says before it knows its week."""
    clean = open_log(write(tmp_path / "a.bin", modern_flight()))
    first = message(MODERN, "GPS", 950_000, 0, 3, ms, week, 15, 80, 474_000_000, 85_500_000, 54_000, 10.0, 90.0, -0.1, 0.0)
    head = formats(MODERN)
    recording = open_log(write(tmp_path / "b.bin", head + first + modern_flight()[len(head) :]))
    assert recording.unix_minus_boot_ns == clean.unix_minus_boot_ns


def test_leap_seconds_count_from_the_day_they_were_made(tmp_path: Path) -> None:
    """1 July 2015 was a Wednesday: four days of its GPS week have a second more than the others."""
    told = []
    for day in (2, 4):
        ms = day * 86_400_000
        gps = message(MODERN, "GPS", 1_000_000, 0, 3, ms, 1851, 15, 80, 474_000_000, 85_500_000, 54_000, 0.0, 0.0, 0.0, 0.0)
        recording = open_log(write(tmp_path / "a.bin", formats(MODERN) + gps))
        assert recording.unix_minus_boot_ns is not None
        told.append(recording.unix_minus_boot_ns // 10**9 - (315_964_800 + 1851 * 604_800 + ms // 1000) + 1)
    assert told == [-16, -17]


def test_a_log_that_tells_nothing_is_refused(tmp_path: Path) -> None:
    with pytest.raises(LogError, match=r"a\.bin: holds no ATT"):
        open_log(write(tmp_path / "a.bin", formats(MODERN) + message(MODERN, "BARO", 1, 2.0)))


def test_a_log_of_px4_of_before_ulog_is_told_from_an_empty_one(tmp_path: Path) -> None:
    """Its framing is the same, but its attitudes have no time of their own."""
    px4 = {"ATT": (2, "ffffff", "qw,qx,qy,qz,Roll,Pitch"), "TIME": (129, "Q", "StartTime")}
    data = formats(px4) + message(px4, "TIME", 1_000_000) + message(px4, "ATT", 1.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    with pytest.raises(LogError, match=r"a\.bin: holds no ATT.* as ArduPilot writes them; remedy: .*\.ulg"):
        open_log(write(tmp_path / "a.bin", data))


def test_accelerations_of_the_first_sensor_at_no_more_than_a_hundred_hertz(tmp_path: Path) -> None:
    parts = [modern_flight(2)]
    for k in range(40):  # 400 Hz
        us = 1_200_000 + 2_500 * k
        parts += [message(MODERN, "IMU", us, sensor, 0.0, 0.0, 0.0, 0.5 + sensor, -0.25, -9.8) for sensor in (0, 1)]
    parts.append(message(MODERN, "IMU", 1_400_000, 0, 0.0, 0.0, 0.0, math.nan, 0.0, 0.0))
    recording = open_log(write(tmp_path / "a.bin", b"".join(parts)))
    forces = [event for _, event in recording.events if isinstance(event, Imu)]
    assert [event.t_boot_ns for event in forces] == [1_200_000_000 + 10_000_000 * k for k in range(10)]
    assert all(event.force_frd_mps2 == pytest.approx((0.5, -0.25, -9.8)) for event in forces)
    assert recording.losses.dropped_messages == 1


def test_accelerations_of_a_log_of_2014(tmp_path: Path) -> None:
    data = formats(OLD) + message(OLD, "ATT", 1_000, 0, 0, 9000) + message(OLD, "IMU", 1_020, 0.0, 0.0, 0.0, 1.0, 2.0, -9.5)
    (force,) = [event for _, event in open_log(write(tmp_path / "a.bin", data)).events if isinstance(event, Imu)]
    assert force == Imu(1_020_000_000, 1_020_000_000, (1.0, 2.0, -9.5))


@pytest.mark.parametrize(
    ("flags", "glitch", "position_ok", "velocity_ok"),
    [
        (0x1A33F, False, True, True),  # in flight: using GPS, whose quality is good
        (0x0433F, True, True, True),
        (0x180A7, False, False, False),  # good GPS before it is used: constant position
        (0, False, False, None),
    ],
)
def test_what_the_estimator_says_of_itself(
    tmp_path: Path, flags: int, *, glitch: bool, position_ok: bool, velocity_ok: bool | None
) -> None:
    data = formats(MODERN) + message(MODERN, "ATT", 1_000_000, 0, 0, 0) + message(MODERN, "XKF4", 1_000_000, 0, 12, 34, 5, flags)
    (status,) = [e for _, e in open_log(write(tmp_path / "a.bin", data)).events if isinstance(e, EstimatorStatus)]
    assert (status.gnss_glitch, status.horizontal_position_ok, status.velocity_ok) == (glitch, position_ok, velocity_ok)


def test_ratios_without_the_estimators_status_are_no_loss(tmp_path: Path) -> None:
    old = {"ATT": OLD["ATT"], "EKF4": (7, "Icccc", "TimeMS,SV,SP,SH,SVT")}
    data = formats(old) + message(old, "ATT", 1000, 0, 0, 0) + message(old, "EKF4", 1000, 3, 0, 0, 0)
    recording = open_log(write(tmp_path / "a.bin", data))
    assert [type(event) for _, event in recording.events] == [LinkChanged, Attitude]
    assert recording.losses == Losses()


def test_a_log_goes_on_after_hours_without_arming(tmp_path: Path) -> None:
    hours_us = 3 * 3_600_000_000
    later = [message(MODERN, "ATT", hours_us + k * 100_000, 0, 0, 0) for k in range(60)]
    stray = message(MODERN, "ATT", 10**15, 0, 0, 0)
    recording = open_log(write(tmp_path / "a.bin", modern_flight(2) + b"".join([*later[:30], stray, *later[30:]])))
    attitudes = [event for _, event in recording.events if isinstance(event, Attitude)]
    assert len(attitudes) == 2 + 60 - 20
    assert attitudes[-1].t_boot_ns == 10_805_900_000_000
    assert recording.losses.clock_steps == 2


def test_a_log_takes_no_memory_of_its_own_size(tmp_path: Path) -> None:
    """A log of 2 GB is to be read on a computer of 4 GB."""
    rate = {"RATE": (40, "QZ", "TimeUS,Text")}
    many = formats(rate) + b"".join(message(rate, "RATE", k, b"many of them") for k in range(60_000))
    path = write(tmp_path / "a.bin", modern_flight() + many)
    assert len(open_log(path).events) > 100  # once before: what is imported counts, too
    tracemalloc.start()
    open_log(path)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 0.2 * path.stat().st_size
