"""The picture of the ground that lies under the tracks of a report: a window of the pack's ortho as JPEG."""

from __future__ import annotations

import cv2
import numpy as np

from visloc_companion.errors import MapError
from visloc_companion.evaluate.record import FlightRecord
from visloc_companion.evaluate.report_map import MapImage
from visloc_companion.geo.raster import apply_affine
from visloc_companion.geo.wgs84 import geo_from_ned
from visloc_companion.protocols import ReferenceMap
from visloc_companion.types import GeoPoint

SIDE_PX = 760
MARGIN = 1.5
JPEG_QUALITY = 72


def map_image(reference: ReferenceMap, record: FlightRecord) -> MapImage | None:
    """The ground around the flight's tracks, or None where the map shows nothing of it."""
    tracks = [
        path[np.isfinite(path).all(axis=1), :2] for path in (record.truth.p_ned_m, record.gnss.p_ned_m, record.estimate_ned_m)
    ]
    points = np.concatenate(tracks)
    if not len(points):
        return None
    low, high = points.min(axis=0), points.max(axis=0)
    gsd_m = max(reference.gsd_m, float((high - low).max()) * MARGIN / SIDE_PX)
    north, east = (low + high) / 2
    centre = geo_from_ned((float(north), float(east), 0.0), record.origin)
    try:
        patch = reference.patch(reference.to_map(centre.lat_deg, centre.lon_deg), (SIDE_PX, SIDE_PX), gsd_m, 0.0)
    except MapError:
        return None
    rgb = patch.pixels if patch.pixels.ndim == 3 else cv2.cvtColor(patch.pixels, cv2.COLOR_GRAY2RGB)
    done, jpeg = cv2.imencode(".jpg", np.ascontiguousarray(rgb[..., ::-1]), [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])
    if not done:
        return None
    last = SIDE_PX - 0.5
    corners = apply_affine(patch.T_map_pix, np.array([[-0.5, -0.5], [last, -0.5], [-0.5, last]]))
    north_west, north_east, south_west = (GeoPoint(*reference.to_geo(float(e), float(n)), 0.0) for e, n in corners)
    return MapImage(jpeg.tobytes(), (SIDE_PX, SIDE_PX), north_west, north_east, south_west)
