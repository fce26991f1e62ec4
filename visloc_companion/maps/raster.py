"""A reference map straight over GeoTIFF files (for evaluation and for building packs)."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from visloc_companion.maps.filled import without_holes
from visloc_companion.maps.geotiff import layer_of, open_dsm, open_ortho
from visloc_companion.maps.grid import GridMap, Heights
from visloc_companion.maps.layer import ArrayLayer
from visloc_companion.maps.places import middle_of
from visloc_companion.maps.seamless import goes_around, seam_away


class RasterMap(GridMap):
    """An orthophoto and, where there is one, a surface model; either may be in any projected or geographic CRS."""

    def near(self, lat_deg: float, lon_deg: float) -> RasterMap:
        """This map, but an orthophoto all around the earth, and its surface model, with the seam away from a place."""
        if not goes_around(self._pixels, self._crs):
            return self
        place, heights = (lat_deg, lon_deg), self._heights
        pixels = seam_away(self._pixels, self._crs, place)
        surface = None if heights.layer is None else seam_away(heights.layer, heights.crs, place)
        return RasterMap(self._crs, pixels, replace(heights, layer=surface), self._gsd_m)

    @classmethod
    def open(
        cls, ortho: Path, dsm: Path | None = None, ground_h_amsl_m: float = 0.0, *, without_small_holes: bool = False
    ) -> RasterMap:
        """Open the files. Heights are those of the surface model as they are (or the plane): metres above sea level.
        `without_small_holes`: filled as packs have them filled, unless the model is too large to be held in memory.

        Raises MapError for a file that cannot be read or is damaged, DatumMissing for one without a CRS or georeference.
        """
        image = open_ortho(ortho)
        pixels, gsd_m = layer_of(image), image.gsd_m
        if dsm is None:
            heights = Heights(None, image.crs, ground_h_amsl_m)
        else:
            surface = open_dsm(dsm)
            here = image.crs.to_geo(*middle_of(pixels))
            layer = layer_of(surface)
            if without_small_holes and isinstance(layer, ArrayLayer):
                layer = without_holes(layer, surface.gsd_m)
            heights = Heights(seam_away(layer, surface.crs, here), surface.crs, ground_h_amsl_m)
        return cls(image.crs, pixels, heights, gsd_m)
