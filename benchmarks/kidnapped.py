"""Kidnapped starts: a vehicle somewhere over a map of two dates, without GNSS and without a first position.

    python -m benchmarks.kidnapped [--trials 20] [--worlds procedural stranger naip naip-off] [--seed 101] [--first 0]
        [--json FILE]

procedural: the landscape of a seed, 4 x 4 km, 120 m above the ground, 10 m/s; the camera sees it five years after the map.
stranger: the same map, but the camera is over the landscape of another seed: there is no right place.
naip: 5 m/px, 2.4 x 3.6 km, all of it searched, the vehicle over rows >= 400; 415 m above the ground (a footprint of 96 px),
25 m/s, map and camera of different years (needs ../shared/data/naip). naip-off: the same flights, a map of the rows < 400 only.

A trial is right when the navigator is anchored within 30 s and not far off (15 m; naip 25 m), and wrong when it is anchored far
off at any time of the flight's 60 s.
"""

from __future__ import annotations

import argparse
import json
import math
import resource
import sys
import tempfile
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import rasterio
from rasterio.windows import Window

from benchmarks.cases import SHARED
from benchmarks.kidnapped_flight import KidnappedFlight, Outcome, Way
from visloc_companion.config import DEFAULT_METHOD
from visloc_companion.geo.wgs84 import geo_from_ned
from visloc_companion.localise.features.onnx import open_features
from visloc_companion.localise.registry import make_localiser, open_features_for
from visloc_companion.localise.runtime import NetworkChoice
from visloc_companion.maps.crs import map_crs
from visloc_companion.maps.pack import PackMap
from visloc_companion.prepare.build import build_pack
from visloc_companion.prepare.world import procedural_world
from visloc_companion.sim.render import CameraSimulator
from visloc_companion.sim.render_effects import CameraEffects
from visloc_companion.sim.scene import Scene
from visloc_companion.types import CameraModel, GeoPoint

WORLDS = ("procedural", "stranger", "naip", "naip-off")
WITHIN_S, LIMIT_S = 30.0, 60.0
ORIGIN_OFF_M = 500.0
STRANGER = 1
"""Seed of the landscape that is not on the map."""
MODEL = CameraModel(320, 240, 277.13, 277.13, 159.5, 119.5, (-0.08, 0.01, 0.0, 0.0, 0.0))
NAIP_MODEL = CameraModel(256, 256, 221.7, 221.7, 127.5, 127.5)
NAIP_MAPS = ("20120731", "20180716")
NAIP_FOOTPRINT_PX, NAIP_GSD_M, NAIP_FIRST_ROW = 96, 5.0, 400


@dataclass(frozen=True, slots=True)
class Course:
    """A map, what the camera sees, how it is flown, and where the vehicle may be: rows and columns of the scene, as shares."""

    pack: PackMap
    scene: Scene
    model: CameraModel
    height_m: float
    speed_mps: float
    allowed_m: float
    rows: tuple[float, float]
    columns: tuple[float, float]


def main() -> None:
    """Fly and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--trials", type=int, default=20, help="of each world")
    parser.add_argument(
        "--worlds", nargs="+", default=["procedural", "naip"], choices=["procedural", "stranger", "naip", "naip-off"]
    )
    parser.add_argument("--seed", type=int, default=101, help="of the procedural landscape; below 100 is for training")
    parser.add_argument("--first", type=int, default=0, help="number of the first trial: another one draws other flights")
    parser.add_argument("--folder", type=Path, help="where procedural worlds are kept")
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    cv2.setNumThreads(1)
    results = {}
    print(f"{HEADER}\n|{'---|' * (HEADER.count('|') - 1)}")
    with tempfile.TemporaryDirectory() as folder:
        for world in options.worlds:
            courses = (
                naip_courses(Path(folder), world) if "naip" in world else procedural_courses(world, options.seed, options.folder)
            )
            outcomes = []
            for number in range(options.first, options.first + options.trials):
                outcomes.append(fly_one(courses[number % len(courses)], number))
                print(world, number, outcomes[-1].line(), file=sys.stderr, flush=True)
            results[world] = summary(outcomes, courses[0].allowed_m)
            print(row(world, results[world]), flush=True)
    if options.json:
        options.json.write_text(json.dumps({"schema": 1, "results": results}, indent=1), encoding="utf-8")


def procedural_courses(world: str, seed: int, folder: Path | None) -> list[Course]:
    """The landscape of a seed and its map; `stranger`: the camera's is another landscape."""
    home = procedural_world(seed, folder, size_m=4000.0)
    seen = procedural_world(STRANGER, folder, size_m=4000.0) if world == "stranger" else home
    pack, scene = PackMap.open(home.pack, verify_hashes=False), Scene.load(seen.flight_ortho, seen.flight_dsm)
    return [Course(pack, scene, MODEL, 120.0, 10.0, 15.0, (0.05, 0.95), (0.05, 0.95))]


def naip_courses(folder: Path, world: str) -> list[Course]:
    """Packs of two years, each flown over with every other year's camera; `naip-off`: without what is flown over."""
    files = sorted((SHARED / "data" / "naip").glob("*.tif"))
    height_m = NAIP_FOOTPRINT_PX * NAIP_GSD_M / 2 / math.tan(math.radians(30))
    margin_px = 0.6 * NAIP_FOOTPRINT_PX
    courses = []
    for year in NAIP_MAPS:
        ortho, home = SHARED / "data" / "naip" / f"{year}.tif", folder / f"{world}-{year}"
        if world == "naip-off":
            ortho = first_rows(ortho, folder / f"{year}.tif")
        build_pack([ortho], None, home, source="USDA NAIP", licence="public domain", networks=[open_features()])
        pack = PackMap.open(home, verify_hashes=False)
        for seen in (file for file in files if file.stem != year):
            scene = Scene.load(seen, None, 0.0)
            width, height = scene.size_px
            rows = (NAIP_FIRST_ROW + margin_px) / height, (height - margin_px) / height
            columns = margin_px / width, (width - margin_px) / width
            courses.append(Course(pack, scene, NAIP_MODEL, height_m, 25.0, 25.0, rows, columns))
    return courses


def first_rows(ortho: Path, cut: Path) -> Path:
    """A copy of an orthophoto's rows before those that are flown over."""
    with rasterio.open(ortho) as source:
        window = Window(0, 0, source.width, NAIP_FIRST_ROW)
        with rasterio.open(cut, "w", **(source.profile | {"height": NAIP_FIRST_ROW})) as target:
            target.write(source.read(window=window))
    return cut


def fly_one(course: Course, number: int) -> Outcome:
    """The flight of a number."""
    features = open_features_for(DEFAULT_METHOD, NetworkChoice(threads=1))
    localiser = make_localiser(DEFAULT_METHOD, course.model, features=features, max_probability_wrong=0.05)
    camera = CameraSimulator(course.scene, course.model, CameraEffects())
    flight = KidnappedFlight(
        way_of(course, np.random.default_rng(number)),
        camera,
        course.model,
        localiser,
        course.pack,
        number,
        far_m=course.height_m,
    )
    return flight.fly(LIMIT_S)


def way_of(course: Course, rng: np.random.Generator) -> Way:
    """A way over the allowed part for WITHIN_S, straight or in a turn, and an EKF origin somewhere about the map's middle."""
    middle = replace(_place(course, 0.5, 0.5), h_amsl_m=_ground(course, 0.5, 0.5))
    off = rng.uniform(-ORIGIN_OFF_M, ORIGIN_OFF_M, 2)
    origin = geo_from_ned((float(off[0]), float(off[1]), 0.0), middle)
    while True:
        column, line = rng.uniform(*course.columns), rng.uniform(*course.rows)
        start = replace(_place(course, column, line), h_amsl_m=_ground(course, column, line) + course.height_m)
        turn = float(rng.choice([0.0, rng.uniform(-0.05, 0.05)]))
        way = Way(start, float(rng.uniform(-math.pi, math.pi)), course.speed_mps, turn, origin)
        if all(_allowed(course, way.at(t_s)[0]) for t_s in (WITHIN_S / 2, WITHIN_S)):
            return way


def _place(course: Course, column: float, line: float) -> GeoPoint:
    """A place of the scene, given as shares of width and height, at height 0."""
    width, height = course.scene.size_px
    lat, lon = map_crs(course.scene.crs).to_geo(*(course.scene.T_map_pix @ np.array([column * width, line * height, 1.0])))
    return GeoPoint(lat, lon, 0.0)


def _ground(course: Course, column: float, line: float) -> float:
    """Height of the surface about a place, given as shares of width and height."""
    heights, (width, height) = course.scene.dsm_amsl_m, course.scene.size_px
    side = 100
    u, v = int(column * width), int(line * height)
    return float(np.median(heights[max(0, v - side) : v + side, max(0, u - side) : u + side]))


def _allowed(course: Course, place: GeoPoint) -> bool:
    width, height = course.scene.size_px
    at = np.array(map_crs(course.scene.crs).to_map(place.lat_deg, place.lon_deg))
    u, v = np.linalg.solve(course.scene.T_map_pix[:, :2], at - course.scene.T_map_pix[:, 2])
    return bool(
        course.columns[0] * width <= u <= course.columns[1] * width and course.rows[0] * height <= v <= course.rows[1] * height
    )


def summary(outcomes: list[Outcome], allowed_m: float) -> dict[str, Any]:
    """Figures of one world's flights."""
    anchored = [o for o in outcomes if o.off_m is not None and o.anchored_s is not None]
    right = [o for o in anchored if o.off_m is not None and o.off_m <= allowed_m]
    times, off = (np.array([getattr(o, name) for o in right], dtype=np.float64) for name in ("anchored_s", "off_m"))
    tiles, tests = (np.array([ms for o in outcomes for ms in getattr(o, name)]) for name in ("tile_ms", "test_ms"))
    return {
        "trials": len(outcomes),
        "right_within_30_s": float(np.mean([o in right and (o.anchored_s or 0.0) <= WITHIN_S for o in outcomes])),
        "right_within_60_s": len(right) / len(outcomes),
        "wrong": len(anchored) - len(right),
        "tests_elsewhere": sum(o.elsewhere for o in outcomes),
        "mistaken": sum(o.mistaken for o in outcomes),
        "anchored_s": {"median": _percentile(times, 50), "p95": _percentile(times, 95)},
        "off_m": {"median": _percentile(off, 50), "max": _percentile(off, 100)},
        "cpu_ms": {"tile": _percentile(tiles, 50), "tile_p95": _percentile(tiles, 95), "test": _percentile(tests, 50)},
        "peak_memory_mb": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024,
    }


def _percentile(values: Any, share: float) -> float | None:
    return float(np.percentile(values, share)) if len(values) else None


def row(world: str, figures: dict[str, Any]) -> str:
    """A world as a row of the table."""
    times, off, cpu = figures["anchored_s"], figures["off_m"], figures["cpu_ms"]
    cells = [
        world,
        str(figures["trials"]),
        f"{100 * figures['right_within_30_s']:.1f} %",
        f"{100 * figures['right_within_60_s']:.1f} %",
        str(figures["wrong"]),
        f"{figures['mistaken']} of {figures['tests_elsewhere']}",
        *(_text(value, 1) for value in (times["median"], times["p95"], off["median"], off["max"])),
        *(_text(value, 0) for value in (cpu["tile"], cpu["tile_p95"], cpu["test"], figures["peak_memory_mb"])),
    ]
    return "| " + " | ".join(cells) + " |"


def _text(value: float | None, digits: int) -> str:
    return "–" if value is None else f"{value:.{digits}f}"


HEADER = (
    "| world | trials | right within 30 s | within 60 s | wrong | tests elsewhere mistaken | anchored after s: median | 95 % | "
    "off by m: median | max | CPU ms a tile: median | 95 % | CPU ms a test | peak memory MB |"
)

if __name__ == "__main__":
    main()
