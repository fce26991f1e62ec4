"""The benchmark of the navigator flies what it says: jammed, injecting, with fixes, and the replay reads all of it."""

from __future__ import annotations

import math
from pathlib import Path

from benchmarks.navigator import CONFIGURATION, baseline_s, flown, replayed_s, table, written
from visloc_companion.app.journal import read_journal
from visloc_companion.app.settings import core_settings
from visloc_companion.config import parse_config
from visloc_companion.types import Fix, Injection, Mode, Status, Verdict


def test_the_flight_injects_on_fixes_and_is_replayed(tmp_path: Path) -> None:
    settings = core_settings(parse_config(CONFIGURATION))
    entries, cost = flown(75.0, settings)
    statuses = [entry.command for entry in entries if isinstance(entry.command, Status)]
    assert statuses[-1].mode is Mode.AIDING
    assert sum(isinstance(entry.command, Injection) for entry in entries) > 100
    assert {fix.method for fix in (e.event for e in entries) if isinstance(fix, Fix)} == {"deep", "structure"}
    assert cost.n == sum(entry.event is not None for entry in entries) > 100 * 75
    assert cost.mean_s > 0
    path = written(entries, tmp_path)
    assert list(read_journal(path)) == entries
    assert replayed_s(path, settings) > 0
    lines = list(table(cost, 75.0, baseline_s()))
    assert lines[-1].startswith("| all |")
    assert any(line.startswith("| Tick | 10.0 |") for line in lines)


def test_beside_a_good_gnss_nothing_is_injected() -> None:
    entries, _ = flown(75.0, core_settings(parse_config(CONFIGURATION)), jammed_s=math.inf)
    statuses = [entry.command for entry in entries if isinstance(entry.command, Status)]
    assert (statuses[-1].mode, statuses[-1].verdict) == (Mode.SHADOW, Verdict.OK)
    assert not any(isinstance(entry.command, Injection) for entry in entries)
    assert sum(isinstance(entry.event, Fix) for entry in entries) > 200
