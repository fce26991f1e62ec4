"""Where a gimbal pointed, in logs of every kind."""

from __future__ import annotations

import math
from pathlib import Path

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink2

from tests.unit.adapters import test_logs_dataflash as dataflash
from tests.unit.adapters import test_logs_tlog as tlog
from tests.unit.adapters import test_logs_ulog as ulog
from visloc_companion.adapters.logs.open import open_log
from visloc_companion.adapters.logs.recording import Recording
from visloc_companion.geo.se3 import euler_from_quat, quat_from_euler
from visloc_companion.types import GimbalAttitude, GimbalFrame

MNT = {"MNT": (12, "QBfffffffff", "TimeUS,I,DRoll,Roll,DPitch,Pitch,DYawB,YawB,DYawE,YawE,Dist")}
NAN = math.nan
AHEAD = quat_from_euler(0.02, math.radians(-70.0), 0.3)
HEADING, BOTH = 44, 96
NAME = "gimbal_device_attitude_status"
TOPIC = [
    *[("uint64_t", "timestamp"), ("float[4]", "q"), ("int32_t", "device_flags"), ("int32_t", "failure_flags")],
    *[("uint8_t", "gimbal_device_id"), ("bool", "received_from_mavlink")],
]


def pointed(recording: Recording) -> list[GimbalAttitude]:
    return [event for _, event in recording.events if isinstance(event, GimbalAttitude)]


def test_of_ardupilots_own_log(tmp_path: Path) -> None:
    """What it could not tell (NaN) is left out; the second gimbal is number 2."""
    parts = [dataflash.modern_flight(), dataflash.formats(MNT)]
    parts.append(dataflash.message(MNT, "MNT", 3_000_000, 0, 0.0, 1.0, -70.0, -69.0, 0.0, 17.0, NAN, 100.0, NAN))
    parts.append(dataflash.message(MNT, "MNT", 3_000_000, 1, NAN, 0.0, NAN, -30.0, NAN, 0.0, NAN, 80.0, NAN))
    parts.append(dataflash.message(MNT, "MNT", 3_100_000, 0, 0.0, NAN, -70.0, NAN, 0.0, NAN, NAN, NAN, NAN))
    recording = open_log(dataflash.write(tmp_path / "a.bin", b"".join(parts)))
    first, second = pointed(recording)
    assert (first.t_rx_ns, first.t_boot_ns, first.t_own_ns, first.gimbal_id) == (3_000_000_000, 3_000_000_000, None, 1)
    assert first.frame is GimbalFrame.HEADING
    assert [math.degrees(a) for a in euler_from_quat(first.q_frame_gimbal)] == pytest.approx([1.0, -69.0, 17.0], abs=1e-4)
    assert second.gimbal_id == 2
    assert recording.losses.dropped_messages == 1


def test_of_px4s_own_log(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """What names both frames is dropped; one that failed says so."""
    monkeypatch.setitem(ulog.TOPICS, NAME, TOPIC)
    monkeypatch.setitem(ulog.TYPES, "int32_t", "i")
    parts = [ulog.flight()]
    parts += [ulog.packed(NAME, 23_000_000, *AHEAD, HEADING, 0, 1, False), ulog.packed(NAME, 23_100_000, *AHEAD, 64, 8, 0, True)]
    parts.append(ulog.packed(NAME, 23_200_000, *AHEAD, BOTH, 0, 1, False))
    recording = open_log(ulog.write(tmp_path / "a.ulg", b"".join(parts)))
    first, second = pointed(recording)
    assert first.t_boot_ns == 23_000_000_000
    assert first.q_frame_gimbal == pytest.approx(AHEAD, abs=1e-6)
    assert (first.frame, first.failed, first.gimbal_id) == (GimbalFrame.HEADING, False, 1)
    assert (second.frame, second.failed, second.gimbal_id) == (GimbalFrame.NORTH, True, 1)
    assert recording.losses.dropped_messages == 1


def test_of_a_ground_stations_log(tmp_path: Path) -> None:
    """The autopilot's word has its clock; a gimbal that speaks itself has one of its own, which moves nothing else: it came with
    what the autopilot said last."""
    records = tlog.flight(mavlink2)
    of_pilot, of_gimbal = tlog.writer(mavlink2), tlog.writer(mavlink2, component=154)

    def said(wall_us: int, boot_ms: int, sender: object) -> bytes:
        message = mavlink2.MAVLink_gimbal_device_attitude_status_message(
            0, 0, boot_ms, HEADING, AHEAD, NAN, NAN, NAN, 0, NAN, NAN, 0
        )
        return tlog.stamped(wall_us, message, sender)

    records.insert(25, said(tlog.UNIX_US + 600_000, 60_600, of_pilot))
    records.insert(30, said(tlog.UNIX_US + 700_000, 5, of_gimbal))
    records.insert(35, said(tlog.UNIX_US + 800_000, 9, tlog.writer(mavlink2, system=9, component=154)))
    plain = open_log(tlog.write(tmp_path / "plain.tlog", *tlog.flight(mavlink2)))
    recording = open_log(tlog.write(tmp_path / "a.tlog", *records))
    first, second = pointed(recording)
    assert (first.t_rx_ns, first.t_boot_ns, first.gimbal_id) == (60_600_000_000, 60_600_000_000, 1)
    assert (second.t_rx_ns, second.t_boot_ns, second.t_own_ns, second.gimbal_id) == (60_600_000_000, 0, 5_000_000, 154)
    assert [item for item in recording.events if not isinstance(item[1], GimbalAttitude)] == plain.events
