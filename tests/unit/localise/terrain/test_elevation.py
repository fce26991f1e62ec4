"""Windows of elevation models: places, voids, area means, and the surface of a reference map."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from visloc_companion.localise.local_frame import LocalFrame
from visloc_companion.localise.terrain.elevation import ElevationMap, elevation_of
from visloc_companion.types import GeoPoint, ReferencePatch


def test_heights_and_slopes_are_those_of_the_ground_whatever_the_rows_point_to(world: SimpleNamespace) -> None:
    ground = world.waves(30)
    model = world.elevation(ground)
    terrain = model.window((100.0, -300.0), (400.0, 300.0), 20.0)
    ne = np.random.default_rng(1).uniform([-200, -500], [400, -100], (50, 2))
    heights, slopes = terrain.heights_and_slopes(ne)
    assert heights == pytest.approx(ground(ne), abs=0.1)
    by_north = (ground(ne + np.array([5.0, 0])) - ground(ne - np.array([5.0, 0]))) / 10
    assert slopes[:, 0] == pytest.approx(by_north, abs=0.02)
    assert terrain.knows(ne).all()


def test_voids_and_what_lies_outside_are_not_known(world: SimpleNamespace) -> None:
    model = world.elevation(world.waves(30))
    model.height_amsl_m[100, 100] = np.nan  # the cell at the origin
    terrain = model.window((0.0, 0.0), (200.0, 200.0), 20.0)
    assert list(terrain.knows(np.array([[0.0, 0.0], [10.0, 0.0], [60.0, 60.0]]))) == [False, False, True]
    assert np.isfinite(terrain.heights(np.array([[0.0, 0.0]]))).all()
    assert not model.window((1e5, 0.0), (200.0, 200.0), 20.0).known.any()


def test_coarser_cells_are_means(world: SimpleNamespace) -> None:
    rng = np.random.default_rng(1)
    noise = ElevationMap(rng.normal(0, 1, (200, 200)).astype(np.float32), np.array([[0.0, 10.0, -1000], [10.0, 0.0, -1000]]), 1.0)
    coarse = noise.window((0.0, 0.0), (800.0, 800.0), 40.0)
    assert coarse.height_amsl_m.std() < 0.4
    assert coarse.slope_rms() < noise.window((0.0, 0.0), (800.0, 800.0), 10.0).slope_rms()


def test_a_reference_maps_surface_is_an_elevation_model() -> None:
    frame = LocalFrame(GeoPoint(47, 8, 0), np.array([[0.0, 1.0], [1.0, 0.0]]), np.array([500_000.0, 5_200_000.0]))
    T_map_pix = np.array([[10.0, 0.0, 500_000.0 - 95], [0.0, -10.0, 5_200_000.0 + 95]])
    v, _ = np.mgrid[0:20, 0:20]
    valid = np.ones((20, 20), bool)
    valid[0, 0] = False
    patch = ReferencePatch(np.zeros((20, 20), np.uint8), valid, (500 - 2.0 * v).astype(np.float32), T_map_pix, 10.0, 0.0)
    model = elevation_of(patch, frame, 1.5)
    assert model.cell_m == pytest.approx(10)
    assert np.isnan(model.height_amsl_m[0, 0])
    terrain = model.window((0.0, 0.0), (50.0, 50.0), 10.0)
    assert terrain.heights(np.array([[0.0, 0.0], [30.0, 0.0]])) == pytest.approx([481.0, 487.0], abs=0.05)
