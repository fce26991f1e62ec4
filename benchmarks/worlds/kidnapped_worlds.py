"""Maps and what is flown over them, for `benchmarks.kidnapped`: where the vehicle may be, and worlds without a right answer."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import rasterio
from rasterio.windows import Window

from benchmarks.flown.kidnapped_flight import Way
from benchmarks.image_cases.cases import SHARED
from visloc_companion.geo.wgs84 import geo_from_ned
from visloc_companion.localise.features.onnx import open_features
from visloc_companion.maps.crs import map_crs
from visloc_companion.maps.pack import PackMap
from visloc_companion.prepare.build import build_pack
from visloc_companion.prepare.world import procedural_world
from visloc_companion.sim.render import CameraSimulator
from visloc_companion.sim.rendering.render_effects import CameraEffects
from visloc_companion.sim.scene import Scene
from visloc_companion.types import CameraModel, GeoPoint

SOLVABLE, IMPOSSIBLE = ("procedural", "naip"), ("stranger", "water", "naip-off")
ALLOWED_M = {"procedural": 15.0, "naip": 25.0}
"""How far off a right position may be; where there is no right place, any is wrong."""
WITHIN_S = 30.0
"""A way stays over its part of the scene for so long."""
ORIGIN_OFF_M = 500.0
STRANGERS = (1, 101)
"""Seeds of the landscape that is not on the map: the first that is not the map's own."""
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
    rows: tuple[float, float]
    columns: tuple[float, float]
    flooded: bool = False

    def camera(self) -> CameraSimulator:
        """What takes the frames."""
        water = np.full(self.scene.size_px[::-1], 255, np.uint8) if self.flooded else None
        return CameraSimulator(self.scene, self.model, CameraEffects(), water)


def courses_of(world: str, seed: int, kept: Path | None, scratch: Path) -> list[Course]:
    """The courses of a world, flown in turns. Procedural ones are kept in `kept`, NAIP's packs are made in `scratch`."""
    return naip_courses(scratch, world) if "naip" in world else procedural_courses(world, seed, kept)


def procedural_courses(world: str, seed: int, folder: Path | None) -> list[Course]:
    """The landscape of a seed and its map; `stranger`: the camera's is another landscape; `water`: it sees nothing but waves."""
    home = procedural_world(seed, folder, size_m=4000.0)
    other = STRANGERS[0] if seed != STRANGERS[0] else STRANGERS[1]
    seen = procedural_world(other, folder, size_m=4000.0) if world == "stranger" else home
    pack, scene = PackMap.open(home.pack, verify_hashes=False), Scene.load(seen.flight_ortho, seen.flight_dsm)
    return [Course(pack, scene, MODEL, 120.0, 10.0, (0.05, 0.95), (0.05, 0.95), world == "water")]


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
            courses.append(Course(pack, scene, NAIP_MODEL, height_m, 25.0, rows, columns))
    return courses


def first_rows(ortho: Path, cut: Path) -> Path:
    """A copy of an orthophoto's rows before those that are flown over."""
    with rasterio.open(ortho) as source:
        window = Window(0, 0, source.width, NAIP_FIRST_ROW)
        with rasterio.open(cut, "w", **(source.profile | {"height": NAIP_FIRST_ROW})) as target:
            target.write(source.read(window=window))
    return cut


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
