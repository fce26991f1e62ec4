"""The map as under another sun, tile by tile: each is made once, whoever looks at it first, and kept while it is looked at.

Frames overlap, so that the light of a window would be worked out some sixty times over. A tile depends on its place and the two
suns alone, not on what was asked before; shadows fall into it from a margin about it.
"""

from __future__ import annotations

import math
from collections import OrderedDict
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from visloc_companion.errors import OutsideMap
from visloc_companion.geo.raster import apply_affine, compose_affine, invert_affine
from visloc_companion.geo.sun import turned
from visloc_companion.localise.features.base import Features, Float32Array, Mask
from visloc_companion.localise.features.gradient import grey
from visloc_companion.localise.local_frame import LocalFrame, local_frame
from visloc_companion.localise.mapped.ground import filled
from visloc_companion.localise.mapped.light import Light, relit, up_azimuth_deg
from visloc_companion.protocols import ReferenceMap
from visloc_companion.types import FeaturePatch, FloatArray, GeoPoint, ReferencePatch

SIDE_PX, MARGIN_M = 256, 32.0
STEPS = 64
"""Sizes of a pixel in an octave: tiles of neighbouring places have the same one."""
LEAST_OFF_PX = 0.05
"""What lies nearer to its place in a tile is left there, for resampling blurs."""
MOST_UNEVEN = 1.05
"""Scale of the map's CRS along one axis over that along the other: tiles whose pixels are longer on the ground tell nothing. Of
equal-area CRSs it is 1.03 at most (EPSG:3035 from Portugal to Crete), of degrees 1.06 at 20 degrees of latitude."""
MOST = 64
"""Tiles that are kept, some 0.6 MB each."""

_Key = tuple[Light, str, str, int, int, int]


@dataclass(frozen=True, slots=True, eq=False)
class _Tile:
    """Features (n, n, C) in half precision, where the map is known (n, n), and the surface (n, n), NaN where it has none."""

    features: NDArray[np.float16]
    valid: Mask
    dsm_amsl_m: Float32Array
    dsm_gsd_m: float


class RelitTiles:
    """Tiles of one map; of another one they begin anew."""

    def __init__(self) -> None:
        self._ref: ReferenceMap | None = None
        self._kept: OrderedDict[_Key, _Tile | None] = OrderedDict()

    def patch(
        self,
        ref: ReferenceMap,
        frame: LocalFrame,
        center_map_m: tuple[float, float],
        size_px: tuple[int, int],
        gsd_m: float,
        features: Features,
        light: Light,
    ) -> FeaturePatch:
        """Features of a window of the map as under the frame's sun. Centre and GSD are those that were asked for to half a pixel
        and to half a per cent. Raises OutsideMap where no pixel is on the map."""
        if ref is not self._ref:
            self._ref, self._kept = ref, OrderedDict()
        octave = round(STEPS * math.log2(gsd_m * frame.map_units_per_m))
        pixel = 2.0 ** (octave / STEPS)
        width, height = size_px
        first_col = round(center_map_m[0] / pixel - (width - 1) / 2)
        first_row = round(-center_map_m[1] / pixel - (height - 1) / 2)
        values = np.zeros((height, width, features.channels), np.float32)
        valid, surface = np.zeros((height, width), np.bool_), np.full((height, width), np.nan, np.float32)
        dsm_gsd_m = 0.0
        for row in range(first_row // SIDE_PX, (first_row + height - 1) // SIDE_PX + 1):
            for col in range(first_col // SIDE_PX, (first_col + width - 1) // SIDE_PX + 1):
                tile = self._tile((light, features.name, features.recipe, octave, col, row), ref, features)
                if tile is None:
                    continue
                of_tile, of_window = zip(_overlap(row, first_row, height), _overlap(col, first_col, width), strict=True)
                values[of_window], valid[of_window] = tile.features[of_tile], tile.valid[of_tile]
                surface[of_window], dsm_gsd_m = tile.dsm_amsl_m[of_tile], tile.dsm_gsd_m
        if not valid.any():
            raise OutsideMap(f"the window about {center_map_m} is outside the map", remedy="use a map that covers the flight")
        T_map_pix = np.array([[pixel, 0.0, first_col * pixel], [0.0, -pixel, -first_row * pixel]])
        return FeaturePatch(values, valid, surface, T_map_pix, pixel / frame.map_units_per_m, dsm_gsd_m)

    def _tile(self, key: _Key, ref: ReferenceMap, features: Features) -> _Tile | None:
        if key in self._kept:
            self._kept.move_to_end(key)
            return self._kept[key]
        light, _, _, octave, col, row = key
        self._kept[key] = _made(ref, light, 2.0 ** (octave / STEPS), col, row, features)
        while len(self._kept) > MOST:
            self._kept.popitem(last=False)
        return self._kept[key]


def serves(frame: LocalFrame) -> bool:
    """Whether a map's CRS is near enough to the ground's shape for tiles on its axes."""
    stretch = np.linalg.svd(frame.J_map_ne, compute_uv=False)
    return float(stretch[0]) <= MOST_UNEVEN * float(stretch[1])


@dataclass(frozen=True, slots=True, eq=False)
class Lit:
    """The map under one light."""

    tiles: RelitTiles
    light: Light


def _made(ref: ReferenceMap, light: Light, pixel: float, col: int, row: int, features: Features) -> _Tile | None:
    """A tile, its first pixel at (col, -row) times SIDE_PX pixels in the map's CRS; None where no pixel is on the map."""
    center = (col * SIDE_PX + (SIDE_PX - 1) / 2) * pixel, -(row * SIDE_PX + (SIDE_PX - 1) / 2) * pixel
    frame = local_frame(GeoPoint(*ref.to_geo(*center), 0.0), ref)
    gsd_m = pixel / frame.map_units_per_m
    margin = math.ceil(MARGIN_M / gsd_m)
    try:
        patch = ref.patch(center, (SIDE_PX + 2 * margin,) * 2, gsd_m, 0.0)
    except OutsideMap:
        return None
    inner = slice(margin, margin + SIDE_PX), slice(margin, margin + SIDE_PX)
    if not patch.valid[inner].any():
        return None
    surface = filled(patch.dsm_amsl_m, patch.valid)
    pixels = relit(grey(patch.pixels), surface, patch.gsd_m, _in_axes(light, frame, patch.T_map_pix))
    first = (col * SIDE_PX - margin) * pixel, -(row * SIDE_PX - margin) * pixel
    pixels, valid, heights = _on_lattice(pixels, patch, np.array([[pixel, 0.0, first[0]], [0.0, -pixel, first[1]]]))
    values = features(pixels, valid)[inner]
    kept = valid[inner].copy(), np.array(heights[inner], dtype=np.float32)  # views would keep the margin, too
    return _Tile(values.astype(np.float16), *kept, patch.dsm_gsd_m)


def _on_lattice(pixels: Float32Array, patch: ReferencePatch, T_map_pix: FloatArray) -> tuple[Float32Array, Mask, Float32Array]:
    """Brightness (H, W), validity and heights of a patch on pixels that are square in the map's CRS: themselves where that keeps
    angles, for a patch's pixels are square on the ground."""
    to_patch = compose_affine(invert_affine(patch.T_map_pix), T_map_pix)
    size = pixels.shape[1], pixels.shape[0]
    corners = np.array([[0, 0], [size[0], 0], [0, size[1]], size], dtype=np.float64)
    if float(np.abs(apply_affine(to_patch, corners) - corners).max()) < LEAST_OFF_PX:
        return pixels, patch.valid, patch.dsm_amsl_m
    nearest = cv2.WARP_INVERSE_MAP | cv2.INTER_NEAREST
    moved = cv2.warpAffine(pixels, to_patch, size, flags=cv2.WARP_INVERSE_MAP | cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)
    valid = cv2.warpAffine(patch.valid.astype(np.uint8), to_patch, size, flags=nearest) > 0
    heights = cv2.warpAffine(patch.dsm_amsl_m, to_patch, size, flags=nearest, borderValue=math.nan)
    return np.asarray(moved, dtype=np.float32), valid, np.asarray(heights, dtype=np.float32)


def _in_axes(light: Light, frame: LocalFrame, T_map_pix: FloatArray) -> Light:
    """Suns from the upward axis of a window instead of from north."""
    up_deg = up_azimuth_deg(frame.A_ne_pix(T_map_pix))
    return Light(turned(light.map_sun, -up_deg), turned(light.frame_sun, -up_deg))


def _overlap(tile: int, first: int, size: int) -> tuple[slice, slice]:
    """Pixels of a tile along one axis, and those of the window from `first` on that they are."""
    low, high = max(tile * SIDE_PX, first), min((tile + 1) * SIDE_PX, first + size)
    return slice(low - tile * SIDE_PX, high - tile * SIDE_PX), slice(low - first, high - first)
