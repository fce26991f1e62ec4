"""Baseline `keypoint`: upright SIFT on the frame turned north up, ratio test, MAGSAC homography, PnP with the attitude prior."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from visloc_companion.errors import OutsideMap, Reason
from visloc_companion.geo.raster import apply_affine
from visloc_companion.localise.answer import Stopwatch, fix, no_fix
from visloc_companion.localise.candidates.hypotheses import footprint_box, search_box
from visloc_companion.localise.features.base import Float32Array
from visloc_companion.localise.features.grey import GREY
from visloc_companion.localise.frame import FrameLevel, full_level, reduced
from visloc_companion.localise.mapped.surface_error import height_covariance, is_coarse
from visloc_companion.localise.mapped.window import searched_map
from visloc_companion.localise.ortho_rectify import CameraPose, MapGrid, ground_homography, ground_points, rectify_plane
from visloc_companion.localise.plan import SearchPlan, planned
from visloc_companion.localise.pose import PoseEstimate, PriorTerm, solve_pose
from visloc_companion.localise.settings import LocaliserSettings
from visloc_companion.localise.verify import logistic
from visloc_companion.protocols import ReferenceMap
from visloc_companion.types import CameraModel, Fix, FloatArray, Image, LocaliseRequest, NoFix

RATIO = 0.85
MIN_INLIERS = 6
MAGSAC_PX = 3.0
MATCH_SIGMA_PX = 1.0
SIGMA_FLOOR_PX = 0.4
MOST_FRAME_PX = 400
"""Longer side of the rectified frame: what is smaller than its pixels seldom outlives the years between photograph and map."""
MOST_OPEN = 300
"""Matches that are used where the heights of all are open: time goes with the cube of their number."""
MATCHED_AT_ONCE = 64
"""Key points of the frame: their products with those of a large map stay in the cache."""
Pairs = tuple[FloatArray, FloatArray]


class KeypointLocaliser:
    """protocols.Localiser by sparse features."""

    method = "keypoint"

    def __init__(self, model: CameraModel, settings: LocaliserSettings) -> None:
        self._model, self._settings = model, settings

    def localise(self, request: LocaliseRequest, pixels: Image, ref: ReferenceMap) -> Fix | NoFix:
        """The pose from the consistent matches, or why there is none."""
        watch = Stopwatch()
        plan = planned(request.prior, pixels, self._model, ref, self._settings, watch)
        if not isinstance(plan, SearchPlan):
            return no_fix(request, self.method, watch, plan)
        level = full_level(pixels, self._model)
        try:
            pairs, grid, K, A_ne_pix = _matched(plan, level, ref, watch)
        except OutsideMap as outside:
            return no_fix(request, self.method, watch, (Reason.OUTSIDE_MAP, outside.what))
        n = len(pairs[0])
        p = _probability_wrong(n)
        numbers = {"inliers": float(n), "p_wrong": p}
        estimate = _pose(pairs, plan, grid, K, A_ne_pix, request.prior.sigma_tilt_rad) if n >= MIN_INLIERS else None
        if estimate is None:
            return no_fix(request, self.method, watch, (Reason.TOO_FEW_FEATURES, f"{n} consistent matches"), numbers)
        if p > self._settings.max_probability_wrong:
            return no_fix(request, self.method, watch, (Reason.NO_MATCH, f"probability of being wrong {p:.3f}"), numbers)
        floor = np.diag([1.0, 1.0, 1.0, 0.0, 0.0, 0.0]) * (SIGMA_FLOOR_PX * grid.gsd_m) ** 2
        covariance = estimate.covariance + floor
        return fix(request, self.method, watch, plan, ref, estimate.pose, covariance, p, self._settings.map_sigma_m, numbers)


def _matched(
    plan: SearchPlan, full: FrameLevel, ref: ReferenceMap, watch: Stopwatch
) -> tuple[Pairs, MapGrid, FloatArray, FloatArray]:
    """Consistent matches, the map window, and the pinhole matrix and grid of the rectified frame."""
    longer_px = max(full.grey.shape[:2])
    gsd_m = max(ref.gsd_m, plan.frame_gsd_m * max(1.0, longer_px / MOST_FRAME_PX))
    with watch:
        low, high = search_box(plan)
        grid = searched_map(ref, plan.frame, low, high, gsd_m, GREY)
        there = _detect(grid.features[..., 0], grid.weight > 0)
    level = reduced(full, gsd_m / plan.frame_gsd_m)
    A_ne_pix, size = _north_up(plan, grid)
    image, seen = rectify_plane(level, plan.pose, A_ne_pix, size, plan.ground_up_m)
    return _consistent(_detect(image, seen), there), grid, level.K, A_ne_pix


def _north_up(plan: SearchPlan, grid: MapGrid) -> tuple[FloatArray, tuple[int, int]]:
    """Grid of the rectified frame along the map's axes, just around the footprint."""
    low, high = footprint_box(plan, np.zeros(1), 1.0)
    linear = grid.A_ne_pix[:, :2]
    corners = np.array([[a, b] for a in (low[0], high[0]) for b in (low[1], high[1])]) @ np.linalg.inv(linear).T
    first, last = np.floor(corners.min(0)), np.ceil(corners.max(0))
    A_ne_pix = np.column_stack([linear, plan.pose.p_ned_m[:2] + linear @ first])
    return A_ne_pix, (int(last[0] - first[0] + 1), int(last[1] - first[1] + 1))


def _detect(image: Float32Array, seen: NDArray[np.bool_]) -> Pairs:
    """Key points (N, 2) pix and RootSIFT descriptors (N, 128)."""
    low, high = float(image.min()), float(image.max())
    stretched = ((image - low) * (255 / max(high - low, 1e-6))).astype(np.uint8)
    sift = cv2.SIFT.create(contrastThreshold=0.01)
    turned = sift.detect(stretched, seen.astype(np.uint8))
    places = {(k.pt, k.octave): _upright(k) for k in turned}  # several orientations of a place are one
    points, descriptors = sift.compute(stretched, list(places.values()))
    if descriptors is None or len(points) < 2:
        return np.zeros((0, 2)), np.zeros((0, 128), np.float32)
    roots = np.sqrt(descriptors / np.maximum(descriptors.sum(1, keepdims=True), 1e-9))
    return np.array([k.pt for k in points], dtype=np.float64), roots


def _upright(point: cv2.KeyPoint) -> cv2.KeyPoint:
    """Both pictures are turned north up: an orientation that is read off them only adds what they differ in."""
    return cv2.KeyPoint(point.pt[0], point.pt[1], point.size, 0.0, point.response, point.octave, point.class_id)


def _consistent(frame: Pairs, there: Pairs) -> Pairs:
    """Matches that pass the ratio test and fit one homography: pix in the rectified frame and in the map window."""
    nothing = np.zeros((0, 2))
    if len(frame[0]) < 4 or len(there[0]) < 4:
        return nothing, nothing
    nearest, distance = _two_nearest(frame[1].astype(np.float32), there[1].astype(np.float32))
    good = distance[:, 0] < RATIO * distance[:, 1]
    if good.sum() < 4:
        return nothing, nothing
    a, b = frame[0][good], there[0][nearest[good, 0]]
    keep = cv2.findHomography(a, b, cv2.USAC_MAGSAC, MAGSAC_PX, maxIters=5000, confidence=0.999)[1].ravel() > 0
    return a[keep], b[keep]


def _two_nearest(descriptors: Float32Array, among: Float32Array) -> tuple[NDArray[np.intp], Float32Array]:
    """(N, 2) which two of (M, 128) are nearest to each of (N, 128), the nearer one first, and their distances (N, 2).

    Which ones is told by products of matrices, |a - b|^2 = |a|^2 + |b|^2 - 2 a b, in a tenth of the time of all differences.
    """
    half_squares = 0.5 * np.einsum("ij,ij->i", among, among)
    nearest = np.empty((len(descriptors), 2), np.intp)
    for first in range(0, len(descriptors), MATCHED_AT_ONCE):
        near = descriptors[first : first + MATCHED_AT_ONCE] @ among.T - half_squares
        rows, found = np.arange(len(near)), nearest[first : first + MATCHED_AT_ONCE]
        found[:, 0] = near.argmax(1)
        near[rows, found[:, 0]] = -np.inf
        found[:, 1] = near.argmax(1)
    distance = np.linalg.norm(descriptors[:, None] - among[nearest], axis=2)
    return nearest, np.asarray(distance, dtype=np.float32)


def _pose(
    pairs: Pairs, plan: SearchPlan, grid: MapGrid, K: FloatArray, A_ne_pix: FloatArray, sigma_tilt_rad: float
) -> PoseEstimate | None:
    heights_m2 = None
    if is_coarse(grid):
        every = -(-len(pairs[0]) // MOST_OPEN)
        pairs = pairs[0][::every], pairs[1][::every]
        heights_m2 = height_covariance(grid, pairs[1], 1.0)
    H = ground_homography(K, plan.pose, A_ne_pix, plan.ground_up_m)
    q = np.column_stack([pairs[0], np.ones(len(pairs[0]))]) @ H.T
    ground = ground_points(grid, pairs[1])
    moved_ne = ground[:, :2].mean(0) - apply_affine(A_ne_pix, pairs[0]).mean(0)
    start = CameraPose(plan.pose.p_ned_m + np.array([*moved_ne, 0.0]), plan.pose.R_ned_cam)
    sigma_px = np.full(len(q), MATCH_SIGMA_PX * K[0, 0] * grid.gsd_m / plan.agl_m)
    prior = PriorTerm(plan.pose.R_ned_cam, sigma_tilt_rad)
    return solve_pose(ground, q[:, :2] / q[:, 2:3], sigma_px, K, start, prior, iterations=15, heights_m2=heights_m2)


def _probability_wrong(inliers: int) -> float:
    """Logistic in the number of inliers, fitted on training rows (benchmarks/calibrate.py)."""
    return logistic(-(0.447 * inliers - 2.32))
