"""A map pack: the read-only reference map of a flight. Pixels and heights are read by windows, features by memory map."""

from __future__ import annotations

import math
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from numpy.lib.format import write_array_header_1_0
from numpy.typing import NDArray

from visloc_companion.errors import MapError
from visloc_companion.geo.raster import T_map_pix_from_gdal, apply_affine, compose_affine, invert_affine
from visloc_companion.maps.crs import MapCrs, map_crs
from visloc_companion.maps.geotiff import DatasetLayer, GeoTiff, open_dsm, open_ortho
from visloc_companion.maps.grid import GridMap, Heights
from visloc_companion.maps.layer import Layer, level_shapes
from visloc_companion.maps.manifest import REBUILD, FeatureLevel, Grid, Manifest, read_manifest
from visloc_companion.maps.verify import verify_files
from visloc_companion.types import FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class StoredFeatures:
    """Features of one GSD, memory-mapped: (rows, cols, channels) int8."""

    level: FeatureLevel
    T_map_pix: FloatArray
    stored: NDArray[np.int8]

    @property
    def pixel_map(self) -> float:
        """Side of a pixel in map units."""
        return abs(float(self.T_map_pix[0, 0]))

    def window(self, shift: tuple[int, int], size_px: tuple[int, int]) -> NDArray[np.float32]:
        """(height, width, channels) from column and row `shift`; zero outside."""
        rows, cols, channels = self.stored.shape
        out = np.zeros((size_px[1], size_px[0], channels), np.float32)
        left, top = max(0, shift[0]), max(0, shift[1])
        right, bottom = min(cols, shift[0] + size_px[0]), min(rows, shift[1] + size_px[1])
        if right > left and bottom > top:
            part = out[top - shift[1] : bottom - shift[1], left - shift[0] : right - shift[0]]
            np.multiply(self.stored[top:bottom, left:right], np.float32(self.level.step), out=part)
        return out


class PackMap(GridMap):
    """A reference map over a pack (protocols.ReferenceMap); `manifest` says what it is, `stored` are its features."""

    def __init__(
        self, manifest: Manifest, crs: MapCrs, pixels: Layer, heights: Heights, features: tuple[StoredFeatures, ...]
    ) -> None:
        super().__init__(crs, pixels, heights, manifest.gsd_m)
        self.manifest = manifest
        self.stored = features

    @classmethod
    def open(cls, folder: Path, verify_hashes: bool = True) -> PackMap:
        """Open a pack; sizes are always checked, hashes unless told not to (about 1 s for each GB).

        Raises MapError for what is no pack, or a damaged one (HashMismatch where a file is not the one it should be).
        """
        manifest = read_manifest(folder)
        verify_files(folder, manifest, hashes=verify_hashes)
        crs = map_crs(manifest.crs.wkt, str(folder / "manifest.json"))
        pixels = _layer(open_ortho(folder / manifest.ortho.file), manifest.ortho, crs)
        entry = manifest.heights
        surface = None if entry.grid is None else _layer(open_dsm(folder / entry.grid.file), entry.grid, crs)
        features = tuple(_features(folder, level) for level in manifest.features)
        return cls(manifest, crs, pixels, Heights(surface, crs, entry.plane_amsl_m), features)

    def stored_gsds_m(self, name: str = "gradient") -> tuple[float, ...]:
        """GSDs of the precomputed features, metres on the ground at the map's centre, finest first."""
        return tuple(f.level.gsd_m for f in self.stored if f.level.name == name)

    def recipe(self, name: str = "gradient") -> str:
        """What the stored features were computed with; empty where there are none."""
        return next((f.level.recipe for f in self.stored if f.level.name == name), "")

    def snapped(
        self, center_map_m: tuple[float, float], size_px: tuple[int, int], gsd_m: float, name: str = "gradient"
    ) -> tuple[tuple[float, float], float]:
        """The nearest centre and GSD at which `patch` (heading 0, this size) carries precomputed features.

        The GSD is a stored one within a factor 2^0.25 (rounding included), the centre at most half a pixel away in each axis;
        where no level is that near, both come back unchanged.
        """
        scale = self._crs.linearised_at_map(*center_map_m).scale
        near = [f for f in self.stored if f.level.name == name]
        if not near:
            return center_map_m, gsd_m
        best = min(near, key=lambda f: abs(math.log2(f.pixel_map / scale / gsd_m)))
        if abs(math.log2(best.pixel_map / scale / gsd_m)) > 0.27:
            return center_map_m, gsd_m
        half = (np.array(size_px, dtype=np.float64) - 1) / 2
        pix = np.rint(apply_affine(invert_affine(best.T_map_pix), np.array(center_map_m)) - half) + half
        centre = apply_affine(best.T_map_pix, pix)
        return (float(centre[0]), float(centre[1])), best.pixel_map / self._crs.linearised_at_map(*centre).scale

    def _features(self, T_map_pix: FloatArray, size_px: tuple[int, int]) -> dict[str, NDArray[Any]]:
        found: dict[str, NDArray[Any]] = {}
        corners = np.array([[0.0, 0.0], [size_px[0], 0.0], [0.0, size_px[1]], [size_px[0], size_px[1]]])
        for features in self.stored:
            T = compose_affine(invert_affine(features.T_map_pix), T_map_pix)
            shift = np.rint(T[:, 2])
            if float(np.abs(apply_affine(T, corners) - corners - shift).max()) < 0.01:
                found[features.level.name] = features.window((int(shift[0]), int(shift[1])), size_px)
        return found


def _layer(tiff: GeoTiff, grid: Grid, crs: MapCrs) -> DatasetLayer:
    same_grid = tiff.shape == (grid.rows, grid.cols) and np.allclose(
        tiff.T_map_pix, T_map_pix_from_gdal(grid.transform), rtol=1e-12, atol=1e-6
    )
    if not same_grid or tiff.crs != crs:
        raise MapError("size, place or CRS is not what the manifest says", where=str(tiff.path), remedy=REBUILD)
    return DatasetLayer(tiff, level_shapes(*tiff.shape))


def _features(folder: Path, level: FeatureLevel) -> StoredFeatures:
    """Map the array. Its header is compared, not parsed: numpy's reader evaluates it, and fails in many ways."""
    path = folder / level.file
    shape = (level.rows, level.cols, level.channels)
    header = BytesIO()
    write_array_header_1_0(header, {"descr": "|i1", "fortran_order": False, "shape": shape})
    want = header.getvalue()
    with path.open("rb") as stream:
        got = stream.read(len(want))
    if got != want or path.stat().st_size != len(want) + math.prod(shape):
        raise MapError(f"is not the array of int8 {shape} that the manifest says", where=str(path), remedy=REBUILD)
    stored = np.memmap(path, dtype=np.int8, mode="r", offset=len(want), shape=shape)
    return StoredFeatures(level, T_map_pix_from_gdal(level.transform), stored)
