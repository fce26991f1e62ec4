"""Where the sun stood over a picture of a known surface, and how the map would look under another one.

Light comes from elsewhere at another hour and season: crowns are bright on another side and shadows fall elsewhere, so that all
the edges of a wood lie a metre off between two dates, or agree no longer. What stands on the ground is known from the surface
model. The map's brightness times the light of the picture's sun over that of its own shows the edges where they are now.

Light on a slope is Lambert's: as the cosine between the slope's normal and the sun, none in cast shadow, and a share of sky
everywhere (Horn 1981, "Hill shading and the reflectance map").
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import cv2
import numpy as np

from visloc_companion.localise.blocks import normalised_correlation
from visloc_companion.localise.features.base import Float32Array, Mask
from visloc_companion.localise.features.gradient import gradient_features
from visloc_companion.localise.mapped.shadow import cast_shadow
from visloc_companion.types import FloatArray, Sun

DIRECT, SKY = 0.6, 0.4
"""Share of the light on level ground from the sun, and from the sky, as photographs show it (their tones are compressed)."""
BRIGHTEST = 1.7
"""Of a slope that faces a low sun, against level ground."""
MOST_CHANGE = 3.0
"""By which factor a pixel's brightness is changed at most."""
WORKING_M, COARSEST_M = 1.0, 2.0
"""Resolution in which the sun is looked for, and that beyond which crowns and their shadows are not seen."""
WIDE_M = 12.0
"""Brightness that goes with wider forms is that of crops and soils."""
AZIMUTHS_DEG, ELEVATIONS_DEG = (-24.0, -12.0, 12.0, 24.0), (12.0, 20.0, 30.0, 42.0, 56.0)
"""Turns from what the slopes say that are tried, and heights of the sun."""
AMBIGUOUS_DEG = (90.0, 180.0, 270.0)
SHIFT_PX = 5
"""The picture may lie so far off the surface: the sun is found before the place is exact."""
LEAST_LIKE, LEAST_LEAD = 0.10, 0.05
"""Correlation of the picture with the light on the surface, and by how much it is ahead of that under a sun from elsewhere."""
LEAST_PX = 60
LEAST_RELIEF_M = 0.1
"""Mean height over or under the surroundings: level ground is lit alike under any sun."""


@dataclass(frozen=True, slots=True)
class Light:
    """The sun over the map's picture, and over the frame."""

    map_sun: Sun
    frame_sun: Sun


def up_azimuth_deg(A_ne_pix: FloatArray) -> float:
    """Azimuth of a window's upward axis (-v), degrees from true north, of its (2, 3) pix -> metres north, east."""
    north, east = (-A_ne_pix[:, 1]).tolist()
    return math.degrees(math.atan2(east, north))


class Relief:
    """A surface (H, W) and its slopes: under every sun the same."""

    def __init__(self, up_m: Float32Array, gsd_m: float) -> None:
        self.up_m, self._gsd_m = up_m, gsd_m
        smooth = cv2.GaussianBlur(up_m, (0, 0), 1.0)
        self.u, self.v = (cv2.Sobel(smooth, cv2.CV_32F, *order, scale=1 / (8 * gsd_m)) for order in ((1, 0), (0, 1)))
        self.steep = np.sqrt(1 + self.u * self.u + self.v * self.v)

    def light(self, sun: Sun) -> Float32Array:
        """(H, W) light, 1 on level ground in the sun, whose azimuth is clockwise from the upward axis."""
        azimuth, flat = math.radians(sun.azimuth_deg), 1 / math.tan(math.radians(sun.elevation_deg))
        facing = (1 - flat * math.sin(azimuth) * self.u + flat * math.cos(azimuth) * self.v) / self.steep
        shaded = np.clip(cast_shadow(self.up_m, self._gsd_m, sun.azimuth_deg, sun.elevation_deg) / max(0.5, self._gsd_m), 0, 1)
        in_sun = 1 - cv2.GaussianBlur(np.asarray(shaded, dtype=np.float32), (0, 0), 0.7)
        return np.asarray(DIRECT * np.clip(facing, 0, BRIGHTEST) * in_sun + SKY, dtype=np.float32)


def relit(grey: Float32Array, surface_up_m: Float32Array, gsd_m: float, light: Light) -> Float32Array:
    """(H, W) the map's brightness as under the frame's sun. Azimuths are clockwise from the upward axis."""
    relief = Relief(surface_up_m, gsd_m)
    change = relief.light(light.frame_sun) / relief.light(light.map_sun)
    return np.asarray(grey * np.clip(change, 1 / MOST_CHANGE, MOST_CHANGE), dtype=np.float32)


def sun_over(grey: Float32Array, seen: Mask, surface_up_m: Float32Array, gsd_m: float) -> Sun | None:
    """The sun over a picture (H, W), known where `seen`, of a surface (H, W); None where neither crowns nor slopes tell it. Its
    azimuth is clockwise from the upward axis.

    Slopes that face the sun are bright: a regression on them says from where (Pentland 1990, "Linear shape from shading"), and
    what the surface looks like under suns about there, with shadows, from how high.
    """
    step = max(1, round(WORKING_M / gsd_m))
    if gsd_m > COARSEST_M or min(grey.shape) // step < LEAST_PX:
        return None
    size = grey.shape[1] // step, grey.shape[0] // step
    whole = tuple(slice(0, n * step) for n in (size[1], size[0]))
    picture, up = (
        np.asarray(cv2.resize(a[whole], size, interpolation=cv2.INTER_AREA), dtype=np.float32) for a in (grey, surface_up_m)
    )
    inside = cv2.resize(seen[whole].astype(np.uint8), size, interpolation=cv2.INTER_NEAREST) > 0
    if inside.sum() < LEAST_PX**2:
        return None
    rise_m = _high_passed(up, gsd_m * step)
    if float(np.abs(rise_m)[inside].mean()) < LEAST_RELIEF_M:
        return None
    relief = Relief(up, gsd_m * step)
    return _likeliest(_Shaded(picture, inside, relief), _azimuth_deg(_high_passed(picture, gsd_m * step), rise_m, relief, inside))


class _Shaded:
    """A picture beside what its surface looks like under a sun."""

    def __init__(self, grey: Float32Array, inside: Mask, relief: Relief) -> None:
        self._inside, self._relief = inside, relief
        features = gradient_features(grey, inside)
        self._block = np.ascontiguousarray(features[SHIFT_PX:-SHIFT_PX, SHIFT_PX:-SHIFT_PX])

    def likeness(self, sun: Sun) -> float:
        """Normalised correlation of the gradients of both, at the best of some shifts."""
        features = gradient_features(100 * self._relief.light(sun), self._inside)
        return float(normalised_correlation(features, self._block).max())


def _azimuth_deg(brightness: Float32Array, rise_m: Float32Array, relief: Relief, inside: Mask) -> float:
    """From where the slopes say that the light comes. The rise stands for crowns of another colour than the ground."""
    columns = (relief.u / relief.steep, relief.v / relief.steep, rise_m, np.ones_like(rise_m))
    told = np.stack(columns, axis=-1)[inside].astype(np.float64)
    by_u, by_v, *_ = np.linalg.lstsq(told, brightness[inside], rcond=None)[0].tolist()
    return math.degrees(math.atan2(-by_u, by_v))


def _likeliest(shaded: _Shaded, azimuth: float) -> Sun | None:
    by_height = [(shaded.likeness(sun), sun) for sun in (Sun(azimuth, e) for e in ELEVATIONS_DEG)]
    _, first = max(by_height, key=lambda each: each[0])
    about = [(shaded.likeness(sun), sun) for sun in (Sun(azimuth + turn, first.elevation_deg) for turn in AZIMUTHS_DEG)]
    like, best = max([*by_height, *about], key=lambda each: each[0])
    elsewhere = max(shaded.likeness(Sun(azimuth + turn, best.elevation_deg)) for turn in AMBIGUOUS_DEG)
    if like < LEAST_LIKE or like - elsewhere < LEAST_LEAD:
        return None
    return replace(best, azimuth_deg=best.azimuth_deg % 360)


def _high_passed(values: Float32Array, gsd_m: float) -> Float32Array:
    smooth = cv2.GaussianBlur(values, (0, 0), 1.0)
    return np.asarray(smooth - cv2.GaussianBlur(values, (0, 0), WIDE_M / gsd_m), dtype=np.float32)
