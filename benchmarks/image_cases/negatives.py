"""Cases without a right answer: water, cloud, and ground that the map does not hold."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import rasterio
from numpy.typing import NDArray
from rasterio.windows import Window

from benchmarks.image_cases.cases import SHARED, maker
from benchmarks.image_cases.frames import Draw, Place, Recipe, anywhere, cut, nominal_height_m

NDWI_WATER = 0.15
"""Water is where (green - NIR) / (green + NIR) exceeds this (McFeeters 1996; lakes of all ten dates lie clearly above)."""


HALF_DIAGONAL = 0.77
"""Of a footprint of side 1 at the largest height drawn."""


def water(foot_px: float, rows: tuple[int, int]) -> Draw:
    """NAIP frames that show nothing but lake, by the rule above, on both dates, however the footprint is turned."""
    files = sorted((SHARED / "data" / "naip").glob("*.tif"))
    images = [maker().read(path) for path in files]
    lakes = [_from_shore_px(_lake(path)) > HALF_DIAGONAL * foot_px for path in files]

    def draw(rng: np.random.Generator) -> Place | None:
        a, b = rng.choice(len(files), 2, replace=False)
        inside = np.argwhere((lakes[a] & lakes[b])[rows[0] : rows[1]])
        if not len(inside):
            return None
        row, col = inside[rng.integers(len(inside))]
        at = np.array([col, row + rows[0]], dtype=np.float64)
        _, transform, crs = images[b]
        dates = (files[b].stem, files[a].stem)
        return cut(rng, images[a][0], at, (files[b], transform, crs), at, Recipe(), foot_px, dates, False)

    return draw


def outside(pack: Path, frame_rows: tuple[int, int], foot_px: float) -> Draw:
    """NAIP frames over ground that the map (one of the files in `pack`: other rows, or another place) does not hold."""
    files = sorted((SHARED / "data" / "naip").glob("*.tif"))
    scenes = [maker().read(path)[0] for path in files]
    maps = [(path, *maker().read(path)) for path in sorted(pack.glob("*.tif"))]
    margin = 0.62 * foot_px

    def draw(rng: np.random.Generator) -> Place | None:
        a, b = int(rng.integers(len(files))), int(rng.integers(len(maps)))
        map_file, ortho, transform, crs = maps[b]
        low, high = frame_rows[0] + margin, min(frame_rows[1], scenes[a].shape[0]) - margin
        seen_at = np.array([rng.uniform(margin, scenes[a].shape[1] - margin), rng.uniform(low, high)])
        at = anywhere(rng, ortho.shape, margin)
        dates = (map_file.stem, files[a].stem)
        return cut(rng, scenes[a], seen_at, (map_file, transform, crs), at, Recipe(), foot_px, dates, False)

    return draw


def clouds(rows: tuple[int, int], foot_px: float) -> Draw:
    """Frames of nothing but cloud: noise of a power law (exponent 1.2 to 2 in amplitude), bright, of little or much contrast."""
    files = sorted((SHARED / "data" / "naip").glob("*.tif"))
    images = [maker().read(path) for path in files]

    def draw(rng: np.random.Generator) -> Place:
        k = int(rng.integers(len(files)))
        ortho, transform, _ = images[k]
        margin = 0.62 * foot_px
        at = np.array([rng.uniform(margin, ortho.shape[1] - margin), rng.uniform(max(margin, rows[0]), rows[1] - margin)])
        height = nominal_height_m(foot_px, transform.a) * (1 + rng.uniform(-0.08, 0.08))
        attitude = (0.0, 0.0, float(rng.uniform(0, 360)))
        return Place(_cloud(rng), files[k], at, height, attitude, (files[k].stem, "cloud"), foot_px, False)

    return draw


def write_pack(folder: Path, rows: tuple[int, int]) -> Path:
    """The NAIP dates cut to some rows, as maps that end there."""
    folder.mkdir(parents=True, exist_ok=True)
    for path in sorted((SHARED / "data" / "naip").glob("*.tif")):
        if (folder / path.name).exists():
            continue
        with rasterio.open(path) as source:
            window = Window(0, rows[0], source.width, rows[1] - rows[0])
            profile = source.profile | {"height": rows[1] - rows[0], "transform": source.window_transform(window)}
            with rasterio.open(folder / path.name, "w", **profile) as target:
                target.write(source.read(window=window))
    return folder


def _lake(path: Path) -> NDArray[np.bool_]:
    with rasterio.open(path) as source:
        green, near_infrared = (source.read(band).astype(np.float32) for band in (2, 4))
    return np.asarray((green - near_infrared) / (green + near_infrared + 1) > NDWI_WATER, dtype=np.bool_)


def _from_shore_px(lake: NDArray[np.bool_]) -> NDArray[np.float32]:
    """Distance of every pixel of a lake from the nearest that is none, or from the image's border."""
    padded = np.pad(lake.astype(np.uint8), 1)
    return np.asarray(cv2.distanceTransform(padded, cv2.DIST_L2, 5)[1:-1, 1:-1], dtype=np.float32)


def _cloud(rng: np.random.Generator) -> NDArray[np.float64]:
    side = maker().FRAME_PX
    frequency = np.hypot(np.fft.fftfreq(side)[:, None], np.fft.rfftfreq(side)[None, :])
    frequency[0, 0] = 1.0
    spectrum = np.fft.rfft2(rng.normal(size=(side, side))) / frequency ** rng.uniform(1.2, 2.0)
    noise = np.fft.irfft2(spectrum, (side, side))
    grey = rng.uniform(150, 215) + rng.uniform(4, 40) * (noise - noise.mean()) / noise.std()
    return np.asarray(np.repeat(grey[..., None], 3, axis=2), dtype=np.float64)
