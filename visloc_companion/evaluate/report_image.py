"""The picture of the ground that lies under the tracks of a report."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from visloc_companion.errors import OutsideMap
from visloc_companion.evaluate.record import FlightRecord, rebased
from visloc_companion.evaluate.report_map import HEIGHT, WIDTH, MapImage, view_of
from visloc_companion.geo.raster import apply_affine
from visloc_companion.geo.wgs84 import geo_from_ned
from visloc_companion.protocols import ReferenceMap
from visloc_companion.types import FloatArray, GeoPoint

_GREY = 128
_QUALITY = 72


def ground_image(reference: ReferenceMap, records: Sequence[FlightRecord], width_px: int = 900) -> MapImage | None:
    """The map under the tracks of these flights (the first one's report), as JPEG; None where the map shows none of it."""
    if not records:
        return None
    origin = records[0].origin
    moved = [rebased(record, origin) for record in records]
    tracks = [t for r in moved for t in (r.truth.p_ned_m, r.estimate_ned_m)] + [moved[0].gnss.p_ned_m]
    view = view_of(tracks)
    size_px = (width_px, round(width_px * HEIGHT / WIDTH))
    centre = geo_from_ned((view.north_m, view.east_m, 0.0), origin)
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
