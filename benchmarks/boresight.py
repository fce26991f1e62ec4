"""Whether a camera that is mounted otherwise than configured is found in flight, and what it is worth when GNSS is lost.

    python -m benchmarks.boresight [--seconds 210] [--jam 180] [--rate 1] [--method gradient] [--seed 1]
        [--cases ...] [--json FILE]

Copter over the procedural world (camera and map of different dates) with the real localiser; GNSS is good until `jam`. Cases:
the mount as configured, off by 2 degrees of roll, of pitch, by 3 of heading, and as configured with GNSS off by 4 m east and 3 m
south all the time, which must not be taken for a tilt.

learned: roll, pitch, heading in use at the jam. error: of the filter's position, horizontally, median of 30 s before the mounting
was learned first (or from 10 s on) and of the time from the jam on.
"""

from __future__ import annotations

import argparse
import json
import math
from pathlib import Path
from typing import Any

import numpy as np

from visloc_companion.evaluate.closed_loop import FlightWorld, FlownScenario, eyes_over, fly_with
from visloc_companion.maps.pack import PackMap
from visloc_companion.prepare.world import procedural_world
from visloc_companion.sim import faults
from visloc_companion.sim.faults import FaultSchedule
from visloc_companion.sim.flight import CLOCK_OFFSET_NS
from visloc_companion.sim.scenarios.base import Scenario
from visloc_companion.sim.scene import Scene
from visloc_companion.sim.setup import FlightSetup
from visloc_companion.types import AutopilotKind, Notice

TWO, THREE = math.radians(2.0), math.radians(3.0)
CASES: dict[str, FaultSchedule] = {
    "as configured": FaultSchedule(),
    "roll 2°": faults.these(faults.MountError(roll_rad=TWO)),
    "pitch 2°": faults.these(faults.MountError(pitch_rad=TWO)),
    "heading 3°": faults.these(faults.MountError(yaw_rad=THREE)),
    "GNSS off by 5 m": faults.step_spoof(0.0, (-3.0, 4.0, 0.0)),
}
FIRST_S, SPAN_S = 10.0, 30.0
NONE = {"roll_deg": 0.0, "pitch_deg": 0.0, "heading_deg": 0.0}


def row_of(name: str, flown: FlownScenario, jam_s: float) -> dict[str, Any]:
    """Figures of a flight."""
    learned = [
        ((entry.now_ns - CLOCK_OFFSET_NS) * 1e-9, dict(entry.command.data))
        for entry in flown.log.entries
        if isinstance(entry.command, Notice) and entry.command.text == "camera's mounting learned"
    ]
    before = [(t_s, data) for t_s, data in learned if t_s < jam_s]
    first_s = before[0][0] if before else FIRST_S + SPAN_S
    t_s, error = flown.record.t_s, flown.record.error_m
    return {
        "case": name,
        "first_s": before[0][0] if before else None,
        **(before[-1][1] if before else NONE),
        "before_m": _median(error[(t_s >= max(FIRST_S, first_s - SPAN_S)) & (t_s < first_s)]),
        "after_m": _median(error[t_s >= jam_s]),
    }


def _median(values: np.ndarray) -> float | None:
    known = values[np.isfinite(values)]
    return float(np.median(known)) if len(known) else None


def line(row: dict[str, Any]) -> str:
    """Markdown."""
    when = "never" if row["first_s"] is None else f"{row['first_s']:.0f} s"
    turned = ", ".join(f"{row[name]:.1f}°" for name in ("roll_deg", "pitch_deg", "heading_deg"))
    errors = (("none" if row[name] is None else f"{row[name]:.2f} m") for name in ("before_m", "after_m"))
    return f"| {row['case']} | {when} | {turned} | {' | '.join(errors)} |"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=210.0)
    parser.add_argument("--jam", type=float, default=180.0)
    parser.add_argument("--rate", type=float, default=1.0, help="frames a second")
    parser.add_argument("--method", default="gradient")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--cases", nargs="+", default=list(CASES), choices=list(CASES))
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    kept = procedural_world(1)
    world = FlightWorld(kept.pack, PackMap.open(kept.pack), Scene.load(kept.flight_ortho, kept.flight_dsm))
    rows = []
    print("| mount | learned first after | roll, pitch, heading | error before | error without GNSS |\n|---|---|---|---|---|")
    for name in options.cases:
        what = faults.jam(options.jam) + CASES[name]
        scenario = Scenario(name, name, options.seconds, what, frame_rate_hz=options.rate, pictures=True)
        setup = FlightSetup(scenario, world.area(), AutopilotKind.ARDUPILOT, "copter", options.seed, structure=False)
        rows.append(row_of(name, fly_with(setup, eyes_over(setup, world, options.method)), options.jam))
        print(line(rows[-1]), flush=True)
    if options.json:
        options.json.write_text(json.dumps({"schema": 1, "rows": rows}, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
