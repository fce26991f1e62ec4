"""The structure vote over land that has changed since the map was made: half of it felled, ploughed or built on.

    python -m benchmarks.changed_land FOLDER [--seeds 100 101 ...] [--n 12] [--frames 8] [--known 0.3] [--json FILE]

Flights as in benchmarks/structure_chain.py, over the later date (leafless, five years on) with the changes of the scenario
`stale_map` everywhere: 60 % of the parcels are felled, 50 % ploughed, 15 % built on. What the prior of a flight's frames shares
is off by `--known` of the usual sigmas (3 m, 0.9 m in height and 0.9 degrees). Worlds below 105 were for development.
"""

from __future__ import annotations

import argparse
import json
from collections import Counter
from dataclasses import asdict
from pathlib import Path

import numpy as np

from benchmarks.structure_chain import GSD_M, MODEL, SIZE_M, Answer, figures, files_of, flight, structure_vote
from visloc_companion.maps.raster import RasterMap
from visloc_companion.sim.changes import Change, changed
from visloc_companion.sim.landscape import build_landscape
from visloc_companion.sim.render import CameraSimulator
from visloc_companion.sim.rendering.render_effects import CameraEffects
from visloc_companion.sim.scenarios import SCENARIOS
from visloc_companion.sim.scene import Scene

EVERYWHERE_M = 2 * SIZE_M
QUANTILES = (50, 75, 90, 95, 100)


def stale(scene: Scene, seed: int) -> Scene:
    """The scene with the changes of the scenario `stale_map`, everywhere."""
    width, height = scene.size_px
    way = np.array([[0.4 * width, 0.5 * height], [0.6 * width, 0.5 * height]])
    for change in SCENARIOS["stale_map"].changes:
        scene = changed(scene, Change(change.kind, half_width_m=EVERYWHERE_M, share=change.share), way, seed)
    return scene


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--seeds", nargs="+", type=int, default=[100, 101, 102, 103, 104])
    parser.add_argument("--n", type=int, default=12, help="flights over each world")
    parser.add_argument("--frames", type=int, default=8)
    parser.add_argument("--known", type=float, default=0.3, help="share of the usual sigmas that the prior is off by")
    parser.add_argument("--max-probability-wrong", type=float, default=0.05)
    parser.add_argument("--json", type=Path)
    chosen = parser.parse_args()
    answers: list[Answer] = []
    for seed in chosen.seeds:
        reference = RasterMap.open(*files_of(seed, chosen.folder))
        scene = stale(build_landscape(seed, "flight", SIZE_M, GSD_M), seed)
        camera = CameraSimulator(scene, MODEL, CameraEffects())
        for number in range(chosen.n):
            shots = flight(scene, camera, seed, number, chosen.frames, chosen.known)
            answers.append(structure_vote(shots, f"{seed}_{number}", reference, chosen.max_probability_wrong))
            last = answers[-1]
            print(f"{last.case} {last.off_m:.2f} {last.probability_wrong} {last.sigma_m} {last.reason}", flush=True)
    if chosen.json is not None:
        chosen.json.write_text(json.dumps([asdict(a) for a in answers], indent=1), encoding="utf-8")
    off = [a.off_m for a in answers if a.error_m is not None]
    if off:
        print("accepted, m off:", *(f"{q} % {np.percentile(off, q):.2f}" for q in QUANTILES))
    print("refused:", *(f"{reason} {n}" for reason, n in Counter(a.reason.split(":")[0] for a in answers if a.reason).items()))
    print("   n   < 2 m   < 5 m fixes >2 m >5 m  median rms(error/sigma) n e up   in 95 %")
    print(figures(answers).rsplit(" ", 1)[0])


if __name__ == "__main__":
    main()
