"""Where a forest hides nearly all of its ground, the height that the vehicle knows decides what is ground."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from visloc_companion.localise.terrain.base import Soundings, TerrainFix
from visloc_companion.localise.terrain.match import locate
from visloc_companion.localise.terrain.settings import TerrainSettings

LOW_M, TALL_M = 8.0, 14.0


def wooded(seen: Soundings, through: float, glades_above: float) -> Soundings:
    """Crowns of 8 to 14 m but in glades; so many of the soundings meet the ground between them."""
    rng = np.random.default_rng(1)
    ne = seen.points_m[:, :2]
    tall = (LOW_M + TALL_M) / 2 + (TALL_M - LOW_M) / 2 * np.sin(ne[:, 0] / 90) * np.sin(ne[:, 1] / 70)
    glade = np.sin(ne[:, 0] / 70 + 1) * np.sin(ne[:, 1] / 60 + 2) > glades_above
    crown = np.where(glade | (rng.random(len(ne)) < through), 0.0, tall * rng.uniform(0.75, 1.0, len(ne)))
    return replace(seen, points_m=np.column_stack([ne, seen.points_m[:, 2] + crown]))


@pytest.mark.parametrize(("through", "glades_above"), [(0.07, 0.7), (0.1, 0.8)])
def test_crowns_are_no_rough_ground_where_the_height_is_known(
    world: SimpleNamespace, through: float, glades_above: float
) -> None:
    ground = world.waves(30.0)
    prior = replace(world.prior(h_off_m=1.0), sigma_h_m=1.0)
    elevation = world.elevation(ground, sigma_m=1.5)
    fix = locate(wooded(world.patch(ground), through, glades_above), prior, elevation, TerrainSettings())
    assert isinstance(fix, TerrainFix), fix
    assert abs(fix.h_amsl_m - world.true_h) < 0.5
    assert np.hypot(*np.subtract(fix.p_ne_m, world.true_ne)) < 2.0
    assert dict(fix.evidence)["others"] < 0.001, "the same place at another height is no other place"
