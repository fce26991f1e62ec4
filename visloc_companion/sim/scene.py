"""A scene: an orthophoto with its surface model, georeferenced, which the simulated camera looks at."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import rasterio
from numpy.typing import NDArray
from rasterio.errors import RasterioError
from rasterio.transform import Affine
from rasterio.warp import Resampling, reproject

from visloc_companion.errors import MapError
from visloc_companion.geo.raster import T_map_pix_from_gdal
from visloc_companion.types import FloatArray, Image


@dataclass(frozen=True, eq=False)
class Scene:
    """Pixels (H, W, 3) RGB uint8 and surface heights (H, W) metres above sea level on one grid of a projected or geographic CRS.

    `T_map_pix` (2, 3) maps `pix` (u, v, 1) to the CRS's easting (or longitude) and northing (or latitude).
    """

    pixels: Image
    dsm_amsl_m: NDArray[np.float32]
    T_map_pix: FloatArray
    crs: str

    def __post_init__(self) -> None:
        if self.pixels.ndim != 3 or self.pixels.shape[2] != 3 or self.pixels.dtype != np.uint8:
            raise MapError(f"pixels are {self.pixels.dtype} {self.pixels.shape}, a scene needs uint8 (H, W, 3)")
        if self.dsm_amsl_m.shape != self.pixels.shape[:2]:
            raise MapError(f"surface model {self.dsm_amsl_m.shape} and pixels {self.pixels.shape[:2]} differ in size")

    @property
    def size_px(self) -> tuple[int, int]:
        """Width and height."""
        return self.pixels.shape[1], self.pixels.shape[0]

    @property
    def center_map(self) -> tuple[float, float]:
        """The middle of the scene in its CRS."""
        centre = self.T_map_pix[:, :2] @ (np.array(self.size_px) - 1) / 2 + self.T_map_pix[:, 2]
        return float(centre[0]), float(centre[1])

    def save(self, folder: Path) -> tuple[Path, Path]:
        """Write `ortho.tif` and `dsm.tif` (tiled GeoTIFF) and return their paths. Raises MapError where that fails."""
        ortho, dsm = folder / "ortho.tif", folder / "dsm.tif"
        try:
            folder.mkdir(parents=True, exist_ok=True)
            _write(ortho, np.moveaxis(self.pixels, 2, 0), self.T_map_pix, self.crs)
            _write(dsm, self.dsm_amsl_m[None], self.T_map_pix, self.crs)
        except (OSError, RasterioError) as why:
            raise MapError(f"cannot be written: {why}", where=str(folder), remedy="name a folder with space to write in") from why
        return ortho, dsm

    @classmethod
    def load(cls, ortho: Path, dsm: Path | None = None, ground_h_amsl_m: float = 0.0) -> Scene:
        """Read a GeoTIFF (its first three bands, or its single one) and a surface model of any grid.

        Without a surface model the ground is the plane at `ground_h_amsl_m`; holes of the surface model get its lowest height.
        Raises MapError naming the file, the fault and the remedy.
        """
        try:
            with rasterio.open(ortho) as source:
                pixels, transform, crs = _pixels(source, ortho), source.transform, source.crs
            heights = np.full(pixels.shape[:2], ground_h_amsl_m, np.float32)
            if dsm is not None:
                heights = _heights_on_grid(dsm, pixels.shape[:2], transform, crs)
        except RasterioError as why:
            raise MapError(f"cannot be read: {why}", where=str(ortho), remedy="give readable GeoTIFF files") from why
        return cls(pixels, heights, T_map_pix_from_gdal(tuple(transform)[:6]), crs.to_string())


def _write(path: Path, bands: NDArray[np.uint8] | NDArray[np.float32], T_map_pix: FloatArray, crs: str) -> None:
    (a, b, c), (d, e, f) = T_map_pix
    transform = Affine(a, b, c - (a + b) / 2, d, e, f - (d + e) / 2)
    profile = {
        "driver": "GTiff",
        "count": bands.shape[0],
        "height": bands.shape[1],
        "width": bands.shape[2],
        "dtype": bands.dtype.name,
        "crs": crs,
        "transform": transform,
        "tiled": True,
        "compress": "deflate",
        "zlevel": 1,
        "predictor": 3 if bands.dtype == np.float32 else 2,
        "interleave": "pixel",
    }
    with rasterio.open(path, "w", **profile) as target:
        target.write(bands)


def _pixels(source: rasterio.DatasetReader, path: Path) -> Image:
    if source.crs is None:
        raise MapError("has no coordinate reference system", where=str(path), remedy="assign it (gdal_edit -a_srs EPSG:...)")
    if source.dtypes[0] != "uint8":
        raise MapError(f"has {source.dtypes[0]} bands, not uint8", where=str(path), remedy="gdal_translate -ot Byte -scale")
    bands = (1, 2, 3) if source.count >= 3 else (1, 1, 1)
    return np.ascontiguousarray(np.moveaxis(source.read(bands), 0, 2))


def _heights_on_grid(path: Path, shape: tuple[int, int], transform: Affine, crs: rasterio.CRS) -> NDArray[np.float32]:
    with rasterio.open(path) as source:
        if source.crs is None:
            raise MapError("has no coordinate reference system", where=str(path), remedy="assign it (gdal_edit -a_srs EPSG:...)")
        heights = np.full(shape, np.nan, np.float32)
        reproject(
            rasterio.band(source, 1),
            heights,
            dst_transform=transform,
            dst_crs=crs,
            dst_nodata=np.nan,
            resampling=Resampling.bilinear,
        )
    known = np.isfinite(heights)
    if not known.any():
        raise MapError("does not overlap the orthophoto", where=str(path), remedy="give the surface model of the same place")
    return np.where(known, heights, heights[known].min())
