"""Rasters that do not say where they lie, and the command that mends each."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import Any

from visloc_companion.errors import DatumMissing, MapError
from visloc_companion.maps.world_file import is_pixel_grid


def require_place(path: Path, dataset: Any) -> None:
    """Refuse an open raster without pixels of its own and real, a CRS or a georeference. Raises MapError, DatumMissing."""
    where = str(path)
    if not dataset.count:
        inside = list(dataset.subdatasets)
        raise MapError(
            f"holds {len(inside)} rasters, such as {inside[0]}" if inside else "holds no raster",
            where=where,
            remedy=f"take out the one that is meant: gdal_translate '{inside[0]}' NEW.tif" if inside else "name a GeoTIFF",
        )
    if any(dtype.startswith("complex") for dtype in dataset.dtypes):
        raise MapError(
            "holds complex numbers, as radar's raw pictures do",
            where=where,
            remedy="make a picture of them: gdal_calc.py -A FILE --calc='abs(A)' --type=Float32 --outfile NEW.tif",
        )
    if dataset.crs is None and (dataset.gcps[0] or dataset.rpcs):
        how = "ground control points" if dataset.gcps[0] else "a camera model (RPC)"
        raise DatumMissing(
            f"is georeferenced by {how} alone",
            where=where,
            remedy=f"rectify it: gdalwarp {'-tps' if dataset.gcps[0] else '-rpc'} -t_srs EPSG:CODE FILE OUT.tif",
        )
    if dataset.crs is None:
        raise DatumMissing("has no coordinate reference system", where=where, remedy=_stating(path, dataset.driver))
    a, b, _, d, e, _ = tuple(dataset.transform)[:6]
    if is_pixel_grid(dataset) or not abs(a * e - b * d) >= 1e-30:
        remedy = "lay its world file beside it (.tfw), or georeference it (gdal_translate -a_ullr, gdalwarp)"
        raise DatumMissing("has no georeference", where=where, remedy=remedy)


def _stating(path: Path, driver: str) -> str:
    """How to state the CRS. GDAL reads no .prj beside a raster, and writes into no PNG or JPEG: a GeoTIFF can always be made."""
    beside = path.with_suffix(".prj")
    if beside.is_file():
        return f"gdal_translate -a_srs {shlex.quote(str(beside))} FILE NEW.tif, if the .prj beside it is that of its grid"
    if driver == "GTiff":
        return "gdal_edit.py -a_srs EPSG:CODE FILE, with the code of its grid"
    return "gdal_translate -a_srs EPSG:CODE FILE NEW.tif, with the code of its grid"
