"""Layers on the disk instead of in memory: each tile of a survey is small, and there are hundreds of them."""

from __future__ import annotations

import tempfile
import weakref
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any

import numpy as np

from visloc_companion.errors import MapError
from visloc_companion.maps.layer import ArrayLayer, Layer, Validity, Values
from visloc_companion.types import FloatArray

MOST_HELD_BYTES = 800_000_000
"""Layers together take so much memory at most."""


class Spill:
    """Keeps layers in memory while there is room, and those that come after in a file that has no name and goes with them.

    The file lies in `folder`, on the disk that the pack will lie on: /tmp is memory on many computers.
    """

    def __init__(self, folder: Path) -> None:
        self._folder, self._room = folder, MOST_HELD_BYTES
        self._file: IO[bytes] | None = None

    def kept(self, layer: Layer) -> Layer:
        """The layer, or the same on the disk. Raises MapError where the disk refuses."""
        if not isinstance(layer, ArrayLayer):
            return layer
        size = sum(values.nbytes + valid.nbytes for values, valid in layer.levels)
        if size <= self._room:
            self._room -= size
            return layer
        try:
            places = tuple((self._written(values), self._written(valid)) for values, valid in layer.levels)
            self.file.flush()
        except OSError as why:
            raise MapError(
                f"{size / 1e6:.1f} MB of a raster that memory has no room for cannot be written: {why.strerror}",
                where=str(self._folder),
                remedy="check the disk and its free space: all rasters lie there unpacked while the pack is built",
            ) from why
        return SpilledLayer(self, layer.T_map_pix, layer.channels, layer.dtype, layer.shapes, places)

    @property
    def file(self) -> IO[bytes]:
        """The open file. Raises OSError."""
        if self._file is None:
            self._file = tempfile.TemporaryFile(dir=self._folder)  # noqa: SIM115 - closed with the last layer
            weakref.finalize(self, self._file.close)
        return self._file

    def _written(self, array: Values) -> int:
        """Where in the file an array begins."""
        at = self.file.seek(0, 2)
        self.file.write(np.ascontiguousarray(array).data)
        return at


@dataclass(frozen=True, slots=True, eq=False)
class SpilledLayer:
    """A layer in a file: where the values and the validity of each level begin. Mapped for each window anew: what was mapped
    before leaves the memory."""

    spill: Spill
    T_map_pix: FloatArray
    channels: int
    dtype: np.dtype[Any]
    shapes: tuple[tuple[int, int], ...]
    places: tuple[tuple[int, int], ...]

    def read(self, level: int, rows: tuple[int, int], cols: tuple[int, int]) -> tuple[Values, Validity]:
        """Copies of the window."""
        shape, (values, valid) = self.shapes[level], self.places[level]
        full = shape if self.channels == 1 else (*shape, self.channels)
        window = slice(*rows), slice(*cols)
        file: Any = self.spill.file
        return (
            np.array(np.memmap(file, self.dtype, "r", values, full)[window]),
            np.array(np.memmap(file, np.uint8, "r", valid, shape)[window]),
        )
