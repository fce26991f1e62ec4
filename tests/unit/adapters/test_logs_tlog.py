from __future__ import annotations

import math
import struct
import tracemalloc
from collections import Counter
from pathlib import Path
from typing import Any

import pytest
from pymavlink.dialects.v10 import ardupilotmega as mavlink1
from pymavlink.dialects.v20 import ardupilotmega as mavlink2

from visloc_companion.adapters.logs.open import open_log
from visloc_companion.adapters.logs.recording import Losses
from visloc_companion.adapters.logs.tlog import read_tlog, records_of
from visloc_companion.errors import LogError
from visloc_companion.geo.se3 import euler_from_quat
from visloc_companion.geo.wgs84 import ned_from_geo
from visloc_companion.types import (
    Attitude,
    AutopilotKind,
    EstimatorStatus,
    Gnss,
    LinkChanged,
    LocalPose,
    OriginChanged,
    PriorPose,
)

UNIX_US = 1_600_000_000_000_000
LAT, LON = 47.4, 8.55


def writer(dialect: Any, system: int = 1, component: int = 1) -> Any:
    return dialect.MAVLink(None, srcSystem=system, srcComponent=component)


def stamped(wall_us: int, message: Any, mav: Any) -> bytes:
    return struct.pack(">Q", wall_us) + bytes(message.pack(mav))


def heartbeat(mav: Any, autopilot: int = 3, kind: int = 2) -> Any:
    return mav.heartbeat_encode(kind, autopilot, 0x81, 0, 4)


def flight(dialect: Any, n: int = 50, boot0_ms: int = 60_000, wall0_us: int = UNIX_US) -> list[bytes]:
    """One record a list item, 10 Hz: heartbeat each second, attitude, receiver and both positions."""
    mav = writer(dialect)
    records = []
    for k in range(n):
        boot_ms, wall_us = boot0_ms + 100 * k, wall0_us + 100_000 * k
        if k % 10 == 0:
            records.append(stamped(wall_us, heartbeat(mav), mav))
        lat_e7 = round((LAT + k * 1e-5) * 1e7)
        north_m = 20.0 + k * 1.1119
        records += [
            stamped(wall_us, mav.attitude_encode(boot_ms, 0.1, -0.05, 1.0, 0, 0, 0.01), mav),
            stamped(
                wall_us, mav.gps_raw_int_encode(boot_ms * 1000, 3, lat_e7, round(LON * 1e7), 500_000, 90, 90, 1100, 0, 12), mav
            ),
            stamped(
                wall_us, mav.global_position_int_encode(boot_ms, lat_e7, round(LON * 1e7), 500_000, 40_000, 1111, 0, 0, 0), mav
            ),
            stamped(wall_us, mav.local_position_ned_encode(boot_ms, north_m, -3.0, -40.0, 11.11, 0, 0), mav),
        ]
    return records


def write(path: Path, *pieces: bytes) -> Path:
    path.write_bytes(b"".join(pieces))
    return path


@pytest.mark.parametrize("dialect", [mavlink1, mavlink2], ids=["mavlink1", "mavlink2"])
def test_both_versions_are_read(tmp_path: Path, dialect: Any) -> None:
    recording = read_tlog(write(tmp_path / "a.tlog", *flight(dialect)))
    assert recording.kind is AutopilotKind.ARDUPILOT
    assert recording.losses == Losses()
    attitudes = [(t_ns, event) for t_ns, event in recording.events if isinstance(event, Attitude)]
    assert len(attitudes) == 50
    assert attitudes[7][0] == attitudes[7][1].t_boot_ns == attitudes[7][1].t_rx_ns == 60_700_000_000
    assert euler_from_quat(attitudes[7][1].q_ned_frd) == pytest.approx((0.1, -0.05, 1.0), abs=1e-6)
    assert recording.unix_minus_boot_ns == UNIX_US * 1000 - 60 * 10**9
    assert recording.duration_s == pytest.approx(4.9)
    ups = [event for _, event in recording.events if isinstance(event, LinkChanged)]
    assert [(up.up, up.armed, up.system_id) for up in ups] == [(True, True, 1)]


def test_the_origin_is_inferred_from_both_positions(tmp_path: Path) -> None:
    recording = open_log(write(tmp_path / "a.tlog", *flight(mavlink2)))
    assert recording.origin_inferred
    (origin,) = [event.origin for _, event in recording.events if isinstance(event, OriginChanged)]
    pose = next(event for _, event in recording.events if isinstance(event, PriorPose))
    local = next(event for _, event in recording.events if isinstance(event, LocalPose))
    assert ned_from_geo(pose.place, origin) == pytest.approx(local.p_ned_m, abs=0.1)
    first_pose = next(k for k, (_, event) in enumerate(recording.events) if isinstance(event, PriorPose))
    assert any(isinstance(event, OriginChanged) for _, event in recording.events[:first_pose])


def test_a_stated_origin_is_kept(tmp_path: Path) -> None:
    mav = writer(mavlink2)
    stated = stamped(UNIX_US, mav.gps_global_origin_encode(round(46 * 1e7), round(8 * 1e7), 300_000), mav)
    recording = open_log(write(tmp_path / "a.tlog", stated, *flight(mavlink2)))
    assert not recording.origin_inferred
    (origin,) = [event.origin for _, event in recording.events if isinstance(event, OriginChanged)]
    assert origin.lat_deg == 46.0


def test_garbage_between_records_is_counted_and_costs_no_good_one(tmp_path: Path) -> None:
    records = flight(mavlink2)
    noise = bytes(range(256)) + b"\xfd\xfe\xfd\x00\x01" + bytes(40)
    clean = read_tlog(write(tmp_path / "a.tlog", *records))
    noisy = read_tlog(write(tmp_path / "b.tlog", noise, *records[:20], noise, *records[20:90], noise[:7], *records[90:]))
    assert noisy.events == clean.events
    assert noisy.losses.garbage_pieces == 3
    assert noisy.losses.garbage_bytes == 2 * len(noise) + 7
    assert not noisy.losses.truncated


def test_a_damaged_packet_is_lost_alone(tmp_path: Path) -> None:
    records = flight(mavlink2)
    broken = bytearray(records[33])
    broken[20] ^= 0x55
    recording = read_tlog(write(tmp_path / "a.tlog", *records[:33], bytes(broken), *records[34:]))
    assert len(recording.events) == len(read_tlog(write(tmp_path / "b.tlog", *records)).events) - 1
    assert recording.losses.garbage_pieces == 1


def test_a_truncated_file_gives_what_is_whole(tmp_path: Path) -> None:
    data = b"".join(flight(mavlink2))
    recording = read_tlog(write(tmp_path / "a.tlog", data[: len(data) // 2]))
    assert recording.losses.truncated
    assert 90 < len(recording.events) < 120


def test_other_systems_are_left_out(tmp_path: Path) -> None:
    station, companion, other = writer(mavlink2, 255, 190), writer(mavlink2, 1, 191), writer(mavlink2, 2)
    foreign = [
        stamped(UNIX_US, heartbeat(station, 8, 6), station),
        stamped(UNIX_US, companion.attitude_encode(999, 3.0, 0, 0, 0, 0, 0), companion),
        stamped(UNIX_US, other.attitude_encode(60_000, -3.0, 0, 0, 0, 0, 0), other),
        stamped(UNIX_US, heartbeat(other), other),
    ]
    recording = read_tlog(write(tmp_path / "a.tlog", *foreign, *flight(mavlink2)))
    assert recording.losses.foreign_messages == 4
    assert recording.losses.reboots == 0
    rolls = [euler_from_quat(event.q_ned_frd)[0] for _, event in recording.events if isinstance(event, Attitude)]
    assert rolls == pytest.approx([0.1] * 50, abs=1e-6)


def test_other_autopilots_are_named(tmp_path: Path) -> None:
    second = writer(mavlink2, system=7)
    extra = [
        stamped(UNIX_US + 100_000, heartbeat(second), second),
        *(stamped(UNIX_US, heartbeat(m), m) for m in [writer(mavlink2, 255)]),
    ]
    assert read_tlog(write(tmp_path / "a.tlog", *flight(mavlink2), *extra)).notes == (
        "The log holds other autopilots, which were left out: 7 (component 1), 255 (component 1); read was 1.",
    )
    assert read_tlog(write(tmp_path / "b.tlog", *flight(mavlink2))).notes == ()


def test_the_vehicle_of_a_system_id_is_read(tmp_path: Path) -> None:
    """Expected: the second vehicle, though the first has more heartbeats; one that is not there is refused."""
    second = mavlink2.MAVLink(None, srcSystem=7, srcComponent=1)
    records = [stamped(UNIX_US, heartbeat(second), second)]
    records += [
        stamped(UNIX_US + 100_000 * k, second.attitude_encode(5_000 + 100 * k, 0.2, 0, 0, 0, 0, 0), second) for k in range(9)
    ]
    path = write(tmp_path / "a.tlog", *flight(mavlink2), *records)
    chosen = open_log(path, system_id=7)
    assert sum(isinstance(event, Attitude) for _, event in chosen.events) == 9
    assert {event.system_id for _, event in chosen.events if isinstance(event, LinkChanged)} == {7}
    assert chosen.notes == ("The log holds other autopilots, which were left out: 1 (component 1); read was 7.",)
    assert sum(isinstance(event, Attitude) for _, event in open_log(path).events) == 50
    with pytest.raises(LogError, match=r"holds no autopilot of system 3; remedy: name one that is there: 1, 7$"):
        open_log(path, system_id=3)


def test_utc_is_what_the_autopilot_says_of_it(tmp_path: Path) -> None:
    """Of the real copter's log of 2015 the ground station's clock was 1.7 s behind."""
    mav = writer(mavlink2)
    ahead_us = 5_000_000
    times = [0, *(UNIX_US - ahead_us + 100_000 * k for k in range(1, 9)), UNIX_US + 10**9]
    says = [stamped(UNIX_US + 100_000 * k, mav.system_time_encode(t_us, 60_000 + 100 * k), mav) for k, t_us in enumerate(times)]
    recording = read_tlog(write(tmp_path / "a.tlog", *flight(mavlink2, n=1), *says))
    assert not recording.utc_of_station
    assert recording.unix_minus_boot_ns == (UNIX_US - ahead_us) * 1000 - 60 * 10**9
    assert read_tlog(write(tmp_path / "b.tlog", *flight(mavlink2))).utc_of_station


def test_utc_is_what_the_autopilot_says_of_it_once_it_has_a_fix(tmp_path: Path) -> None:
    """Before, PX4 takes it from a ground station, whose clock may be off, or counts from 2000."""
    mav = writer(mavlink2)
    ahead_us, from_2000_us = 3_000_000, 946_684_800_000_000
    records = []
    for k in range(50):
        t_us = from_2000_us if k < 5 else UNIX_US + 100_000 * k + ahead_us * (k < 35)
        records += [
            stamped(UNIX_US + 100_000 * k, message, mav)
            for message in (
                heartbeat(mav, autopilot=12),
                mav.attitude_encode(60_000 + 100 * k, 0, 0, 0, 0, 0, 0),
                mav.gps_raw_int_encode(0, 3 if k >= 40 else 1, round(LAT * 1e7), round(LON * 1e7), 500_000, 90, 90, 0, 0, 12),
                mav.system_time_encode(t_us, 60_000 + 100 * k),
            )
        ]
    recording = read_tlog(write(tmp_path / "a.tlog", *records))
    assert (recording.unix_minus_boot_ns, recording.utc_of_station) == (UNIX_US * 1000 - 60 * 10**9, False)
    assert read_tlog(write(tmp_path / "b.tlog", *records[:160])).utc_of_station, "it never had one"


def test_a_reboot_brings_the_link_down_and_continues_time(tmp_path: Path) -> None:
    before, after = flight(mavlink2), flight(mavlink2, boot0_ms=1_000, wall0_us=UNIX_US + 20_000_000)
    recording = read_tlog(write(tmp_path / "a.tlog", *before, *after))
    assert recording.losses.reboots == 1
    assert [t for t, _ in recording.events] == sorted(t for t, _ in recording.events)
    ups = [event.up for _, event in recording.events if isinstance(event, LinkChanged)]
    assert ups == [True, False, True]
    last = next(event for _, event in reversed(recording.events) if isinstance(event, Attitude))
    assert last.t_boot_ns == last.t_rx_ns == pytest.approx(84.9e9)


@pytest.mark.parametrize("step_s", [-600, 30, 600])
def test_a_clock_of_the_ground_station_that_is_set_moves_nothing(tmp_path: Path, step_s: int) -> None:
    """At whatever message it is set: GPS_RAW_INT and HEARTBEAT have no boot time of the autopilot."""
    records = flight(mavlink2)
    for at in range(100, 106):
        late = [struct.pack(">Q", struct.unpack(">Q", record[:8])[0] + step_s * 10**6) + record[8:] for record in records[at:]]
        recording = open_log(write(tmp_path / "a.tlog", *records[:at], *late))
        assert recording.duration_s == pytest.approx(4.9)
        behind_s = [(t_ns - e.t_boot_ns) / 1e9 for t_ns, e in recording.events if isinstance(e, Attitude | PriorPose | LocalPose)]
        assert max(map(abs, behind_s)) == pytest.approx(0)


@pytest.mark.parametrize("set_at", [0, 100, 10_000])
def test_a_clock_that_begins_in_1970_costs_nothing(tmp_path: Path, set_at: int) -> None:
    """A companion without a clock of its own records until its time is set, or for ever; its records counted as garbage."""
    begun_us = 30_000_000
    records = [
        struct.pack(">Q", begun_us + struct.unpack(">Q", record[:8])[0] - UNIX_US) + record[8:] if k < set_at else record
        for k, record in enumerate(flight(mavlink2))
    ]
    recording = open_log(write(tmp_path / "a.tlog", *records))
    assert sum(isinstance(event, Attitude) for _, event in recording.events) == 50
    assert (recording.losses.garbage_bytes, recording.losses.reboots) == (0, 0)
    assert recording.duration_s == pytest.approx(4.9)


def test_a_signed_packet_is_read(tmp_path: Path) -> None:
    mav = writer(mavlink2)
    mav.signing.secret_key, mav.signing.sign_outgoing, mav.signing.timestamp = b"k" * 32, True, 1
    signed = stamped(UNIX_US + 4_950_000, mav.attitude_encode(64_950, 0.3, 0, 0, 0, 0, 0), mav)
    recording = read_tlog(write(tmp_path / "a.tlog", *flight(mavlink2), signed))
    assert recording.losses == Losses()
    assert euler_from_quat(recording.events[-1][1].q_ned_frd)[0] == pytest.approx(0.3)  # type: ignore[union-attr]


def test_positions_that_mean_nothing_make_no_events(tmp_path: Path) -> None:
    mav = writer(mavlink2)
    nowhere = stamped(UNIX_US, mav.global_position_int_encode(60_000, 0, 0, 0, 0, 0, 0, 0, 0), mav)
    nan = stamped(UNIX_US, mav.attitude_encode(60_000, math.nan, 0, 0, 0, 0, 0), mav)
    recording = read_tlog(write(tmp_path / "a.tlog", stamped(UNIX_US, heartbeat(mav), mav), nowhere, nan))
    assert [type(event) for _, event in recording.events] == [LinkChanged]


@pytest.mark.parametrize("data", [b"", b"\xfe" * 4000, b"hello world, no log at all\n" * 9, struct.pack(">Q", UNIX_US)])
def test_what_is_no_log_is_refused_by_name(tmp_path: Path, data: bytes) -> None:
    with pytest.raises(LogError, match=r"a\.tlog: .*; remedy: "):
        open_log(write(tmp_path / "a.tlog", data))


def test_a_log_without_an_autopilot_is_refused(tmp_path: Path) -> None:
    station = writer(mavlink2, 255, 190)
    with pytest.raises(LogError, match="no MAVLink packet of an autopilot"):
        read_tlog(write(tmp_path / "a.tlog", stamped(UNIX_US, heartbeat(station, 8, 6), station)))


def test_missing_and_unknown_files(tmp_path: Path) -> None:
    with pytest.raises(LogError, match="cannot be read"):
        open_log(tmp_path / "none.tlog")
    with pytest.raises(LogError, match="is no log that is known"):
        open_log(write(tmp_path / "a.pdf", b"%PDF-1.7 nothing"))


def test_the_content_decides_before_the_suffix(tmp_path: Path) -> None:
    assert open_log(write(tmp_path / "flight.dat", *flight(mavlink1))).duration_s == pytest.approx(4.9)


def test_unknown_messages_are_counted_only_where_records_go_on() -> None:
    mav = writer(mavlink2)
    unknown = struct.pack(">Q", UNIX_US) + b"\xfd\x02\x00\x00\x00\x01\x01\xff\xff\xee" + b"ab" + b"cc"
    good = stamped(UNIX_US, heartbeat(mav), mav)
    losses = Losses()
    assert len(list(records_of(unknown + good + unknown[:-1] + good, losses))) == 2
    assert losses.unknown_messages == 1
    assert losses.garbage_pieces == 1


def test_gnss_keeps_its_receiver(tmp_path: Path) -> None:
    recording = read_tlog(write(tmp_path / "a.tlog", *flight(mavlink2)))
    gnss = [event for _, event in recording.events if isinstance(event, Gnss)]
    assert {event.receiver for event in gnss} == {0}
    assert gnss[3].v_ned_mps == pytest.approx((11.0, 0.0, 0.0))


def test_messages_that_tell_of_no_flight_take_little_memory(tmp_path: Path) -> None:
    mav = writer(mavlink2)
    parameter = mav.param_value_encode(b"ATC_RAT_PIT_P", 0.135, 9, 900, 17)
    many = [stamped(UNIX_US + k, parameter, mav) for k in range(3_000)]
    path = write(tmp_path / "a.tlog", *flight(mavlink2), *many)
    tracemalloc.start()
    assert len(read_tlog(path).events) > 200
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 3 * path.stat().st_size  # with all messages of the second pass kept: 19 times


@pytest.mark.parametrize(("name", "kind", "n"), [(b"GPS_TYPE2", 14, 0), (b"GPS2_TYPE", 14, 0), (b"GPS2_TYPE", 1, 1)])
def test_what_a_companion_plays_is_no_second_receiver(tmp_path: Path, name: bytes, kind: int, n: int) -> None:
    """Wherever in the log the ground station asked for the parameters."""
    mav = writer(mavlink2)
    second = mav.gps2_raw_encode(64_000_000, 3, round(LAT * 1e7), round(LON * 1e7), 500_000, 90, 90, 1100, 0, 12, 0, 0)
    parameter = mav.param_value_encode(name, kind, 2, 1200, 7)
    more = [stamped(UNIX_US + 4_950_000, message, mav) for message in (second, parameter)]
    recording = read_tlog(write(tmp_path / "a.tlog", *flight(mavlink2), *more))
    assert sum(event.receiver == 1 for _, event in recording.events if isinstance(event, Gnss)) == n


@pytest.mark.parametrize(("name", "kind", "n"), [(b"GPS_TYPE", 14, 1), (b"GPS1_TYPE", 14, 1), (b"GPS1_TYPE", 1, 0)])
def test_a_first_receiver_that_a_companion_plays_is_told(tmp_path: Path, name: bytes, kind: int, n: int) -> None:
    mav = writer(mavlink2)
    parameter = stamped(UNIX_US + 4_950_000, mav.param_value_encode(name, kind, 2, 1200, 7), mav)
    recording = read_tlog(write(tmp_path / "a.tlog", *flight(mavlink2), parameter))
    assert sum("plays by GPS_INPUT" in note for note in recording.notes) == n


def test_packets_that_tell_of_no_flight_are_decoded_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    mav = writer(mavlink2)
    unread = [stamped(UNIX_US + 100_000 * k, mav.vfr_hud_encode(11.0, 11.0, 90, 50, 500.0, 0.0), mav) for k in range(50)]
    decoded: Counter[str] = Counter()
    decode = mavlink2.MAVLink.decode

    def counted(self: Any, packet: bytearray) -> Any:
        message = decode(self, packet)
        decoded[message.get_type()] += 1
        return message

    monkeypatch.setattr(mavlink2.MAVLink, "decode", counted)
    path = write(tmp_path / "a.tlog", *(piece for pair in zip(flight(mavlink2), unread, strict=False) for piece in pair))
    assert any(isinstance(event, Attitude) for _, event in read_tlog(path).events)
    assert decoded["VFR_HUD"] == 50
    assert decoded["ATTITUDE"] > 0
    assert decoded["ATTITUDE"] % 2 == 0


@pytest.mark.parametrize("dialect", [mavlink1, mavlink2])
def test_packets_that_tell_of_no_flight_still_tell_the_time(tmp_path: Path, dialect: Any) -> None:
    mav = writer(dialect)
    channels = mav.rc_channels_encode(70_000, 8, *[1500] * 18, 255)
    status = mav.ekf_status_report_encode(0x1F, 0.1, 0.1, 0.1, 0.1, 0.1)
    late = [stamped(UNIX_US + 10_000_000, message, mav) for message in (channels, status)]
    recording = read_tlog(write(tmp_path / "a.tlog", *flight(dialect, 20), *late))
    t_ns, event = recording.events[-1]
    assert isinstance(event, EstimatorStatus)
    assert t_ns == 70_000_000_000
