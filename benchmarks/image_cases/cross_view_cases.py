"""Cases of the published task T1: neither heading nor lean is known, and the place only to about a footprint.

As published (Sabel et al. 2022, after Shetty & Gao 2019): ±200 m on each axis from 250 m above ground, of which the tool's camera
sees 289 m across, is ±0.69 of the footprint; height ±20 %, any heading, 0 to 45 degrees of lean in any direction.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.image_cases.cases import SHARED, maker
from benchmarks.image_cases.frames import Draw, Place, Recipe, cut, two_dates, write_cases
from benchmarks.image_cases.tilt_cases import untold

FOOT_PX = 144
T1 = Recipe(offset_px=100, heading_deg=180, height=0.2, tilt_deg=45)
PRIOR = {"prior_roll_deg": 0.0, "prior_pitch_deg": 0.0, "prior_yaw_deg": 0.0, "sigma_tilt_deg": 18.0}
"""Level and north, with the 1-sigma on each axis of a lean that is uniform up to 45 degrees."""
FIRST_SCORED_ROW, LAST_ROW, ANY_ROW = 400, 721, (0, 721)
NAIP, OTHER_PLACE = SHARED / "data" / "naip", SHARED / "data" / "bitemporal" / "bragg_2009_2012"

Dated = tuple[Path, Any, Any, Any]
"""An image's file, pixels, transform and CRS."""


def t1_fit(root: Path, n: int) -> Path:
    """Training rows of NAIP, two dates each."""
    return _untold(root / "t1_fit", n, 951, naip((0, FIRST_SCORED_ROW), same=False))


def t1(root: Path, n: int) -> Path:
    """Other rows of NAIP, two dates each."""
    return _untold(root / "t1", n, 952, naip((FIRST_SCORED_ROW, LAST_ROW), same=False))


def t1_same(root: Path, n: int) -> Path:
    """The same image for frame and map."""
    return _untold(root / "t1_same", n, 953, naip((FIRST_SCORED_ROW, LAST_ROW), same=True))


def t1_pairs(root: Path, n: int) -> Path:
    """Pairs of dates of another area."""
    pairs = sorted(path for path in (SHARED / "data" / "bitemporal").glob("bragg_*") if path.is_dir())
    return _untold(root / "t1_pairs", n, 954, two_dates(pairs, FOOT_PX, T1))


def t1_fit_elsewhere(root: Path, n: int) -> Path:
    """Training rows of NAIP on maps of another area."""
    return _untold(root / "t1_fit_elsewhere", n, 955, elsewhere(NAIP, (0, FIRST_SCORED_ROW), OTHER_PLACE, ANY_ROW))


def t1_elsewhere(root: Path, n: int) -> Path:
    """Frames of another area on other rows of NAIP."""
    return _untold(root / "t1_elsewhere", n, 956, elsewhere(OTHER_PLACE, ANY_ROW, NAIP, (FIRST_SCORED_ROW, LAST_ROW)))


FIT: dict[str, Callable[[Path, int], Path]] = {"t1_fit": t1_fit, "t1_fit_elsewhere": t1_fit_elsewhere}
SETS: dict[str, Callable[[Path, int], Path]] = {"t1": t1, "t1_same": t1_same, "t1_pairs": t1_pairs, "t1_elsewhere": t1_elsewhere}


def naip(rows: tuple[int, int], *, same: bool) -> Draw:
    """Frames whose camera is over those rows."""
    images = _read(NAIP)

    def draw(rng: np.random.Generator) -> Place | None:
        a, b = rng.choice(len(images), 2, replace=False)
        (frame_file, scene, _, _), (map_file, ortho, transform, crs) = images[b if same else a], images[b]
        at = _over(rng, ortho.shape, rows)
        dates = map_file.stem, frame_file.stem
        return cut(rng, scene, at, (map_file, transform, crs), at, T1, FOOT_PX, dates, True)

    return draw


def elsewhere(scenes: Path, seen_rows: tuple[int, int], maps: Path, rows: tuple[int, int]) -> Draw:
    """Frames over rows of one folder's images that are said to be over rows of another's."""
    seen, images = _read(scenes), _read(maps)

    def draw(rng: np.random.Generator) -> Place | None:
        (frame_file, scene, _, _), (map_file, ortho, transform, crs) = _one(rng, seen), _one(rng, images)
        at, seen_at = _over(rng, ortho.shape, rows), _over(rng, scene.shape, seen_rows)
        return cut(rng, scene, seen_at, (map_file, transform, crs), at, T1, FOOT_PX, (map_file.stem, frame_file.stem), False)

    return draw


def _read(folder: Path) -> list[Dated]:
    return [(path, *maker().read(path)) for path in sorted(folder.glob("*.tif"))]


def _one(rng: np.random.Generator, images: list[Dated]) -> Dated:
    return images[rng.integers(len(images))]


def _over(rng: np.random.Generator, shape: tuple[int, ...], rows: tuple[int, int]) -> NDArray[np.float64]:
    margin = 0.62 * FOOT_PX
    low, high = max(margin, rows[0]), min(shape[0] - margin, rows[1])
    return np.array([rng.uniform(margin, shape[1] - margin), rng.uniform(low, high)])


def _untold(folder: Path, n: int, seed: int, draw: Draw) -> Path:
    told = write_cases(folder.with_name(f"{folder.name}_told"), n, seed, draw, T1)
    return untold(told, folder, largest_deg=90.0, n=n, prior=PRIOR)
