"""Stacks of co-registered images of one place: what training pairs are cut from."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
import rasterio
from numpy.typing import NDArray

from visloc_companion.errors import CasesError
from visloc_companion.localise.features.gradient import gradient_features
from visloc_companion.sim.landscape import build_landscape
from visloc_companion.sim.season import Cover, Rgb, Season, season_of

Bands = NDArray[np.uint8]


@dataclass(frozen=True, slots=True, eq=False)
class Stack:
    """Images of one place: `dates` are (H, W, K) uint8 on one pixel grid of `gsd_m`, up to `shift_px` (D, 2).

    The shift is by how much a date's content lies right of and below the common grid.
    """

    name: str
    dates: tuple[Bands, ...]
    shift_px: NDArray[np.float64]
    gsd_m: float


def naip_stack(folder: Path, first_row: int = 0, last_row: int = 400) -> Stack:
    """The dates of a folder of GeoTIFFs on one grid, cut to the rows `first_row` <= row < `last_row`.

    Raises CasesError where there are not at least two images of one size.
    """
    images = [_bands(path)[first_row:last_row] for path in sorted(folder.glob("*.tif"))]
    if len(images) < 2 or len({image.shape[:2] for image in images}) != 1:
        raise CasesError(
            "needs at least two GeoTIFFs of one size", where=str(folder), remedy="name a folder with the dates of one place"
        )
    return Stack(folder.name, tuple(images), np.zeros((len(images), 2)), _gsd_m(min(folder.glob("*.tif"))))


def paired_stack(folder: Path, pairs: tuple[str, ...]) -> list[Stack]:
    """One stack for each named pair (`<pair>/a.tif`, `<pair>/b.tif`), the shift between the two measured. Raises CasesError."""
    return [_pair(folder / name) for name in pairs]


def _pair(folder: Path) -> Stack:
    a, b = (_bands(folder / f"{side}.tif") for side in "ab")
    return Stack(folder.name, (a, b), np.stack([np.zeros(2), measured_shift_px(a, b)]), _gsd_m(folder / "a.tif"))


def measured_shift_px(a: Bands, b: Bands, reach_px: int = 6) -> NDArray[np.float64]:
    """(2,) columns and rows by which b's content lies right of and below a's: peak of the correlation of gradient features."""
    fa, fb = (gradient_features(image[..., :3], np.ones(image.shape[:2], bool)) for image in (a, b))
    inner = np.ascontiguousarray(fa[reach_px:-reach_px, reach_px:-reach_px])
    scores = cv2.matchTemplate(np.ascontiguousarray(fb), inner, cv2.TM_CCORR_NORMED)
    _, _, _, (col, row) = cv2.minMaxLoc(scores)
    return np.array([col - reach_px, row - reach_px], dtype=np.float64)


def landscape_stack(seed: int, size_m: float, gsd_m: float, dates: int) -> Stack:
    """The procedural landscape of a seed in several seasons drawn at random by that seed."""
    rng = np.random.default_rng([seed, 7])
    images = [
        build_landscape(seed, _varied(season_of(("map", "flight")[k % 2]), rng), size_m, gsd_m).pixels for k in range(dates)
    ]
    return Stack(f"landscape {seed}", tuple(images), np.zeros((dates, 2)), gsd_m)


def _varied(season: Season, rng: np.random.Generator) -> Season:
    """A season with other colours, another sun and another atmosphere."""
    return replace(
        season,
        sun_azimuth_deg=float(rng.uniform(80, 280)),
        sun_elevation_deg=float(rng.uniform(22, 62)),
        contrast=float(rng.uniform(0.75, 1.15)),
        saturation=float(rng.uniform(0.5, 1.2)),
        haze=float(rng.uniform(0, 0.15)),
        crops=tuple(_recoloured(cover, rng, 0.35) for cover in season.crops),
        meadows=tuple(_recoloured(cover, rng, 0.25) for cover in season.meadows),
        asphalt=_tinted(season.asphalt, rng, 0.25),
        track=_tinted(season.track, rng, 0.2),
        verge=_tinted(season.verge, rng, 0.3),
        water=_tinted(season.water, rng, 0.4),
        deciduous=tuple(_tinted(color, rng, 0.25) for color in season.deciduous),
        conifer=tuple(_tinted(color, rng, 0.2) for color in season.conifer),
    )


def _recoloured(cover: Cover, rng: np.random.Generator, spread: float) -> Cover:
    return replace(cover, color=_tinted(cover.color, rng, spread))


def _tinted(color: Rgb, rng: np.random.Generator, spread: float) -> Rgb:
    gain = np.exp(rng.normal(0, spread) + rng.normal(0, 0.08, 3))
    r, g, b = np.clip(np.array(color) * gain, 5, 250)
    return float(r), float(g), float(b)


def _bands(path: Path) -> Bands:
    try:
        with rasterio.open(path) as source:
            return np.ascontiguousarray(source.read()[:4].transpose(1, 2, 0).astype(np.uint8))
    except rasterio.errors.RasterioIOError as why:
        raise CasesError(f"cannot be read: {why}", where=str(path), remedy="name a GeoTIFF") from why


def _gsd_m(path: Path) -> float:
    with rasterio.open(path) as source:
        return float(abs(source.transform.a))
