"""From the prior to what is searched: local coordinates, working resolutions, the region and the heading x scale grid."""

from __future__ import annotations

import math
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, replace
from functools import lru_cache

import cv2
import numpy as np

from visloc_companion.errors import OutsideMap, Reason
from visloc_companion.geo.camera import R_FRD_CAM, unproject
from visloc_companion.geo.se3 import R_from_quat
from visloc_companion.localise.features.gradient import GRADIENT
from visloc_companion.localise.frame import check_pixels
from visloc_companion.localise.local_frame import LocalFrame, local_frame
from visloc_companion.localise.mapped.map_part import part_on_map
from visloc_companion.localise.ortho_rectify import MAX_TAN_INCIDENCE, CameraPose
from visloc_companion.localise.settings import LocaliserSettings
from visloc_companion.protocols import FeatureMap, ReferenceMap
from visloc_companion.types import CameraModel, FeaturePatch, FloatArray, Image, PosePrior, ReferencePatch

COARSE_PIXELS, COARSEST_PIXELS = 90.0, 45.0
"""Side (px) of the square with the footprint's area at the search level; down to the second
where the map within the region would have more pixels than `LocaliserSettings.most_positions`."""
FINE_PIXELS = 200.0
"""The same at the level of the refinement, ..."""
FINEST_PIXELS = 400.0
"""... and of the last one, of the winner only. None is finer than the map or the frame."""
STEP_PX = 1.3
"""Largest misfit (px, at 0.7 of the footprint's half side) that the heading and scale grid leaves, ..."""
STEP_SHARE = 0.0155
"""... and the same as a share of the side: a small footprint has no structure to spare (training rows: 62 against 68 % right at
48 px). Not where only the search is coarse, for cost, and the refinement sees what the map has: in regions of 2.9 km² of the
training landscape, 120 m above ground, the right place was the highest peak in 28 of 30 frames, with three times as many
templates in 27."""
SIGMAS = 3.0
MIN_SHARE_OF_GROUND = 0.4
HALF_WINDOW = 24
"""Half side (px) of the window that the ground's height is taken from."""
LOWEST_LAND_M = -450.0
"""Height of the shore of the Dead Sea, above mean sea level."""
LEAST_SHARE_BELOW = 0.1
"""Share of the search region that must lie low enough below the vehicle where its middle does not."""
SAMPLES = 13
"""Rows and columns of the lattice of the frame whose rays are followed to the ground."""
UNTIMED: AbstractContextManager[object] = nullcontext()
"""For callers that do not tell the map's side from the rest."""


@dataclass(frozen=True, slots=True, eq=False)
class SearchPlan:
    """What is searched for. Lengths in metres, angles in radians; `footprint_ne_m` (N, 2) is the outline about the nadir,
    `looked_at_ne_m` (2,) the middle of the view there and `area_m2` the footprint's area if all of it were seen as in the middle.

    `headings_rad` are turns about the vertical added to the prior attitude, `scales` factors of `agl_m`; `cov_ne_m2` (2, 2) is
    the prior's covariance widened by what the unknown tilt moves the picture, and `within_m` how far north, south, east
    and west of it is searched at most (inf: as far as that covariance reaches).
    """

    frame: LocalFrame
    pose: CameraPose
    ground_up_m: float
    agl_m: float
    footprint_ne_m: FloatArray
    looked_at_ne_m: FloatArray
    area_m2: float
    frame_gsd_m: float
    coarse_gsd_m: float
    fine_gsd_m: float
    finest_gsd_m: float
    cov_ne_m2: FloatArray
    radius_cap_m: float
    within_m: float
    headings_rad: FloatArray
    scales: FloatArray

    @property
    def region_half_m(self) -> FloatArray:
        """(2,) how far north or south, and east or west, of the prior's place is searched."""
        return np.minimum(SIGMAS * np.sqrt(np.diag(self.cov_ne_m2)), min(self.radius_cap_m, self.within_m))


def make_plan(
    prior: PosePrior,
    model: CameraModel,
    ref: ReferenceMap,
    settings: LocaliserSettings,
    map_side: AbstractContextManager[object] = UNTIMED,
) -> SearchPlan | tuple[Reason, str]:
    """Plan the search, or say why there is nothing to search (too low, horizon in view, outside the map or its CRS).

    The map is read within `map_side` (answer.Stopwatch).
    """
    try:
        frame = local_frame(prior.place, ref)
    except OutsideMap as outside:
        return Reason.OUTSIDE_MAP, outside.what
    pose = CameraPose(np.array([0.0, 0.0, -prior.place.h_amsl_m]), R_from_quat(prior.q_ned_frd) @ R_FRD_CAM)
    outline, share = footprint(model, pose.R_ned_cam)
    if share < MIN_SHARE_OF_GROUND:
        return Reason.HORIZON_IN_VIEW, f"only {100 * share:.0f} % of the frame looks down steeply enough"
    with map_side:
        surface = ground_near(prior, ref, frame, outline, settings)
    if surface is None:
        return Reason.OUTSIDE_MAP, "no map within the search region"
    ground, spread, searched_m2 = surface
    agl = prior.place.h_amsl_m - ground
    if agl < settings.min_height_m:
        return Reason.TOO_LOW, f"{agl:.1f} m above the surface"
    looked_at, pixel_m2 = middle_of_view(model, pose.R_ned_cam)
    pixels = share * model.width_px * model.height_px
    area = agl * agl * min(_area(outline), pixel_m2 * pixels)
    frame_gsd = math.sqrt(area / pixels)
    finest = max(frame_gsd, ref.gsd_m)
    affordable = min(math.sqrt(searched_m2 / settings.most_positions), math.sqrt(area) / COARSEST_PIXELS)
    coarse = max(finest, math.sqrt(area) / COARSE_PIXELS, affordable)
    side_px = math.sqrt(area) / coarse
    misfit_px = STEP_PX if coarse == affordable else min(STEP_PX, STEP_SHARE * side_px)
    step = grid_step(misfit_px, side_px)
    tilt_m = prior.sigma_tilt_rad * agl
    return SearchPlan(
        frame=frame,
        pose=pose,
        ground_up_m=ground,
        agl_m=agl,
        footprint_ne_m=outline * agl,
        looked_at_ne_m=looked_at * agl,
        area_m2=area,
        frame_gsd_m=frame_gsd,
        coarse_gsd_m=coarse,
        fine_gsd_m=max(finest, math.sqrt(area) / FINE_PIXELS),
        finest_gsd_m=max(finest, math.sqrt(area) / FINEST_PIXELS),
        cov_ne_m2=np.array(prior.cov_ne_m2) + np.eye(2) * (tilt_m**2 + (coarse / 2) ** 2),
        radius_cap_m=settings.max_search_radius_m,
        within_m=within_of(prior),
        headings_rad=_grid(min(math.pi, SIGMAS * prior.sigma_yaw_rad), step),
        scales=np.exp(_grid(math.log1p(min(1.5, (SIGMAS * prior.sigma_h_m + spread) / agl)), step)),
    )


def within_of(prior: PosePrior) -> float:
    """How far north, south, east or west of its place a prior lets the camera be at most, metres."""
    return math.inf if prior.within_m is None else prior.within_m


def grid_step(misfit_px: float, side_px: float) -> float:
    """Between headings (rad) and logarithms of the scale that leave a misfit at 0.7 of a square footprint's half side (1.13: a
    disc of that area has such a radius)."""
    return 2 * misfit_px / (0.7 * side_px / 2 * 1.13)


def with_steps(plan: SearchPlan, gsd_m: float, step: float) -> SearchPlan:
    """The plan at another resolution of its search, with headings (rad) and logarithms of the scale so far apart."""
    reach = float(plan.headings_rad.max()), float(np.log(plan.scales.max()))
    headings, scales = (_grid(at_most, step) for at_most in reach)
    return replace(plan, coarse_gsd_m=gsd_m, headings_rad=headings, scales=np.exp(scales))


def planned(
    prior: PosePrior,
    pixels: Image,
    model: CameraModel,
    ref: ReferenceMap,
    settings: LocaliserSettings,
    map_side: AbstractContextManager[object] = UNTIMED,
) -> SearchPlan | tuple[Reason, str]:
    """The plan for a frame, or why it cannot be localised: what is wrong with its pixels, or with where it was taken."""
    return check_pixels(pixels, model) or make_plan(prior, model, ref, settings, map_side)


def ground_near(
    prior: PosePrior, ref: ReferenceMap, frame: LocalFrame, outline: FloatArray, settings: LocaliserSettings
) -> tuple[float, float, float] | None:
    """Surface height where the prior looks, averaged over a footprint, half its spread over the search region, and the area (m²)
    of the map about that region; else None.

    Where the vehicle cannot be above that, but can above other ground of the region (a slope that the prior is on, and the valley
    beside it), height and spread are those of that ground. `outline` (N, 2) is the footprint 1 m below. None where no map lies
    within the region.
    """
    sigma = math.sqrt(max(np.linalg.eigvalsh(np.array(prior.cov_ne_m2))[-1], 0.0))
    reach = min(settings.max_search_radius_m, SIGMAS * sigma, within_of(prior))
    agl, ground, spread, searched_m2 = 100.0, 0.0, 0.0, 0.0
    for turn in range(3):
        side = _side_m(outline, agl)
        found = _surface_within(ref, frame, outline.mean(0) * agl, reach + side)
        while found is None and turn == 0 and agl < prior.place.h_amsl_m - LOWEST_LAND_M:
            agl *= 2  # who is high up sees past a gap of the map, and into it from beside it
            side = _side_m(outline, agl)
            found = _surface_within(ref, frame, outline.mean(0) * agl, reach + side)
        if found is None:
            return None
        patch, looked_m = found
        known = patch.valid & np.isfinite(patch.dsm_amsl_m)
        heights = np.where(known, patch.dsm_amsl_m, np.float32(np.median(patch.dsm_amsl_m[known])))
        mean = cv2.blur(heights, (max(1, round(side / patch.gsd_m)) | 1,) * 2, borderType=cv2.BORDER_REPLICATE)
        centre = len(mean) // 2
        around = min(centre, int(reach / patch.gsd_m))
        within = slice(centre - around, centre + around + 1)
        near = mean[within, within]
        below = near[near <= prior.place.h_amsl_m - settings.min_height_m]
        ground = float(mean[centre, centre])
        if prior.place.h_amsl_m - ground < settings.min_height_m and below.size >= LEAST_SHARE_BELOW * near.size:
            near, ground = below, float(np.median(below))
        low, high = np.percentile(near, (5, 95))
        spread = float(high - low) / 2
        searched_m2 = float(known.mean()) * (2 * looked_m) ** 2
        agl, before = max(1.0, prior.place.h_amsl_m - ground), agl
        if abs(agl - before) < 0.1 * agl:
            break
    return ground, spread, searched_m2


def above_ground_m(plan: SearchPlan, pose: CameraPose, ref: ReferenceMap) -> float:
    """How high a camera is over the mean surface of what it sees, metres; over the plan's ground where the map has none there."""
    for _ in range(2):
        low, high = view_box(plan, pose)
        patch = _surface(ref, plan.frame.to_map((low + high) / 2), float((high - low).max()) / 2)
        if patch is None:
            break
        heights = patch.dsm_amsl_m[patch.valid & np.isfinite(patch.dsm_amsl_m)]
        plan = replace(plan, ground_up_m=float(heights.mean(dtype=np.float64)))
    return -float(pose.p_ned_m[2]) - plan.ground_up_m


def _side_m(outline: FloatArray, agl_m: float) -> float:
    """Side of the footprint so far below, metres."""
    return max(20.0, agl_m * math.sqrt(_area(outline)))


def _surface_within(
    ref: ReferenceMap, frame: LocalFrame, middle_ne_m: FloatArray, reach_m: float
) -> tuple[ReferencePatch | FeaturePatch, float] | None:
    """Surface heights about a place, and how far they reach (m): those of the map's part of that square where the map is so small
    beside it that it lies between the samples. None where no map lies within the square."""
    patch = _surface(ref, frame.to_map(middle_ne_m), reach_m)
    part = part_on_map(ref, frame, middle_ne_m - reach_m, middle_ne_m + reach_m) if patch is None else None
    if part is not None and float((part[1] - part[0]).max()) < reach_m:
        reach_m = float((part[1] - part[0]).max()) / 2
        patch = _surface(ref, frame.to_map((part[0] + part[1]) / 2), reach_m)
    return None if patch is None else (patch, reach_m)


def _surface(ref: ReferenceMap, centre_map_m: tuple[float, float], reach_m: float) -> ReferencePatch | FeaturePatch | None:
    """Surface heights on about 49 x 49 pixels that reach so far from a place; None where none is known there.

    Stored features mark where the map holds anything: over a pack that has them no pixel is read.
    """
    gsd_m = max(ref.gsd_m, reach_m / HALF_WINDOW)
    patch: ReferencePatch | FeaturePatch | None = None
    try:
        if isinstance(ref, FeatureMap):
            of = (GRADIENT.name, GRADIENT.recipe)
            stored_m = ref.stored_gsd_m(centre_map_m, gsd_m, *of)
            side = 1 + 2 * math.ceil(HALF_WINDOW * gsd_m / (stored_m or gsd_m))
            patch = ref.stored_patch(centre_map_m, (side, side), gsd_m, *of)
        patch = patch or ref.patch(centre_map_m, (2 * HALF_WINDOW + 1,) * 2, gsd_m, 0.0)
    except OutsideMap:
        return None
    return patch if (patch.valid & np.isfinite(patch.dsm_amsl_m)).any() else None


def footprint(model: CameraModel, R_ned_cam: FloatArray) -> tuple[FloatArray, float]:
    """Outline (N, 2) north, east of what the camera sees of a plane 1 m below, cut at the flattest useful view; and the share
    of the frame within that cut."""
    rays = _useful_rays(model, R_ned_cam)
    ne = rays[:, :2] / rays[:, 2:3] if len(rays) else np.zeros((1, 2))
    hull = cv2.convexHull(ne.astype(np.float32))
    return np.asarray(hull.reshape(-1, 2), dtype=np.float64), len(rays) / SAMPLES**2


def middle_of_view(model: CameraModel, R_ned_cam: FloatArray) -> tuple[FloatArray, float]:
    """Median place (2,) north, east that the camera sees of a plane 1 m below, and the median area that a pixel covers there.

    Half of the frame lies to either side of it, however much ground the far half covers.
    """
    rays = _useful_rays(model, R_ned_cam)
    if not len(rays):
        return np.zeros(2), math.inf
    ne = rays[:, :2] / rays[:, 2:]
    depth = rays @ R_ned_cam[:, 2] / rays[:, 2]
    return np.asarray(np.median(ne, axis=0)), float(np.median(depth) ** 3) / (model.fx_px * model.fy_px)


def view_box(plan: SearchPlan, pose: CameraPose) -> tuple[FloatArray, FloatArray]:
    """Smallest box (low, high; metres north, east of the local origin) of the ground that a pose sees, its tilt included."""
    at_prior = np.column_stack([plan.footprint_ne_m, np.full(len(plan.footprint_ne_m), plan.agl_m)])
    rays = at_prior @ plan.pose.R_ned_cam @ pose.R_ned_cam.T
    flat = np.hypot(rays[:, 0], rays[:, 1])
    tan = np.where(rays[:, 2] > 0, np.minimum(flat / np.maximum(rays[:, 2], 1e-9), MAX_TAN_INCIDENCE), MAX_TAN_INCIDENCE)
    z = max(1.0, -float(pose.p_ned_m[2]) - plan.ground_up_m)
    seen = pose.p_ned_m[:2] + rays[:, :2] * (z * tan / np.maximum(flat, 1e-9))[:, None]
    return seen.min(0), seen.max(0)


def turned(R_ned_cam: FloatArray, heading_rad: float) -> FloatArray:
    """The attitude turned about the vertical by `heading_rad` clockwise seen from above."""
    s, c = math.sin(heading_rad), math.cos(heading_rad)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]) @ R_ned_cam


def _useful_rays(model: CameraModel, R_ned_cam: FloatArray) -> FloatArray:
    """(N, 3) NED rays of a lattice of the frame that meet the ground steeply enough."""
    rays = _lattice(model) @ R_ned_cam.T
    steep = (rays[:, 2] > 0) & (np.hypot(rays[:, 0], rays[:, 1]) < MAX_TAN_INCIDENCE * rays[:, 2])
    return np.asarray(rays[steep], dtype=np.float64)


@lru_cache(maxsize=4)
def _lattice(model: CameraModel) -> FloatArray:
    """(SAMPLES^2, 3) rays in the camera's frame: the same for all frames of a camera."""
    u, v = np.meshgrid(np.linspace(0, model.width_px - 1, SAMPLES), np.linspace(0, model.height_px - 1, SAMPLES))
    rays = unproject(model, np.column_stack([u.ravel(), v.ravel()]))
    rays.setflags(write=False)
    return rays


def _area(outline: FloatArray) -> float:
    x, y = outline[:, 0], outline[:, 1]
    return 0.5 * abs(float(np.dot(x, np.roll(y, 1)) - np.dot(y, np.roll(x, 1))))


def _grid(reach: float, step: float) -> FloatArray:
    """Symmetric grid of at most `step` spacing that covers ±(reach - step/2)."""
    n = max(0, math.ceil((reach - step / 2) / step))
    return np.asarray(np.arange(-n, n + 1) * (min(step, max(reach, 1e-9) / max(n, 1)) if n else step), dtype=np.float64)
