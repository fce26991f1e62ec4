"""Cases of real photographs of a town, from 115 m up, over a satellite map of 0.16 m a pixel, varied as frames are."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np

from benchmarks.image_cases.cases import read_table, write_tables
from benchmarks.image_cases.photos import PhotoPrior, drone_urban
from benchmarks.image_cases.sensor_variations import FRAMES, NOT_OF_THIS_CAMERA, Bands
from visloc_companion.types import Image

SHRUNK = 6
NEAR = PhotoPrior(40.0)
"""A prior as a filter gives it seconds after its last fix."""
VARIED = (
    *(
        "colour",
        "grey",
        "inverted grey",
        "thermal-like (made)",
        "night gain, SNR 4",
        "on-screen display",
        "letterbox",
        "mirrored",
    ),
)


def _shrunk(bands: Bands, _: np.random.Generator) -> Image:
    size = bands.shape[1] // SHRUNK, bands.shape[0] // SHRUNK
    return np.asarray(cv2.resize(bands[..., :3], size, interpolation=cv2.INTER_AREA), dtype=np.uint8)


PHOTOS: dict[str, Callable[[Bands, np.random.Generator], Image]] = {
    **{name: FRAMES[name] for name in VARIED},
    "shrunk to 0.8 m a pixel": _shrunk,
}


def of_photos(root: Path, name: str, _n: int, _foot_px: float) -> Path:
    """The folder of cases of the 35 photographs, one prior each."""
    folder = root / f"photo {name}"
    if (folder / "cases.csv").exists():
        return folder
    (folder / "frames").mkdir(parents=True, exist_ok=True)
    source = drone_urban(root / "photos", NEAR, draws=1)
    tables = []
    for number, (case, truth) in enumerate(zip(read_table(source / "cases.csv"), read_table(source / "truth.csv"), strict=True)):
        if truth["solvable"] == "0":
            continue
        photo = cv2.imread(case["frame"])[..., ::-1]
        bands = np.dstack([photo, np.zeros_like(photo[..., :1])])
        pixels = PHOTOS[name](bands, np.random.default_rng([31, number]))
        file = f"frames/{case['id']}.png"
        cv2.imwrite(str(folder / file), pixels if pixels.ndim == 2 else pixels[..., ::-1])
        scale = pixels.shape[1] / photo.shape[1]
        of_size = {k: float(case[k]) * scale for k in ("fx_px", "fy_px")}
        of_size |= {k: (float(case[k]) + 0.5) * scale - 0.5 for k in ("cx_px", "cy_px")}
        solvable = int(name not in NOT_OF_THIS_CAMERA)
        tables.append((case | {"frame": file} | of_size, truth | {"solvable": solvable}))
    return write_tables(folder, *zip(*tables, strict=True))
