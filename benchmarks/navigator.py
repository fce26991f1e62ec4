"""What the navigator costs: `python -m benchmarks.navigator [--minutes 10] [--good-gnss] [--gate] [--profile N]`.

A flight of so many minutes, GNSS jammed for all but the first or (`--good-gnss`) for none of them
(benchmarks/flown/navigator_flight.py), is flown once event by event and then replayed from its journal. CPU time, as ratios to a
fixed piece of work in the same run (prediction and update of a filter of four states in plain numpy), because absolute times
depend on the machine and on who else uses it. `--profile` names the functions that take the most time, `--gate` ends with 1 where
the mean is above 0.3 ms per event or an hour's replay above 20 s.
"""

from __future__ import annotations

import argparse
import cProfile
import math
import pstats
import sys
import tempfile
import time
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks.flown.navigator_flight import JAMMED_S, Answers, events
from visloc_companion.app.journal import Entry, JournalHeader, JournalWriter, read_journal
from visloc_companion.app.replay import replay
from visloc_companion.app.settings import core_settings
from visloc_companion.cli.read_once import read_once
from visloc_companion.config import parse_config
from visloc_companion.core.navigator import Navigator
from visloc_companion.core.settings import CoreSettings
from visloc_companion.types import Event

CONFIGURATION = {"injection": {"switch_source": True}, "localiser": {"odometry": True}}
LIMIT_EVENT_MS, LIMIT_REPLAY_S = 0.3, 20.0
BASELINE_EVERY_NS = 10_000_000_000
BASELINE_REPEATS = 20
MAX_BYTES = 10**10


@dataclass(slots=True)
class Cost:
    """CPU seconds of each kind of event, and of the fixed piece of work each time it was measured."""

    by_kind: defaultdict[str, list[float]]
    baseline: list[float]

    @property
    def mean_s(self) -> float:
        """Of one event."""
        return sum(sum(values) for values in self.by_kind.values()) / self.n

    @property
    def n(self) -> int:
        """Events."""
        return sum(len(values) for values in self.by_kind.values())


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--minutes", type=float, default=10.0)
    parser.add_argument("--good-gnss", action="store_true", help="GNSS is never jammed, and all fixes are held against it")
    parser.add_argument("--gate", action="store_true")
    parser.add_argument("--profile", type=int, default=0, metavar="N", help="the N functions that take the most time")
    options = parser.parse_args()
    settings = core_settings(parse_config(CONFIGURATION))
    profiler = cProfile.Profile() if options.profile else None
    jammed_s = math.inf if options.good_gnss else JAMMED_S
    entries, cost = flown(60 * options.minutes, settings, profiler, jammed_s)
    if profiler is not None:
        pstats.Stats(profiler).sort_stats("tottime").print_stats(options.profile)
        return
    with tempfile.TemporaryDirectory() as folder:
        replay_s = 60 / options.minutes * replayed_s(written(entries, Path(folder)), settings)
    base_s = float(np.median(cost.baseline))
    print(f"{cost.n} events; the fixed piece of work takes {1e3 * base_s:.4f} ms\n")
    print("\n".join(table(cost, 60 * options.minutes, base_s)))
    print(f"\nreplay of an hour from its journal: {replay_s:.0f} s, {replay_s / base_s:.0f} times the fixed piece of work")
    if options.gate and (1e3 * cost.mean_s > LIMIT_EVENT_MS or replay_s > LIMIT_REPLAY_S):
        sys.exit(1)


def table(cost: Cost, seconds: float, base_s: float) -> Iterator[str]:
    """Lines of the table."""
    yield "| event | a second | mean ms (CPU) | ratio | 99 % ms | share |"
    yield "|---|---|---|---|---|---|"
    total_s = cost.mean_s * cost.n
    for kind, values in sorted(cost.by_kind.items(), key=lambda item: -sum(item[1])):
        mean_s, rate = float(np.mean(values)), len(values) / seconds
        figures = f"{1e3 * mean_s:.3f} | {mean_s / base_s:.1f} | {1e3 * np.percentile(values, 99):.3f}"
        yield f"| {kind} | {rate:.1f} | {figures} | {100 * sum(values) / total_s:.0f} % |"
    yield f"| all | {cost.n / seconds:.0f} | {1e3 * cost.mean_s:.3f} | {cost.mean_s / base_s:.1f} | | |"


def flown(
    seconds: float, settings: CoreSettings, profiler: cProfile.Profile | None = None, jammed_s: float = JAMMED_S
) -> tuple[list[Entry], Cost]:
    """The flight as the daemon would journal it, and what it cost; GNSS is jammed from a time on."""
    navigator, answers = Navigator(settings), Answers()
    entries: list[Entry] = []
    cost, reading_s = Cost(defaultdict(list), []), clock_s()
    measured_ns = -BASELINE_EVERY_NS

    def take(event: Event, now_ns: int) -> None:
        if profiler is not None:
            profiler.enable()
        begun = time.process_time()
        commands = navigator.on(event, now_ns)
        cost.by_kind[type(event).__name__].append(max(0.0, time.process_time() - begun - reading_s))
        if profiler is not None:
            profiler.disable()
        entries.append(Entry(now_ns, event, None))
        entries.extend(Entry(now_ns, None, command) for command in commands)
        answers.ask(now_ns, commands)

    for now_ns, event in events(seconds, jammed_s):
        for at_ns, answer in answers.until(now_ns):
            take(answer, at_ns)
        take(event, now_ns)
        if now_ns - measured_ns >= BASELINE_EVERY_NS:
            measured_ns = now_ns
            cost.baseline.append(baseline_s())
    return entries, cost


def written(entries: list[Entry], folder: Path) -> Path:
    """The journal of a flight."""
    writer = JournalWriter.create(folder, JournalHeader(CONFIGURATION), max_bytes=MAX_BYTES)
    for entry in entries:
        writer.entry(entry)
        writer.wait(4000)  # the daemon never writes so fast
    writer.close()
    if writer.path is None:
        raise RuntimeError("the journal was not written")
    return writer.path


def replayed_s(path: Path, settings: CoreSettings) -> float:
    """CPU seconds of reading a journal and giving its events to a navigator, as the command `replay` does."""
    with read_once():
        begun = time.process_time()
        for _ in replay(read_journal(path, commands=False), settings):
            pass
        return time.process_time() - begun


def clock_s() -> float:
    """CPU seconds that reading the clock takes: more than some events do."""
    begun = time.process_time()
    for _ in range(1000):
        time.process_time()
    return (time.process_time() - begun) / 1000


def baseline_s() -> float:
    """CPU seconds of one prediction and one update of a filter of four states (Joseph's form)."""
    x, P, Q, R = np.zeros(4), np.eye(4), 0.01 * np.eye(4), np.eye(2)
    F, H, z = np.eye(4) + 0.1 * np.eye(4, k=2), np.eye(2, 4), np.array([0.1, -0.1])
    begun = time.process_time()
    for _ in range(BASELINE_REPEATS):
        x, P = F @ x, F @ P @ F.T + Q
        K = np.linalg.solve(H @ P @ H.T + R, H @ P).T
        keep = np.eye(4) - K @ H
        x, P = x + K @ (z - H @ x), keep @ P @ keep.T + K @ R @ K.T
    return (time.process_time() - begun) / BASELINE_REPEATS


if __name__ == "__main__":
    main()
