"""Expected: a log of ArduPilot's own tells of GNSS and pressures what it would have sent over MAVLink."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.unit.adapters.test_logs_dataflash import MODERN, OLD, formats, message, write
from visloc_companion.adapters.logs.open import open_log
from visloc_companion.core.settings import CoreSettings
from visloc_companion.evaluate.flight import replay_recording
from visloc_companion.types import Baro, Event, Gnss, LinkChanged, Status

TABLE = {
    "ATT": MODERN["ATT"],
    "GPS": MODERN["GPS"],
    "GPA": (30, "QBCCCC", "TimeUS,I,VDop,HAcc,VAcc,SAcc"),
    "BARO": (31, "QBffc", "TimeUS,I,Alt,Press,Temp"),
    "ARSP": (32, "QBffc", "TimeUS,I,Airspeed,DiffPress,Temp"),
}


def gps(us: int, receiver: int, lat_e7: int, status: int = 3) -> bytes:
    moving = (54_000, 10.0, 90.0, -0.1, 0.0)
    return message(TABLE, "GPS", us, receiver, status, 3_600_000 + us // 1000, 2200, 15, 80, lat_e7, 85_500_000, *moving)


def events(path: Path, *messages: bytes) -> list[Event]:
    return [event for _, event in open_log(write(path, formats(TABLE) + b"".join(messages))).events]


def test_both_receivers_are_read_and_no_more(tmp_path: Path) -> None:
    messages = [gps(1_000_000 + 200_000 * k, receiver, 474_000_000 + receiver) for k in range(3) for receiver in (0, 1, 2)]
    read = [event for event in events(tmp_path / "a.bin", *messages) if isinstance(event, Gnss)]
    assert [(event.receiver, round(event.place.lat_deg * 1e7)) for event in read] == [(0, 474_000_000), (1, 474_000_001)] * 3


@pytest.mark.parametrize(("name", "kind", "n"), [(b"GPS_TYPE2", 14, 1), (b"GPS2_TYPE", 14, 1), (b"GPS2_TYPE", 1, 2)])
def test_what_a_companion_plays_is_no_second_receiver(tmp_path: Path, name: bytes, kind: int, n: int) -> None:
    """visloc itself may, with injection.output = "gps_input": held against it, each spoofed receiver would be found out."""
    table = TABLE | {"PARM": (34, "QNf", "TimeUS,Name,Value")}
    data = formats(table) + message(table, "PARM", 900_000, name, kind)
    data += gps(1_000_000, 0, 474_000_000) + gps(1_000_000, 1, 474_000_000)
    recording = open_log(write(tmp_path / "a.bin", data))
    assert [e.receiver for _, e in recording.events if isinstance(e, Gnss)] == [0, 1][:n]


@pytest.mark.parametrize(("name", "kind", "n"), [(b"GPS_TYPE", 14, 1), (b"GPS1_TYPE", 14, 1), (b"GPS1_TYPE", 1, 0)])
def test_a_first_receiver_that_a_companion_plays_is_told(tmp_path: Path, name: bytes, kind: int, n: int) -> None:
    """It may be another companion's, and is all that there is; if it was visloc's, a replay judges its own positions."""
    table = TABLE | {"PARM": (34, "QNf", "TimeUS,Name,Value")}
    data = formats(table) + message(table, "PARM", 900_000, name, kind) + gps(1_000_000, 0, 474_000_000)
    recording = open_log(write(tmp_path / "a.bin", data))
    assert [e.receiver for _, e in recording.events if isinstance(e, Gnss)] == [0]
    assert sum("plays by GPS_INPUT" in note for note in recording.notes) == n


def test_the_second_receiver_of_an_older_log_has_a_message_of_its_own(tmp_path: Path) -> None:
    table = {"ATT": OLD["ATT"], "GPS": OLD["GPS"], "GPS2": (40, *OLD["GPS"][1:])}
    values = (3, 3_600_000, 2200, 15, 80, 474_000_000, 85_500_000, 0, 54_000, 1000, 9000, -0.1, 1000)
    data = formats(table) + message(table, "GPS", *values) + message(table, "GPS2", *values)
    read = [event for _, event in open_log(write(tmp_path / "a.bin", data)).events if isinstance(event, Gnss)]
    assert [event.receiver for event in read] == [0, 1]


def test_a_receiver_has_the_accuracy_that_it_states(tmp_path: Path) -> None:
    messages = [
        gps(1_000_000, 0, 474_000_000),
        message(TABLE, "GPA", 1_000_000, 0, 150, 1230, 1870, 50),
        message(TABLE, "GPA", 1_000_000, 1, 150, 90, 0, 50),
        gps(1_200_000, 0, 474_000_000),
        gps(1_200_000, 1, 474_000_000),
        message(TABLE, "ATT", 2_500_000, 0, 0, 0),
        gps(4_000_000, 0, 474_000_000),
    ]
    read = [event for event in events(tmp_path / "a.bin", *messages) if isinstance(event, Gnss)]
    assert [(event.h_acc_m, event.v_acc_m) for event in read] == [
        (None, None), (pytest.approx(12.3), pytest.approx(18.7)), (pytest.approx(0.9), None), (None, None)
    ], "unknown before the first, where it is 0, and where it is old"  # fmt: skip


def test_pressures_are_in_hectopascals_with_that_of_the_airspeed_sensor(tmp_path: Path) -> None:
    messages = [
        message(TABLE, "BARO", 1_000_000, 0, 0.0, 95_432.1, 2150),
        message(TABLE, "ARSP", 1_050_000, 0, 20.0, 245.0, 2150),
        message(TABLE, "ARSP", 1_050_000, 1, 20.0, 999.0, 2150),
        message(TABLE, "BARO", 1_100_000, 0, 0.0, 95_400.0, 2150),
        message(TABLE, "BARO", 1_100_000, 1, 0.0, 11_111.0, 2150),
        message(TABLE, "ATT", 2_500_000, 0, 0, 0),
        message(TABLE, "BARO", 4_000_000, 0, 0.0, 95_300.0, 2150),
    ]
    read = [event for event in events(tmp_path / "a.bin", *messages) if isinstance(event, Baro)]
    assert [(round(event.pressure_hpa, 2), event.dynamic_hpa) for event in read] == [
        (954.32, 0.0), (954.0, pytest.approx(2.45)), (953.0, 0.0)
    ]  # fmt: skip
    assert read[0].temperature_c == pytest.approx(21.5)


def test_a_receiver_that_is_led_astray_is_told_by_the_other(tmp_path: Path) -> None:
    """The first is dragged 100 m to the north after 20 s; the second stays."""
    parts = []
    for k in range(400):
        us, drag_e7 = 1_000_000 + 100_000 * k, 9_000 if k >= 200 else 0
        parts.append(message(TABLE, "ATT", us, 0, 0, 0))
        parts += [gps(us, 0, 474_000_000 + drag_e7), gps(us, 1, 474_000_000)] if k % 2 == 0 else []
    recording = open_log(write(tmp_path / "a.bin", formats(TABLE) + b"".join(parts)))
    replayed = replay_recording(recording.events, CoreSettings())
    told = {
        reason
        for entry in replayed
        if isinstance(entry.command, Status) and entry.now_ns > 25_000_000_000
        for reason in entry.command.reasons
    }
    assert "receivers_differ" in told


@pytest.mark.parametrize("both", [False, True])
def test_a_plane_is_armed_by_a_message_of_its_own(tmp_path: Path, both: bool) -> None:
    table = TABLE | {"ARM": (33, "QBI", "TimeUS,ArmState,ArmChecks"), "EV": MODERN["EV"]}
    parts = [message(table, "ATT", us, 0, 0, 0) for us in range(1_000_000, 2_000_000, 100_000)]
    for at, state, event in ((8, 0, 11), (4, 1, 10)):
        parts[at:at] = [message(table, "ARM", 0, state, 1), *([message(table, "EV", 0, event)] if both else [])]
    recording = open_log(write(tmp_path / "a.bin", formats(table) + b"".join(parts)))
    links = [(event.t_rx_ns, event.armed) for _, event in recording.events if isinstance(event, LinkChanged)]
    assert links == [(1_000_000_000, False), (1_300_000_000, True), (1_700_000_000, False)]
