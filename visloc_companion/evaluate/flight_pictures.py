"""What the camera of a simulated flight saw, and what the map holds of the same ground, side by side."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from visloc_companion.errors import OutsideMap
from visloc_companion.evaluate.closed_loop import FlightWorld, FlownScenario
from visloc_companion.evaluate.reports.report_pictures import PicturePair
from visloc_companion.geo.pinhole_view import pinhole_view
from visloc_companion.geo.wgs84 import geo_from_ned
from visloc_companion.sim.camera import LEVEL
from visloc_companion.sim.render import CameraSimulator
from visloc_companion.sim.rendering.render_effects import CameraEffects
from visloc_companion.types import GeoPoint, Image

_WIDTH_PX = 420
_QUALITY = 75


def picture_pairs(flown: FlownScenario, world: FlightWorld, times_s: Sequence[float]) -> list[PicturePair]:
    """Frames of a level camera from the true track, rendered anew, each beside the map; times off the map are left out."""
    model, record = pinhole_view(flown.setup.camera_model()), flown.record
    camera = CameraSimulator(world.scene, model, CameraEffects())
    size_px = (_WIDTH_PX, round(_WIDTH_PX * model.height_px / model.width_px))
    gsd_m = flown.setup.height_m * model.width_px / model.fx_px / _WIDTH_PX
    pairs = []
    for t_s in times_s:
        north_m, east_m, down_m = (float(value) for value in record.truth.at(np.array([t_s]))[0])
        place = geo_from_ned((north_m, east_m, down_m), record.origin)
        try:
            below = _map_at(world, place, size_px, gsd_m)
        except OutsideMap:
            continue
        seen = cv2.resize(camera.frame(place, LEVEL, round(t_s)), size_px, interpolation=cv2.INTER_AREA)
        pairs.append(PicturePair(t_s, _jpeg(np.asarray(seen, dtype=np.uint8)), _jpeg(below)))
    return pairs


def _map_at(world: FlightWorld, place: GeoPoint, size_px: tuple[int, int], gsd_m: float) -> Image:
    patch = world.reference.patch(world.reference.to_map(place.lat_deg, place.lon_deg), size_px, gsd_m, 0.0)
    pixels = patch.pixels if patch.pixels.ndim == 3 else np.repeat(patch.pixels[..., None], 3, axis=2)
    return np.where(patch.valid[..., None], pixels, 128).astype(np.uint8)


def _jpeg(pixels: Image) -> bytes:
    _, jpeg = cv2.imencode(".jpg", np.ascontiguousarray(pixels[:, :, ::-1]), [cv2.IMWRITE_JPEG_QUALITY, _QUALITY])
    return jpeg.tobytes()
