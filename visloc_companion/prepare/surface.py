"""Heights of a pack: the surface model or clouds, their vertical datum, and the grid they are written in."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np

from visloc_companion.errors import DatumMissing, MapError
from visloc_companion.maps.crs import MapCrs
from visloc_companion.maps.geotiff import layer_of, open_dsm, require_heights
from visloc_companion.maps.manifest import Grid, HeightEntry
from visloc_companion.maps.seamless import seam_away
from visloc_companion.maps.spilled import Spill
from visloc_companion.prepare.cloud import cloud_surface
from visloc_companion.prepare.mosaic import Step, write_heights
from visloc_companion.prepare.target import Source, TargetGrid, grid_over, outline, outline_box

Datum = Literal["amsl", "ellipsoidal"]
Box = tuple[float, float, float, float]
"""West, south, east, north (map units)."""
DSM = "dsm.tif"
LARGEST_UNDULATION_M = 120.0
"""The geoid (EGM2008) lies between -107 and +86 m."""


@dataclass(frozen=True, slots=True, eq=False)
class Surface:
    """Where heights come from, what is taken off them (the geoid undulation), and their grid in the pack."""

    sources: tuple[Source, ...]
    datum: Datum
    undulation_m: float | None
    grid: TargetGrid


def surface_sources(dsms: Sequence[Path], clouds: Sequence[Path], cloud_crs: str, spill: Spill) -> tuple[Source, ...]:
    """The surface models or, without one, the upper surfaces of the clouds. Raises MapError, DatumMissing."""
    made = map(_model, dsms) if dsms else (cloud_surface(path, cloud_crs) for path in clouds)
    return tuple(replace(source, layer=spill.kept(source.layer)) for source in made)


def _model(dsm: Path) -> Source:
    tiff = open_dsm(dsm)
    require_heights(tiff)
    gsd_m = tiff.gsd_m
    return Source(str(dsm), layer_of(tiff), tiff.crs, gsd_m)


def make_surface(
    sources: tuple[Source, ...], grid: TargetGrid, stated: Datum | None, undulation_m: float | None
) -> Surface | None:
    """Settle datum and grid; None without a source.

    Raises DatumMissing where heights are ellipsoidal and no undulation is known, MapError where a source does not overlap
    the orthophoto.
    """
    if not sources:
        return None
    here = grid.middle_lat_lon_deg
    sources = tuple(replace(source, layer=seam_away(source.layer, source.crs, here)) for source in sources)
    datum, undulation_m = settled_datum([(source.name, source.crs) for source in sources], stated, undulation_m)
    return Surface(sources, datum, undulation_m, _height_grid(sources, grid))


def settled_datum(
    named: Sequence[tuple[str, MapCrs]], stated: Datum | None, undulation_m: float | None
) -> tuple[Datum, float | None]:
    """Datum of files given by name and CRS, and what is taken off their heights (None above sea level).

    Raises DatumMissing where heights are ellipsoidal and no undulation is known, and where CRS and statement contradict.
    """
    datum = _datum(named, stated)
    if datum == "amsl":
        return datum, None
    if undulation_m is None:
        raise DatumMissing(
            "heights are ellipsoidal and the geoid undulation is not given",
            where=named[0][0],
            remedy="--geoid-undulation-m N, the geoid's height above the ellipsoid at the place",
        )
    if not abs(undulation_m) <= LARGEST_UNDULATION_M:
        raise DatumMissing(
            f"nowhere on earth is the geoid {undulation_m:g} m above the ellipsoid",
            where="--geoid-undulation-m",
            remedy="name the geoid's height above the ellipsoid, not that of the ground",
        )
    return datum, undulation_m


def write_surface(folder: Path, surface: Surface, grid: TargetGrid, plane_h_amsl_m: float, step: Step) -> HeightEntry:
    """Write the heights above sea level. Raises MapError where the source has none on the orthophoto."""
    own = surface.grid
    known, filled = write_heights(folder / DSM, own, surface.sources, surface.undulation_m or 0.0, step)
    if not known:
        raise MapError(
            "holds no height on the orthophoto", where=surface.sources[0].name, remedy="name the surface model of the place"
        )
    area = _area(_common(own.bounds, grid.bounds)) / _area(grid.bounds)
    return HeightEntry(
        source_datum=surface.datum,
        geoid_undulation_m=surface.undulation_m,
        plane_amsl_m=plane_h_amsl_m,
        grid=Grid(file=DSM, rows=own.rows, cols=own.cols, transform=own.transform),
        share_known=min(1.0, known * area),
        share_filled=filled,
    )


def _datum(named: Sequence[tuple[str, MapCrs]], stated: Datum | None) -> Datum:
    """What the user says, else what the CRS says (three-dimensional: ellipsoidal), else above sea level."""
    if depths := [(name, crs.vertical_name) for name, crs in named if crs.counts_down]:
        raise DatumMissing(
            f"its CRS says that it holds depths ({depths[0][1]})",
            where=depths[0][0],
            remedy="turn them round (gdal_calc.py -A FILE --calc=-A --outfile NEW.tif), and state the CRS of its grid alone",
        )
    ellipsoidal = [name for name, crs in named if crs.is_ellipsoidal_3d]
    if stated == "amsl" and ellipsoidal:
        raise DatumMissing(
            "its CRS says that heights are ellipsoidal", where=ellipsoidal[0], remedy="--vertical-datum ellipsoidal"
        )
    sea_level = [(name, crs.sea_level_name) for name, crs in named if crs.sea_level_name]
    if stated == "ellipsoidal" and sea_level:
        raise DatumMissing(
            f"its CRS says that heights are above sea level ({sea_level[0][1]})",
            where=sea_level[0][0],
            remedy="leave --vertical-datum ellipsoidal out; where the CRS is wrong, state that of its grid alone "
            "(gdal_edit.py -a_srs, for clouds las2las -epsg or pdal translate)",
        )
    if 0 < len(ellipsoidal) < len(named) and stated is None:
        raise DatumMissing("heights of the files have different datums", where=ellipsoidal[0], remedy="convert them to one")
    return stated or ("ellipsoidal" if ellipsoidal else "amsl")


def _height_grid(sources: tuple[Source, ...], grid: TargetGrid) -> TargetGrid:
    """Over what the sources and the orthophoto share, and a pixel more where the sources reach, so that heights at its border lie
    between known ones; the pixel of the first source, but not finer than the orthophoto's."""
    west, south, east, north = grid.bounds
    for source in sources:
        edge = outline(source, grid.crs)
        known = edge[np.isfinite(edge).all(axis=1)]
        apart = not len(known) or (known.max(axis=0) <= [west, south]).any() or (known.min(axis=0) >= [east, north]).any()
        if apart:
            raise MapError(
                "does not overlap the orthophoto", where=source.name, remedy="name the surface model of the place, check its CRS"
            )
    box = outline_box(sources, grid.crs)
    shared = grid_over(sources[0], grid.crs, _common(grid.bounds, box), smallest_pixel=grid.pixel)
    more = shared.pixel
    grown = west - more, south - more, east + more, north + more
    return grid_over(sources[0], grid.crs, _common(grown, box), smallest_pixel=grid.pixel)


def _area(box: Box) -> float:
    return (box[2] - box[0]) * (box[3] - box[1])


def _common(a: Box, b: Box) -> Box:
    return max(a[0], b[0]), max(a[1], b[1]), min(a[2], b[2]), min(a[3], b[3])
