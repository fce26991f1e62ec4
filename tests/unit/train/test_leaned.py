"""Frames that are laid out with a tilt that is wrong."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from visloc_companion.train import pairs
from visloc_companion.train.augment import leaned
from visloc_companion.train.pairs import PairSettings, StackPyramid, make_pair
from visloc_companion.train.shapes import paint_dates
from visloc_companion.train.sources import Stack

SIDE, HEIGHT_PX = 101, 90.0


@pytest.mark.parametrize("towards_deg", [0, 70, 200])
@pytest.mark.parametrize("tilt_deg", [0, 4, 12])
@pytest.mark.parametrize(("right_px", "down_px"), [(0, 0), (25, -10), (-18, -30)])
def test_ground_lies_where_the_angles_of_its_ray_put_it(tilt_deg: float, towards_deg: float, right_px: int, down_px: int) -> None:
    v, u = np.mgrid[:SIDE, :SIDE] - (SIDE - 1) / 2
    spot = (200 * np.exp(-0.5 * ((u - right_px) ** 2 + (v - down_px) ** 2) / 2.0**2)).astype(np.float32)
    tilt, towards = math.radians(tilt_deg), math.radians(towards_deg)
    seen = leaned(spot, tilt, towards, HEIGHT_PX)
    found = np.array([float((u * seen).sum()), float((v * seen).sum())]) / float(seen.sum())

    along, across = np.array([math.cos(towards), math.sin(towards)]), np.array([-math.sin(towards), math.cos(towards)])
    ahead, beside = np.array([right_px, down_px]) @ along, np.array([right_px, down_px]) @ across
    angle = math.atan(ahead / HEIGHT_PX)
    ahead_seen = HEIGHT_PX * (math.tan(angle + tilt) - math.tan(tilt))
    beside_seen = beside * math.cos(angle) / math.cos(angle + tilt)
    np.testing.assert_allclose(found, ahead_seen * along + beside_seen * across, atol=0.15)  # a spot is stretched, too


def test_frames_lean_by_up_to_what_is_asked_for_and_not_at_all_by_default(monkeypatch: pytest.MonkeyPatch) -> None:
    town = np.repeat(paint_dates(np.random.default_rng(4), 300, 1)[0][..., None], 3, 2).astype(np.uint8)
    stack = StackPyramid(Stack("town", (town, town), np.zeros((2, 2)), np.ones(town.shape[:2], np.bool_)))
    plain = PairSettings(reference_px=64, footprint_share=0.8)
    asked: list[tuple[float, float, float]] = []

    def watched(image: Any, tilt_rad: float, towards_rad: float, height_px: float) -> Any:
        asked.append((tilt_rad, towards_rad, height_px))
        return leaned(image, tilt_rad, towards_rad, height_px)

    monkeypatch.setattr(pairs, "leaned", watched)
    upright = [make_pair(np.random.default_rng(seed), stack, plain, 48, (0.8, 1.2)) for seed in range(40)]
    assert asked == []
    leaning = replace(plain, misfit_tilt_rad=0.2)
    tilted = [make_pair(np.random.default_rng(seed), stack, leaning, 48, (0.8, 1.2)) for seed in range(40)]
    tilts, directions, heights = np.array(asked).T
    assert len(tilts) == 40
    assert 0.15 < tilts.max() <= 0.2
    assert tilts.min() < 0.05
    assert np.ptp(directions) > math.pi
    assert set(np.round(heights, 9)) == {round(0.8 * 48 / 2 / math.tan(math.radians(30)), 9)}
    for a, b in zip(upright, tilted, strict=True):
        np.testing.assert_array_equal(a.offset_px, b.offset_px)
        assert not np.array_equal(a.query, b.query)
