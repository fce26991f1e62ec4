"""Expected: a bit that flips in one time of a DataFlash log, which has no checksums, costs that message alone."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.unit.adapters.test_logs_dataflash import MODERN, formats, message, modern_flight, write
from visloc_companion.adapters.logs.open import open_log
from visloc_companion.types import Attitude, LinkChanged, PriorPose

SAMPLES, AT = 60, 30
"""Ten a second, from 1 s on; the damaged one."""


def times_us(path: Path, kind: type) -> list[int]:
    return [t_ns // 1000 for t_ns, event in open_log(path).events if isinstance(event, kind)]


@pytest.mark.parametrize("ahead_us", [300_000, 524_288, 1_048_576, 1_900_000])
@pytest.mark.parametrize("name", ["ATT", "POS", "GPS"])
def test_a_time_that_is_ahead_carries_nothing_along(tmp_path: Path, name: str, ahead_us: int) -> None:
    """Of what came within that time after it, all had its time, or was left out."""
    data, us = modern_flight(SAMPLES), 1_000_000 + AT * 100_000
    head = message(MODERN, name, us, *[0] * (len(MODERN[name][1]) - 1))[:11]
    assert data.count(head) >= 1
    damaged = data.replace(head, head[:3] + (us + ahead_us).to_bytes(8, "little"), 1)
    path = write(tmp_path / "a.bin", damaged)
    clean = write(tmp_path / "b.bin", data)
    for kind in (Attitude, PriorPose):
        hit = {us} if (kind, name) in ((Attitude, "ATT"), (PriorPose, "POS")) else set()
        assert times_us(path, kind) == [t_us for t_us in times_us(clean, kind) if t_us not in hit]
    losses = open_log(path).losses
    assert (losses.dropped_messages, losses.clock_steps) == (1, 1)


def test_two_times_that_are_wrong_alike_are_no_step_of_the_clock(tmp_path: Path) -> None:
    """The same bit in two messages a second apart: the second seemed to go on from the first, and all behind it was lost."""
    data, bit = modern_flight(SAMPLES), 1 << 31
    for us in (2_000_000, 3_000_000):
        head = message(MODERN, "ATT", us, 0, 0, 0)[:11]
        assert data.count(head) == 1
        data = data.replace(head, head[:3] + (us ^ bit).to_bytes(8, "little"))
    path = write(tmp_path / "a.bin", data)
    assert times_us(path, PriorPose) == times_us(write(tmp_path / "b.bin", modern_flight(SAMPLES)), PriorPose)
    assert len(times_us(path, Attitude)) == SAMPLES - 2


def test_gaps_late_messages_and_the_last_one_cost_nothing(tmp_path: Path) -> None:
    """Nothing is logged for half a second, and then something that is 0.1 s late; the log ends behind another gap."""
    att = [message(MODERN, "ATT", us, 0, 0, 0) for us in (1_000_000, 1_500_000, 1_400_000, 1_600_000, 2_400_000)]
    path = write(tmp_path / "a.bin", formats(MODERN) + b"".join(att))
    assert times_us(path, Attitude) == [1_000_000, 1_500_000, 1_500_000, 1_600_000, 2_400_000]
    assert open_log(path).losses.dropped_messages == 0


def test_an_arming_counts_whatever_its_time(tmp_path: Path) -> None:
    data, event = modern_flight(), message(MODERN, "EV", 2_000_000, 10)
    assert event in data
    path = write(tmp_path / "a.bin", data.replace(event, message(MODERN, "EV", 2_500_000, 10)))
    assert [event.armed for _, event in open_log(path).events if isinstance(event, LinkChanged)] == [False, True]


def test_the_clock_goes_on_behind_hours_without_a_log(tmp_path: Path) -> None:
    hours_us = 3 * 3_600_000_000
    later = [message(MODERN, "ATT", hours_us + k * 100_000, 0, 0, 0) for k in range(60)]
    stray = message(MODERN, "ATT", hours_us + 40 * 100_000 + 524_288, 0, 0, 0)
    path = write(tmp_path / "a.bin", modern_flight(2) + b"".join([*later[:40], stray, *later[41:]]))
    assert times_us(path, Attitude)[-20:] == [hours_us + k * 100_000 for k in (39, *range(41, 60))]
