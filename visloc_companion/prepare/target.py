"""The grid of a pack: north up, square pixels, in a projected CRS in metres that is nearly true to scale."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from visloc_companion.errors import MapError
from visloc_companion.geo.raster import T_map_pix_from_gdal, apply_affine
from visloc_companion.maps.crs import MapCrs, utm_at
from visloc_companion.maps.geotiff import Stretch, layer_of, open_ortho
from visloc_companion.maps.layer import Layer
from visloc_companion.maps.manifest import ReprojectedFrom
from visloc_companion.maps.outlasts import outlasts_geotiff
from visloc_companion.maps.places import middle_of
from visloc_companion.maps.seamless import goes_around
from visloc_companion.maps.spilled import Spill
from visloc_companion.types import FloatArray

BLOCK_PX = 256
"""Tile of the pack's rasters; overviews go on until the raster fits into two of them."""
MAX_PIXELS = 4_000_000_000
FINEST_M = 0.001
"""No camera over land sees as little in a pixel: coordinates in degrees that are held for metres do."""
UTM_DEG = (-80.0, 84.0)
"""Latitudes that UTM is for. Beyond, pixels of degrees grow so narrow that no square ones of a size that could be built show
them; a polar projection's stay square."""
FINER = 1.25
"""Rasters whose pixels differ by less count as equally fine."""
LARGEST_M = 1_000_000.0
"""Beyond, no projection is true to scale; and a pack is for one flight."""


@dataclass(frozen=True, slots=True, eq=False)
class Source:
    """A raster that goes into the pack, in its own CRS. `name` is for messages."""

    name: str
    layer: Layer
    crs: MapCrs
    gsd_m: float


def ortho_source(path: Path, stretches: Mapping[str, Stretch], spill: Spill) -> Source:
    """An orthophoto as a source. Raises MapError, DatumMissing for what is none."""
    tiff = open_ortho(path, stretches)
    return Source(str(path), spill.kept(layer_of(tiff)), tiff.crs, tiff.gsd_m)


@dataclass(frozen=True, slots=True)
class TargetGrid:
    """North-west corner and pixel of a grid (map units), (rows, cols), and how often it halves evenly."""

    crs: MapCrs
    west: float
    north: float
    pixel: float
    rows: int
    cols: int
    overviews: int

    @property
    def transform(self) -> tuple[float, float, float, float, float, float]:
        """Affine (a, b, c, d, e, f) from ras (col, row)."""
        return self.pixel, 0.0, self.west, 0.0, -self.pixel, self.north

    @property
    def T_map_pix(self) -> FloatArray:
        """(2, 3)."""
        return T_map_pix_from_gdal(self.transform)

    @property
    def bounds(self) -> tuple[float, float, float, float]:
        """West, south, east, north (map units)."""
        return self.west, self.north - self.rows * self.pixel, self.west + self.cols * self.pixel, self.north

    @property
    def middle_lat_lon_deg(self) -> tuple[float, float]:
        """WGS 84."""
        west, south, east, north = self.bounds
        return self.crs.to_geo((west + east) / 2, (south + north) / 2)


def pack_grid(sources: Sequence[Source]) -> TargetGrid:
    """The grid over all orthophotos: the first one's CRS, pixel and alignment where it is fit for it, else UTM.

    Raises MapError for orthophotos that no map can be made from.
    """
    first = sources[0]
    for source in sources:
        if goes_around(source.layer, source.crs):
            raise MapError(
                "goes all around the earth, and says nothing of where you fly",
                where=source.name,
                remedy="name the tiles of the place, on both sides of its seam where it lies there (--ortho takes several files)",
            )
        _refuse_polar_degrees(source)
        if source.gsd_m < FINEST_M:
            raise MapError(
                f"has pixels of {source.gsd_m:.2g} m in {source.crs.name}",
                where=source.name,
                remedy="where its coordinates are degrees, state that: gdal_edit.py -a_srs EPSG:4326 FILE",
            )
    crs = pack_crs(first)
    box = outline_box(sources, crs)
    if max(box[2] - box[0], box[3] - box[1]) > LARGEST_M:
        raise MapError(
            f"spans {(box[2] - box[0]) / 1000:.0f} x {(box[3] - box[1]) / 1000:.0f} km" + " with the others" * (len(sources) > 1),
            where=first.name,
            remedy="cut it to where you fly (gdalwarp -te, gdal_translate -projwin)",
        )
    return grid_over(first, crs, box)


def finer_than_first(sources: Sequence[Source], smallest_m: float = 0.0) -> list[str]:
    """A sentence on each raster that is finer than the first of its kind, which gives the pack its pixel (`smallest_m` at least)
    and hides what lies below it."""
    first = sources[0]
    return [
        f"{source.name} has pixels of {source.gsd_m:.3g} m, and the pack gets those of {first.name}, {first.gsd_m:.3g} m, "
        "which lies on top: name the finest first"
        for source in sources[1:]
        if max(source.gsd_m, smallest_m) < first.gsd_m / FINER
    ]


def reprojected_from(sources: Sequence[Source], crs: MapCrs) -> tuple[ReprojectedFrom, ...]:
    """The CRSs of orthophotos that are changed to this one, each once, as the first orthophoto in it has it."""
    found: dict[str, ReprojectedFrom] = {}
    for source in sources:
        if source.crs != crs and source.crs.name not in found:
            accuracy_m = source.crs.accuracy_m(*middle_of(source.layer))
            found[source.crs.name] = ReprojectedFrom(name=source.crs.name, accuracy_m=accuracy_m)
    return tuple(found.values())


def pack_crs(first: Source) -> MapCrs:
    """The orthophoto's own CRS if it is projected, in metres, true to scale within 2 % there, not mirrored (as Krovak's southings
    and westings are: frames match no mirror image), and comes out of a GeoTIFF as it went in; else the place's UTM zone."""
    easting, northing = middle_of(first.layer)
    here = first.crs.linearised_at_map(easting, northing)
    stretch = np.linalg.svd(here.J_map_ne, compute_uv=False)
    is_true = float(np.abs(stretch - 1).max()) < 0.02 and float(np.linalg.det(here.J_map_ne)) < 0
    if not first.crs.is_geographic and first.crs.metres_per_unit == 1.0 and is_true and outlasts_geotiff(first.crs):
        return first.crs
    return utm_at(*first.crs.to_geo(easting, northing))


def _refuse_polar_degrees(source: Source) -> None:
    if not source.crs.is_geographic:
        return
    lat_deg, _ = source.crs.to_geo(*middle_of(source.layer))
    if not UTM_DEG[0] <= lat_deg <= UTM_DEG[1]:
        polar = "EPSG:5041" if lat_deg > 0 else "EPSG:5042"
        raise MapError(
            f"lies at latitude {lat_deg:.4f} and has pixels of degrees, which hardly have a width there",
            where=source.name,
            remedy=f"change it to a projection of the pole: gdalwarp -t_srs {polar} FILE NEW",
        )


def grid_over(model: Source, crs: MapCrs, box: tuple[float, float, float, float], smallest_pixel: float = 0.0) -> TargetGrid:
    """A grid over a box (west, south, east, north) with the pixel of `model`, aligned with it if that is north up in `crs`."""
    T = model.layer.T_map_pix
    west, south, east, north = box
    pixel = math.sqrt(abs(float(np.linalg.det(T[:, :2]))))
    aligned = model.crs == crs and np.allclose(T[:, :2], [[pixel, 0.0], [0.0, -pixel]], rtol=1e-6, atol=pixel * 1e-7)
    if model.crs != crs:
        pixel = model.gsd_m
    if aligned and pixel >= smallest_pixel:
        corner = T[:, 2] + np.array([-pixel / 2, pixel / 2])
        west = float(corner[0]) + math.floor((west - corner[0]) / pixel + 1e-6) * pixel
        north = float(corner[1]) + math.ceil((north - corner[1]) / pixel - 1e-6) * pixel
    pixel = max(pixel, smallest_pixel)
    cols, rows = (max(1, math.ceil(extent / pixel - 1e-6)) for extent in (east - west, north - south))
    overviews = max(0, math.ceil(math.log2(max(rows, cols) / (2 * BLOCK_PX))))
    whole = 2**overviews
    rows, cols = -(-rows // whole) * whole, -(-cols // whole) * whole
    if rows * cols > MAX_PIXELS:
        raise MapError(
            f"the pack would have {cols} x {rows} pixels: the orthophotos lie far apart or are very fine",
            where=model.name,
            remedy="build several packs, or thin the orthophotos (gdalwarp -tr)",
        )
    return TargetGrid(crs, west, north, pixel, rows, cols, overviews)


def outline_box(sources: Sequence[Source], crs: MapCrs) -> tuple[float, float, float, float]:
    """West, south, east, north of all rasters in a CRS. Raises MapError where one has no place in it."""
    boxes = []
    for source in sources:
        points = outline(source, crs)
        if not np.isfinite(points).all():
            raise MapError(f"has no place in {crs.name}", where=source.name, remedy="build a pack of its own from it")
        boxes.append(np.concatenate([points.min(axis=0), points.max(axis=0)]))
    low, high = np.min(boxes, axis=0)[:2], np.max(boxes, axis=0)[2:]
    return float(low[0]), float(low[1]), float(high[0]), float(high[1])


def outline(source: Source, crs: MapCrs) -> FloatArray:
    """(N, 2) points around the raster's edge, in a CRS; NaN where undefined."""
    rows, cols = source.layer.shapes[0]
    t = np.linspace(0.0, 1.0, 33)
    zero, one = np.zeros_like(t), np.ones_like(t)
    share = np.concatenate([np.column_stack(p) for p in ((t, zero), (t, one), (zero, t), (one, t))])
    points = apply_affine(source.layer.T_map_pix, share * [cols, rows] - 0.5)
    return points if source.crs == crs else crs.to_map_array(source.crs.to_geo_array(points))
