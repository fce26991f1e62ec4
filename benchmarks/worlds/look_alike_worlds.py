"""Ground that looks alike in several places, for `benchmarks.look_alike`: blocks of the procedural landscape laid out again.

    blocks     squares of BLOCK_M, each one of three of the landscape in one of random order: what a frame shows lies in several
               places, and no two ways over it agree for long
    rows       one square of BLOCK_M everywhere, with what is its own in each place for a share of STRAY of the squares
    periodic   one square of BLOCK_M everywhere: nothing tells its places apart
    plantation one square of PLANT_M everywhere

Both dates are laid out alike, each from its own landscape: map and camera are five years apart.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from visloc_companion.localise.features.onnx import open_features
from visloc_companion.maps.pack import PackMap
from visloc_companion.prepare.build import build_pack
from visloc_companion.sim.land.season import Date
from visloc_companion.sim.landscape import build_landscape
from visloc_companion.sim.scene import Scene
from visloc_companion.types import Image

KINDS: Final = ("blocks", "rows", "periodic", "plantation", "ordinary")
SIZE_M, GSD_M = 1000.0, 0.5
BLOCK_M, PLANT_M, STRAY = 60.0, 12.0, 0.12
LETTERS = 3


@dataclass(frozen=True, slots=True)
class Ground:
    """What the navigator has, and what the camera sees."""

    pack: PackMap
    scene: Scene


def ground_of(kind: str, seed: int, folder: Path) -> Ground:
    """The ground of a kind and a seed, kept in the folder."""
    home = folder / f"{kind}-{seed}"
    if not (home / "pack").is_dir():
        for date in ("map", "flight"):
            scene = build_landscape(seed, "map" if date == "map" else "flight", SIZE_M, GSD_M)
            flat = np.zeros_like(scene.dsm_amsl_m)
            Scene(laid_out(scene.pixels, kind, seed), flat, scene.T_map_pix, scene.crs).save(home / date)
        networks = [open_features()]
        build_pack(
            [home / "map" / "ortho.tif"], None, home / "pack", source="procedural landscape", licence="CC0-1.0", networks=networks
        )
    scene = Scene.load(home / "flight" / "ortho.tif", home / "flight" / "dsm.tif")
    return Ground(PackMap.open(home / "pack", verify_hashes=False), scene)


def scene_of(seed: int, date: Date, size_m: float, gsd_m: float) -> Scene:
    """Ground of a kind that follows from the seed, level, as `landscape_cases.Worlds` asks for it; ValueError but at GSD_M."""
    if gsd_m != GSD_M:
        raise ValueError(f"squares are laid out at {GSD_M} m a pixel, not {gsd_m}")
    scene = build_landscape(seed, date, size_m, gsd_m)
    pixels = laid_out(scene.pixels, KINDS[seed % len(KINDS)], seed)
    return Scene(pixels, np.zeros_like(scene.dsm_amsl_m), scene.T_map_pix, scene.crs)


def laid_out(pixels: Image, kind: str, seed: int) -> Image:
    """The pixels (H, W, 3) of one date, its squares laid out by the kind and the seed alone."""
    if kind == "ordinary":
        return pixels
    rng = np.random.default_rng(seed)
    side = round((PLANT_M if kind == "plantation" else BLOCK_M) / GSD_M)
    rows, columns = pixels.shape[0] // side, pixels.shape[1] // side
    corners = rng.integers(0, min(pixels.shape[:2]) - side, (LETTERS, 2))
    chosen = rng.integers(0, LETTERS, (rows, columns)) if kind == "blocks" else np.zeros((rows, columns), np.int64)
    own = rng.random((rows, columns)) < (STRAY if kind == "rows" else 0.0)
    out = pixels.copy()
    for row in range(rows):
        for column in range(columns):
            if not own[row, column]:
                y, x = corners[chosen[row, column]]
                at = slice(row * side, (row + 1) * side), slice(column * side, (column + 1) * side)
                out[at] = pixels[y : y + side, x : x + side]
    return out
