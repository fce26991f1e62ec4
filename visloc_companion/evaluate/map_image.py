"""The picture of the ground that lies under the tracks of a report: a window of the map as JPEG."""

from __future__ import annotations

import cv2
import numpy as np

from visloc_companion.errors import OutsideMap
from visloc_companion.evaluate.record import FlightRecord, rebased
from visloc_companion.evaluate.reports.report_map import HEIGHT, WIDTH, MapImage, flight_view
from visloc_companion.geo.raster import apply_affine
from visloc_companion.geo.wgs84 import geo_from_ned
from visloc_companion.protocols import ReferenceMap
from visloc_companion.types import FloatArray, GeoPoint

_GREY = 128
_QUALITY = 72


def map_image(
    reference: ReferenceMap, record: FlightRecord, baseline: FlightRecord | None = None, width_px: int = 900
) -> MapImage | None:
    """The ground that the report of a flight (with a baseline, if it has one) shows; None where the map has nothing of it."""
    view = flight_view(record, rebased(baseline, record.origin) if baseline is not None else None)
    size_px = (width_px, round(width_px * HEIGHT / WIDTH))
    centre = geo_from_ned((view.north_m, view.east_m, 0.0), record.origin)
    try:
        patch = reference.patch(reference.to_map(centre.lat_deg, centre.lon_deg), size_px, view.width_m * 1.04 / width_px, 0.0)
    except OutsideMap:
        return None
    pixels = patch.pixels if patch.pixels.ndim == 3 else np.repeat(patch.pixels[..., None], 3, axis=2)
    shown = np.where(patch.valid[..., None], pixels, _GREY).astype(np.uint8)
    ok, jpeg = cv2.imencode(".jpg", np.ascontiguousarray(shown[:, :, ::-1]), [cv2.IMWRITE_JPEG_QUALITY, _QUALITY])
    if not ok:
        return None
    right, bottom = size_px[0] - 0.5, size_px[1] - 0.5
    corners = apply_affine(patch.T_map_pix, np.array([[-0.5, -0.5], [right, -0.5], [-0.5, bottom]]))
    north_west, north_east, south_west = (_geo(reference, corner) for corner in corners)
    return MapImage(jpeg.tobytes(), size_px, north_west, north_east, south_west)


def _geo(reference: ReferenceMap, corner: FloatArray) -> GeoPoint:
    lat_deg, lon_deg = reference.to_geo(float(corner[0]), float(corner[1]))
    return GeoPoint(lat_deg, lon_deg, 0.0)
