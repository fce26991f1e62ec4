"""Pictures of single cases: the frame laid on the map at the truth, the map there, and the map where the answer put it."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from visloc_companion.errors import MapError, OutsideMap
from visloc_companion.evaluate.cases import BadCase, Case, Truth, read_frame
from visloc_companion.evaluate.images.case_map import map_near, open_case_map
from visloc_companion.evaluate.images.image_metrics import CaseResult
from visloc_companion.geo.camera import R_FRD_CAM
from visloc_companion.geo.pinhole_view import pinhole_view
from visloc_companion.geo.se3 import R_from_quat, quat_from_euler
from visloc_companion.localise.around.rectified import rectified
from visloc_companion.localise.frame import full_level, reduced
from visloc_companion.localise.local_frame import local_frame
from visloc_companion.localise.ortho_rectify import CameraPose, MapGrid, rectify_surface
from visloc_companion.localise.plan import footprint
from visloc_companion.protocols import ReferenceMap
from visloc_companion.types import GeoPoint, Image, Quat

SIDE_PX = 220
ROOM = 1.15
"""Side of a picture over that of the footprint."""


@dataclass(frozen=True, slots=True, eq=False)
class CasePictures:
    """(SIDE_PX, SIDE_PX, 3) RGB each, north up, one scale: frame rectified at the truth, map there, and both at the answer."""

    frame_at_truth: Image
    map_at_truth: Image
    frame_at_answer: Image | None
    map_at_answer: Image | None


def case_pictures(case: Case | BadCase, truth: Truth, result: CaseResult) -> CasePictures | None:
    """The pictures of a case, None where frame or map cannot be read, or the truth lies outside the map or is no whole pose."""
    if isinstance(case, BadCase) or not truth.is_pose:
        return None
    pixels = read_frame(case.frame)
    if pixels is None:
        return None
    attitude = quat_from_euler(*(math.radians(a) for a in (truth.roll_deg, truth.pitch_deg, truth.yaw_deg)))
    try:
        ref = map_near(open_case_map(case.ortho, case.dsm), case.prior.place)
        here = _laid_out(case, pixels, ref, GeoPoint(truth.lat_deg, truth.lon_deg, truth.h_m), attitude)
    except MapError:
        return None
    there: tuple[Image, Image] | tuple[None, None] = (None, None)
    if result.fix is not None:
        try:
            there = _laid_out(case, pixels, ref, result.fix.place, result.fix.q_ned_frd)
        except OutsideMap:
            there = (None, None)
    return CasePictures(*here, *there)


def _laid_out(case: Case, pixels: Image, ref: ReferenceMap, place: GeoPoint, q_ned_frd: Quat) -> tuple[Image, Image]:
    """Frame rectified on the map's surface and the map, on one north-up window about the footprint. Raises OutsideMap."""
    camera = case.camera.model(pixels)
    pixels, model = rectified(pixels, camera), pinhole_view(camera)
    R_ned_cam = R_from_quat(q_ned_frd) @ R_FRD_CAM
    outline, _ = footprint(model, R_ned_cam)
    local = local_frame(place, ref)
    under = ref.patch(local.to_map(np.zeros(2)), (9, 9), 2 * ref.gsd_m, 0.0)
    agl_m = max(1.0, place.h_amsl_m - float(np.median(under.dsm_amsl_m[under.valid])))
    low, high = outline.min(0) * agl_m, outline.max(0) * agl_m
    gsd_m = ROOM * float((high - low).max()) / SIDE_PX
    patch = ref.patch(local.to_map((low + high) / 2), (SIDE_PX, SIDE_PX), gsd_m, 0.0)
    up_m = np.where(patch.valid, patch.dsm_amsl_m, np.float32(place.h_amsl_m - agl_m)).astype(np.float32)
    weight = patch.valid.astype(np.float32)
    grid = MapGrid(np.zeros((*weight.shape, 0), np.float32), weight, up_m, local.A_ne_pix(patch.T_map_pix), gsd_m)
    pose = CameraPose(np.array([0.0, 0.0, -place.h_amsl_m]), R_ned_cam)
    bands = [pixels[..., k] for k in range(3)] if pixels.ndim == 3 else [pixels] * 3
    seen = None
    laid = []
    for band in bands:
        level = reduced(full_level(np.ascontiguousarray(band), model), gsd_m / (agl_m / model.fx_px))
        image, seen = rectify_surface(level, pose, grid)
        laid.append(image)
    frame = np.clip(np.stack(laid, -1), 0, 255).astype(np.uint8)
    if seen is not None:
        frame[~seen] = 0
    reference = patch.pixels if patch.pixels.ndim == 3 else np.repeat(patch.pixels[..., None], 3, axis=2)
    return frame, np.where(patch.valid[..., None], reference, 0).astype(np.uint8)
