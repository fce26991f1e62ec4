"""One frame at a time against several together: `python -m benchmarks.joint [--n N] [--rows 400:] [--method gradient|deep]`.

Sequences are cut from NAIP: the camera sees one date, the map is another. A camera of 60 degrees looks straight down so that it
covers 173 map pixels, and flies straight on; frames overlap by 60 to 80 %. The first frame's prior is off by up to
20 px in each axis, 20 degrees and 25 % of the height; the others' follow from it by the odometry, whose steps are off by
`--odometry` (share of their length, each axis), its turns by 0.3 degrees (1 sigma, each axis). Every answer counts.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import pyproj
from numpy.typing import NDArray

from benchmarks.image_cases.cases import SHARED, maker
from visloc_companion.geo.camera import R_FRD_CAM
from visloc_companion.geo.se3 import R_from_quat, quat_from_euler
from visloc_companion.geo.wgs84 import geo_from_ned, ned_from_geo
from visloc_companion.localise.answer import Stopwatch
from visloc_companion.localise.candidates.pyramid import view
from visloc_companion.localise.features.base import Features
from visloc_companion.localise.features.gradient import GRADIENT
from visloc_companion.localise.iclk import aligned
from visloc_companion.localise.joint import JointFrame, JointResult, RelativePose, joint_alignment
from visloc_companion.localise.ortho_rectify import CameraPose
from visloc_companion.localise.plan import SearchPlan, make_plan
from visloc_companion.localise.settings import LocaliserSettings
from visloc_companion.maps.raster import RasterMap
from visloc_companion.types import CameraModel, GeoPoint, PosePrior

FOOT_PX = 173.0
OFFSET_PX, HEADING_DEG, HEIGHT_SHARE = 20.0, 20.0, 0.25
TURN_SIGMA_RAD = math.radians(0.3)
SIGMA_TILT_RAD = math.radians(0.3)
WRONG_PX = 5.0


@dataclass(frozen=True)
class Sequence:
    """Frames with their priors, odometry, true places (N) and the map."""

    frames: list[JointFrame]
    odometry: list[RelativePose]
    truth: list[GeoPoint]
    map_file: Path


def main() -> None:
    """Cut the sequences, align them both ways, print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--n", type=int, default=60)
    parser.add_argument("--rows", default="400:", help="rows of the map in which the cameras are")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--odometry", type=float, default=0.03)
    parser.add_argument("--method", choices=("gradient", "deep"), default="gradient")
    args = parser.parse_args()
    cv2.setNumThreads(1)
    features = GRADIENT if args.method == "gradient" else shipped_features()
    model = camera()
    rng = np.random.default_rng(args.seed)
    errors: dict[int, list[tuple[float, float]]] = {}
    maps: dict[Path, RasterMap] = {}
    for sequence in sequences(rng, args.n, args.rows, args.odometry):
        ref = maps.setdefault(sequence.map_file, RasterMap.open(sequence.map_file, None))
        alone, together = single(sequence, model, ref, features), joint(sequence, model, ref, features)
        errors.setdefault(len(sequence.frames), []).extend(zip(alone, together, strict=True))
    print("| frames | n | < 5 px alone | together | mean px alone | together | mean of the right alone | together |")
    print("|" + "---|" * 8)
    for count, px in sorted(errors.items()):
        print(table_row(str(count), np.array(px)))
    print(table_row("all", np.concatenate([np.array(px) for px in errors.values()])))


def table_row(name: str, px: NDArray[np.float64]) -> str:
    """Figures of (N, 2) errors in map pixels, alone and together."""
    right = px < WRONG_PX
    shares = [f"{100 * share:.1f} %" for share in right.mean(0)]
    means = [f"{mean:.2f}" for mean in px.mean(0)]
    of_right = [f"{px[right[:, k], k].mean():.2f}" for k in range(2)]
    return "| " + " | ".join([name, str(len(px)), *shares, *means, *of_right]) + " |"


def shipped_features() -> Features:
    """The shipped network's."""
    from visloc_companion.localise.features.onnx import open_features

    return open_features()


def camera() -> CameraModel:
    """The tool's camera."""
    tool = maker()
    return CameraModel(tool.FRAME_PX, tool.FRAME_PX, tool.FOCAL_PX, tool.FOCAL_PX, tool.CENTRE_PX, tool.CENTRE_PX)


def sequences(rng: np.random.Generator, n: int, rows: str, odometry: float) -> Iterator[Sequence]:
    """So many sequences whose cameras lie within the rows."""
    files = sorted((SHARED / "data" / "naip").glob("*.tif"))
    images = [maker().read(file) for file in files]
    first, last = (int(x) if x else None for x in rows.split(":"))
    margin = 0.62 * FOOT_PX * (1 + HEIGHT_SHARE) / 1.2
    done = 0
    while done < n:
        seen, there = rng.choice(len(files), 2, replace=False)
        ortho, transform, crs = images[there]
        count, step_px = int(rng.integers(3, 6)), FOOT_PX * (1 - rng.uniform(0.6, 0.8))
        course = rng.uniform(0, 2 * math.pi)
        start = np.array([rng.uniform(margin, ortho.shape[1] - margin), rng.uniform(first or 0, last or ortho.shape[0])])
        at = start + np.arange(count)[:, None] * step_px * np.array([math.sin(course), -math.cos(course)])
        low, high = np.array([margin, max(margin, first or 0)]), np.array(ortho.shape[1::-1]) - margin
        if (at < low).any() or (at > np.minimum(high, [np.inf, last or np.inf])).any():
            continue
        done += 1
        yield _flown(rng, images[seen][0], at, course, (files[there], transform, crs), odometry)


def _flown(
    rng: np.random.Generator,
    scene: NDArray[np.uint8],
    at_pix: NDArray[np.float64],
    course: float,
    there: tuple[Path, object, object],
    odometry: float,
) -> Sequence:
    tool = maker()
    map_file, transform, crs = there
    to_geo = pyproj.Transformer.from_crs(crs, 4326, always_xy=True)
    lonlat = [to_geo.transform(*(transform * tuple(p + 0.5))) for p in at_pix]
    nominal_m = FOOT_PX * transform.a / 2 / math.tan(math.radians(30))
    height_m = nominal_m * (1 + rng.uniform(-HEIGHT_SHARE, HEIGHT_SHARE))
    yaw = course + math.radians(rng.uniform(-10, 10))
    home = GeoPoint(lonlat[0][1], lonlat[0][0], 0.0)
    poses, truth, pixels = [], [], []
    for pix, (lon, lat) in zip(at_pix, lonlat, strict=True):
        h, heading = height_m * (1 + rng.uniform(-0.02, 0.02)), yaw + math.radians(rng.normal(0, 1))
        truth.append(GeoPoint(lat, lon, h))
        north, east, _ = ned_from_geo(GeoPoint(lat, lon, 0.0), home)
        poses.append(CameraPose(np.array([north, east, -h]), R_from_quat(quat_from_euler(0.0, 0.0, heading)) @ R_FRD_CAM))
        M = tool.pix_per_metre(transform, crs, lat, lon)
        frame, _ = tool.render(scene, pix, M, h, tool.R_ned_frd(math.degrees(heading), 0.0, 0.0))
        noisy = frame * rng.uniform(0.8, 1.2) + rng.normal(0, 3, frame.shape)
        pixels.append(np.clip(noisy, 0, 255).astype(np.uint8))
    steps = [_measured(rng, k, poses[k], poses[k + 1], odometry) for k in range(len(poses) - 1)]
    offset = np.append(rng.uniform(-OFFSET_PX, OFFSET_PX, 2) * transform.a, height_m - nominal_m)
    turn = R_from_quat(quat_from_euler(0.0, 0.0, math.radians(rng.uniform(-HEADING_DEG, HEADING_DEG))))
    believed = [CameraPose(poses[0].p_ned_m + offset, turn @ poses[0].R_ned_cam)]
    for step in steps:
        last = believed[-1]
        believed.append(CameraPose(last.p_ned_m + last.R_ned_cam @ step.p_first_m, last.R_ned_cam @ step.R_first_second))
    frames = [
        JointFrame(image, _prior(rng, pose, home, transform.a, nominal_m)) for image, pose in zip(pixels, believed, strict=True)
    ]
    return Sequence(frames, steps, truth, map_file)


def _measured(rng: np.random.Generator, k: int, first: CameraPose, second: CameraPose, share: float) -> RelativePose:
    """Odometry from one frame to the next with its noise, and the covariance of that."""
    p = first.R_ned_cam.T @ (second.p_ned_m - first.p_ned_m)
    R = first.R_ned_cam.T @ second.R_ned_cam
    sigma_m = share * float(np.linalg.norm(p))
    wrong = cv2.Rodrigues(rng.normal(0, TURN_SIGMA_RAD, 3))[0]
    covariance = np.diag([sigma_m**2] * 3 + [TURN_SIGMA_RAD**2] * 3)
    return RelativePose(k, k + 1, p + rng.normal(0, sigma_m, 3), wrong @ R, covariance)


def _prior(rng: np.random.Generator, pose: CameraPose, home: GeoPoint, gsd_m: float, nominal_m: float) -> PosePrior:
    """The prior of a frame: roll and pitch come from the autopilot for each, the rest was carried on by odometry."""
    heading = math.atan2(pose.R_ned_cam[1, 0], pose.R_ned_cam[0, 0]) - math.pi / 2
    tilt = rng.normal(0, SIGMA_TILT_RAD, 2)
    sigma_m = OFFSET_PX * gsd_m / 3**0.5
    return PosePrior(
        geo_from_ned((float(pose.p_ned_m[0]), float(pose.p_ned_m[1]), float(pose.p_ned_m[2])), home),
        quat_from_euler(float(tilt[0]), float(tilt[1]), heading),
        ((sigma_m**2, 0.0), (0.0, sigma_m**2)),
        HEIGHT_SHARE * nominal_m / 3**0.5,
        math.radians(HEADING_DEG) / 3**0.5,
        SIGMA_TILT_RAD,
    )


def single(sequence: Sequence, model: CameraModel, ref: RasterMap, features: Features) -> list[float]:
    """Errors (map pixels) of each frame aligned on its own; where it finds nothing, that of its prior."""
    errors = []
    for frame, truth in zip(sequence.frames, sequence.truth, strict=True):
        plan = make_plan(frame.prior, model, ref, LocaliserSettings())
        if not isinstance(plan, SearchPlan):
            raise SystemExit(f"a frame cannot be planned for: {plan[1]}")
        found = aligned(view(frame.pixels, model, plan, frame.prior, plan.frame), ref, features, Stopwatch())
        pose = found.end.pose if found else plan.pose
        errors.append(_error_px(plan.frame.origin, pose, truth, ref.gsd_m))
    return errors


def joint(sequence: Sequence, model: CameraModel, ref: RasterMap, features: Features) -> list[float]:
    """The same of all frames aligned together."""
    result = joint_alignment(sequence.frames, sequence.odometry, model, ref, features)
    if not isinstance(result, JointResult):
        raise SystemExit(f"the frames cannot be aligned: {result[1]}")
    origin = result.local.origin
    return [_error_px(origin, p.pose, truth, ref.gsd_m) for p, truth in zip(result.poses, sequence.truth, strict=True)]


def _error_px(origin: GeoPoint, pose: CameraPose, truth: GeoPoint, gsd_m: float) -> float:
    north, east, _ = ned_from_geo(GeoPoint(truth.lat_deg, truth.lon_deg, 0.0), origin)
    return float(np.hypot(pose.p_ned_m[0] - north, pose.p_ned_m[1] - east)) / gsd_m


if __name__ == "__main__":
    main()
