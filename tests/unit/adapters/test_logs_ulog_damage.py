"""Expected: a damaged place of a ULog, which has no checksums, costs what it hit and its neighbours, wherever it lies."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tests.unit.adapters.test_logs_ulog import flight, packed, write
from visloc_companion.adapters.logs.open import open_log
from visloc_companion.types import Attitude

SAMPLES, STEP_S = 400, 0.1


def attitudes_s(path: Path) -> list[float]:
    return [t_ns / 1e9 for t_ns, event in open_log(path).events if isinstance(event, Attitude)]


@pytest.mark.parametrize("seed", range(40))
def test_bytes_that_are_missing_cost_no_more_than_they_held(tmp_path: Path, seed: int) -> None:
    """What followed them was read for a message of up to 65 kB, or for one beyond the file's end, which ended the log: of 40
    logs of 40 s one lost 23 s."""
    rng = np.random.default_rng(seed)
    data = bytearray(flight(SAMPLES))
    at = int(rng.integers(len(data) // 10, len(data) * 9 // 10))
    del data[at : at + int(rng.integers(1, 300))]
    times = attitudes_s(write(tmp_path / "a.ulg", bytes(data)))
    assert times[-1] == pytest.approx(20.0 + (SAMPLES - 1) * STEP_S)
    assert max(np.diff(times)) <= 4 * STEP_S + 1e-6


@pytest.mark.parametrize("bit", range(16))
def test_a_bit_of_a_size_costs_a_message(tmp_path: Path, bit: int) -> None:
    data = bytearray(flight(SAMPLES))
    at = data.index(packed("vehicle_status", 40_000_000, 2))
    data[at + bit // 8] ^= 1 << bit % 8
    recording = open_log(write(tmp_path / "a.ulg", bytes(data)))
    times = [t_ns / 1e9 for t_ns, event in recording.events if isinstance(event, Attitude)]
    assert not recording.losses.truncated
    assert recording.losses.garbage_pieces + recording.losses.dropped_messages > 0
    assert len(times) >= SAMPLES - 1


def test_a_log_that_is_cut_off_is_read_up_to_there(tmp_path: Path) -> None:
    whole = flight(SAMPLES)
    recording = open_log(write(tmp_path / "a.ulg", whole[:-7]))
    assert recording.losses.truncated
    assert recording.losses.garbage_pieces == 0
    assert len(attitudes_s(tmp_path / "a.ulg")) == SAMPLES


@pytest.mark.shared
def test_a_real_log_has_no_losses(shared_data: Path) -> None:
    losses = open_log(shared_data / "logs" / "px4_vtol_bench.ulg").losses
    assert (losses.garbage_bytes, losses.unknown_messages, losses.truncated) == (0, 0, False)
