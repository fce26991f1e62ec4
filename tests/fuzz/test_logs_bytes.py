"""Whatever bytes a log holds: it is read with losses or refused with a LogError, never anything else."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from visloc_companion.adapters.logs.dataflash import read_dataflash
from visloc_companion.adapters.logs.open import open_log
from visloc_companion.adapters.logs.tlog import read_tlog
from visloc_companion.adapters.logs.ulog import read_ulog
from visloc_companion.errors import LogError

READERS = {"tlog": read_tlog, "bin": read_dataflash, "ulg": read_ulog}
STARTS = {"tlog": b"\x00\x05\xaf\x00\x00\x00\x00\x00\xfe", "bin": b"\xa3\x95\x80\x59", "ulg": b"ULog\x01\x12\x35\x01" + bytes(8)}


@pytest.mark.parametrize("kind", list(READERS))
@settings(max_examples=60, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.binary(max_size=600))
def test_noise(tmp_path: Path, kind: str, data: bytes) -> None:
    path = tmp_path / f"noise.{kind}"
    path.write_bytes(STARTS[kind] + data)
    with pytest.raises(LogError):
        READERS[kind](path)


@pytest.mark.shared
@pytest.mark.parametrize("name", ["plane_bench_nofix_2018.tlog", "copter_real_2014.bin", "px4_vtol_bench.ulg"])
@pytest.mark.parametrize("seed", range(3))
def test_a_damaged_real_log_is_read_in_time_order(shared_data: Path, tmp_path: Path, name: str, seed: int) -> None:
    rng = np.random.default_rng(seed)
    whole = np.frombuffer((shared_data / "logs" / name).read_bytes(), dtype=np.uint8).copy()
    whole = whole[: int(len(whole) * rng.uniform(0.3, 0.6))]
    hits = rng.integers(len(whole) // 4, len(whole), 120)
    whole[hits] = rng.integers(0, 256, len(hits), dtype=np.uint8)
    damaged = np.insert(whole, int(rng.integers(len(whole) // 2, len(whole))), rng.integers(0, 256, 999, dtype=np.uint8))
    path = tmp_path / name
    path.write_bytes(damaged.tobytes())
    recording = open_log(path)
    assert len(recording.events) > 100
    assert recording.losses.garbage_pieces + recording.losses.dropped_messages > 0
    times = [t_ns for t_ns, _ in recording.events]
    assert times == sorted(times)
    assert times[-1] - times[0] < 3600 * 10**9
