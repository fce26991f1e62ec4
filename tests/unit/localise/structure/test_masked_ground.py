"""A cloud of the ground where landing gear is in view, and a mask says so."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tests.unit.landing_gear import legs, masked, with_gear
from visloc_companion.localise.masked import painted_over, with_margin
from visloc_companion.localise.structure.base import LocalCloud
from visloc_companion.localise.structure.cloud import local_cloud


def test_a_cloud_is_of_the_ground_beside_the_gear(structure, town) -> None:
    truth = [structure.pose(0, step, 90, 1.5, -1.0, 2.0) for step in (-27, 0, 27)]
    bare = structure.flown(town, truth)
    frames = [replace(frame, pixels=with_gear(frame.pixels)) for frame in bare]
    model = masked(structure.MODEL)
    told = local_cloud([replace(f, pixels=painted_over(f.pixels, model)) for f in frames], with_margin(model))
    untold = local_cloud(frames, structure.MODEL)
    assert isinstance(told, LocalCloud), told
    shown = told.pix[np.isfinite(told.pix).all(1)].round().astype(int)
    assert len(shown) > 3000
    assert not legs(structure.MODEL.width_px, structure.MODEL.height_px)[shown[:, 1], shown[:, 0]].any()
    assert scatter_m(told, town) < 0.3
    assert not isinstance(untold, LocalCloud) or scatter_m(untold, town) > 5.0


def scatter_m(cloud: LocalCloud, town) -> float:
    """Within which nine tenths of the heights lie, but for what they have in common."""
    off_m = cloud.points_m[:, 2] - town.height(cloud.points_m[:, :2])
    return float(np.percentile(np.abs(off_m - np.median(off_m)), 90))
