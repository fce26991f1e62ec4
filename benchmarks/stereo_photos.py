"""Motion stereo on real photos of a town, where no surface is known: what agrees, and pictures to look at.

    python -m benchmarks.stereo_photos ../shared/data/drone_urban [--report DIR] [--heights FILE]

Photos that follow each other within 70 m are taken three by three, with the poses of `photos.csv` (positions good to about 1.5 m,
the height above ground to 3 %, focal length to 2 %, no lens distortion known). `apart`: median difference of the heights that the
two pairs of a triple give where both see the ground, each on its own but for the middle photo; `after`: after a shift, tilt and
scale. Nothing is tuned on these photos.
"""

from __future__ import annotations

import argparse
import csv
import math
import time
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path

import cv2
import numpy as np

from visloc_companion.geo.camera import R_FRD_CAM
from visloc_companion.geo.se3 import R_from_quat, quat_from_euler
from visloc_companion.geo.wgs84 import ned_from_geo
from visloc_companion.localise.structure.base import LocalCloud, PosedFrame
from visloc_companion.localise.structure.cloud import local_cloud
from visloc_companion.types import CameraModel, FloatArray, GeoPoint, Image

STEP_M = 70.0
CELL_M, PIXEL_M = 1.0, 0.5
COLUMNS, TILE_PX, MARGIN_PX = 6, 220, 18
SIGMA_POSITION_M, SIGMA_ATTITUDE_RAD, SIGMA_HEIGHT_SHARE = 1.5, math.radians(0.7), 0.03
ENU_NED: FloatArray = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])


def photos(folder: Path) -> tuple[list[str], list[PosedFrame], CameraModel]:
    """Names, frames and camera of a folder's `photos.csv`; `local` is about the first photo, up from the ground."""
    with (folder / "photos.csv").open(encoding="utf-8") as source:
        rows = list(csv.DictReader(source))
    first = GeoPoint(float(rows[0]["lat_deg"]), float(rows[0]["lon_deg"]), 0.0)
    names, frames = [], []
    pixels = cv2.imread(str(folder / rows[0]["file"]))
    f, cx, cy = (float(rows[0][k]) for k in ("fx_px", "cx_px", "cy_px"))
    for row in rows:
        pixels = cv2.imread(str(folder / row["file"]))
        n, e, _ = ned_from_geo(GeoPoint(float(row["lat_deg"]), float(row["lon_deg"]), 0.0), first)
        roll, pitch, yaw = (math.radians(float(row[k])) for k in ("roll_deg", "pitch_deg", "yaw_deg"))
        T = np.eye(4)
        T[:3, :3] = ENU_NED @ R_from_quat(quat_from_euler(-roll, pitch + math.pi / 2, yaw)) @ R_FRD_CAM
        T[:3, 3] = e, n, float(row["h_agl_m"])
        sigma = SIGMA_POSITION_M, SIGMA_ATTITUDE_RAD, SIGMA_ATTITUDE_RAD
        names.append(Path(row["file"]).stem)
        frames.append(PosedFrame(np.ascontiguousarray(pixels[:, :, ::-1]), T, *sigma, height_m=float(row["h_agl_m"])))
    return names, frames, CameraModel(pixels.shape[1], pixels.shape[0], f, f, cx, cy)


def differences(a: LocalCloud, b: LocalCloud) -> tuple[float, float, int]:
    """Median difference of two clouds' heights in cells that both have, the same after shift, tilt and scale, and how many."""
    cells: list[dict[tuple[int, int], float]] = []
    for cloud in (a, b):
        keys = np.floor(cloud.points_m[:, :2] / CELL_M).astype(int)
        order = np.argsort(cloud.points_m[:, 2])
        cells.append(dict(zip(map(tuple, keys[order].tolist()), cloud.points_m[order, 2].tolist(), strict=True)))
    common = sorted(cells[0].keys() & cells[1].keys())
    if len(common) < 200:
        return math.nan, math.nan, len(common)
    up = np.array([[c[key] for key in common] for c in cells])
    apart = up[1] - up[0]
    A = np.column_stack([np.ones(len(common)), np.array(common) - np.mean(common, 0), up[0]])
    left, near = apart, np.abs(apart - np.median(apart)) < 3
    for _ in range(4):
        left = apart - A @ np.linalg.lstsq(A[near], apart[near], rcond=None)[0]
        near = np.abs(left) < max(0.3, 4.5 * float(np.median(np.abs(left))))
    return float(np.median(np.abs(apart))), float(np.median(np.abs(left))), len(common)


def drawn(cloud: LocalCloud) -> tuple[Image, Image]:
    """(H, W, 3) BGR heights (2nd to 98th percentile, blue to red) and (H, W) the surface lit from the north-west; north is up,
    PIXEL_M a pixel, black without a point."""
    low = cloud.points_m[:, :2].min(0)
    size = np.ceil((cloud.points_m[:, :2].max(0) - low) / PIXEL_M).astype(int) + 1
    at = ((cloud.points_m[:, :2] - low) / PIXEL_M).astype(int)
    up = np.full(size[::-1], np.nan)
    up[size[1] - 1 - at[:, 1], at[:, 0]] = cloud.points_m[:, 2]
    lowest, highest = np.nanpercentile(up, (2, 98))
    known = np.isfinite(up)
    grey = np.nan_to_num(np.clip((up - lowest) / (highest - lowest), 0, 1) * 255).astype(np.uint8)
    color = np.asarray(cv2.applyColorMap(grey, cv2.COLORMAP_TURBO) * known[:, :, None].astype(np.uint8), dtype=np.uint8)
    slope = np.nan_to_num(up - np.roll(np.roll(up, 1, 0), 1, 1))
    return color, np.clip(128 + 60 * slope, 0, 255).astype(np.uint8) * known.astype(np.uint8)


def picture(path: Path, frame: PosedFrame, cloud: LocalCloud) -> None:
    """The middle photo, heights, and the lit surface."""
    path.parent.mkdir(parents=True, exist_ok=True)
    color, lit = drawn(cloud)
    photo = cv2.resize(frame.pixels[:, :, ::-1], (round(color.shape[1] * 16 / 9), color.shape[0]))
    cv2.imwrite(str(path), np.hstack([photo, color, np.repeat(lit[:, :, None], 3, 2)]))


def sheet(panels: Sequence[tuple[str, Image]]) -> Image:
    """Heights of named clouds side by side, each reduced to a tile of TILE_PX."""
    rows = math.ceil(len(panels) / COLUMNS)
    out = np.full((rows * TILE_PX, COLUMNS * TILE_PX, 3), 255, np.uint8)
    for k, (name, heights) in enumerate(panels):
        share = (TILE_PX - 2 * MARGIN_PX) / max(heights.shape[:2])
        small = cv2.resize(heights, None, fx=share, fy=share, interpolation=cv2.INTER_NEAREST)
        small[(small == 0).all(2)] = 255
        top, left = TILE_PX * (k // COLUMNS) + MARGIN_PX, TILE_PX * (k % COLUMNS) + MARGIN_PX
        out[top : top + small.shape[0], left : left + small.shape[1]] = small
        cv2.putText(out, name, (left, top), cv2.FONT_HERSHEY_SIMPLEX, 0.45, (40, 40, 40), 1, cv2.LINE_AA)
    return out


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--report", type=Path, help="folder for pictures with the photos beside; never publish them")
    parser.add_argument("--heights", type=Path, help="picture of the heights of all clouds, without a photo")
    options = parser.parse_args()
    cv2.setNumThreads(1)
    names, frames, model = photos(options.folder)
    step = [float(np.hypot(*(b.T_local_cam[:2, 3] - a.T_local_cam[:2, 3]))) for a, b in pairwise(frames)]
    print("| photos | base to height | tracks | scatter px | chi2 | matched | points | sigma m | scale | apart m | after m | s |")
    print(f"|{'---|' * 12}")
    panels: list[tuple[str, Image]] = []
    for k in range(len(frames) - 2):
        if max(step[k : k + 2]) > STEP_M:
            continue
        three, name = frames[k : k + 3], f"{names[k][4:]}-{names[k + 2][4:]}"
        started = time.process_time()
        cloud = local_cloud(three, model)
        seconds = time.process_time() - started
        if not isinstance(cloud, LocalCloud):
            print(f"| {name} | refused: {cloud.reason.value} {cloud.detail} |||||||||||", flush=True)
            continue
        pairs = [local_cloud(three[i : i + 2], model) for i in (0, 1)]
        apart, after = math.nan, math.nan
        if isinstance(pairs[0], LocalCloud) and isinstance(pairs[1], LocalCloud):
            apart, after, _ = differences(pairs[0], pairs[1])
        e = dict(cloud.evidence)
        print(
            f"| {name} | {e['base_to_height']:.2f} | {e['good_tracks']:.0f} | {e['scatter_px']:.2f} | {e['chi2']:.2f} | "
            f"{e['completeness']:.0%} | {len(cloud.points_m)} | {e['sigma_m']:.2f} | {cloud.sigma_scale:.3f} | {apart:.2f} | "
            f"{after:.2f} | {seconds:.2f} |",
            flush=True,
        )
        if options.report:
            picture(options.report / f"{name}.png", three[1], cloud)
        panels.append((name, drawn(cloud)[0]))
    if options.heights and panels:
        options.heights.parent.mkdir(parents=True, exist_ok=True)
        cv2.imwrite(str(options.heights), sheet(panels), [cv2.IMWRITE_JPEG_QUALITY, 80])


if __name__ == "__main__":
    main()
