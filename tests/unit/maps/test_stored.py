from pathlib import Path

import numpy as np
import pytest
from numpy.lib.format import open_memmap

from visloc_companion.maps.manifest import FeatureLevel
from visloc_companion.maps.stored import INVALID, open_stored, quantised, tiled_shape

STEP, TILE = 2 / 127, 16


@pytest.fixture
def level() -> FeatureLevel:
    transform = (1.0, 0.0, 100.0, 0.0, -1.0, 900.0)
    return FeatureLevel(
        file="net_00.npy", rows=40, cols=50, transform=transform, name="net", recipe="r", channels=3, oriented=1, step=STEP,
        gsd_m=1.0, tile_px=TILE,
    )  # fmt: skip


def written(folder: Path, level: FeatureLevel, values: np.ndarray, valid: np.ndarray) -> None:
    out = open_memmap(
        folder / level.file, mode="w+", dtype=np.int8, shape=tiled_shape(level.rows, level.cols, level.channels, TILE)
    )
    stored = quantised(values, valid, STEP)
    for row in range(out.shape[0]):
        for col in range(out.shape[1]):
            part = stored[row * TILE : (row + 1) * TILE, col * TILE : (col + 1) * TILE]
            out[row, col, : part.shape[0], : part.shape[1]] = part
    out.flush()


@pytest.mark.parametrize(
    "window", [(0, 0, 50, 40), (3, 15, 30, 20), (-7, -9, 20, 20), (40, 30, 30, 30), (60, 60, 5, 5), (15, 15, 1, 1)]
)
def test_windows_are_cut_out_of_the_tiles(tmp_path: Path, level: FeatureLevel, window: tuple[int, int, int, int]) -> None:
    rng = np.random.default_rng(1)
    values, valid = rng.uniform(-2, 2, (40, 50, 3)).astype(np.float32), rng.random((40, 50)) > 0.2
    written(tmp_path, level, values, valid)
    left, top, width, height = window
    got, there = open_stored(tmp_path, level).window((left, top), (width, height))
    big, known = np.zeros((240, 250, 3), np.float32), np.zeros((240, 250), bool)
    big[100:140, 100:150], known[100:140, 100:150] = values * valid[..., None], valid
    part = slice(100 + top, 100 + top + height), slice(100 + left, 100 + left + width)
    assert got.dtype == np.float32 and (there == known[part]).all()
    assert np.abs(got - big[part]).max(initial=0) <= STEP / 2 + 1e-6
    assert not got[~there].any()


def test_quantisation_keeps_the_mark_of_no_content_apart() -> None:
    values = np.array([[[-5.0, 5.0, 0.0], [2.0, -2.0, STEP * 0.6]]], np.float32)
    stored = quantised(values, np.array([[True, False]]), STEP)
    assert stored.tolist() == [[[-127, 127, 0], [INVALID, 0, 0]]]
