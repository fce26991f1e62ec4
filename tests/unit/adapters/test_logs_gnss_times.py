"""Calendar time in the autopilots' own logs: a receiver whose time jumps is told as in flight."""

from __future__ import annotations

import struct
from pathlib import Path

import pytest

from tests.unit.adapters import test_logs_dataflash as bin_log
from tests.unit.adapters import test_logs_ulog as ulog
from visloc_companion.adapters.logs.gnss_times import gnss_times, unix_minus_boot_ns
from visloc_companion.adapters.logs.open import open_log
from visloc_companion.core.satellites.gnss_clock import GnssClock
from visloc_companion.types import GnssTime

S = 1_000_000_000


def clock_after(events: list[GnssTime]) -> GnssClock:
    clock = GnssClock()
    for event in events:
        clock.on_time(event)
    return clock


def test_a_ulogs_receiver_tells_the_time_once_a_second(tmp_path: Path) -> None:
    recording = open_log(ulog.write(tmp_path / "a.ulg", ulog.flight()))
    found = [(t_ns, event) for t_ns, event in recording.events if isinstance(event, GnssTime)]
    assert [t_ns for t_ns, _ in found] == [20 * S, 21 * S, 22 * S]
    assert [(e.t_rx_ns, e.t_boot_ns, e.t_unix_ns) for _, e in found][1] == (21 * S, 0, 1_600_000_021 * S)
    assert clock_after([event for _, event in found]).jump_s == 0.0


def test_a_ulog_whose_receivers_time_jumps_tells_of_it(tmp_path: Path) -> None:
    data = ulog.flight()
    for k in range(15, 30):
        us = 20_000_000 + 100_000 * k
        row = struct.pack("<QQ", us, 1_600_000_000_000_000 + us)
        assert row in data
        data = data.replace(row, struct.pack("<QQ", us, 1_600_000_007_000_000 + us))
    recording = open_log(ulog.write(tmp_path / "a.ulg", data))
    clock = clock_after([event for _, event in recording.events if isinstance(event, GnssTime)])
    assert clock.jump_s == pytest.approx(7.0)
    assert clock.signs(recording.events[-1][0]) == ("clock_jump",)


def test_a_dataflash_logs_receiver_tells_the_time(tmp_path: Path) -> None:
    """GPS weeks and milliseconds, with the leap seconds off."""
    recording = open_log(bin_log.write(tmp_path / "a.bin", bin_log.modern_flight()))
    found = [event for _, event in recording.events if isinstance(event, GnssTime)]
    assert [event.t_rx_ns for event in found] == [1 * S, 2 * S]
    week_start_unix_s = 315_964_800 + 2200 * 604_800 - 18
    assert [event.t_unix_ns for event in found] == [(week_start_unix_s + 3600 + k) * S for k in range(2)]


@pytest.mark.parametrize("at", [0, 7, 19])
def test_a_damaged_time_is_no_jump(at: int) -> None:
    told = [(k * S, 100 * S) for k in range(20)]
    told[at] = (at * S, 900 * S)
    clock = clock_after([event for _, event in gnss_times(told) if isinstance(event, GnssTime)])
    assert (clock.jump_s, unix_minus_boot_ns(told)) == (0.0, 100 * S)


def test_no_time_and_one_time_are_none_and_one() -> None:
    assert (gnss_times([]), unix_minus_boot_ns([])) == ([], None)
    assert gnss_times([(5 * S, 3)]) == [(5 * S, GnssTime(5 * S, 0, 5 * S + 3))]


def test_a_recorded_flight_has_no_jump(shared_data: Path) -> None:
    """A copter of 2014, whose log was once 0.8 s late."""
    recording = open_log(shared_data / "logs" / "copter_real_2014.bin")
    found = [event for _, event in recording.events if isinstance(event, GnssTime)]
    assert len(found) > 300
    assert clock_after(found).jump_s == 0.0
