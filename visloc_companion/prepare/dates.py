"""Orthophotos of other dates: the map's features are the mean over all dates, so that what changes from year to year counts less.

A feature's length is its weight in the search: where the dates show the same edges it stays, where each shows another crop it
shrinks. In flight nothing is added, for the pack holds the mean.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from visloc_companion.errors import MapError
from visloc_companion.localise.features.base import Features, Float32Array, without_margin
from visloc_companion.maps.geotiff import files_of, stretches_of
from visloc_companion.maps.manifest import OtherDate, SourceEntry, source_entry
from visloc_companion.maps.seamless import seam_away
from visloc_companion.maps.spilled import Spill
from visloc_companion.maps.stored import NEAR_OCTAVES
from visloc_companion.prepare.date_shift import shift_between
from visloc_companion.prepare.mosaic import merged, resampled
from visloc_companion.prepare.target import Source, TargetGrid, ortho_source
from visloc_companion.types import FloatArray

LEAST_MOVE_PX = 0.1
"""What lies nearer than this is left where it is, for resampling blurs."""
MOST_MOVE_M = 50.0
"""Datums that are mixed up move a picture by more; rectification is not so far off."""
BENT_PX = 1.0
"""Parts of a date that lie further beside the rest, in the pack's pixels, blur what they are the mean with."""


@dataclass(frozen=True, slots=True, eq=False)
class DatedSource:
    """An orthophoto of another date, and how it is laid on the first one."""

    source: Source
    laid: OtherDate

    def serves(self, gsd_m: float) -> bool:
        """Whether its pixels are fine enough for features of a GSD."""
        return self.source.gsd_m <= gsd_m * 2**NEAR_OCTAVES

    def window(
        self, grid: TargetGrid, T_map_pix: FloatArray, size_px: tuple[int, int]
    ) -> tuple[NDArray[np.uint8], NDArray[np.bool_]]:
        """(H, W) or (H, W, 3) pixels of a (width, height) window of the pack's grid, and where there are any."""
        moved = np.array([[0.0, 0.0, self.laid.moved_east_m], [0.0, 0.0, self.laid.moved_north_m]])
        return resampled(self.source, grid, T_map_pix - moved, size_px)


def dated_sources(paths: Sequence[Path], sources: Sequence[Source], grid: TargetGrid, spill: Spill) -> tuple[DatedSource, ...]:
    """Open the orthophotos of other dates and lay each on the pack's own (`sources`, the first on top).

    Raises MapError for a file that cannot be read, and for one that cannot be laid on them: of another place, or all water.
    """
    return tuple(_laid(_opened(path, spill, grid), sources, grid) for path in paths)


def named_again(paths: Sequence[Path], entries: Sequence[OtherDate], folder: Path, grid: TargetGrid) -> tuple[DatedSource, ...]:
    """The orthophotos of the dates that a pack of this grid was made of, as they were laid then.

    Raises MapError where other files are named than these, in their order.
    """
    spill = Spill(folder.parent)
    opened = [_opened(path, spill, grid) for path in paths]
    if [inputs for _, inputs in opened] != [entry.inputs for entry in entries]:
        names = " ".join(entry.inputs[0].file for entry in entries)
        raise MapError(
            "its features are the mean over other dates, too" if entries else "it was built from one date",
            where=str(folder),
            remedy=f"name the same files, in their order: --other-dates {names}" if entries else "build it again with them",
        )
    return tuple(DatedSource(source, entry) for (source, _), entry in zip(opened, entries, strict=True))


def bent_dates(dates: Sequence[OtherDate], gsd_m: float) -> list[str]:
    """A sentence on each date of which parts lie more than a pixel beside the rest: its features are blurred there."""
    return [
        f"parts of {date.inputs[0].file} lie {date.parts_apart_m:.1f} m (root mean square) beside the first orthophoto: its "
        "edges and those of the others blur; rectify it anew, with the same surface model, or leave it out of --other-dates"
        for date in dates
        if date.parts_apart_m is not None and date.parts_apart_m > BENT_PX * gsd_m
    ]


def mean_features(
    features: Features,
    own: tuple[NDArray[np.uint8], NDArray[np.bool_]],
    dates: Iterable[tuple[NDArray[np.uint8], NDArray[np.bool_]]],
    margin_px: int,
) -> Float32Array:
    """(H, W, C) features of a window (pixels and validity, with a margin) as the mean over all dates that show a pixel."""
    total = features(*own, margin_px)
    n_dates = np.ones((*total.shape[:2], 1), np.float32)
    for pixels, valid in dates:
        inner = without_margin(valid, margin_px)
        if inner.any():
            total = total + features(pixels, valid, margin_px)
            n_dates += inner[..., None]
    return np.asarray(total / n_dates, dtype=np.float32)


def _opened(path: Path, spill: Spill, grid: TargetGrid) -> tuple[Source, tuple[SourceEntry, ...]]:
    source = ortho_source(path, stretches_of([path]), spill)
    layer = seam_away(source.layer, source.crs, grid.middle_lat_lon_deg)
    return replace(source, layer=layer), tuple(map(source_entry, files_of(path)))


def _laid(opened: tuple[Source, tuple[SourceEntry, ...]], sources: Sequence[Source], grid: TargetGrid) -> DatedSource:
    source, inputs = opened
    pixel = max(grid.pixel, source.gsd_m * grid.pixel / sources[0].gsd_m)
    channels = max(each.layer.channels for each in sources)
    shift = shift_between(
        lambda T_map_pix, size_px: merged(sources, grid, T_map_pix, size_px, channels),
        lambda T_map_pix, size_px: resampled(source, grid, T_map_pix, size_px),
        grid.bounds,
        pixel,
    )
    remedy = "check its CRS and place (gdalinfo), or leave it out of --other-dates"
    if shift is None:
        raise MapError(f"nothing shows how it lies on {sources[0].name}", where=source.name, remedy=remedy)
    if (away := math.hypot(shift.east, shift.north)) > MOST_MOVE_M:
        raise MapError(f"lies {away:.0f} m beside {sources[0].name}", where=source.name, remedy=remedy)
    near = max(abs(shift.east), abs(shift.north)) < LEAST_MOVE_PX * pixel
    east_m, north_m = (0.0, 0.0) if near else (-shift.east, -shift.north)
    parts_m = None if math.isnan(shift.parts) else shift.parts
    return DatedSource(source, OtherDate(moved_east_m=east_m, moved_north_m=north_m, parts_apart_m=parts_m, inputs=inputs))
