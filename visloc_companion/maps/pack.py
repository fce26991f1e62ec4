"""A map pack: the read-only reference map of a flight. Pixels and heights are read by windows, features by memory map."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from visloc_companion.errors import MapError, OutsideMap
from visloc_companion.geo.raster import T_map_pix_from_gdal, apply_affine, compose_affine, invert_affine
from visloc_companion.maps.cloud_tiles import StoredCloud, open_cloud
from visloc_companion.maps.crs import MapCrs, map_crs
from visloc_companion.maps.ed25519 import PublicKey
from visloc_companion.maps.geotiff import DatasetLayer, GeoTiff, open_dsm, open_ortho
from visloc_companion.maps.grid import GridMap, Heights
from visloc_companion.maps.layer import Layer, level_shapes
from visloc_companion.maps.manifest import REBUILD, Grid, Manifest
from visloc_companion.maps.signature import read_signed
from visloc_companion.maps.stored import NEAR_OCTAVES, StoredFeatures, open_stored
from visloc_companion.maps.verify import verify_files
from visloc_companion.maps.world_file import as_hashed
from visloc_companion.types import FeaturePatch, FloatArray


class PackMap(GridMap):
    """A reference map over a pack (protocols.ReferenceMap, FeatureMap); `manifest` says what it is, `stored` are its features."""

    def __init__(
        self,
        manifest: Manifest,
        crs: MapCrs,
        pixels: Layer,
        heights: Heights,
        features: tuple[StoredFeatures, ...],
        cloud: StoredCloud | None,
    ) -> None:
        super().__init__(crs, pixels, heights, manifest.gsd_m)
        self.manifest = manifest
        self.stored = features
        self.cloud = cloud

    @classmethod
    def open(cls, folder: Path, verify_hashes: bool = True, trusted: Sequence[PublicKey] = ()) -> PackMap:
        """Open a pack; sizes are always checked, hashes unless told not to (about 1 s for each GB). Where keys are trusted the
        manifest must be signed by one of them, which says of the files what their hashes do.

        Raises MapError for what is no pack, or a damaged one (HashMismatch where a file is not the one it should be,
        SignatureInvalid where no trusted key signed it).
        """
        manifest = read_signed(folder, trusted)
        verify_files(folder, manifest, hashes=verify_hashes)
        crs = map_crs(manifest.crs.wkt, str(folder / "manifest.json"))
        entry = manifest.heights
        with as_hashed():
            pixels = _layer(open_ortho(folder / manifest.ortho.file), manifest.ortho, crs)
            surface = None if entry.grid is None else _layer(open_dsm(folder / entry.grid.file), entry.grid, crs)
        features = tuple(open_stored(folder, level) for level in manifest.features)
        cloud = None if manifest.cloud is None else open_cloud(folder, manifest.cloud)
        return cls(manifest, crs, pixels, Heights(surface, crs, entry.plane_amsl_m), features, cloud)

    def stored_gsd_m(self, center_map_m: tuple[float, float], gsd_m: float, name: str, recipe: str) -> float | None:
        """See protocols.FeatureMap."""
        level = self._nearest(center_map_m, gsd_m, name, recipe)
        return None if level is None else level.pixel_map / self._crs.linearised_at_map(*center_map_m).scale

    def stored_patch(
        self, center_map_m: tuple[float, float], size_px: tuple[int, int], gsd_m: float, name: str, recipe: str
    ) -> FeaturePatch | None:
        """See protocols.FeatureMap. Raises OutsideMap where no pixel is on the map."""
        level = self._nearest(center_map_m, gsd_m, name, recipe)
        if level is None:
            return None
        half = (np.array(size_px, dtype=np.float64) - 1) / 2
        corner = np.rint(apply_affine(invert_affine(level.T_map_pix), np.array(center_map_m)) - half)
        T_map_pix = compose_affine(level.T_map_pix, np.array([[1.0, 0.0, corner[0]], [0.0, 1.0, corner[1]]]))
        features, valid = level.window((int(corner[0]), int(corner[1])), size_px)
        heights = self._height_window(T_map_pix, size_px)
        valid &= np.isfinite(heights)
        if not valid.any():
            raise OutsideMap(f"the window about {center_map_m} is outside the map", remedy="use a map that covers the flight")
        easting, northing = apply_affine(T_map_pix, half)
        gsd_m = level.pixel_map / self._crs.linearised_at_map(float(easting), float(northing)).scale
        return FeaturePatch(features, valid, heights, T_map_pix, gsd_m, self._dsm_gsd_m)

    def why_not_stored(self, name: str, recipe: str) -> str:
        """Why features are not taken from the pack but computed in flight; empty where they are taken from it."""
        of_name = [entry.level for entry in self.stored if entry.level.name == name]
        if not of_name:
            return f"the pack holds no features {name!r}: they are computed in flight, which costs time"
        if all(level.recipe != recipe for level in of_name):
            return f"the pack's features {name!r} are of another recipe ({of_name[0].recipe}): they are computed in flight"
        return ""

    def _points_within(self, center_map_m: tuple[float, float], radius_map: float, max_points: int) -> FloatArray:
        points = np.zeros((0, 3)) if self.cloud is None else self.cloud.within(center_map_m, radius_map, max_points)
        return points if len(points) else super()._points_within(center_map_m, radius_map, max_points)

    def _nearest(self, center_map_m: tuple[float, float], gsd_m: float, name: str, recipe: str) -> StoredFeatures | None:
        """The level of a function nearest to a GSD; None where none is within a factor 2^NEAR_OCTAVES."""
        pixel = gsd_m * self._crs.linearised_at_map(*center_map_m).scale
        of_kind = [entry for entry in self.stored if entry.level.name == name and entry.level.recipe == recipe]
        best = min(of_kind, key=lambda entry: abs(math.log2(entry.pixel_map / pixel)), default=None)
        return best if best is not None and abs(math.log2(best.pixel_map / pixel)) <= NEAR_OCTAVES else None


def _layer(tiff: GeoTiff, grid: Grid, crs: MapCrs) -> DatasetLayer:
    same_grid = tiff.shape == (grid.rows, grid.cols) and np.allclose(
        tiff.T_map_pix, T_map_pix_from_gdal(grid.transform), rtol=1e-12, atol=1e-6
    )
    if not same_grid or tiff.crs != crs:
        raise MapError("size, place or CRS is not what the manifest says", where=str(tiff.path), remedy=REBUILD)
    return DatasetLayer(tiff, level_shapes(*tiff.shape))
