from __future__ import annotations

from typing import Any

import numpy as np
import pytest

torch = pytest.importorskip("torch", reason="PyTorch is not installed: make install-train")

from visloc_companion.train.losses import correlation_surface, upright  # noqa: E402
from visloc_companion.train.pairs import Pair, PairSettings, StackPyramid, make_pair  # noqa: E402
from visloc_companion.train.shapes import paint_dates  # noqa: E402
from visloc_companion.train.sources import Stack  # noqa: E402
from visloc_companion.train.steps import as_batch  # noqa: E402

PLAIN = PairSettings(
    misfit_turn_rad=0.0, misfit_log_scale=0.0, same_date_share=1.0, change_share=0.0, photometric=0.0, footprint_share=0.95
)


def stack_of(image: np.ndarray, valid: np.ndarray | None = None) -> StackPyramid:
    bands = np.ascontiguousarray(np.repeat(image[..., None], 3, 2).astype(np.uint8))
    land = np.ones(image.shape, np.bool_) if valid is None else valid
    return StackPyramid(Stack("test", (bands, bands), np.zeros((2, 2)), land))


def spot(shape: tuple[int, int], u_px: float, v_px: float, sigma_px: float) -> np.ndarray:
    v, u = np.mgrid[: shape[0], : shape[1]]
    return 250 * np.exp(-0.5 * ((u - u_px) ** 2 + (v - v_px) ** 2) / sigma_px**2)


@pytest.mark.parametrize("shape", [(700, 900), (701, 903), (703, 901)])
@pytest.mark.parametrize("scale", [1.0, 2.0, 4.0])
def test_reduced_levels_show_a_place_where_the_whole_image_does(shape: tuple[int, int], scale: float) -> None:
    at = np.array([shape[1] - 80.3, shape[0] - 60.6])
    pyramid = stack_of(spot(shape, *at, 3 * scale))
    side = 32
    A_source_piece = np.column_stack([np.diag([scale, scale]), at - scale * np.array([17.25, 14.5])])
    piece = pyramid.piece(np.random.default_rng(0), 0, A_source_piece, side)
    v, u = np.mgrid[:side, :side]
    weight = piece / piece.sum()
    assert [float((u * weight).sum()), float((v * weight).sum())] == pytest.approx([17.25, 14.5], abs=0.06)


def test_labels_say_where_the_frame_lies_how_it_is_turned_and_scaled() -> None:
    town = paint_dates(np.random.default_rng(4), 600, 1)[0]
    pairs: list[Pair] = [make_pair(np.random.default_rng(seed), stack_of(town), PLAIN, 80, (0.8, 1.4)) for seed in range(24)]
    batch = as_batch(pairs)
    peaks, scores = {}, {}
    for sign in (1, -1):
        query = batch.query[:, 1:3] * batch.query_valid[:, None]
        window, mask = upright(query, batch.query_valid, batch.window_to_query, sign * batch.turn_rad)
        surface = correlation_surface(batch.reference[:, 1:3], window, mask)
        flat, n = surface.flatten(1), surface.shape[-1]
        best = flat.argmax(1)
        peaks[sign] = np.stack([(best % n).numpy(), (best // n).numpy()], 1) - batch.offset_px.numpy()
        scores[sign] = float(flat.amax(1).mean())
    near = np.abs(peaks[1]).max(1) < 1.0
    assert near.mean() > 0.8
    assert np.abs(peaks[1][near].mean(0)).max() < 0.2
    assert scores[1] > scores[-1] + 0.03


def test_pairs_are_cut_where_all_dates_show_land() -> None:
    land = paint_dates(np.random.default_rng(4), 400, 1)[0].clip(60, 200)
    v, u = np.mgrid[:400, :400]
    valid = np.abs(u - v) < 190
    marked = np.where(valid, land, 0)
    pyramid = stack_of(marked, valid)
    settings = PairSettings(reference_px=64)
    empty = []
    for seed in range(40):
        seen: list[float] = []

        class Watched:
            shape, dates, name, empty_share = pyramid.shape, pyramid.dates, pyramid.name, pyramid.empty_share

            def piece(self, *cut: Any, seen: list[float] = seen) -> np.ndarray:
                seen.append(pyramid.empty_share(*cut[2:]))
                return pyramid.piece(*cut)

        make_pair(np.random.default_rng(seed), Watched(), settings, 48, (0.7, 2.0))  # type: ignore[arg-type]
        empty += seen
    assert len(empty) == 80
    assert max(empty) <= 0.02
