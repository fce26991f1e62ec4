"""The map of an image case: a GeoTIFF with its surface model, or a pack, whose features may be those of several dates."""

from __future__ import annotations

from pathlib import Path

from visloc_companion.errors import MapError
from visloc_companion.maps.manifest import read_manifest
from visloc_companion.maps.pack import PackMap
from visloc_companion.maps.raster import RasterMap
from visloc_companion.types import GeoPoint


def open_case_map(ortho: Path, dsm: Path | None) -> RasterMap | PackMap:
    """The map that a case names; hashes of a pack are not checked.

    Raises MapError for what is no map, a damaged one, and a surface model beside a pack, DatumMissing as RasterMap.open.
    """
    if not ortho.is_dir():
        return RasterMap.open(ortho, dsm, without_small_holes=True)
    if dsm is not None:
        raise MapError(
            "is given beside a pack, which holds its own heights", where=f"dsm = {dsm}", remedy="leave the column empty"
        )
    return PackMap.open(ortho, verify_hashes=False)


def map_near(reference: RasterMap | PackMap, place: GeoPoint) -> RasterMap | PackMap:
    """The map of a case as it is about a place: of an orthophoto all around the earth the seam lies elsewhere."""
    return reference.near(place.lat_deg, place.lon_deg) if isinstance(reference, RasterMap) else reference


def picture_of(ortho: Path) -> Path:
    """The GeoTIFF that shows the map of a case. Raises MapError for a folder that is no pack."""
    return ortho / read_manifest(ortho).ortho.file if ortho.is_dir() else ortho
