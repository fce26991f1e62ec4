"""Flights over rendered ground that looks alike in several places: answers as they were, as they are, and with hypotheses.

    python -m benchmarks.look_alike [--kinds blocks periodic ...] [--flights 6] [--frames 12] [--seed 101] [--folder FOLDER]
        [--pictures FOLDER]

A vehicle comes back to where it can see, its position known to SIGMA_M, and flies straight at SPEED_MPS, HEIGHT_M above flat
ground (benchmarks/worlds/look_alike_worlds.py); a frame every STEP_S. Dead reckoning errs by a constant velocity. For each flight
the first fix is judged: `looks`, where a match is believed by its looks alone; `share`, where it is no likelier than its share of
all places (localise/candidates/open_places.py); `tracks`, where hypotheses are carried on (core/places/open_tracks.py). The prior
of a frame does not depend on which, for none of them has had a fix before. With --pictures the frames and the map with the places
that are open.
"""

from __future__ import annotations

import argparse
import math
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import cv2
import numpy as np

from benchmarks.worlds.kidnapped_worlds import MODEL
from benchmarks.worlds.look_alike_worlds import KINDS, Ground, ground_of
from visloc_companion.config import DEFAULT_METHOD
from visloc_companion.core.places.open_tracks import OpenTracks
from visloc_companion.geo.se3 import quat_from_euler
from visloc_companion.geo.wgs84 import distance_m, geo_from_ned, ned_from_geo
from visloc_companion.localise.registry import make_localiser, open_features_for
from visloc_companion.localise.runtime import NetworkChoice
from visloc_companion.localise.verify import left_to_place
from visloc_companion.maps.crs import map_crs
from visloc_companion.protocols import Localiser
from visloc_companion.sim.render import CameraSimulator
from visloc_companion.sim.rendering.render_effects import CameraEffects
from visloc_companion.types import Fix, FrameRef, GeoPoint, Image, LocaliseRequest, NoFix, PosePrior, Vec2

NAMES = ("looks", "share", "tracks")
HEIGHT_M, SPEED_MPS, STEP_S = 60.0, 10.0, 3
SIGMA_M, DRIFT_MPS, START_M = 30.0, 0.5, 200.0
MAX_WRONG, FAR_M, S = 0.05, 10.0, 1_000_000_000


@dataclass(slots=True)
class Flown:
    """The first fix of each name: after s, how far off (m)."""

    first: dict[str, tuple[int, float]] = field(default_factory=dict)

    def note(self, name: str, t_s: int, off_m: float) -> None:
        """Keep the first."""
        self.first.setdefault(name, (t_s, off_m))


def main(argv: Sequence[str] | None = None) -> None:
    """Fly and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--kinds", nargs="+", choices=KINDS, default=KINDS)
    parser.add_argument("--flights", type=int, default=6, help="of each kind")
    parser.add_argument("--frames", type=int, default=12, help="of a flight")
    parser.add_argument("--seed", type=int, default=101, help="of the landscape; below 100 is for training")
    parser.add_argument("--folder", type=Path, help="where the ground is kept")
    parser.add_argument("--pictures", type=Path)
    options = parser.parse_args(argv)
    cv2.setNumThreads(1)
    features = open_features_for(DEFAULT_METHOD, NetworkChoice(threads=1))
    strict, lenient = (
        make_localiser(DEFAULT_METHOD, MODEL, features=features, max_probability_wrong=limit) for limit in (MAX_WRONG, 1.0)
    )
    print("| ground | flights | looks: right | wrong | share: right | wrong | tracks: right | wrong | s: share | tracks |")
    print("|---|---|---|---|---|---|---|---|---|---|")
    with tempfile.TemporaryDirectory() as scratch:
        for kind in options.kinds:
            ground = ground_of(kind, options.seed, options.folder or Path(scratch))
            flights = []
            for number in range(options.flights):
                pictures = options.pictures / f"{kind}-{number}" if options.pictures else None
                flights.append(fly(ground, strict, lenient, number, options.frames, pictures))
            print(row(kind, flights), flush=True)


def row(kind: str, flights: Sequence[Flown]) -> str:
    """A kind as a row of the table; the times are medians of right first fixes."""
    cells = [kind, str(len(flights))]
    for name in NAMES:
        off = [flown.first[name][1] for flown in flights if name in flown.first]
        cells += [str(sum(m <= FAR_M for m in off)), str(sum(m > FAR_M for m in off))]
    for name in NAMES[1:]:
        times = [f.first[name][0] for f in flights if name in f.first and f.first[name][1] <= FAR_M]
        cells.append(f"{np.median(times):.0f}" if times else "–")
    return "| " + " | ".join(cells) + " |"


def fly(ground: Ground, strict: Localiser, lenient: Localiser, number: int, frames: int, pictures: Path | None) -> Flown:
    """One flight; `lenient` believes everything, for the place that a declined match had."""
    rng, crs = np.random.default_rng(number), map_crs(ground.scene.crs)
    east_m, north_m = np.array(ground.scene.center_map) + rng.uniform(-START_M, START_M, 2)
    origin = replace(GeoPoint(*crs.to_geo(float(east_m), float(north_m)), 0.0), h_amsl_m=HEIGHT_M)
    camera = CameraSimulator(ground.scene, MODEL, CameraEffects())
    course, drift, off = rng.uniform(-math.pi, math.pi), rng.normal(0, DRIFT_MPS, 2), rng.normal(0, SIGMA_M, 2)
    v = SPEED_MPS * np.array([math.cos(course), math.sin(course)])
    tracks, flown = OpenTracks(MAX_WRONG), Flown()
    for k in range(frames):
        t_s = k * STEP_S
        for tenth in range(10 * STEP_S):
            tracks.moving((t_s - STEP_S) * S + (tenth + 1) * S // 10, (float(v[0] + drift[0]), float(v[1] + drift[1])))
        truth = geo_from_ned((float(v[0] * t_s), float(v[1] * t_s), 0.0), origin)
        tilt = rng.normal(0, 0.02, 2)
        pixels = camera.frame(truth, quat_from_euler(float(tilt[0]), float(tilt[1]), course), 1000 * number + k)
        ne = v * t_s + off + drift * t_s
        attitude = tilt + rng.normal(0, 0.008, 2)
        q = quat_from_euler(float(attitude[0]), float(attitude[1]), course + float(rng.normal(0, 0.03)))
        sigma_m = math.hypot(SIGMA_M, DRIFT_MPS * t_s)
        believed = replace(geo_from_ned((float(ne[0]), float(ne[1]), 0.0), origin), h_amsl_m=HEIGHT_M + float(rng.normal(0, 1.0)))
        prior = PosePrior(believed, q, ((sigma_m**2, 0.0), (0.0, sigma_m**2)), 3.0, math.radians(5), math.radians(1))
        request = LocaliseRequest(k, FrameRef(t_s * S, t_s * S, k, 0, MODEL.width_px, MODEL.height_px, 3), prior, 1)
        tracks.asked(request)
        answer = strict.localise(request, pixels, ground.pack)
        _judge(flown, tracks, answer, lenient, (request, pixels, ground), truth, origin, t_s)
        if pictures is not None:
            _draw(pictures, k, pixels, ground, answer, truth)
        if len(flown.first) == len(NAMES):
            break
    return flown


def _judge(
    flown: Flown,
    tracks: OpenTracks,
    answer: Fix | NoFix,
    lenient: Localiser,
    asked: tuple[LocaliseRequest, Image, Ground],
    truth: GeoPoint,
    origin: GeoPoint,
    t_s: int,
) -> None:
    if isinstance(answer, Fix):
        for name in NAMES:
            flown.note(name, t_s, distance_m(answer.place, truth))
        return
    told, (request, pixels, ground) = dict(answer.evidence), asked
    of_place = left_to_place(told) if "votes" in told else 0.0
    looks_right = of_place > 0 and (1 - told["p_wrong"]) / of_place >= 1 - MAX_WRONG
    if looks_right and "looks" not in flown.first:
        best = lenient.localise(request, pixels, ground.pack)
        if isinstance(best, Fix):
            flown.note("looks", t_s, distance_m(best.place, truth))
    fix = tracks.answered(answer, origin, DRIFT_MPS)
    if fix is not None:
        flown.note("tracks", t_s, distance_m(fix.place, truth))


def _draw(folder: Path, k: int, pixels: Image, ground: Ground, answer: Fix | NoFix, truth: GeoPoint) -> None:
    """The frame beside the ground about the truth: green where the vehicle is, red what is open, blue a fix."""
    reach_m, gsd_m = 150.0, float(np.hypot(*ground.scene.T_map_pix[:, 0]))
    crs, inverse = map_crs(ground.scene.crs), np.linalg.inv(ground.scene.T_map_pix[:, :2])
    middle = inverse @ (np.array(crs.to_map(truth.lat_deg, truth.lon_deg)) - ground.scene.T_map_pix[:, 2])
    side = round(2 * reach_m / gsd_m)
    crop = cv2.getRectSubPix(ground.scene.pixels, (side, side), (float(middle[0]), float(middle[1])))

    def mark(at: Vec2, colour: tuple[int, int, int], radius: int) -> None:
        cv2.circle(crop, (round(side / 2 + at[1] / gsd_m), round(side / 2 - at[0] / gsd_m)), radius, colour, 3)

    mark((0.0, 0.0), (0, 255, 0), 14)
    places = (
        [(answer.place, 1.0)] if isinstance(answer, Fix) else [(p.place, math.exp(p.log_evidence)) for p in answer.open_places]
    )
    for place, share in places:
        north, east, _ = ned_from_geo(place, truth)
        mark((north, east), (0, 0, 255) if isinstance(answer, Fix) else (255, 0, 0), 4 + round(18 * share))
    frame = cv2.resize(pixels, (round(side * pixels.shape[1] / pixels.shape[0]), side))
    folder.mkdir(parents=True, exist_ok=True)
    cv2.imwrite(str(folder / f"{k:02d}.jpg"), cv2.cvtColor(np.hstack([frame, crop]), cv2.COLOR_RGB2BGR))


if __name__ == "__main__":
    main()
