"""Lines of soundings under a navigation height that walks: a barometer's, in weather."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np

from visloc_companion.localise.terrain.base import Soundings, TerrainFix
from visloc_companion.localise.terrain.elevation import ElevationMap
from visloc_companion.localise.terrain.match import locate
from visloc_companion.localise.terrain.settings import TerrainSettings

FLIGHTS, WALK = 12, 0.24
"""The walk in m/sqrt(s): 10 m in an hour."""


def under_weather(seen: Soundings, seed: int) -> Soundings:
    """The same line of a height that is right at its end, and walked there from wherever it was before."""
    order = np.argsort(seen.age_s)
    spans = np.diff(seen.age_s[order], prepend=0.0)
    off = np.empty(len(order))
    off[order] = np.cumsum(np.random.default_rng([seed, 6]).normal(0, WALK, len(order)) * np.sqrt(spans))
    return replace(seen, points_m=seen.points_m + off[:, None] * [0, 0, 1])


def flown(world: SimpleNamespace) -> tuple[np.ndarray, np.ndarray]:
    """Heights' errors (N,) and the same over their sigmas, over a good model of gentle hills."""
    errors, ratios = [], []
    for seed in range(FLIGHTS):
        ground = world.waves(40, seed=seed)
        model: ElevationMap = world.elevation(ground, half_m=4500.0, sigma_m=0.5, noise_m=0.3)
        prior = replace(world.prior(20.0), sigma_h_walk=WALK)
        fix = locate(under_weather(world.profile(ground, 4000.0), seed), prior, model, TerrainSettings(max_probability_wrong=1.0))
        assert isinstance(fix, TerrainFix)
        errors.append(fix.h_amsl_m - world.true_h)
        ratios.append(errors[-1] / fix.sigma_h_m)
    return np.array(errors), np.array(ratios)


def test_the_end_of_a_line_tells_the_height_there(world: SimpleNamespace) -> None:
    """In its mean over 80 s it would be off by 0.24 m/sqrt(s) x sqrt(80 s / 3) = 1.2 m."""
    errors, ratios = flown(world)
    assert np.sqrt(np.square(errors).mean()) < 0.7
    assert 0.4 < np.sqrt(np.square(ratios).mean()) < 1.3
