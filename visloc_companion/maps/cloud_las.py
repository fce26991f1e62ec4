"""LAS, LAZ and COPC files by laspy (the extra `prep`): read once from the first point to the last, in chunks of bounded memory.

A COPC file is a LAZ file whose points are sorted; it is read like any other.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from visloc_companion.errors import CloudError, VislocError
from visloc_companion.maps.cloud_npz import require_file
from visloc_companion.maps.crs import MapCrs, map_crs
from visloc_companion.maps.las_crs import height_unit_m, stated_wkt
from visloc_companion.types import FloatArray

NOISE_CLASSES = (7, 18)
"""ASPRS LAS 1.4: low point, high noise."""
CHUNK_POINTS = 1_000_000
RUST_PANIC = "PanicException"
"""What the decoder raises where it gives up; it is no Exception."""
LAZ_BIT = 0x80
"""Of the point format in the header of a compressed file."""
READ_AGAIN = "copy or download the file again"


@dataclass(frozen=True, slots=True, eq=False)
class LasFile:
    """An open file. `low`, `high` (3,) are the header's bounds in the units of the file; a unit of height has `height_unit_m`.

    `states_crs`: `crs` is what the file says, not what it was opened with.
    """

    path: Path
    reader: Any
    crs: MapCrs | None
    states_crs: bool
    point_count: int
    low: FloatArray
    high: FloatArray
    height_unit_m: float

    @property
    def metres_per_unit(self) -> FloatArray:
        """(3,) of easting, northing and height; 1 where the file states no CRS."""
        if self.crs is None:
            return np.ones(3)
        return np.array([self.crs.metres_per_unit, self.crs.metres_per_unit, self.height_unit_m])

    def chunks(self, chunk_points: int = CHUNK_POINTS) -> Iterator[FloatArray]:
        """(N, 3) points in the file's CRS and units, without noise classes and withheld points.

        Raises CloudError where the file ends before the points that its header states.
        """
        done = 0
        while done < self.point_count:
            with las_errors(self.path):
                records = self.reader.read_points(chunk_points)
                if not len(records):
                    break
                done += len(records)
                points = _surface_points(records)
            yield points
        if done < self.point_count:
            raise CloudError(
                f"is cut off: the header states {self.point_count} points, {done} are there",
                where=str(self.path),
                remedy=READ_AGAIN,
            )


@contextmanager
def open_las(path: Path, crs_text: str = "") -> Iterator[LasFile]:
    """Open a file; `crs_text` (EPSG:CODE or WKT) serves where it states no CRS.

    Raises CloudError where it cannot be read, states no point or no scale, or is in degrees, and where laspy is missing; MapError
    for a CRS that is none.
    """
    laspy = _laspy(path)
    require_file(path, "name a .las or .laz file")
    wanted = laspy.DecompressionSelection
    with las_errors(path):
        _check_records(path)
        _check_chunks(path)
        reader = laspy.open(
            path,
            laz_backend=laspy.LazBackend.Lazrs,  # the parallel one takes what memory a damaged file asks for, and aborts
            decompression_selection=wanted.XY_RETURNS_CHANNEL | wanted.Z | wanted.CLASSIFICATION | wanted.FLAGS,
        )
    with reader:
        with las_errors(path):
            header = reader.header
            stated = stated_wkt(header)
            text = stated or crs_text
            count = int(header.point_count)
            low, high = np.array(header.mins, np.float64), np.array(header.maxs, np.float64)
            steps, offsets = np.array(header.scales, np.float64), np.array(header.offsets, np.float64)
        if count == 0:
            raise CloudError("holds no point", where=str(path), remedy="name a cloud with content")
        if not (np.isfinite([steps, offsets]).all() and steps.all()):
            what = f"header: scale factors {steps} and offsets {offsets} give no coordinates"
            raise CloudError(what, where=str(path), remedy=f"{READ_AGAIN}, or write it anew (las2las)")
        if not (np.isfinite(low).all() and np.isfinite(high).all() and (low <= high).all()):
            raise CloudError(f"header: bounds {low} to {high} are no box", where=str(path), remedy=READ_AGAIN)
        crs = map_crs(text, str(path)) if text else None
        if crs is not None and crs.is_geographic:
            raise CloudError("is in degrees", where=str(path), remedy="reproject it to a CRS in metres (pdal, las2las)")
        with las_errors(path):
            height_m = height_unit_m(header, crs)
        yield LasFile(path, reader, crs, stated != "", count, low, high, height_m)


@contextmanager
def las_errors(path: Path) -> Iterator[None]:
    """What laspy and the decoder raise for a damaged file (of any type: they trust what they read) as a CloudError."""
    try:
        yield
    except VislocError:
        raise
    except BaseException as why:
        if not isinstance(why, Exception) and type(why).__name__ != RUST_PANIC:
            raise
        raise CloudError(f"cannot be read as a point cloud: {why}", where=str(path), remedy=READ_AGAIN) from why


def _check_records(path: Path) -> None:
    """Refuse a header that states more records of variable length than fit the file: laspy would make room for them all.

    Offsets and sizes: ASPRS LAS 1.4, tables 3, 5 and 6.
    """
    with path.open("rb") as stream:
        head = stream.read(247)
    if head[:4] != b"LASF":
        raise CloudError("is no LAS file: it does not begin with LASF", where=str(path), remedy=READ_AGAIN)
    header_size, to_points, count = struct.unpack_from("<HII", head, 94)
    (more,) = struct.unpack_from("<I", head, 243) if (head[24], head[25]) >= (1, 4) else (0,)
    if count * 54 > max(0, to_points - header_size) or more * 60 > path.stat().st_size:
        raise CloudError(
            f"header: states {count} and {more} records, for which it has no room", where=str(path), remedy=READ_AGAIN
        )


def _check_chunks(path: Path) -> None:
    """Refuse a compressed file whose table of chunks states more of them than it has bytes: the decoder would make room for them
    all, and abort the process where it cannot.

    LASzip: the points begin with the table's offset (-1: in the last eight bytes of the file), the table with version and number.
    """
    size = path.stat().st_size
    with path.open("rb") as stream:
        head = stream.read(105)
        if not head[104] & LAZ_BIT:
            return
        (to_points,) = struct.unpack_from("<I", head, 96)
        at = _int64(stream, to_points, size)
        at = _int64(stream, size - 8, size) if at == -1 else at
        if at is None or not 0 < at <= size - 8:
            what = "the table of its chunks lies outside of the file (it is cut off, or a LASzip of before 2011 made it)"
            raise CloudError(what, where=str(path), remedy=f"{READ_AGAIN}, or write it anew (las2las)")
        stream.seek(at)
        _, n_chunks = struct.unpack("<II", stream.read(8))
    if n_chunks > size:
        raise CloudError(f"states {n_chunks} chunks, for which it has no room", where=str(path), remedy=READ_AGAIN)


def _int64(stream: BinaryIO, at: int, size: int) -> int | None:
    if not 0 <= at <= size - 8:
        return None
    stream.seek(at)
    return int(struct.unpack("<q", stream.read(8))[0])


def _surface_points(records: Any) -> FloatArray:
    keep = ~np.isin(np.asarray(records.classification), NOISE_CLASSES) & (np.asarray(records.withheld) == 0)
    points = np.empty((int(np.count_nonzero(keep)), 3))
    for k, axis in enumerate((records.x, records.y, records.z)):
        points[:, k] = np.asarray(axis)[keep]
    return points


def _laspy(path: Path) -> Any:
    try:
        import laspy
    except ImportError as why:
        raise CloudError(
            "reading .las and .laz needs laspy", where=str(path), remedy="pip install 'visloc-companion[prep]'"
        ) from why
    return laspy
