"""A scene: an orthophoto with its surface model, georeferenced, which the simulated camera looks at."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import rasterio
from numpy.typing import NDArray
from rasterio.errors import RasterioError
from rasterio.transform import Affine
from rasterio.warp import Resampling, reproject

from visloc_companion.errors import MapError
from visloc_companion.geo.raster import T_map_pix_from_gdal, apply_affine, invert_affine
from visloc_companion.maps.crs import Linearisation, map_crs
from visloc_companion.maps.from_white import as_shown
from visloc_companion.maps.geotiff import DatasetLayer, colour_bands, open_dsm
from visloc_companion.maps.world_file import open_raster
from visloc_companion.types import FloatArray, GeoPoint, Image

MOST_SIDE_PX = 32766
"""OpenCV's remap takes no more (SHRT_MAX - 1)."""


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
        _require_size(*self.size_px)
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

    def projection_at(self, place: GeoPoint) -> Linearisation:
        """Its CRS linearised at a place, whose easting is as the raster has it: that may run on beyond 180 degrees.

        Raises OutsideMap where the CRS has no coordinates for the place.
        """
        crs = map_crs(self.crs)
        here = crs.linearised_at(place)
        if crs.turn is None:
            return here
        easting, northing = here.origin_map_m
        return Linearisation(here.J_map_ne, (easting + crs.turn * round((self.center_map[0] - easting) / crs.turn), northing))

    def reach_m(self, place: GeoPoint) -> float:
        """Horizontal distance from a place to the nearest edge, negative beyond it. Raises OutsideMap where its CRS has none."""
        local = self.projection_at(place)
        T_pix_map = invert_affine(self.T_map_pix)
        pix_per_m = np.linalg.norm(T_pix_map[:, :2] @ local.J_map_ne, axis=1)
        at = apply_affine(T_pix_map, np.array(local.origin_map_m))
        return float(np.min(np.minimum(at + 0.5, np.array(self.size_px) - 0.5 - at) / pix_per_m))

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
        """Read a GeoTIFF (red, green and blue where they are named, else its first three bands or its single one) and a surface
        model of any grid.

        Without a surface model the ground is the plane at `ground_h_amsl_m`. Its heights are read as those of a map are (feet,
        what no land is); holes get the lowest one.
        Raises MapError naming the file, the fault and the remedy.
        """
        with _readable(ortho), open_raster(ortho) as source:
            _require_size(source.width, source.height, str(ortho))
            pixels, transform, crs = _pixels(source, ortho), source.transform, source.crs
        heights = np.full(pixels.shape[:2], ground_h_amsl_m, np.float32)
        if dsm is not None:
            with _readable(dsm):
                heights = _heights_on_grid(dsm, pixels.shape[:2], transform, crs)
            if not np.isfinite(heights).any():
                what = f"does not overlap {ortho}"
                raise MapError(what, where=str(dsm), remedy="give orthophoto and surface model of the same place")
            heights = np.where(np.isfinite(heights), heights, np.nanmin(heights))
        return cls(pixels, heights, T_map_pix_from_gdal(tuple(transform)[:6]), crs.to_string())


def _require_size(width: int, height: int, where: str = "") -> None:
    if max(width, height) > MOST_SIDE_PX:
        raise MapError(
            f"has {width} x {height} px; what a simulated camera looks at has {MOST_SIDE_PX} a side at most",
            where=where,
            remedy="cut out the land about the map's middle: gdal_translate -projwin LEFT TOP RIGHT BOTTOM IN.tif OUT.tif",
        )


@contextmanager
def _readable(path: Path) -> Iterator[None]:
    try:
        yield
    except RasterioError as why:
        raise MapError(f"cannot be read: {why}", where=str(path), remedy="give a readable GeoTIFF file") from why


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
        raise MapError(
            "has no coordinate reference system",
            where=str(path),
            remedy="state it (gdal_translate -a_srs EPSG:CODE FILE NEW.tif)",
        )
    if source.dtypes[0] != "uint8":
        raise MapError(f"has {source.dtypes[0]} bands, not uint8", where=str(path), remedy="gdal_translate -ot Byte -scale")
    bands = colour_bands(path, source)
    pixels = np.ascontiguousarray(np.moveaxis(source.read(bands if len(bands) == 3 else bands * 3), 0, 2))
    return as_shown(source, pixels)


def _heights_on_grid(path: Path, shape: tuple[int, int], transform: Affine, crs: rasterio.CRS) -> NDArray[np.float32]:
    """Heights above sea level, m, NaN where there are none."""
    tiff = open_dsm(path)
    (rows, cols), source = tiff.shape, tiff.dataset
    values, known = DatasetLayer(tiff, ((rows, cols),)).read(0, (0, rows), (0, cols))
    stored = np.where(known > 0, values, np.float32(np.nan))
    heights = np.full(shape, np.nan, np.float32)
    reproject(
        stored,
        heights,
        src_transform=source.transform,
        src_crs=source.crs,
        src_nodata=np.nan,
        dst_transform=transform,
        dst_crs=crs,
        dst_nodata=np.nan,
        resampling=Resampling.bilinear,
    )
    return heights
