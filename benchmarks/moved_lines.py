"""Fixes beside a line that has moved since the map was made: the shore of a lake or flood, the border of a field.

    python -m benchmarks.moved_lines FOLDER [--seeds 100 101 ...] [--methods deep gradient iclk] [--moved 0 3 5 10 20]
        [--shares 0.33 0.5 0.67 0.85] [--kinds shore] [--lands ordinary changed] [--json FILE]

A line runs through the procedural landscape, straight or meandering, by its seed. What lies beyond it is water (`shore`, `ebb`:
the water has fallen and left mud) or one smooth field (`field`), on both dates; in the frame the line has moved by so many
metres. `flood`, `shade`: the map has no line, the frame has, and beyond it water or the shade of a cloud. `--shares`: how much of
the frame lies beyond. `changed`: 70 % of the parcels were ploughed anew. Worlds below 100 were for development.
"""

from __future__ import annotations

import argparse
import json
import math
from collections.abc import Iterator
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from visloc_companion.geo.se3 import quat_from_euler
from visloc_companion.geo.wgs84 import geo_from_ned, ned_from_geo
from visloc_companion.localise.registry import make_localiser, open_features_for
from visloc_companion.localise.runtime import NetworkChoice
from visloc_companion.maps.crs import map_crs
from visloc_companion.maps.raster import RasterMap
from visloc_companion.protocols import Localiser, ReferenceMap
from visloc_companion.sim.changes import Change, changed
from visloc_companion.sim.landscape import build_landscape
from visloc_companion.sim.render import CameraSimulator
from visloc_companion.sim.rendering.render_effects import CameraEffects
from visloc_companion.sim.scene import Scene
from visloc_companion.types import CameraModel, Fix, FrameRef, GeoPoint, Image, LocaliseRequest, PosePrior, Quat

MODEL = CameraModel(320, 240, 277.13, 277.13, 159.5, 119.5)
SIZE_M, GSD_M = 700.0, 0.5
METHODS = ("deep", "gradient", "iclk")
KINDS = ("shore", "ebb", "field", "flood", "shade")
LANDS = {"ordinary": 0.0, "changed": 0.7}
"""Share of the parcels that were ploughed anew."""
SIGMA_M, SIGMA_YAW_RAD, SIGMA_H_SHARE, SIGMA_TILT_RAD = 10.0, math.radians(3.0), 0.02, math.radians(0.3)
ALONG_M = 180.0
WATER, MUD, FIELDS = (58, 74, 80), (128, 116, 96), ((128, 134, 84), (140, 122, 92))
SHADE = 0.5
EDGE_M = 0.7
CHI2_99, FAR_M = 9.21, 5.0


@dataclass(frozen=True, slots=True)
class Answer:
    """Of one frame: what was asked, and what came out: errors north and east, `chi2` of both under what the fix claims."""

    method: str
    kind: str
    land: str
    seed: int
    share: float
    moved_m: float
    reason: str
    north_m: float = 0.0
    east_m: float = 0.0
    sigma_m: float = 0.0
    chi2: float = 0.0
    probability_wrong: float = 1.0

    @property
    def off_m(self) -> float:
        """Horizontal distance from the truth."""
        return math.hypot(self.north_m, self.east_m)


@dataclass(frozen=True, slots=True, eq=False)
class Line:
    """Through the middle of a scene, `along` a unit vector (x, y); how far (H, W) each pixel lies beyond it, metres."""

    along: NDArray[np.float64]
    beyond_m: NDArray[np.float32]


def line_of(seed: int, scene: Scene) -> Line:
    """A line of any direction, bent by two waves; one of three is straight."""
    rng = np.random.default_rng((seed, 5))
    angle = rng.uniform(0, 2 * math.pi)
    along, across = np.array([math.cos(angle), math.sin(angle)]), np.array([-math.sin(angle), math.cos(angle)])
    width, height = scene.size_px
    v, u = np.indices((height, width))
    xy = np.stack([u - width / 2, v - height / 2], axis=-1) * GSD_M
    s, bent = xy @ along, 0.0 if seed % 3 == 0 else 1.0
    waves = ((rng.uniform(180, 320), 7.0), (rng.uniform(60, 110), 2.0))
    level = sum(bent * size_m * np.sin(2 * math.pi * s / length_m + rng.uniform(0, 6)) for length_m, size_m in waves)
    return Line(along, np.asarray(xy @ across - level, dtype=np.float32))


def covered(scene: Scene, line: Line, kind: str, moved_m: float, seed: int) -> tuple[Scene, NDArray[np.uint8] | None]:
    """The scene with what lies beyond the line, that has moved towards the land by so much, and (H, W) 255 where it is water."""
    beyond_m = line.beyond_m + np.float32(-moved_m if kind == "ebb" else moved_m)
    share = np.clip(beyond_m / EDGE_M + 0.5, 0, 1)[..., None]
    pixels, dsm = scene.pixels.astype(np.float32), scene.dsm_amsl_m
    if kind == "shade":
        return replace(scene, pixels=_mixed(pixels, pixels * SHADE, share)), None
    level_m = np.float32(np.percentile(dsm, 20))
    flat = np.where(beyond_m > 0, level_m, dsm).astype(np.float32)
    if kind == "field":
        tones = np.array(FIELDS[seed % 2], np.float32) + _grain(seed + round(10 * moved_m), dsm.shape)
        return replace(scene, pixels=_mixed(pixels, tones, share), dsm_amsl_m=flat), None
    if kind == "ebb":
        bared = np.clip(line.beyond_m / EDGE_M + 0.5, 0, 1)[..., None]
        pixels = _mixed(pixels, np.array(MUD, np.float32) + _grain(seed, dsm.shape), bared).astype(np.float32)
        flat = np.where(line.beyond_m > 0, level_m, dsm).astype(np.float32)
    water = np.array(WATER, np.float32) + _grain(seed + 1, dsm.shape)
    return replace(scene, pixels=_mixed(pixels, water, share), dsm_amsl_m=flat), (share[..., 0] * 255).astype(np.uint8)


def mapped(earlier: Scene, line: Line, kind: str, seed: int) -> Scene:
    """What the map shows of the earlier date, with the line where the kind has one then."""
    return earlier if kind in ("flood", "shade") else covered(earlier, line, "shore" if kind == "ebb" else kind, 0.0, seed)[0]


def grown(later: Scene, land: str, seed: int) -> Scene:
    """The later date with what has changed of its parcels."""
    way = np.array([[0.4, 0.5], [0.6, 0.5]]) * later.size_px
    return changed(later, Change("ploughed", half_width_m=2 * SIZE_M, share=LANDS[land]), way, seed)


def over_moved(now: Scene, line: Line, kind: str, moved_m: float, seed: int) -> CameraSimulator:
    """A camera over the later date with the line so far from where the map has it."""
    scene, water = covered(now, line, kind, moved_m, seed + 500)
    return CameraSimulator(scene, MODEL, CameraEffects(), water)


def frames(
    scene: Scene, camera: CameraSimulator, line: Line, seed: int, shares: list[float]
) -> Iterator[tuple[float, GeoPoint, Quat, Image, LocaliseRequest]]:
    """Two frames for each share that lies beyond the line, each with the camera's place and attitude; these and the priors are
    the same wherever the line has moved to."""
    rng = np.random.default_rng((seed, 6))
    crs = map_crs(scene.crs)
    width, height = scene.size_px
    for number, share in enumerate(s for s in shares for _ in range(2)):
        above_m, yaw = rng.uniform(105, 135), rng.uniform(-math.pi, math.pi)
        middle = np.array([width / 2, height / 2]) + line.along * rng.uniform(-ALONG_M, ALONG_M) / GSD_M
        away_m = (0.5 - share) * above_m  # a footprint is about as wide as the camera is high
        away = np.array([line.along[1], -line.along[0]])  # towards the land
        at_line = middle - away * float(line.beyond_m[tuple(np.clip(np.round(middle[::-1]).astype(int), 0, height - 1))]) / -GSD_M
        column, row = at_line + away * away_m / GSD_M
        lat, lon = crs.to_geo(*(scene.T_map_pix @ np.array([column, row, 1.0])))
        near = scene.dsm_amsl_m[max(0, int(row) - 100) : int(row) + 100, max(0, int(column) - 100) : int(column) + 100]
        place = GeoPoint(lat, lon, float(np.median(near)) + above_m)
        roll, pitch = rng.normal(0, math.radians(3), 2)
        attitude = quat_from_euler(roll, pitch, yaw)
        pixels = camera.frame(place, attitude, seed * 1000 + number)
        off = rng.normal(0, 1, 6)
        sigma_h_m = SIGMA_H_SHARE * above_m
        tilt, turn = off[3:5] * SIGMA_TILT_RAD, off[5] * SIGMA_YAW_RAD
        q_prior = quat_from_euler(roll + tilt[0], pitch + tilt[1], yaw + turn)
        cov = ((SIGMA_M**2, 0.0), (0.0, SIGMA_M**2))
        at = geo_from_ned((off[0] * SIGMA_M, off[1] * SIGMA_M, off[2] * sigma_h_m), place)
        prior = PosePrior(at, q_prior, cov, sigma_h_m, SIGMA_YAW_RAD, SIGMA_TILT_RAD)
        frame = FrameRef(0, 0, number, 0, MODEL.width_px, MODEL.height_px, 3)
        yield share, place, attitude, pixels, LocaliseRequest(number, frame, prior, seed)


def answered(
    localiser: Localiser, request: LocaliseRequest, pixels: Image, ref: ReferenceMap, place: GeoPoint
) -> dict[str, float | str]:
    """What a localiser says of a frame, against the truth."""
    fix = localiser.localise(request, pixels, ref)
    if not isinstance(fix, Fix):
        return {"reason": fix.reason.value}
    north, east, _ = ned_from_geo(fix.place, place)
    cov, off = np.array(fix.cov_ne_m2), np.array([north, east])
    chi2, sigma = float(off @ np.linalg.solve(cov, off)), math.sqrt(float(np.linalg.eigvalsh(cov)[-1]))
    return {
        **{"reason": "", "north_m": north, "east_m": east, "sigma_m": sigma, "chi2": chi2},
        "probability_wrong": fix.probability_wrong,
    }


def _mixed(under: NDArray[np.float32], over: NDArray[np.float32], share: NDArray[np.float32]) -> Image:
    return np.asarray(np.clip(under + (over - under) * share, 0, 255), dtype=np.uint8)


def _grain(seed: int, shape: tuple[int, ...]) -> NDArray[np.float32]:
    """(H, W, 1) of a smooth field or water."""
    noise = np.random.default_rng((seed, 7)).standard_normal(shape, dtype=np.float32)
    return np.asarray(cv2.GaussianBlur(noise, (0, 0), 2.0) * np.float32(20.0), dtype=np.float32)[..., None]


def figures(answers: list[Answer]) -> str:
    """Counts and errors of answers that share a row."""
    taken = [a for a in answers if not a.reason]
    text = f"{len(answers):4d} {len(taken):4d}"
    if not taken:
        return text
    off, chi2 = np.array([a.off_m for a in taken]), np.array([a.chi2 for a in taken])
    rms, beyond = math.sqrt(float(chi2.mean()) / 2), int((chi2 > CHI2_99).sum())
    sigma, far = np.median([a.sigma_m for a in taken]), int((off > FAR_M).sum())
    errors = f"{np.median(off):6.2f} {np.percentile(off, 95):6.2f} {off.max():6.2f}"
    return f"{text}  {errors}  {sigma:6.2f}  {rms:5.2f}  {beyond:3d}  {far:3d}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--seeds", nargs="+", type=int, default=list(range(100, 108)))
    parser.add_argument("--methods", nargs="+", choices=METHODS, default=list(METHODS))
    parser.add_argument("--moved", nargs="+", type=float, default=[0.0, 3.0, 5.0, 10.0, 20.0])
    parser.add_argument("--shares", nargs="+", type=float, default=[0.33, 0.5, 0.67, 0.85])
    parser.add_argument("--kinds", nargs="+", choices=KINDS, default=["shore"])
    parser.add_argument("--lands", nargs="+", choices=list(LANDS), default=list(LANDS))
    parser.add_argument("--max-probability-wrong", type=float, default=0.05)
    parser.add_argument("--json", type=Path)
    chosen = parser.parse_args()
    cv2.setNumThreads(1)
    localisers = {}
    for method in chosen.methods:
        features = open_features_for(method, NetworkChoice(threads=1))
        limit = chosen.max_probability_wrong
        localisers[method] = make_localiser(method, MODEL, features=features, max_probability_wrong=limit)
    answers: list[Answer] = []
    for seed in chosen.seeds:
        earlier, later = (build_landscape(seed, date, SIZE_M, GSD_M) for date in ("map", "flight"))
        line = line_of(seed, earlier)
        for kind in chosen.kinds:
            ref = RasterMap.open(*mapped(earlier, line, kind, seed).save(chosen.folder / f"{kind}{seed}"))
            for land in chosen.lands:
                now = grown(later, land, seed)
                for moved_m in chosen.moved:
                    camera = over_moved(now, line, kind, moved_m, seed)
                    for share, place, _, pixels, request in frames(earlier, camera, line, seed, chosen.shares):
                        for method, localiser in localisers.items():
                            what = answered(localiser, request, pixels, ref, place)
                            answers.append(Answer(method, kind, land, seed, share, moved_m, **what))  # type: ignore[arg-type]
        print(f"seed {seed}", flush=True)
    if chosen.json is not None:
        chosen.json.write_text(json.dumps([asdict(a) for a in answers], indent=1), encoding="utf-8")
    print("method   kind  land     moved    n  acc  median    p95    max   sigma  rms(e/s)  beyond99  >5 m")
    for method in chosen.methods:
        for kind in chosen.kinds:
            for land in chosen.lands:
                for moved_m in chosen.moved:
                    row = [a for a in answers if (a.method, a.kind, a.land, a.moved_m) == (method, kind, land, moved_m)]
                    print(f"{method:8} {kind:5} {land:9} {moved_m:4.0f} {figures(row)}")


if __name__ == "__main__":
    main()
