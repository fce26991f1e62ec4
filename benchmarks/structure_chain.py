"""The whole structure vote in flight: frames, cloud, registration, pose; and the image's vote on the same frames.

    python -m benchmarks.structure_chain FOLDER [--seeds 100 101 ...] [--n 10] [--frames 8] [--image deep]
        [--max-probability-wrong 0.05] [--snow] [--elsewhere] [--json FILE]

Over each world `--n` straight flights of `--frames` frames, 0.14 of the height apart, are rendered from the later date (leafless,
ploughed, five years on), 75 to 120 m above the ground at 73.9 degrees, and placed on the earlier date's surface model; FOLDER
keeps that. The prior of all frames of a flight is off by the same amount (10 m horizontally, 3 m in height, 3 degrees of heading,
1-sigma each), and each by 0.3 m and 0.5 degrees of tilt beside. Seeds below 100 and from 200 on were for development.

With `--elsewhere` the map's shape is that of the next of the seeds' worlds: no place is right, and every structure fix is wrong.

A vote is right where its fix is off by less than 5 m. phi is the correlation of the two votes' being right, with the 95 %
interval of a bootstrap over the flights.
"""

from __future__ import annotations

import argparse
import json
import math
import time
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from visloc_companion.evaluate.protection import CHI2_95
from visloc_companion.geo.se3 import quat_from_euler
from visloc_companion.geo.wgs84 import geo_from_ned, ned_from_geo
from visloc_companion.localise.flight import flight_registration
from visloc_companion.localise.registry import make_localiser, open_features_for
from visloc_companion.localise.runtime import NetworkChoice
from visloc_companion.localise.settings import LocaliserSettings
from visloc_companion.localise.structure.localiser import StructureLocaliser
from visloc_companion.maps.around import MAX_POINTS
from visloc_companion.maps.crs import map_crs
from visloc_companion.maps.raster import RasterMap
from visloc_companion.protocols import Localiser
from visloc_companion.sim.land.season import SNOW
from visloc_companion.sim.landscape import build_landscape
from visloc_companion.sim.render import CameraSimulator
from visloc_companion.sim.rendering.render_effects import CameraEffects
from visloc_companion.sim.scene import Scene
from visloc_companion.types import CameraModel, Fix, FloatArray, FrameRef, GeoPoint, Image, LocaliseRequest, NoFix, PosePrior

MODEL = CameraModel(640, 480, 425.5, 425.5, 319.5, 239.5, (-0.05, 0.01, 0.0, 0.0, 0.0))
SIZE_M, GSD_M = 800.0, 0.4
SPACING = 0.14
SIGMA_M, SIGMA_H_M, SIGMA_YAW_RAD, SIGMA_TILT_RAD, SIGMA_EACH_M = 10.0, 3.0, math.radians(3.0), math.radians(0.5), 0.3
SUCCESS_M, FAR_M = 2.0, 5.0
DRAWS = 2000
Truths = NDArray[np.float64]


class Elsewhere(RasterMap):
    """A map whose shape is that of other ground, lifted to where its own lies."""

    _other: RasterMap

    @classmethod
    def over(cls, other: RasterMap, ortho: Path, dsm: Path) -> Elsewhere:
        """The map of these files with the other's shape."""
        made = cls.open(ortho, dsm)
        assert isinstance(made, cls)
        made._other = other
        return made

    def cloud_around(self, center_map_m: tuple[float, float], radius_m: float, max_points: int = MAX_POINTS) -> FloatArray:
        """(N, 3) as RasterMap's."""
        own = super().cloud_around(center_map_m, radius_m, max_points)
        cloud = self._other.cloud_around(center_map_m, radius_m, max_points)
        lift = float(np.median(own[:, 2]) - np.median(cloud[:, 2]))
        return np.asarray(cloud + np.array([0.0, 0.0, lift]), dtype=np.float64)


@dataclass(frozen=True, slots=True, eq=False)
class Shot:
    """A frame, what is asked about it, and the truth."""

    place: GeoPoint
    pixels: Image
    request: LocaliseRequest


@dataclass(frozen=True, slots=True)
class Answer:
    """One vote: error north, east, up (m) with its 1-sigma, or why there is none."""

    vote: str
    case: str
    error_m: tuple[float, float, float] | None
    sigma_m: tuple[float, float, float] | None
    probability_wrong: float | None
    reason: str
    cpu_s: float

    @property
    def off_m(self) -> float:
        """Horizontal error, infinite without an answer."""
        return math.inf if self.error_m is None else math.hypot(*self.error_m[:2])


def flight(scene: Scene, camera: CameraSimulator, seed: int, number: int, frames: int, known: float = 1.0) -> list[Shot]:
    """So many frames in a line over a random place. What their prior shares is off by `known` of the usual sigmas."""
    rng = np.random.default_rng([seed, number, 7])
    above, heading = rng.uniform(75, 120), rng.uniform(-math.pi, math.pi)
    width, height = scene.size_px
    margin = (0.9 * above + frames * SPACING * above / 2) / GSD_M
    column, row = rng.uniform(margin, width - margin), rng.uniform(margin, height - margin)
    half = int(0.4 * above / GSD_M)
    under = scene.dsm_amsl_m[int(row) - half : int(row) + half, int(column) - half : int(column) + half]
    lat, lon = map_crs(scene.crs).to_geo(*(scene.T_map_pix @ np.array([column, row, 1.0])))
    middle = GeoPoint(lat, lon, float(np.median(under)) + above)
    shared = known * np.array([*rng.normal(0, SIGMA_M, 2), rng.normal(0, SIGMA_H_M)])
    turned = known * rng.normal(0, SIGMA_YAW_RAD)
    shots = []
    for k in range(frames):
        along = (k - (frames - 1) / 2) * SPACING * above
        place = geo_from_ned((along * math.cos(heading), along * math.sin(heading), float(rng.normal(0, 0.5))), middle)
        roll, pitch, yaw = (
            rng.normal(0, math.radians(2)),
            rng.normal(0, math.radians(2)),
            heading + rng.normal(0, math.radians(1)),
        )
        pixels = camera.frame(place, quat_from_euler(roll, pitch, yaw), seed * 10_000 + number * 10 + k)
        believed = geo_from_ned(tuple(shared + rng.normal(0, SIGMA_EACH_M, 3)), place)
        tilt = rng.normal(0, SIGMA_TILT_RAD, 2)
        q = quat_from_euler(roll + tilt[0], pitch + tilt[1], yaw + turned)
        cov = (((known * SIGMA_M) ** 2, 0.0), (0.0, (known * SIGMA_M) ** 2))
        prior = PosePrior(believed, q, cov, known * SIGMA_H_M, known * SIGMA_YAW_RAD, SIGMA_TILT_RAD)
        frame = FrameRef(k, (k + 1) * 1_000_000_000, k, 0, MODEL.width_px, MODEL.height_px, 3)
        shots.append(Shot(place, pixels, LocaliseRequest(k, frame, prior, seed)))
    return shots


def judged(vote: str, case: str, shots: list[Shot], answer: Fix | NoFix, cpu_s: float) -> Answer:
    """An answer against the truth of the frame that it is of."""
    if isinstance(answer, NoFix):
        return Answer(vote, case, None, None, None, f"{answer.reason.value}: {answer.detail}", cpu_s)
    error = ned_from_geo(answer.place, shots[answer.frame_id].place)
    (nn, _), (_, ee) = answer.cov_ne_m2
    sigma = (math.sqrt(nn), math.sqrt(ee), answer.sigma_h_m)
    return Answer(vote, case, (error[0], error[1], -error[2]), sigma, answer.probability_wrong, "", cpu_s)


def votes_of(shots: list[Shot], case: str, reference: RasterMap, image: Localiser, most_wrong: float) -> list[Answer]:
    """The image's vote on the last frame, and the structure's."""
    last, start = shots[-1], time.process_time()
    by_image = image.localise(last.request, last.pixels, reference)
    spent = time.process_time() - start
    return [judged("image", case, shots, by_image, spent), structure_vote(shots, case, reference, most_wrong)]


def structure_vote(shots: list[Shot], case: str, reference: RasterMap, most_wrong: float) -> Answer:
    """The structure's vote on the last frame of a flight."""
    structure = StructureLocaliser(MODEL, LocaliserSettings(max_probability_wrong=most_wrong), flight_registration())
    start = time.process_time()
    for shot in shots:
        structure.remember(shot.request, shot.pixels, reference)
    answer = structure.localise(shots[-1].request, shots[-1].pixels, reference)
    return judged("structure", case, shots, answer, time.process_time() - start)


def files_of(seed: int, folder: Path) -> tuple[Path, Path]:
    """Orthophoto and surface model of a world's earlier date, made where they are not there yet."""
    kept = folder / f"map{seed}"
    paths = (kept / "ortho.tif", kept / "dsm.tif")
    return paths if paths[1].exists() else build_landscape(seed, "map", SIZE_M, GSD_M).save(kept)


def figures(answers: list[Answer]) -> str:
    """One line of a vote's figures."""
    found = [a for a in answers if a.error_m is not None]
    off = np.array([a.off_m for a in answers])
    words = [f"{len(answers):4d} {np.mean(off < SUCCESS_M):7.1%} {np.mean(off < FAR_M):7.1%} {len(found):5d}"]
    words.append(f"{sum(a.off_m > SUCCESS_M for a in found):4d} {sum(a.off_m > FAR_M for a in found):4d}")
    words.append(f"{np.median(off[np.isfinite(off)]) if found else math.nan:7.2f}")
    if found:
        ratio = np.array([np.divide(np.array(a.error_m), np.array(a.sigma_m)) for a in found if a.off_m < FAR_M])
        words.append(" ".join(f"{r:5.2f}" for r in np.sqrt((ratio**2).mean(0))))
        words.append(f"{np.mean((ratio[:, :2] ** 2).sum(1) < CHI2_95):6.1%}")
    words.append(f"{1e3 * np.median([a.cpu_s for a in answers]):6.0f}")
    return " ".join(words)


def phi(one: Truths, other: Truths) -> float:
    """Correlation of two votes' being right (Pearson's of two binary variables); 0 where one of them is always the same."""
    spread = float(one.std() * other.std())
    return float(((one - one.mean()) * (other - other.mean())).mean()) / spread if spread > 0 else 0.0


def together(pairs: list[tuple[Answer, Answer]]) -> list[str]:
    """How often image and structure are right together, phi with its interval, and where one was accepted and far off."""
    right = np.array([[a.off_m < FAR_M for a in pair] for pair in pairs], dtype=np.float64)
    lines = []
    for one, other in ((True, True), (True, False), (False, True), (False, False)):
        n = int(((right[:, 0] == one) & (right[:, 1] == other)).sum())
        lines.append(f"image {'right' if one else 'not':5} structure {'right' if other else 'not':5} {n:4d}")
    rng = np.random.default_rng(0)
    drawn = [phi(*right[rng.integers(0, len(right), len(right))].T) for _ in range(DRAWS)]
    low, high = np.percentile(drawn, (2.5, 97.5))
    lines.append(f"phi {phi(*right.T):.2f} ({low:.2f} to {high:.2f})")
    for pair in pairs:
        for wrong, beside in (pair, pair[::-1]):
            if wrong.error_m is not None and wrong.off_m >= FAR_M:
                lines.append(f"{wrong.case}: {wrong.vote} off by {wrong.off_m:.1f} m, {beside.vote} by {beside.off_m:.1f} m")
    return lines


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--seeds", nargs="+", type=int, default=[100, 101, 102, 103, 104])
    parser.add_argument("--n", type=int, default=10, help="flights over each world")
    parser.add_argument("--frames", type=int, default=8, help="of a flight; the worker keeps eight")
    parser.add_argument("--image", default="deep", help="method of the image's vote")
    parser.add_argument("--max-probability-wrong", type=float, default=0.05)
    parser.add_argument("--snow", action="store_true", help="the later date under snow")
    parser.add_argument("--elsewhere", action="store_true", help="the shape of another world")
    parser.add_argument("--json", type=Path)
    chosen = parser.parse_args()
    if chosen.elsewhere and len(chosen.seeds) < 2:
        parser.error("--elsewhere needs two seeds")
    features = open_features_for(chosen.image, NetworkChoice(threads=1))
    image = make_localiser(chosen.image, MODEL, features=features, max_probability_wrong=chosen.max_probability_wrong)
    answers: list[Answer] = []
    for k, seed in enumerate(chosen.seeds):
        reference = RasterMap.open(*files_of(seed, chosen.folder))
        if chosen.elsewhere:
            other = RasterMap.open(*files_of(chosen.seeds[(k + 1) % len(chosen.seeds)], chosen.folder))
            reference = Elsewhere.over(other, *files_of(seed, chosen.folder))
        scene = build_landscape(seed, SNOW if chosen.snow else "flight", SIZE_M, GSD_M)
        camera = CameraSimulator(scene, MODEL, CameraEffects())
        for number in range(chosen.n):
            case = f"{seed}_{number}"
            shots = flight(scene, camera, seed, number, chosen.frames)
            answers += votes_of(shots, case, reference, image, chosen.max_probability_wrong)
            print(*(f"{a.vote} {a.off_m:.2f} {a.reason}" for a in answers[-2:]), sep=" | ", flush=True)
        if chosen.json is not None:
            chosen.json.write_text(json.dumps([asdict(a) for a in answers], indent=1), encoding="utf-8")
    print("vote         n   < 2 m   < 5 m fixes >2 m >5 m  median rms(error/sigma) n e up   in 95 % cpu ms")
    by_vote = {vote: [a for a in answers if a.vote == vote] for vote in ("image", "structure")}
    for vote, given in by_vote.items():
        print(f"{vote:10} {figures(given)}")
    print("\n".join(together(list(zip(by_vote["image"], by_vote["structure"], strict=True)))))


if __name__ == "__main__":
    main()
