"""Point clouds from files, in metres: read in chunks, thinned to a number of points that memory allows, without wild points."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from visloc_companion.errors import CloudError
from visloc_companion.maps.cloud_las import open_las
from visloc_companion.maps.cloud_npz import open_npz
from visloc_companion.maps.crs import MapCrs
from visloc_companion.maps.wild import surface_mask
from visloc_companion.types import FloatArray

MAX_POINTS = 8_000_000
"""Most points that are kept. With what reading needs beside it stays below 1 GB, whatever the file holds."""
LARGEST_M = 1e8
"""No place on earth has larger coordinates in a projected CRS."""
LAS_SUFFIXES = (".laz", ".las")
SUFFIXES = (".npz", *LAS_SUFFIXES)
Box = tuple[float, float, float, float]
"""West, south, east, north in metres along the axes of the file's CRS."""


@dataclass(frozen=True, slots=True, eq=False)
class Cloud:
    """Points (N, 3) east, north, up, metres along the axes of `crs` (None: the file states none, its axes are its own).

    Every `stride`-th point of the file (within the box) is there, but for `n_wild` that lay alone.
    """

    name: str
    points_m: FloatArray
    crs: MapCrs | None
    stride: int
    n_wild: int

    @property
    def note(self) -> str:
        """What was left out for the sake of memory; empty where nothing was."""
        return "" if self.stride == 1 else f"{self.name}: every {self.stride}th point is used, for there are too many"


def read_cloud(path: Path, *, box_m: Box | None = None, max_points: int = MAX_POINTS, crs_text: str = "") -> Cloud:
    """The surface points of a `.npz` (array `points` (N, 3), metres), `.las`, `.laz` or COPC file.

    LAS files in feet become metres; classes 7 and 18 and withheld points are left out; `crs_text` serves where they state no CRS.
    More than `max_points` are thinned evenly. Raises CloudError naming file, field and remedy for a file that is missing, cut
    off, damaged, empty (also: within the box), in degrees, or holds what is not finite, no place, or of another shape.
    """
    with _opened(path, crs_text) as (crs, count, chunks):
        kept = Sampler(min(max_points, count), max_points)
        for chunk in chunks:
            check_places(chunk, path)
            kept.add(chunk if box_m is None else chunk[_inside(chunk, box_m)])
    points = kept.points
    if not len(points):
        what = "holds no point that is a surface" if box_m is None else f"holds no point within {box_m}"
        raise CloudError(what, where=str(path), remedy="name a cloud of the place, with points of other classes than noise")
    keep = surface_mask(points)
    n_wild = int(np.count_nonzero(~keep))
    return Cloud(str(path), points[keep] if n_wild else points, crs, kept.stride, n_wild)


def require_same_crs(source: Cloud, reference: Cloud) -> None:
    """Raise CloudError where both clouds state their CRS and these are different grids.

    Two realisations of a datum lie a metre or two apart, which is a registration's to find.
    """
    if source.crs is not None and reference.crs is not None and not source.crs.has_grid_of(reference.crs):
        raise CloudError(
            f"is in {source.crs.name}, the reference in {reference.crs.name}",
            where=source.name,
            remedy="reproject one of them (pdal translate FILE OUT reprojection --filters.reprojection.out_srs=...)",
        )


def check_places(points_m: FloatArray, path: Path) -> None:
    """Raise CloudError where coordinates (N, 3) are not finite or no place on earth."""
    largest = float(np.abs(points_m).max(initial=0.0))
    if not largest <= LARGEST_M:
        raise CloudError(
            f"coordinates of up to {largest:.3g} m are no place", where=f"{path}: points", remedy="leave these points out"
        )


class Sampler:
    """Every stride-th of the points that are added, in their order; the stride doubles whenever they become too many.

    Which points remain depends only on their order and number, not on how they are split into chunks.
    """

    def __init__(self, expected: int, most: int) -> None:
        self.stride = 1
        self._most = max(2, most)
        self._buffer = np.empty((max(2, min(expected, self._most)), 3))
        self._kept = self._seen = 0

    def add(self, points: FloatArray) -> None:
        """Take in (N, 3) points."""
        while True:
            taken = points[-self._seen % self.stride :: self.stride]
            if self._kept + len(taken) <= len(self._buffer):
                break
            half = (self._kept + 1) // 2
            self._buffer[:half] = self._buffer[: self._kept : 2]
            self._kept, self.stride = half, 2 * self.stride
        self._buffer[self._kept : self._kept + len(taken)] = taken
        self._kept += len(taken)
        self._seen += len(points)

    @property
    def points(self) -> FloatArray:
        """(N, 3) what is kept."""
        return self._buffer[: self._kept]


@contextmanager
def _opened(path: Path, crs_text: str) -> Iterator[tuple[MapCrs | None, int, Iterator[FloatArray]]]:
    suffix = path.suffix.lower()
    if suffix == ".npz":
        with open_npz(path) as (count, chunks):
            yield None, count, chunks
    elif suffix in SUFFIXES:
        with open_las(path, crs_text) as las:
            yield las.crs, las.point_count, (chunk * las.metres_per_unit for chunk in las.chunks())
    else:
        raise CloudError(
            f"{suffix or 'no suffix'} is no format of clouds", where=str(path), remedy="name a .npz, .laz or .las file"
        )


def _inside(points_m: FloatArray, box_m: Box) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
    west, south, east, north = box_m
    x, y = points_m[:, 0], points_m[:, 1]
    return np.asarray((x >= west) & (x <= east) & (y >= south) & (y <= north))
