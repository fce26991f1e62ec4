"""The dense search's hypotheses: heading x scale templates, the region of the nadir, and peaks back to poses."""

from __future__ import annotations

import math

import cv2
import numpy as np
from numpy.typing import NDArray

from visloc_companion.localise.candidates.frame_features import FrameFeatures, SearchedFeatures, plane_raster
from visloc_companion.localise.features.base import Float32Array
from visloc_companion.localise.ortho_rectify import CameraPose, MapGrid
from visloc_companion.localise.plan import SIGMAS, SearchPlan, turned
from visloc_companion.localise.pose import to_view
from visloc_companion.localise.search import Peak, ScoreVolume, Template, find_peaks, search
from visloc_companion.types import FloatArray

LATTICE = 61
"""Places along each axis of the prior's ellipse by which it is told how much of it is searched."""


def hypotheses(plan: SearchPlan) -> list[tuple[float, float]]:
    """All (heading, scale) pairs."""
    return [(float(h), float(s)) for h in plan.headings_rad for s in plan.scales]


def arms_to_view(plan: SearchPlan) -> FloatArray:
    """(K, 2) metres north, east from the nadir to the ground that the camera's axis meets, for each hypothesis."""
    arm = to_view(plan.pose, plan.ground_up_m)[:2]
    return np.array([scale * _turn(heading) @ arm for heading, scale in hypotheses(plan)])


def footprint_box(plan: SearchPlan, headings_rad: FloatArray, scale: float) -> tuple[FloatArray, FloatArray]:
    """Smallest box (low, high; metres north, east about the nadir) that holds the nadir and the turned, scaled footprints."""
    c, s = np.cos(headings_rad)[:, None], np.sin(headings_rad)[:, None]
    n, e = plan.footprint_ne_m[:, 0], plan.footprint_ne_m[:, 1]
    corners = scale * np.stack([c * n - s * e, s * n + c * e], -1).reshape(-1, 2)
    return np.minimum(corners.min(0), 0.0), np.maximum(corners.max(0), 0.0)


def search_box(plan: SearchPlan) -> tuple[FloatArray, FloatArray]:
    """Box (low, high; metres north, east of the local origin) of the map that the search may look at."""
    low, high = footprint_box(plan, plan.headings_rad, float(plan.scales.max()))
    half = plan.region_half_m
    return plan.pose.p_ned_m[:2] + low - half, plan.pose.p_ned_m[:2] + high + half


def search_window(
    grid: MapGrid, frame: SearchedFeatures, plan: SearchPlan, zero_mean: bool = False, threads: int = 1
) -> ScoreVolume:
    """Exhaustive search over the plan's region on a map window."""
    frame.compute_all()
    pairs = hypotheses(plan)
    linear = grid.A_ne_pix[:, :2]
    inverse = np.linalg.inv(linear)
    low, high = footprint_box(plan, plan.headings_rad, float(plan.scales.max()))
    corners = np.array([[a, b] for a in (low[0], high[0]) for b in (low[1], high[1])]) @ inverse.T
    extent = [int(x) for x in (*(np.floor(corners.min(0)) - 1), *(np.ceil(corners.max(0)) + 1))]
    centre = inverse @ (plan.pose.p_ned_m[:2] - grid.A_ne_pix[:, 2])
    reach = np.abs(inverse) @ plan.region_half_m
    size = grid.weight.shape[::-1]
    looked_at = np.array([inverse @ _turn(heading) @ plan.looked_at_ne_m for heading in plan.headings_rad])
    first, last = [], []
    for k in range(2):
        first.append(max(math.floor(centre[k] - reach[k]), math.floor(-looked_at[:, k].max())))
        last.append(max(first[k], min(math.ceil(centre[k] + reach[k]), math.ceil(size[k] - looked_at[:, k].min()))))
    return search(
        grid.features,
        grid.weight,
        lambda k: make_template(frame, plan, linear, *pairs[k]),
        len(pairs),
        (first[0], first[1], last[0], last[1]),
        (extent[0], extent[1], extent[2], extent[3]),
        zero_mean,
        threads,
    )


def make_template(frame: FrameFeatures, plan: SearchPlan, linear: FloatArray, heading_rad: float, scale: float) -> Template:
    """The frame rectified over a plane for one hypothesis, on the map's axes with the nadir on a pixel."""
    pose = CameraPose(np.array([0.0, 0.0, -plan.ground_up_m - plan.agl_m * scale]), turned(plan.pose.R_ned_cam, heading_rad))
    A_ne_pix, size = plane_raster(plan, linear, heading_rad, scale)
    first = np.rint(np.linalg.solve(linear, A_ne_pix[:, 2])).astype(int)
    return Template(*frame.on_plane(pose, A_ne_pix, size, plan.ground_up_m), (int(first[0]), int(first[1])))


def peaks_in_region(volume: ScoreVolume, grid: MapGrid, plan: SearchPlan, count: int, radius_px: float) -> list[Peak]:
    """The best peaks within the prior's 3-sigma ellipse."""
    return find_peaks(volume, region(volume, grid, plan), radius_px, count)


def region(volume: ScoreVolume, grid: MapGrid, plan: SearchPlan) -> NDArray[np.bool_]:
    """Mask of a volume's positions within the prior's 3-sigma ellipse, and no further than the prior says."""
    height, width = volume.score.shape
    u, v = np.arange(width) + volume.origin_px[0], np.arange(height)[:, None] + volume.origin_px[1]
    A = grid.A_ne_pix
    n = A[0, 0] * u + A[0, 1] * v + A[0, 2] - plan.pose.p_ned_m[0]
    e = A[1, 0] * u + A[1, 1] * v + A[1, 2] - plan.pose.p_ned_m[1]
    W = np.linalg.inv(plan.cov_ne_m2)
    inside = W[0, 0] * n * n + 2 * W[0, 1] * n * e + W[1, 1] * e * e <= SIGMAS**2
    inside &= np.maximum(np.abs(n), np.abs(e)) <= plan.within_m
    return np.asarray(inside & (n * n + e * e <= plan.radius_cap_m**2), dtype=np.bool_)


def unsearched(plan: SearchPlan, most_side_m: float) -> float:
    """Probability by the prior, within its 3-sigma ellipse, of the places that are left out: those beyond the radius that the
    settings allow, and whose view lies beyond a window of the map of so much a side."""
    at = np.linspace(-SIGMAS, SIGMAS, LATTICE)
    x, y = (a.ravel() for a in np.meshgrid(at, at))
    squared = x * x + y * y
    share = np.where(squared <= SIGMAS**2, np.exp(-squared / 2), 0.0)
    variances, axes = np.linalg.eigh(plan.cov_ne_m2)
    off_m = np.column_stack([x, y]) * np.sqrt(np.maximum(variances, 0.0)) @ axes.T
    seen = np.hypot(off_m[:, 0], off_m[:, 1]) <= plan.radius_cap_m
    seen &= (np.abs(off_m) <= most_side_m / 2).all(1)
    return float(1 - share @ seen / share.sum())


def pose_of_peak(peak: Peak, grid: MapGrid, plan: SearchPlan, footprint_up_m: Float32Array) -> CameraPose:
    """The pose that a peak stands for. `footprint_up_m` (H, W): surface averaged over a footprint (`footprint_heights`)."""
    heading, scale = hypotheses(plan)[peak.hypothesis]
    ne = grid.A_ne_pix @ np.array([peak.u_px, peak.v_px, 1.0])
    centre = ne + scale * _turn(heading) @ plan.footprint_ne_m.mean(0)
    uv = np.linalg.inv(grid.A_ne_pix[:, :2]) @ (centre - grid.A_ne_pix[:, 2])
    row = int(np.clip(round(float(uv[1])), 0, footprint_up_m.shape[0] - 1))
    col = int(np.clip(round(float(uv[0])), 0, footprint_up_m.shape[1] - 1))
    p = np.array([ne[0], ne[1], -float(footprint_up_m[row, col]) - plan.agl_m * scale])
    return CameraPose(p, turned(plan.pose.R_ned_cam, heading))


def footprint_heights(grid: MapGrid, plan: SearchPlan) -> Float32Array:
    """Surface heights (H, W) averaged over about a footprint."""
    side = min(max(3, int(math.sqrt(plan.area_m2) / grid.gsd_m)), 2 * min(grid.weight.shape) - 1) | 1
    return np.asarray(cv2.blur(grid.surface_up_m, (side, side), borderType=cv2.BORDER_REPLICATE), dtype=np.float32)


def _turn(heading_rad: float) -> FloatArray:
    c, s = math.cos(heading_rad), math.sin(heading_rad)
    return np.array([[c, -s], [s, c]])
