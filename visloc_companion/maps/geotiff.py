"""GeoTIFF files: checks on opening, and layers over them."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rasterio.enums import ColorInterp, MaskFlags, Resampling
from rasterio.errors import RasterioError
from rasterio.windows import Window

from visloc_companion.errors import DatumMissing, MapError, OutsideMap
from visloc_companion.geo.raster import T_map_pix_from_gdal
from visloc_companion.maps.averaged import averaged_holes
from visloc_companion.maps.collar import collar
from visloc_companion.maps.crs import MapCrs, map_crs
from visloc_companion.maps.fills import HEIGHTS_M, RIM_PX, SAME_M, in_missing, missing_blocks, no_colour, undeclared_fill
from visloc_companion.maps.from_white import counts_from_white, positive
from visloc_companion.maps.ground_pixel import ground_gsd_m
from visloc_companion.maps.layer import ArrayLayer, Layer, Validity, Values, array_layer, halved, level_shapes
from visloc_companion.maps.manifest import require_utf8
from visloc_companion.maps.overviews import overviews_are_averages
from visloc_companion.maps.shown import Shown, heights_shown_by, shown_by, thinned
from visloc_companion.maps.unplaced import require_place
from visloc_companion.maps.world_file import open_raster
from visloc_companion.types import FloatArray

IN_MEMORY_BYTES = 400_000_000
"""Rasters with fewer bytes than this are read whole; larger ones are read by windows."""
_READ_AGAIN = "copy or download the file again (gdalinfo -checksum FILE names the damage)"
FOOT_M = 0.3048
_UNKNOWN = "not recognized as being in a supported file format"
_MAKE_ONE = "make a GeoTIFF of it with a program that reads it (QGIS, or gdal_translate FILE NEW.tif)"
Stretch = tuple[float, float]
"""Values that become 0 and 255."""
STRIP_ROWS = 256


@dataclass(frozen=True, slots=True, eq=False)
class GeoTiff:
    """An open GeoTIFF, its CRS, its grid and which bands are used.

    `stretch` maps other types than uint8 to 0-255. Heights are `height_unit_m` (None where the bands are no heights) times the
    band's values, and `lift_m`. `shown`: what says where it shows something; `missing`: where nothing does,
    its blocks that were never written (maps/fills.py). `negative`: its colours count from white.
    """

    path: Path
    dataset: Any
    crs: MapCrs
    T_map_pix: FloatArray
    bands: tuple[int, ...]
    stretch: Stretch | None
    height_unit_m: float | None
    lift_m: float = 0.0
    shown: Shown = field(kw_only=True)
    missing: NDArray[np.bool_] | None = None
    negative: bool = False

    @property
    def shape(self) -> tuple[int, int]:
        """(rows, cols)."""
        return int(self.dataset.height), int(self.dataset.width)

    @property
    def gsd_m(self) -> float:
        """Geometric mean of the pixel's sides on the ground, at the raster's centre, metres. Raises MapError at a pole."""
        return ground_gsd_m(self.crs, self.T_map_pix, self.shape, str(self.path))


def files_of(path: Path) -> list[Path]:
    """A raster's file, and all that its pixels and place come from as well: world files, .aux.xml, masks, tiles of a .vrt.

    Raises MapError.
    """
    dataset, _, _ = _open(path)
    with dataset:
        others = sorted({Path(name) for name in dataset.files} - {path})
    return [path, *(other for other in others if other.is_file())]


def nodata_of(path: Path) -> float | None:
    """The nodata value that says where a raster is empty; None where none does (a mask counts before it). Raises MapError."""
    dataset, _, _ = _open(path)
    with dataset:
        return float(dataset.nodata) if MaskFlags.nodata in dataset.mask_flag_enums[0] else None


def crs_of(path: Path) -> tuple[MapCrs, tuple[float, float]]:
    """A raster's CRS, and easting and northing of its middle. Raises MapError, DatumMissing."""
    dataset, crs, T_map_pix = _open(path)
    with dataset:
        easting, northing = T_map_pix @ np.array([(dataset.width - 1) / 2, (dataset.height - 1) / 2, 1.0])
    return crs, (float(easting), float(northing))


def open_ortho(path: Path, stretches: Mapping[str, Stretch] | None = None) -> GeoTiff:
    """Open an orthophoto: colour (three bands) or grey (one). `stretches`: those of its map. Raises MapError, DatumMissing."""
    dataset, crs, T_map_pix = _open(path)
    meanings = _meanings(path, dataset)
    dtype, bands = dataset.dtypes[0], _colour_bands(dataset, meanings)
    shown = _shown(path, dataset, meanings)
    if stretches is None:
        stretches = {} if dtype == "uint8" else {dtype: _stretch(_sampled(path, dataset, bands, shown))}
    missing = None if shown.is_stated else missing_blocks(dataset)
    found = path, dataset, crs, T_map_pix, bands, stretches.get(dtype), None
    return GeoTiff(*found, shown=shown, missing=missing, negative=counts_from_white(dataset))


def stretches_of(paths: Sequence[Path]) -> dict[str, Stretch]:
    """What each type of value but uint8 is stretched by, 2 % and 98 % of the values of all files of that type.

    One for all tiles of a map: each by its own values, they would differ in brightness. Raises MapError.
    """
    of_type = defaultdict[str, list[FloatArray]](list)
    for path in paths:
        dataset, _, _ = _open(path)
        with dataset:
            if dataset.dtypes[0] != "uint8":
                meanings = _meanings(path, dataset)
                bands, shown = _colour_bands(dataset, meanings), _shown(path, dataset, meanings)
                of_type[dataset.dtypes[0]].append(_sampled(path, dataset, bands, shown))
    return {dtype: _stretch(np.concatenate(samples)) for dtype, samples in of_type.items()}


def open_dsm(path: Path) -> GeoTiff:
    """Open a surface model: heights in the first band, metres or feet. Raises MapError, DatumMissing."""
    dataset, crs, T_map_pix = _open(path)
    meanings = _meanings(path, dataset)
    if meanings[0] in (ColorInterp.palette, ColorInterp.red):
        raise MapError("holds colours, no heights", where=str(path), remedy="name a surface model (GeoTIFF, one band of heights)")
    if dataset.dtypes[0] == "uint8" and (dataset.scales[0], dataset.offsets[0]) == (1.0, 0.0):
        raise MapError(
            "holds 256 shades, as a picture or a hillshade does",
            where=str(path),
            remedy="name the surface model itself; where these are heights in metres: gdal_translate -ot Float32 FILE NEW.tif",
        )
    unit_m = _height_unit_m(path, (dataset.units[0] or "").lower(), crs)
    scale, lift_m = unit_m * dataset.scales[0], unit_m * dataset.offsets[0]
    shown = heights_shown_by(dataset, meanings)
    missing = None if shown.is_stated else missing_blocks(dataset)
    return GeoTiff(path, dataset, crs, T_map_pix, (1,), None, scale, lift_m, shown=shown, missing=missing)


def require_heights(tiff: GeoTiff) -> None:
    """Refuse a surface model whose holes look like ground: averaged with it, or a value that is none and that nothing declares.

    Raises MapError with the command that declares it.
    """
    with _reading(tiff.path):
        averaged = averaged_holes(tiff.dataset, tiff.shown, tiff.height_unit_m or 1.0, tiff.lift_m, tiff.gsd_m)
    if averaged is not None:
        raise MapError(averaged[0], where=str(tiff.path), remedy=averaged[1])
    if tiff.dataset.nodata is not None:
        return
    shape = thinned(tiff.dataset)
    with _reading(tiff.path):
        raw = tiff.dataset.read(1, out_shape=shape, resampling=Resampling.nearest).astype(np.float64)
        mask = tiff.shown.read(tiff.dataset, shape)
    if tiff.missing is not None:
        middles = ((np.arange(n) * full + full // 2) // n for n, full in zip(shape, tiff.shape, strict=True))
        mask &= ~in_missing(tiff.dataset, tiff.missing, *middles)
    heights = raw * (tiff.height_unit_m or 1.0) + tiff.lift_m
    used = mask & (heights >= HEIGHTS_M[0]) & (heights <= HEIGHTS_M[1])
    rim = math.ceil(RIM_PX * shape[0] / tiff.shape[0])
    fill_m = undeclared_fill(heights, used, rim) if used.any() else None
    if fill_m is not None:
        share = float((np.abs(heights[used] - fill_m) <= SAME_M).mean())
        value = float(raw[used][heights[used] == fill_m][0])
        raise MapError(
            f"{100 * share:.2g} % of its pixels are {value:.9g}, far from all other heights: holes that it does not declare",
            where=str(tiff.path),
            remedy=f"gdal_edit.py -a_nodata {value:.9g} FILE; where that is a height, declare what none has: -a_nodata -32768",
        )


def _height_unit_m(path: Path, unit: str, crs: MapCrs) -> float:
    """Metres in a unit of height: the band's or the vertical CRS's. On a grid in metres or degrees neither need be stated."""
    if unit.startswith(("ft", "foot", "feet", "us")):
        return FOOT_M
    if unit in ("m", "metre", "meter", "metres", "meters"):
        return 1.0
    if unit:
        raise MapError(
            f"heights are in {unit!r}",
            where=str(path),
            remedy="state metres or feet: gdal_edit.py -units m (or ft) FILE; others convert to metres",
        )
    if not crs.states_heights and crs.metres_per_unit < 1.0:  # nobody has heights in kilometres; NaN of degrees
        what = "its grid is in feet, and it does not say whether its heights are"
        raise DatumMissing(what, where=str(path), remedy="gdal_edit.py -units ft FILE, or -units m")
    return crs.vertical_metres_per_unit


def layer_of(tiff: GeoTiff, in_memory_bytes: int = IN_MEMORY_BYTES) -> Layer:
    """A layer of the file: read whole where it is small, by windows otherwise. Raises MapError for damaged pixels."""
    lazy = DatasetLayer(tiff, level_shapes(*tiff.shape))
    rows, cols = tiff.shape
    if rows * cols * len(tiff.bands) * lazy.dtype.itemsize > in_memory_bytes:
        with _reading(tiff.path):
            return replace(lazy, by_overviews=overviews_are_averages(tiff.dataset, tiff.bands[0], tiff.shown))
    raw, mask = lazy.stored(0, (0, rows), (0, cols))
    values, valid = _converted(lazy, raw, mask)
    if tiff.height_unit_m is None and not tiff.shown.tells(mask > 0):
        valid[collar(values if tiff.stretch is None else _pixels_of(raw))] = 0  # stretched, dark and empty pixels are the same
    layer: ArrayLayer = array_layer(tiff.T_map_pix, values, valid > 0)
    tiff.dataset.close()
    return layer


def _converted(lazy: DatasetLayer, raw: NDArray[Any], mask: Validity) -> tuple[Values, Validity]:
    """What `converted` makes of a whole raster, a strip of rows at a time: what it reckons with in between takes 8 bytes a value
    and more, many times as much as the raster itself."""
    tops = range(0, len(mask), STRIP_ROWS)
    strips = [lazy.converted(raw[:, top : top + STRIP_ROWS], mask[top : top + STRIP_ROWS]) for top in tops]
    return np.concatenate([values for values, _ in strips]), np.concatenate([valid for _, valid in strips])


def _pixels_of(raw: NDArray[Any]) -> NDArray[Any]:
    """(rows, cols) of one band or (rows, cols, 3) of bands (1 or 3, rows, cols)."""
    return np.asarray(raw[0]) if len(raw) == 1 else np.ascontiguousarray(raw.transpose(1, 2, 0))


@dataclass(frozen=True, slots=True, eq=False)
class DatasetLayer:
    """A layer whose windows are read from the file; levels come from its overviews, or (not `by_overviews`, and where it has
    none) are averaged when read."""

    tiff: GeoTiff
    shapes: tuple[tuple[int, int], ...]
    by_overviews: bool = True
    dtype: np.dtype[Any] = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "dtype", np.dtype(np.uint8 if self.tiff.height_unit_m is None else np.float32))

    @property
    def T_map_pix(self) -> FloatArray:
        """(2, 3) of level 0."""
        return self.tiff.T_map_pix

    @property
    def channels(self) -> int:
        """1 or 3."""
        return len(self.tiff.bands)

    def read(self, level: int, rows: tuple[int, int], cols: tuple[int, int]) -> tuple[Values, Validity]:
        """A window. Raises MapError where the file is damaged."""
        if level and (self._says_nothing or not self.by_overviews):
            return self._averaged(level, rows, cols)
        return self.converted(*self.stored(level, rows, cols))

    def stored(self, level: int, rows: tuple[int, int], cols: tuple[int, int]) -> tuple[NDArray[Any], Validity]:
        """(bands, rows, cols) of a window as the file has them, and where it says that it shows something."""
        n = 2**level
        window = Window(cols[0] * n, rows[0] * n, (cols[1] - cols[0]) * n, (rows[1] - rows[0]) * n)
        shape = (rows[1] - rows[0], cols[1] - cols[0])
        how = Resampling.average if level else Resampling.nearest
        with _reading(self.tiff.path):
            raw = self.tiff.dataset.read(list(self.tiff.bands), window=window, out_shape=(self.channels, *shape), resampling=how)
            mask = self.tiff.shown.read(self.tiff.dataset, shape, window)
        if self.tiff.missing is not None:
            middles = (np.arange(*span) * n + n // 2 for span in (rows, cols))
            mask[in_missing(self.tiff.dataset, self.tiff.missing, *middles)] = False
        return raw, mask.astype(np.uint8) * np.uint8(255)

    @property
    def _says_nothing(self) -> bool:
        """Whether values may stand for nothing that GDAL would not take for such, and average with others."""
        as_they_are = self.tiff.height_unit_m is None and self.tiff.stretch is None
        return self.tiff.shown.alpha > 0 or (not self.tiff.shown.is_stated and not as_they_are)

    def _averaged(self, level: int, rows: tuple[int, int], cols: tuple[int, int]) -> tuple[Values, Validity]:
        """A window of a level from that below it, known pixels alone, a strip of rows at a time."""
        strips = [(top, min(top + STRIP_ROWS, rows[1])) for top in range(rows[0], rows[1], STRIP_ROWS)]
        parts = [halved(*self.read(level - 1, (2 * top, 2 * bottom), (2 * cols[0], 2 * cols[1]))) for top, bottom in strips]
        return np.concatenate([values for values, _ in parts]), np.concatenate([valid for _, valid in parts])

    def converted(self, raw: NDArray[Any], mask: Validity) -> tuple[Values, Validity]:
        """Heights in metres, or colours of 8 bits, of what is stored, and where they are known."""
        if self.tiff.height_unit_m is not None:
            stored = np.where(mask > 0, raw[0], 0).astype(np.float64)
            heights = (stored * self.tiff.height_unit_m + self.tiff.lift_m).astype(np.float32)
            known = (mask > 0) & (heights >= HEIGHTS_M[0]) & (heights <= HEIGHTS_M[1])
            return np.where(known, heights, np.float32(0)), known.astype(np.uint8) * np.uint8(255)
        if self.tiff.stretch is not None:
            low, high = self.tiff.stretch
            scaled = (np.where(mask > 0, raw, 0).astype(np.float64) - low) * (255 / (high - low))
            finite = np.isfinite(scaled).all(axis=0)
            if not self.tiff.shown.is_stated:
                finite &= ~no_colour(raw)
            raw = np.clip(np.nan_to_num(scaled), 0, 255).astype(np.uint8)
            mask = np.where(finite, mask, 0).astype(np.uint8)
        return (positive(_pixels_of(raw), mask) if self.tiff.negative else _pixels_of(raw)), mask


def _open(path: Path) -> tuple[Any, MapCrs, FloatArray]:
    where = str(path)
    require_utf8(where)
    if not path.is_file():
        raise MapError("is a folder" if path.is_dir() else "there is no such file", where=where, remedy="name a GeoTIFF")
    try:
        dataset = open_raster(path)
    except RasterioError as why:
        remedy = _READ_AGAIN if path.suffix.lower() in (".tif", ".tiff") or _UNKNOWN not in str(why) else _MAKE_ONE
        raise MapError(f"cannot be opened as a raster: {why}", where=where, remedy=remedy) from why
    require_place(path, dataset)
    crs = map_crs(dataset.crs.to_wkt(version="WKT2_2019"), where)
    a, b, c, d, e, f = tuple(dataset.transform)[:6]
    T_map_pix = T_map_pix_from_gdal((a, b, c, d, e, f))
    _check_place(where, crs, T_map_pix, (dataset.height, dataset.width))
    return dataset, crs, T_map_pix


def _check_place(where: str, crs: MapCrs, T_map_pix: FloatArray, shape: tuple[int, int]) -> None:
    """Refuse a raster whose middle is no place on earth: its CRS is that of other coordinates."""
    x, y = (float(v) for v in T_map_pix @ np.array([(shape[1] - 1) / 2, (shape[0] - 1) / 2, 1.0]))
    try:
        lat_deg = crs.to_geo(x, y)[0]
    except OutsideMap:
        lat_deg = math.nan
    if not abs(lat_deg) <= 90:
        raise MapError(
            f"its middle, {x:.8g}, {y:.8g}, is no place in {crs.name}",
            where=where,
            remedy="state the CRS that these coordinates have (gdal_edit.py -a_srs EPSG:CODE FILE)",
        )


def _meanings(path: Path, dataset: Any) -> tuple[ColorInterp, ...]:
    """What each band is; a damaged file answers even that with an error, and GDAL's own have no public base in rasterio."""
    try:
        return tuple(dataset.colorinterp)
    except Exception as why:
        raise MapError(f"bands cannot be told apart: {why}", where=str(path), remedy=_READ_AGAIN) from why


def colour_bands(path: Path, dataset: Any) -> tuple[int, ...]:
    """Bands of red, green and blue, or of grey, of an open raster. Raises MapError where it has a colour table or is damaged."""
    return _colour_bands(dataset, _meanings(path, dataset))


def _colour_bands(dataset: Any, meanings: tuple[ColorInterp, ...]) -> tuple[int, ...]:
    meaning = {interpretation: band for band, interpretation in zip(dataset.indexes, meanings, strict=True)}
    rgb = tuple(meaning.get(colour, 0) for colour in (ColorInterp.red, ColorInterp.green, ColorInterp.blue))
    if ColorInterp.palette in meaning:
        raise MapError("has a colour table", where=str(dataset.name), remedy="expand it: gdal_translate -expand rgb")
    if all(rgb):
        return rgb
    colours = [band for band in dataset.indexes if meanings[band - 1] is not ColorInterp.alpha]
    if not colours:
        raise MapError("holds no band of colours but alpha", where=str(dataset.name), remedy="name an orthophoto, not its mask")
    return tuple(colours[:3]) if len(colours) >= 3 else (colours[0],)


def _shown(path: Path, dataset: Any, meanings: tuple[ColorInterp, ...]) -> Shown:
    with _reading(path):
        return shown_by(dataset, meanings)


@contextmanager
def _reading(path: Path) -> Iterator[None]:
    """Turn errors of damaged pixels into a MapError that names the file."""
    try:
        yield
    except RasterioError as why:
        said = why.__cause__ or why  # rasterio says "see previous exception"; GDAL names block or tile
        raise MapError(f"pixels cannot be read: {said}", where=str(path), remedy=_READ_AGAIN) from why


def _sampled(path: Path, dataset: Any, bands: tuple[int, ...], shown: Shown) -> FloatArray:
    """Valid values of all bands, from a thinned read."""
    shape = thinned(dataset)
    with _reading(path):
        raw = dataset.read(list(bands), out_shape=(len(bands), *shape))
        mask = shown.read(dataset, shape)
    if not shown.tells(mask):
        mask &= ~(no_colour(raw) | collar(_pixels_of(raw)))
    sample = raw.astype(np.float64)
    used: FloatArray = sample[:, mask]
    used = used[np.isfinite(used)]
    if not used.size:
        raise MapError("has no valid pixel", where=str(path), remedy="name an orthophoto with content")
    return used


def _stretch(values: FloatArray) -> Stretch:
    low, high = np.percentile(values, [2, 98])
    return float(low), float(max(high, low + 1e-6))
