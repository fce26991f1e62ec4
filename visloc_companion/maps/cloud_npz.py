"""Clouds in `.npz` files: the array `points` (N, 3), decompressed in chunks, so that memory does not grow with the file."""

from __future__ import annotations

import zipfile
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.lib import format as npy

from visloc_companion.errors import CloudError
from visloc_companion.types import FloatArray

FIELD = "points"
CHUNK_POINTS = 1_000_000
LARGEST_BY_COLUMNS = 10_000_000
"""Points of an array stored column by column, which is held whole: its first point needs the last part of the file."""
_WRITE_AGAIN = "write it as numpy.savez_compressed(FILE, points=xyz) with xyz (N, 3) float in metres"


def require_file(path: Path, remedy: str) -> None:
    """Raises CloudError where there is no such file, or this user may not look."""
    try:
        what = "" if path.is_file() else "there is no such file"
    except OSError as why:
        what = f"cannot be read: {why.strerror}"
    if what:
        raise CloudError(what, where=str(path), remedy=remedy)


@contextmanager
def open_npz(path: Path) -> Iterator[tuple[int, Iterator[FloatArray]]]:
    """Number of points, and chunks (n, 3) of them. Raises CloudError naming what is wrong; nothing in the file is executed."""
    require_file(path, "name a .npz, .las or .laz file")
    where = f"{path}: {FIELD}"
    try:
        with zipfile.ZipFile(path) as archive:
            names = archive.namelist()
            if f"{FIELD}.npy" not in names:
                found = ", ".join(sorted(name.removesuffix(".npy") for name in names[:10])) or "nothing"
                raise CloudError(f"has no array {FIELD!r}, it has {found}", where=str(path), remedy=_WRITE_AGAIN)
            with archive.open(f"{FIELD}.npy") as stream:
                (count, columns), by_columns, kind = _header(stream, where)
                if count == 0:
                    raise CloudError("holds no point", where=where, remedy="name a cloud with content")
                yield count, _chunks(stream, count * columns, by_columns, kind, where)
    except (OSError, EOFError, zipfile.BadZipFile, zlib.error, NotImplementedError, RuntimeError) as why:
        raise CloudError(f"cannot be read as .npz: {why}", where=str(path), remedy="copy the file again") from why


def _header(stream: IO[bytes], where: str) -> tuple[tuple[int, int], bool, np.dtype[Any]]:
    try:
        version = npy.read_magic(stream)
        read = npy.read_array_header_1_0 if version == (1, 0) else npy.read_array_header_2_0
        shape, by_columns, kind = read(stream)
    except Exception as why:  # numpy's reader of headers parses them as Python, and fails as variously as that does
        raise CloudError(f"is no array: {why}", where=where, remedy=_WRITE_AGAIN) from why
    if kind.hasobject:
        raise CloudError("holds pickled objects, which are never loaded", where=where, remedy=_WRITE_AGAIN)
    if len(shape) != 2 or shape[1] != 3:
        raise CloudError(f"has the shape {shape}, not (N, 3)", where=where, remedy=_WRITE_AGAIN)
    if kind.kind not in "fiu":
        raise CloudError(f"holds {kind}, not numbers", where=where, remedy=_WRITE_AGAIN)
    return (int(shape[0]), 3), bool(by_columns), kind


def _chunks(stream: IO[bytes], numbers: int, by_columns: bool, kind: np.dtype[Any], where: str) -> Iterator[FloatArray]:
    count = numbers // 3
    if by_columns:
        if count > LARGEST_BY_COLUMNS:
            raise CloudError(
                f"{count} points are stored column by column, which takes them all into memory",
                where=where,
                remedy="write numpy.ascontiguousarray(xyz)",
            )
        columns = [_read(stream, count, kind, where) for _ in range(3)]
        yield np.column_stack(columns)
        return
    for start in range(0, count, CHUNK_POINTS):
        yield _read(stream, 3 * min(CHUNK_POINTS, count - start), kind, where).reshape(-1, 3)


def _read(stream: IO[bytes], numbers: int, kind: np.dtype[Any], where: str) -> FloatArray:
    raw = stream.read(numbers * kind.itemsize)
    if len(raw) < numbers * kind.itemsize:
        raise CloudError("is cut off: it ends before its last point", where=where, remedy="copy the file again")
    values = np.frombuffer(raw, kind).astype(np.float64)
    if bad := int(np.count_nonzero(~np.isfinite(values))):
        raise CloudError(f"{bad} values are not finite", where=where, remedy="leave these points out")
    return values
