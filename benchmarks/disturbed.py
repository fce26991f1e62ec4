"""The daemon's processes are disturbed while it flies: `python -m benchmarks.disturbed [--seed N] [--scenario NAME] [--out DIR]`.

The demonstration's two processes in real time over its world, GNSS jammed for 18 minutes (`long_jam`). Every 6 to 18 s something
happens that the seed draws: the localising process is killed, or stopped for up to 8 s; the daemon itself is stopped for up to
3 s; its link is sent packets of noise, or noise that begins as a MAVLink packet does; a hundred clients hold its status socket;
four processes compute for 8 s beside it.

Prints what was done, how far off positions were that were sent, how many were beyond their protection level, the longest silence
(a stopped daemon is silent), and memory and open files of the daemon and its localising process over the flight. Ends with 1
where a position was beyond its level, files are left open, or the daemon was silent for 1 s longer than it was stopped.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
from pathlib import Path

import numpy as np

from benchmarks.flown.disturbances import KINDS, Disturber, Taken
from visloc_companion.app.journal import read_journal
from visloc_companion.config import DEFAULT_METHOD
from visloc_companion.evaluate.closed_loop import FlightWorld
from visloc_companion.evaluate.demonstration.demo_processes import fly_processes, journal_of, require_ours
from visloc_companion.evaluate.expected import error_over_level
from visloc_companion.evaluate.metrics import error_figures
from visloc_companion.evaluate.record import FlightRecord, from_entries
from visloc_companion.localise.registry import open_features_for
from visloc_companion.localise.runtime import NetworkChoice
from visloc_companion.maps.pack import PackMap
from visloc_companion.prepare.world import procedural_world
from visloc_companion.sim.scenarios import FLIGHTS
from visloc_companion.sim.scene import Scene
from visloc_companion.sim.setup import FlightSetup
from visloc_companion.types import AutopilotKind

SILENT_MORE_S = 1.0
"""A stopped daemon has to come back, hear the autopilot, and see a frame."""


def main() -> None:
    """Fly, disturb, judge, print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, default=7)
    parser.add_argument("--scenario", choices=list(FLIGHTS), default="long_jam")
    parser.add_argument("--dialect", type=AutopilotKind, default=AutopilotKind.ARDUPILOT)
    parser.add_argument("--kinds", nargs="*", choices=list(KINDS), default=list(KINDS))
    parser.add_argument("--out", type=Path)
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        out = args.out or Path(folder)
        out.mkdir(parents=True, exist_ok=True)
        disturber = Disturber(args.seed, args.kinds)
        record = flown(out, args.scenario, args.dialect, args.seed, disturber)
    print("\n".join(figures(record, disturber)))
    sys.exit(not held(record, disturber))


def flown(out: Path, scenario: str, dialect: AutopilotKind, seed: int, disturber: Disturber) -> FlightRecord:
    """The flight by both processes, as its journal tells it, beside the truth. Raises LinkError where a process ended early,
    ConfigError where `out` holds somebody else's journals."""
    require_ours(out)
    network = open_features_for(DEFAULT_METHOD, NetworkChoice(threads=2))
    files = procedural_world(1, networks=[network] if network else None)
    world = FlightWorld(files.pack, PackMap.open(files.pack), Scene.load(files.flight_ortho, files.flight_dsm))
    setup = FlightSetup(FLIGHTS[scenario], world.area(), dialect, "copter", seed)
    log = fly_processes(out, setup, files, 1.0, print, disturber)
    (out / "disturbed.json").write_text(json.dumps(disturber.as_json(), indent=1), encoding="utf-8")
    return from_entries(read_journal(journal_of(out)), log.truth, t0_ns=log.truth[0].t_ns)


def held(record: FlightRecord, disturber: Disturber) -> bool:
    """Whether nothing that the flight must not show was seen."""
    first, last = disturber.daemon[0], disturber.daemon[-1]
    return beyond(record) == 0 and last.files <= first.files and silence_s(record) <= disturber.longest_stop_s + SILENT_MORE_S


def beyond(record: FlightRecord) -> int:
    """Epochs in which a position was sent that was further off than its protection level."""
    return int((record.error_m > record.protection_level_m)[record.injected].sum())


def silence_s(record: FlightRecord) -> float:
    """Longest time between two positions that were sent, seconds. A daemon that was stopped goes on WAITING, which
    `metrics.injection_figures` takes for a pause that was meant."""
    return float(np.diff(record.injection_t_s).max(initial=0.0))


def figures(record: FlightRecord, disturber: Disturber) -> list[str]:
    """What is printed."""
    sent = record.injected
    error, level_m = error_figures(record, sent), np.median(record.protection_level_m[sent])
    counts = ", ".join(f"{kind} {disturber.done.count(kind)}" for kind in KINDS if kind in disturber.done)
    return [
        f"{len(disturber.done)} disturbances: {counts}",
        f"{sent.sum()} epochs sent: error {error['median']:.2f} m median, {error['p95']:.2f} m (95 %), "
        f"{error['max']:.1f} m at most; {beyond(record)} beyond the level ({level_m:.1f} m median), "
        f"error over level {error_over_level(record, sent):.2f} at most",
        f"longest silence {silence_s(record):.1f} s, the daemon was stopped for {disturber.longest_stop_s:.1f} s at most",
        f"daemon: {_course(disturber.daemon)}",
        f"localising process: {_course(disturber.worker)} (killed ones begin anew)",
    ]


def _course(taken: list[Taken]) -> str:
    memory = [one.resident_mib for one in taken]
    files = [one.files for one in taken]
    thirds = [memory[len(memory) * k // 3] for k in range(3)] + memory[-1:]
    course = " → ".join(f"{mib:.0f}" for mib in thirds)
    return f"resident {course} MiB, {max(memory):.0f} at most; {min(files)} to {max(files)} files"


if __name__ == "__main__":
    main()
