"""The JSON of a flight against a real simulator: the figures of any flight, and those that only such a one has.

The daemon's part is read from the journals that it left, one for each of its lives; the truth is the simulator's.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from visloc_companion.adapters.logs.truth import TruthRow
from visloc_companion.app.journal import Entry, read_header, read_journal
from visloc_companion.evaluate.gate import Check
from visloc_companion.evaluate.metrics import Interval, flight_summary
from visloc_companion.evaluate.real.real_flight import RealFigures
from visloc_companion.evaluate.record import FlightRecord, from_entries
from visloc_companion.sim.real.clock import EPOCH_NS
from visloc_companion.sim.real.programs import Simulator
from visloc_companion.sim.real.record import RealLog
from visloc_companion.sim.real.scenario import RealScenario

_NS_PER_S = 1_000_000_000


def real_record(log: RealLog, folder: Path) -> FlightRecord:
    """The flight as the daemon saw it, with the truth; `folder` is where its journals are. Without any it has no epochs.

    Raises JournalError for a file that is no journal.
    """
    truth = [TruthRow(EPOCH_NS + round(sample.t_s * _NS_PER_S), sample.true_place) for sample in log.samples]
    return from_entries(_entries(folder), truth)


def real_result(
    log: RealLog,
    scenario: RealScenario,
    simulator: Simulator,
    figures: RealFigures,
    judged: Sequence[Check],
    record: FlightRecord,
) -> dict[str, Any]:
    """What `visloc sim --autopilot` writes: the fields of every flight, beside them those of docs/autopilots.md.

    `pulled_m` is 0 where no false GNSS pulled, `settled_s` null where the autopilot never followed (the check says so).
    """
    settled_s = figures.settled_s if figures.settled_s is None or math.isfinite(figures.settled_s) else None
    return {
        **asdict(figures),
        "settled_s": settled_s,
        **flight_summary(record, gnss_faults_s=_faults_s(log, scenario, record)),
        "scenario": scenario.name,
        "autopilot": "px4" if simulator.is_px4 else "ardupilot",
        "vehicle": "plane" if simulator.is_plane else "copter",
        "seed": scenario.seed,
        "with_daemon": scenario.with_daemon,
        "failsafe": ", ".join(figures.failsafes) or None,
        "pulled_m": figures.pulled_m or 0.0,
        "modes": record.changes(record.modes),
        "verdicts": record.changes(record.verdicts),
        "judged": bool(judged),
        "passed": all(check.passed for check in judged),
        "expected": [asdict(check) for check in judged],
        "version": log.version,
        "marks": log.marks,
        "texts": log.texts,
    }


def _entries(folder: Path) -> Iterator[Entry]:
    for path in sorted(folder.glob("*.mcap"), key=lambda path: read_header(path).started_ns):
        yield from read_journal(path)


def _faults_s(log: RealLog, scenario: RealScenario, record: FlightRecord) -> list[Interval]:
    """When GNSS was bad, seconds since the record's start."""
    began_s = (record.t0_ns - EPOCH_NS) / _NS_PER_S
    starts = [t_s for t_s in (log.at("jam"), log.at("drag")) if t_s is not None]
    if not scenario.gnss_at_boot:
        return [(0.0, record.duration_s)]
    if not starts:
        return []
    back_s = log.at("back")
    return [(min(starts) - began_s, record.duration_s if back_s is None else back_s - began_s)]
