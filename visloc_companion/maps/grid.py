"""What both reference maps share: windows, heights and places over a layer of pixels and a source of heights."""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from visloc_companion.errors import MapError, OutsideMap
from visloc_companion.geo.raster import apply_affine, compose_affine, invert_affine, window_affine
from visloc_companion.maps.around import MAX_POINTS, on_the_ground, sampled_surface
from visloc_companion.maps.crs import Linearisation, MapCrs
from visloc_companion.maps.ground_pixel import ground_gsd_m
from visloc_companion.maps.layer import Layer
from visloc_companion.maps.places import middle_of, near_middle, pix_of_geo
from visloc_companion.maps.warp import interpolate, warp_affine, warp_places
from visloc_companion.types import FloatArray, GeoPoint, ReferencePatch


@dataclass(frozen=True, slots=True, eq=False)
class Heights:
    """Surface heights: a layer in its own CRS, or a plane where there is none."""

    layer: Layer | None
    crs: MapCrs
    plane_amsl_m: float


class GridMap:
    """A reference map (protocols.ReferenceMap) over a layer of pixels.

    A pixel is valid where the orthophoto has content and the height is known; heights are NaN elsewhere.
    """

    def __init__(self, crs: MapCrs, pixels: Layer, heights: Heights, gsd_m: float) -> None:
        self._crs, self._pixels, self._heights, self._gsd_m = crs, pixels, heights, gsd_m
        self._T_pix_map = invert_affine(pixels.T_map_pix)
        surface = heights.layer
        self._same_axes = surface is not None and heights.crs == crs and self._reckons_alike(surface)
        self._dsm_gsd_m = 0.0 if surface is None else ground_gsd_m(heights.crs, surface.T_map_pix, surface.shapes[0])

    @property
    def gsd_m(self) -> float:
        """Ground sample distance of the finest level at the map's centre, metres on the ground."""
        return self._gsd_m

    @property
    def crs(self) -> MapCrs:
        """The map's CRS."""
        return self._crs

    @property
    def shape(self) -> tuple[int, int]:
        """(rows, cols) of the finest level."""
        return self._pixels.shapes[0]

    @property
    def T_map_pix(self) -> FloatArray:
        """(2, 3) of the finest level."""
        return self._pixels.T_map_pix

    @property
    def center_map_m(self) -> tuple[float, float]:
        """Easting and northing of the middle of the raster."""
        return middle_of(self._pixels)

    @property
    def corners_map_m(self) -> FloatArray:
        """(4, 2) easting and northing of the raster's corners."""
        rows, cols = self.shape
        corners = np.array([[-0.5, -0.5], [cols - 0.5, -0.5], [-0.5, rows - 0.5], [cols - 0.5, rows - 0.5]])
        return apply_affine(self.T_map_pix, corners)

    def spread_map_m(self, side: int) -> FloatArray:
        """(side, side, 2) easting and northing of the middles of as many equal parts of the raster, from the first row on."""
        rows, cols = self.shape
        share = (np.arange(side) + 0.5) / side
        pix = np.stack(np.meshgrid(share * cols - 0.5, share * rows - 0.5), axis=-1)
        return apply_affine(self.T_map_pix, pix.reshape(-1, 2)).reshape(side, side, 2)

    def patch(
        self, center_map_m: tuple[float, float], size_px: tuple[int, int], gsd_m: float, heading_rad: float
    ) -> ReferencePatch:
        """Window of (width, height) pixels; see protocols.ReferenceMap.

        Raises OutsideMap where no pixel is on the map, MapError for a size or GSD that is no window.
        """
        if min(size_px) < 1 or not (gsd_m > 0 and math.isfinite(gsd_m) and math.isfinite(heading_rad)):
            raise MapError(
                f"no window: size {size_px} px, GSD {gsd_m} m, heading {heading_rad} rad", remedy="correct the request"
            )
        here = self._crs.linearised_at_map(*center_map_m)
        T_map_pix = window_affine(center_map_m, size_px, here.J_map_ne, gsd_m, heading_rad + here.convergence_rad)
        pixels, valid = warp_affine(self._pixels, T_map_pix, size_px)
        heights = self._height_window(T_map_pix, size_px)
        valid &= np.isfinite(heights)
        if not valid.any():
            raise OutsideMap(f"the window about {center_map_m} is outside the map", remedy="use a map that covers the flight")
        return ReferencePatch(pixels, valid, heights, T_map_pix, gsd_m, heading_rad, self._dsm_gsd_m)

    def projection_at(self, place: GeoPoint) -> Linearisation:
        """The CRS linearised at a place."""
        here = self._crs.linearised_at(place)
        return Linearisation(here.J_map_ne, self._on_the_raster(*here.origin_map_m))

    def to_map(self, lat_deg: float, lon_deg: float) -> tuple[float, float]:
        """Easting and northing in the map's CRS. Raises OutsideMap where it has none."""
        return self._on_the_raster(*self._crs.to_map(lat_deg, lon_deg))

    def to_geo(self, easting_m: float, northing_m: float) -> tuple[float, float]:
        """Latitude and longitude (-180 to 180), degrees WGS 84. Raises OutsideMap where there are none."""
        lat_deg, lon_deg = self._crs.to_geo(easting_m, northing_m)
        return lat_deg, lon_deg if abs(lon_deg) <= 180 else (lon_deg + 180) % 360 - 180

    def height_amsl_m(self, easting_m: float, northing_m: float) -> float:
        """Surface height at a place (NaN outside)."""
        return float(self.heights_amsl_m(np.array([[easting_m, northing_m]]))[0])

    def heights_amsl_m(self, map_m: FloatArray) -> FloatArray:
        """(N,) surface heights at (N, 2) easting, northing (NaN outside)."""
        heights = self._heights
        if heights.layer is None:
            rows, cols = self.shape
            pix = apply_affine(self._T_pix_map, map_m)
            inside = (pix >= -0.5).all(axis=1) & (pix[:, 0] <= cols - 0.5) & (pix[:, 1] <= rows - 0.5)
            return np.where(inside, heights.plane_amsl_m, np.nan)
        return interpolate(heights.layer, self._height_pix(heights.layer, map_m))

    def covers(self, lat_deg: float, lon_deg: float, margin_m: float = 0.0) -> bool:
        """Whether a place lies on the map's rectangle, grown (or shrunk, if negative) by a margin."""
        try:
            easting, northing = self.to_map(lat_deg, lon_deg)
        except OutsideMap:
            return False
        u, v = apply_affine(self._T_pix_map, np.array([easting, northing]))
        rows, cols = self.shape
        margin = margin_m / self._gsd_m
        return bool(-0.5 - margin <= u <= cols - 0.5 + margin and -0.5 - margin <= v <= rows - 0.5 + margin)

    def cloud_around(self, center_map_m: tuple[float, float], radius_m: float, max_points: int = MAX_POINTS) -> FloatArray:
        """(N, 3) points of the upper surface within `radius_m` of a place: metres true east and true north of it, and above mean
        sea level. Grid convergence and scale of the CRS are taken out (`projection_at` leads back).

        From the map's cloud where it has one there, else from its surface model; at most `max_points`, thinned evenly. Raises
        OutsideMap where there is none, MapError for a map whose ground is a plane, and for a radius that is none.
        """
        if not (radius_m > 0 and math.isfinite(radius_m) and max_points > 0):
            raise MapError(f"no circle: radius {radius_m} m, {max_points} points", remedy="correct the request")
        here = self._crs.linearised_at_map(*center_map_m)
        points = self._points_within(center_map_m, radius_m * here.scale, max_points)
        if not len(points):
            raise OutsideMap(f"the circle about {center_map_m} is outside the map", remedy="use a map that covers the flight")
        return on_the_ground(points, here)

    def _points_within(self, center_map_m: tuple[float, float], radius_map: float, max_points: int) -> FloatArray:
        """(N, 3) easting, northing, height of the surface model's samples in a circle."""
        layer = self._heights.layer
        if layer is None:
            raise MapError("the map has no shape: its ground is a plane", remedy="build it with --dsm or --cloud")
        pixel = self._dsm_gsd_m * self._crs.linearised_at_map(*center_map_m).scale
        T_map_pix = layer.T_map_pix if self._same_axes else None
        return sampled_surface(self._height_window, T_map_pix, pixel, center_map_m, radius_map, max_points)

    def _on_the_raster(self, easting: float, northing: float) -> tuple[float, float]:
        """A place as the raster has it: eastings may run beyond 180 degrees, across the antimeridian or from 0 to 360."""
        if (turn := self._crs.turn) is None:
            return easting, northing
        return float(near_middle(self._pixels, turn, np.array([easting]))[0]), northing

    def _reckons_alike(self, surface: Layer) -> bool:
        """Whether heights of the map's CRS have its eastings: one raster may have 190 degrees where another has -170."""
        turn, easting = self._crs.turn, self.center_map_m[0]
        return turn is None or abs(near_middle(surface, turn, np.array([easting]))[0] - easting) < turn / 4

    def picture(self, T_map_pix: FloatArray, size_px: tuple[int, int]) -> tuple[NDArray[np.uint8], NDArray[np.bool_]]:
        """Pixels of a (width, height) window of any (2, 3) affine, and which of them hold map (heights not asked)."""
        pixels, valid = warp_affine(self._pixels, T_map_pix, size_px)
        return np.asarray(pixels, np.uint8), valid

    def share_valid(self, T_map_pix: FloatArray, size_px: tuple[int, int]) -> FloatArray:
        """(height, width) share of each pixel of a coarse window that holds map, from 4 x 4 samples (heights not asked)."""
        fine = compose_affine(T_map_pix, np.array([[0.25, 0.0, -0.375], [0.0, 0.25, -0.375]]))
        valid = warp_affine(self._pixels, fine, (4 * size_px[0], 4 * size_px[1]))[1]
        return np.asarray(valid.reshape(size_px[1], 4, size_px[0], 4).mean(axis=(1, 3)), np.float64)

    def contrast_left(self, T_map_cell: FloatArray, size_px: tuple[int, int], side_px: int) -> FloatArray:
        """(height, width) how much of the contrast of each pixel of a coarse window, (2, 3) `T_map_cell`, is left where 4 x 4
        pixels of the map are averaged: 0.25 of white noise. `side_px`, a multiple of 4, of them lie along a coarse one."""
        share = 1 / side_px
        fine = compose_affine(T_map_cell, np.array([[share, 0.0, share / 2 - 0.5], [0.0, share, share / 2 - 0.5]]))
        left = np.zeros((size_px[1], size_px[0]))
        for row in range(size_px[1]):
            here = compose_affine(fine, np.array([[1.0, 0.0, 0.0], [0.0, 1.0, row * side_px]]))
            pixels, valid = warp_affine(self._pixels, here, (size_px[0] * side_px, side_px))
            left[row] = _contrast_left(pixels if pixels.ndim == 2 else pixels[..., 1], valid, side_px)
        return left

    def _height_pix(self, layer: Layer, map_m: FloatArray) -> FloatArray:
        """(N, 2) pix of the height layer at (N, 2) easting, northing of the map."""
        if not self._same_axes:
            return pix_of_geo(layer, self._heights.crs, self._crs.to_geo_array(map_m))
        return apply_affine(invert_affine(layer.T_map_pix), map_m)

    def _height_window(self, T_map_pix: FloatArray, size_px: tuple[int, int]) -> NDArray[np.float32]:
        width, height = size_px
        heights = self._heights
        if heights.layer is None:
            return np.full((height, width), heights.plane_amsl_m, np.float32)
        if self._same_axes:
            return np.asarray(warp_affine(heights.layer, T_map_pix, size_px)[0], np.float32)
        layer = heights.layer
        places = warp_places(layer, lambda pix: self._height_pix(layer, apply_affine(T_map_pix, pix)), size_px)
        return np.asarray(places[0], np.float32)


def _contrast_left(pixels: NDArray[np.uint8], valid: NDArray[np.bool_], side_px: int) -> FloatArray:
    """(N,) of the squares of a strip (side_px, N side_px); what is not valid counts as the mean of the rest."""
    strip = pixels.astype(np.float32)
    if not valid.all():
        known = valid.reshape(side_px, -1, side_px)
        mean = (strip.reshape(known.shape) * known).sum(axis=(0, 2)) / np.maximum(known.sum(axis=(0, 2)), 1)
        strip = np.where(valid, strip, np.repeat(mean, side_px)).astype(np.float32)
    averaged = cv2.resize(strip, (strip.shape[1] // 4, side_px // 4), interpolation=cv2.INTER_AREA)
    full, left = (part.reshape(len(part), -1, n).std(axis=(0, 2)) for part, n in ((strip, side_px), (averaged, side_px // 4)))
    return np.asarray(left / np.maximum(full, 1e-6), np.float64)
