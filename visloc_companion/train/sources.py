"""Stacks of co-registered images of one place: what training pairs are cut from."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from visloc_companion.errors import CasesError
from visloc_companion.localise.features.gradient import gradient_features
from visloc_companion.sim.land.season import Cover, Rgb, Season, season_of
from visloc_companion.sim.landscape import build_landscape
from visloc_companion.train.imagery import (
    SUFFIXES,
    Bands,
    Imagery,
    colours,
    geotiffs_in,
    read_imagery,
    require_same_grid,
    require_same_size,
)

MOST_SHIFT_PX = 6
"""By more the two dates of a pair must not be shifted against each other; ..."""
SEARCHED_PX = 24
"""... which is told by a search that reaches further."""


@dataclass(frozen=True, slots=True, eq=False)
class Stack:
    """Images of one place: `dates` are (H, W, K) uint8 on one pixel grid, up to `shift_px` (D, 2).

    The shift is by how much a date's content lies right of and below the common grid. `valid` (H, W): where all dates show land.
    """

    name: str
    dates: tuple[Bands, ...]
    shift_px: NDArray[np.float64]
    valid: NDArray[np.bool_]


def dates_stack(folder: Path, first_row: int = 0, last_row: int = 400) -> Stack:
    """The dates of a folder of GeoTIFFs on one grid: of the rows `first_row` <= row < `last_row` the part that shows land.

    Raises CasesError where there are not at least two images of one grid, or there is no land that all of them show.
    """
    images = [read_imagery(path) for path in geotiffs_in(folder)]
    if len(images) < 2:
        raise CasesError(
            f"holds {len(images)} GeoTIFFs ({', '.join(SUFFIXES)}), at least two are needed",
            where=str(folder),
            remedy="name a folder with the dates of one place",
        )
    for other in images[1:]:
        require_same_grid(images[0], other)
    rows = slice(first_row, last_row)
    valid = np.logical_and.reduce([image.valid[rows] for image in images])
    return _cropped(folder, Stack(folder.name, tuple(image.bands[rows] for image in images), np.zeros((len(images), 2)), valid))


def paired_stack(folder: Path, pairs: tuple[str, ...]) -> list[Stack]:
    """One stack for each named pair (`<pair>/a.tif`, `<pair>/b.tif`), the shift between the two measured. Raises CasesError."""
    return [_pair(folder / name) for name in pairs]


def _pair(folder: Path) -> Stack:
    a, b = (read_imagery(folder / f"{side}.tif") for side in "ab")
    require_same_size(a, b)
    shift_px = measured_shift_px(a, b)
    if np.abs(shift_px).max() > MOST_SHIFT_PX:
        raise CasesError(
            f"is shifted against a.tif by {np.abs(shift_px).max():g} px or more, or shows another place",
            where=str(b.path),
            remedy=f"register the two to within {MOST_SHIFT_PX} px, or leave the pair out (`pairs` of the source)",
        )
    back = np.column_stack([np.eye(2), shift_px])
    flags = cv2.INTER_NEAREST | cv2.WARP_INVERSE_MAP
    b_valid = cv2.warpAffine(b.valid.astype(np.uint8), back, b.valid.shape[::-1], flags=flags, borderMode=cv2.BORDER_REPLICATE)
    valid = np.logical_and(a.valid, np.asarray(b_valid) > 0)
    return _cropped(folder, Stack(folder.name, (a.bands, b.bands), np.stack([np.zeros(2), shift_px]), valid))


def measured_shift_px(a: Imagery, b: Imagery) -> NDArray[np.float64]:
    """(2,) columns and rows by which b's content lies right of and below a's: peak of the correlation of gradient features."""
    reach = min(SEARCHED_PX, min(a.valid.shape) // 4)
    fa, fb = (gradient_features(colours(image), image.valid) for image in (a, b))
    inner = np.ascontiguousarray(fa[reach:-reach, reach:-reach])
    scores = cv2.matchTemplate(np.ascontiguousarray(fb), inner, cv2.TM_CCORR_NORMED)
    _, _, _, (col, row) = cv2.minMaxLoc(scores)
    return np.array([col - reach, row - reach], dtype=np.float64)


def _cropped(folder: Path, stack: Stack) -> Stack:
    """The least rectangle of a stack that holds all land that all its dates show."""
    if not stack.valid.any() and stack.valid.size:
        raise CasesError(
            "no pixel shows land on all dates", where=str(folder), remedy="cut the dates to the area that all of them cover"
        )
    rows, cols = (np.flatnonzero(stack.valid.any(axis)) for axis in (1, 0))
    if not len(rows):
        return stack
    part = slice(rows[0], rows[-1] + 1), slice(cols[0], cols[-1] + 1)
    return replace(stack, dates=tuple(np.ascontiguousarray(date[part]) for date in stack.dates), valid=stack.valid[part])


def landscape_stack(seed: int, size_m: float, gsd_m: float, dates: int) -> Stack:
    """The procedural landscape of a seed in several seasons drawn at random by that seed."""
    rng = np.random.default_rng([seed, 7])
    images = [
        build_landscape(seed, _varied(season_of(("map", "flight")[k % 2]), rng), size_m, gsd_m).pixels for k in range(dates)
    ]
    return Stack(f"landscape {seed}", tuple(images), np.zeros((dates, 2)), np.ones(images[0].shape[:2], np.bool_))


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
