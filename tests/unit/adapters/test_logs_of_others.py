"""Files that are taken for logs and are none that is read: what they are is said, whatever their name."""

from __future__ import annotations

from pathlib import Path

import pytest

from visloc_companion.adapters.logs.open import open_log
from visloc_companion.adapters.mavlink.dialect import mav
from visloc_companion.errors import LogError
from visloc_companion.types import Attitude

FORMATS = b"FMT, 128, 89, FMT, BBnNZ, Type,Length,Name,Format,Columns\n"


def packets(n: int, *, version: int = 2) -> list[bytes]:
    link = mav.MAVLink(None, 1, 1)
    heartbeat = mav.MAVLink_heartbeat_message(2, 3, 81, 0, 4, 3)
    attitudes = [mav.MAVLink_attitude_message(100 * k, 0.0, 0.0, 0.1, 0.0, 0.0, 0.0) for k in range(1, n)]
    return [message.pack(link, force_mavlink1=version == 1) for message in (heartbeat, *attitudes)]


@pytest.mark.parametrize("name", ["flight.log", "flight.bin", "flight.tlog"])
@pytest.mark.parametrize(
    ("data", "said"),
    [
        (50 * FORMATS, "is a text that was made of a .bin; remedy: replay the .bin itself"),
        (b"ULogEnc\1" + bytes(500), "is encrypted; remedy: decrypt it"),
        (b"#ROSBAG V2.0\n" + bytes(4000), "is a ROS bag; remedy: replay the autopilot's own log"),
        (b"".join(packets(20)), "without the times at which they came; remedy: replay the .tlog"),
        (b"".join(packets(20, version=1)), "without the times at which they came; remedy: replay the .tlog"),
    ],
)
def test_what_it_is_is_said(tmp_path: Path, name: str, data: bytes, said: str) -> None:
    (tmp_path / name).write_bytes(data)
    with pytest.raises(LogError, match=said):
        open_log(tmp_path / name)


@pytest.mark.parametrize("version", [1, 2])
def test_a_telemetry_log_that_was_cut_before_a_packet_is_read(tmp_path: Path, version: int) -> None:
    stamped = [(1_700_000_000_000_000 + 10**5 * k).to_bytes(8, "big") + p for k, p in enumerate(packets(20, version=version))]
    (tmp_path / "a.tlog").write_bytes(b"".join([stamped[0], *stamped])[8:])
    assert sum(isinstance(event, Attitude) for _, event in open_log(tmp_path / "a.tlog").events) == 19
