"""Correlation of complex fields with many templates by overlapping blocks of the discrete Fourier transform.

    c(s) = sum over k, x of  conj(T_k(x)) F_k(s + offset + x)        s: every pixel of a box

The fields outside their array are zero. A field holds two real channels as real and imaginary part: the real part of c is then
the sum of both real correlations, and against a real template the two parts are the two correlations. The box is cut into
blocks whose size is chosen for the least work (overlap-save: Oppenheim & Schafer, Discrete-Time Signal Processing, section 8.7),
so that a template is transformed at its own size, not at the map's.

OpenCV's transform is used where Intel's primitives are in it, else SciPy's: measured for 256 x 256 complex values 0.08 ms with
the primitives, 0.20 ms SciPy, 0.82 ms OpenCV without them.
"""

from __future__ import annotations

from functools import cache
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from visloc_companion.localise.features.base import Float32Array

Complex64Array = NDArray[np.complex64]
Box = tuple[int, int, int, int]
"""(u_first, v_first, u_last, v_last), both ends included."""

USUAL_SIZE, LARGEST_SIZE = 640, 4800
"""Longest transform that is chosen where the template is shorter (longer ones leave the cache: measured), and of all."""
PRODUCT_WORK = 4.0
"""Work of a complex multiply-add in units of a transform's work per value and bit of its length (measured)."""

WHOLE_VALUES, SUMMED_VALUES = 100_000, 16384
"""Sums over the fields of transforms of so many values or more are worked out so many at a time, which stay in the cache then
(measured, 5 fields: 1.1 to 1.5 times as fast from 320 x 320 on, no faster below)."""


class BlockCorrelator:
    """The fields' block spectra over a box of positions, shared by all templates.

    `fields` (K, H, W) complex64; `box` the positions wanted, in pixels of the fields, inside or outside; `extent` the smallest
    box that holds all templates about their position; `size` the transforms' height and width (`block_size`). `blocks` are the
    rows and columns of the box that each block covers. Read-only after construction: any number of threads may correlate.
    """

    def __init__(self, fields: Complex64Array, box: Box, extent: Box, size: tuple[int, int]) -> None:
        self._extent, self._size = extent, size
        rows, cols = box[3] - box[1] + 1, box[2] - box[0] + 1
        down, right = size[0] - (extent[3] - extent[1]), size[1] - (extent[2] - extent[0])
        self.blocks = [
            (slice(r, min(rows, r + down)), slice(c, min(cols, c + right)))
            for r in range(0, rows, down)
            for c in range(0, cols, right)
        ]
        top, left = box[1] + extent[1], box[0] + extent[0]
        self._spectra = [_forward(_window(fields, top + r.start, left + c.start, size)) for r, c in self.blocks]

    def spectrum(self, template: Complex64Array | Float32Array, offset_px: tuple[int, int]) -> Complex64Array:
        """(K, h, w) conjugate spectrum of a template whose first pixel lies `offset_px` (u, v) from the position."""
        out = self.room(len(template))
        self.transform(template, offset_px, out)
        return out

    def room(self, fields: int | None = None) -> Complex64Array:
        """An array for `transform`: for templates of as many fields, or of so many."""
        return np.empty((len(self._spectra[0]) if fields is None else fields, *self._size), np.complex64)

    def transform(self, template: Complex64Array | Float32Array, offset_px: tuple[int, int], out: Complex64Array) -> None:
        """Write a template's `spectrum` to an array that may serve for many."""
        left, top = offset_px[0] - self._extent[0], offset_px[1] - self._extent[1]
        height, width = template.shape[-2:]
        right, bottom = self._extent[2] - self._extent[0] + 1, self._extent[3] - self._extent[1] + 1
        if min(left, top) < 0 or top + height > bottom or left + width > right:
            raise ValueError(f"template of {width} x {height} px at {offset_px} is outside the extent {self._extent}")
        out.fill(0)
        out[:, top : top + height, left : left + width] = template
        np.conjugate(_forward(out), out=out)

    def summed(self, block: int, spectrum: Complex64Array) -> Complex64Array:
        """(rows, cols) correlation summed over the fields, over a block."""
        fields = self._spectra[block]
        if len(fields) == 1:
            return self._cut(block, fields[0] * spectrum[0])
        height, width = self._size
        rows = height if height * width < WHOLE_VALUES else max(1, SUMMED_VALUES // width)
        total = np.empty(self._size, np.complex64)
        product = np.empty((rows, width), np.complex64)
        for first in range(0, height, rows):
            part = slice(first, first + rows)
            summed, other = total[part], product[: height - first]
            np.multiply(fields[0][part], spectrum[0][part], out=summed)
            for field, of_template in zip(fields[1:], spectrum[1:], strict=True):
                np.multiply(field[part], of_template[part], out=other)
                summed += other
        return self._cut(block, total)

    def each(self, block: int, spectrum: Complex64Array) -> list[Complex64Array]:
        """(rows, cols) correlation of each field with the one template of `spectrum` (1, h, w), over a block."""
        return [self._cut(block, field * spectrum[0]) for field in self._spectra[block]]

    def _cut(self, block: int, spectrum: Complex64Array) -> Complex64Array:
        rows, cols = self.blocks[block]
        return _inverse(spectrum)[: rows.stop - rows.start, : cols.stop - cols.start]


def block_size(box: Box, extent: Box, fields: int, templates: int) -> tuple[int, int]:
    """Height and width of the transforms that do the least work: summed over so many fields but one, the last for itself."""
    along = []
    for axis in (1, 0):
        wanted, reach = (area[axis + 2] - area[axis] + 1 for area in (box, extent))
        sizes = _fast_sizes()
        sizes = sizes[int(np.searchsorted(sizes, reach)) : int(np.searchsorted(sizes, wanted + reach - 1)) + 1]
        sizes = sizes[: max(1, int(np.searchsorted(sizes, USUAL_SIZE, side="right")))]
        if not len(sizes):
            raise ValueError(f"a template of {reach} px is beyond the largest transform of {LARGEST_SIZE} px")
        along.append((sizes, -(-wanted // (sizes - reach + 1))))
    (heights, across), (widths, down) = along
    values = np.multiply.outer(heights, widths).astype(np.float64)
    blocks = np.multiply.outer(across, down)
    transform = values * np.log2(values)
    work = templates * (fields * transform + blocks * (2 * transform + PRODUCT_WORK * fields * values))
    work += blocks * fields * transform
    row, col = np.unravel_index(int(np.argmin(work)), work.shape)
    return int(heights[row]), int(widths[col])


@cache
def _fast_sizes() -> NDArray[np.int64]:
    """Multiples of 8 without prime factors beyond 5."""
    found = {2**a * 3**b * 5**c for a in range(3, 13) for b in range(8) for c in range(6)}
    return np.array(sorted(size for size in found if size <= LARGEST_SIZE))


def paired(values: Float32Array) -> Complex64Array:
    """(K, H, W) complex64 field: the channels of (H, W, C), two by two."""
    if values.shape[2] % 2:
        values = np.concatenate([values, np.zeros_like(values[..., :1])], -1)
    return np.ascontiguousarray(np.moveaxis(np.ascontiguousarray(values).view(np.complex64), -1, 0))


def correlated_within(fields: Complex64Array, template: Complex64Array) -> Complex64Array:
    """(H - h + 1, W - w + 1) correlation, summed over K, of a template (K, h, w) with fields (K, H, W) that hold all of it."""
    (count, height, width), (_, rows, cols) = fields.shape, template.shape
    both = np.zeros((2 * count, cv2.getOptimalDFTSize(height), cv2.getOptimalDFTSize(width)), np.complex64)
    both[:count, :height, :width], both[count:, :rows, :cols] = fields, template
    both = _forward(both)
    product = np.conjugate(both[count:], out=both[count:])
    product *= both[:count]
    return _inverse(product.sum(axis=0))[: height - rows + 1, : width - cols + 1]


def _window(fields: Complex64Array, top: int, left: int, size: tuple[int, int]) -> Complex64Array:
    """(K, *size) of the fields from a pixel on, zero outside them."""
    found = np.zeros((fields.shape[0], *size), np.complex64)
    r0, c0 = max(0, top), max(0, left)
    r1, c1 = min(fields.shape[1], top + size[0]), min(fields.shape[2], left + size[1])
    if r1 > r0 and c1 > c0:
        found[:, r0 - top : r1 - top, c0 - left : c1 - left] = fields[:, r0:r1, c0:c1]
    return found


def _forward(values: Complex64Array) -> Complex64Array:
    if not cv2.ipp.useIPP():
        return np.asarray(_scipy_fft().fft2(values, overwrite_x=True), dtype=np.complex64)
    for plane in values.view(np.float32).reshape(*values.shape, 2):
        cv2.dft(plane, dst=plane)
    return values


def _inverse(spectrum: Complex64Array) -> Complex64Array:
    if not cv2.ipp.useIPP():
        return np.asarray(_scipy_fft().ifft2(spectrum, overwrite_x=True), dtype=np.complex64)
    parts = spectrum.view(np.float32).reshape(*spectrum.shape, 2)
    cv2.dft(parts, dst=parts, flags=cv2.DFT_INVERSE | cv2.DFT_SCALE)
    return spectrum


def _scipy_fft() -> Any:
    """Loading it takes two thirds as long as all else that localises."""
    import scipy.fft  # type: ignore[import-untyped]

    return scipy.fft


if not cv2.ipp.useIPP():  # where it is needed, before the first frame
    _scipy_fft()
