"""The pack's orthophoto as a pyramid of small pictures, which a browser fetches as it pans and zooms."""

from __future__ import annotations

import hashlib
import math
from collections import OrderedDict
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from visloc_companion.errors import OutsideMap
from visloc_companion.geo.raster import apply_affine, compose_affine
from visloc_companion.maps.manifest import MANIFEST
from visloc_companion.maps.pack import PackMap

TILE_PX = 512
KEPT = 128
"""Encoded tiles that are kept, some 30 to 100 kB each."""
LATTICE = 9
"""Places stated along each side of the map: between them its CRS is straight to centimetres over 10 km."""
_QUALITY = 80


class MapPictures:
    """Tiles of one pack. Level 0 is one tile that holds all of it; each further level halves the ground sample distance.

    Rows and columns are those of the orthophoto (`ras`: the corner of its top left pixel is 0, 0). One thread at a time.
    """

    def __init__(self, folder: Path) -> None:
        """Open a pack; sizes are checked, hashes are the daemon's care. Raises MapError."""
        self._map = PackMap.open(folder, verify_hashes=False)
        self._name = folder.resolve().name
        self.identity = hashlib.sha256((folder / MANIFEST).read_bytes()).hexdigest()[:12]
        self.levels = 1 + max(0, math.ceil(math.log2(max(self._map.shape) / TILE_PX)))
        self._kept: OrderedDict[tuple[int, int, int], bytes] = OrderedDict()

    def description(self) -> dict[str, Any]:
        """What the page must know: sizes, and latitude and longitude on a lattice over the raster, row by row."""
        rows, cols = self._map.shape
        share = np.linspace(0.0, 1.0, LATTICE)
        ras = np.array([(u * cols, v * rows) for v in share for u in share])
        places = [self._map.to_geo(float(e), float(n)) for e, n in apply_affine(self._map.T_map_pix, ras - 0.5)]
        return {
            "name": self._name,
            "identity": self.identity,
            "gsd_m": self._map.gsd_m,
            "rows": rows,
            "cols": cols,
            "tile_px": TILE_PX,
            "levels": self.levels,
            "lattice": LATTICE,
            "places": [(round(lat_deg, 8), round(lon_deg, 8)) for lat_deg, lon_deg in places],
        }

    def tile(self, level: int, col: int, row: int) -> bytes:
        """A tile as WebP, transparent where there is no map. Raises OutsideMap where there is none such."""
        key = (level, col, row)
        if key in self._kept:
            self._kept.move_to_end(key)
            return self._kept[key]
        self._kept[key] = self._rendered(*key)
        if len(self._kept) > KEPT:
            self._kept.popitem(last=False)
        return self._kept[key]

    def _rendered(self, level: int, col: int, row: int) -> bytes:
        rows, cols = self._map.shape
        if not 0 <= level < self.levels:
            raise OutsideMap(f"no level {level}")
        step = 2.0 ** (self.levels - 1 - level)
        left, top = col * TILE_PX * step, row * TILE_PX * step
        if not (0 <= left < cols and 0 <= top < rows):
            raise OutsideMap(f"no tile {col}, {row} of level {level}")
        T_pix_tile = np.array([[step, 0.0, left + step / 2 - 0.5], [0.0, step, top + step / 2 - 0.5]])
        pixels, valid = self._map.picture(compose_affine(self._map.T_map_pix, T_pix_tile), (TILE_PX, TILE_PX))
        rgb = pixels if pixels.ndim == 3 else np.repeat(pixels[..., None], 3, axis=2)
        bgra = np.dstack([rgb[..., ::-1], np.where(valid, 255, 0).astype(np.uint8)])
        ok, data = cv2.imencode(".webp", np.ascontiguousarray(bgra), [cv2.IMWRITE_WEBP_QUALITY, _QUALITY])
        if not ok:
            raise OutsideMap(f"tile {col}, {row} of level {level} cannot be encoded")
        return data.tobytes()
