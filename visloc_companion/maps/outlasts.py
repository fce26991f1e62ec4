"""Whether a CRS that is written into a GeoTIFF comes out of it again."""

from __future__ import annotations

from rasterio import Affine
from rasterio.io import MemoryFile

from visloc_companion.errors import DatumMissing, MapError
from visloc_companion.maps.crs import MapCrs, map_crs


def outlasts_geotiff(crs: MapCrs) -> bool:
    """False of the few that come out as another one, by GDAL's tables or for want of keys: no pack in them could be opened."""
    place = Affine.translation(1.0, 1.0)
    with MemoryFile() as file:
        with file.open(driver="GTiff", width=1, height=1, count=1, dtype="uint8", crs=crs.wkt, transform=place):
            pass
        with file.open() as written:
            text = written.crs.to_wkt(version="WKT2_2019") if written.crs else ""
    try:
        return map_crs(text) == crs
    except (MapError, DatumMissing):
        return False
