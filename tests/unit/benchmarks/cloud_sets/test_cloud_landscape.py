"""Registration cases over the procedural landscape, and what is printed of them."""

from __future__ import annotations

from functools import partial

import numpy as np
import pytest

from benchmarks import cloud_reach
from benchmarks.cloud_sets import cloud_landscape
from benchmarks.cloud_sets.cloud_landscape import GSD_M, NOISE_M, SIZE_M, SOURCE_M, TRAINING, TRAINING_ELSEWHERE, LandscapeWorld
from visloc_companion.localise.registration.base import NotRegistered, Registered, RegistrationPrior
from visloc_companion.localise.registration.similarity import moved

CELLS = int(SIZE_M / GSD_M)


@pytest.fixture
def world() -> LandscapeWorld:
    """A surface whose height is a hundredth of the northing, and a coarse reference of it, 30 m up."""
    north = SIZE_M / 2 - (np.arange(CELLS) + 0.5) * GSD_M
    surface = np.repeat((30 + 0.01 * north)[:, None], CELLS, axis=1).astype(np.float32)
    xy = np.random.default_rng(0).uniform(-SIZE_M / 2, SIZE_M / 2, (4000, 2))
    return LandscapeWorld(3, surface, np.column_stack([xy, 30 + 0.01 * xy[:, 1]]))


def test_the_truth_puts_a_source_where_it_was_cut_out(world):
    case = world.case(2, 100.0)
    assert case.T_true is not None
    placed = moved(case.T_true, case.source_m)
    assert np.ptp(placed[:, :2], axis=0) == pytest.approx([SOURCE_M, SOURCE_M], abs=1)
    assert (placed[:, 2] - 30 - 0.01 * placed[:, 1]).std() == pytest.approx(NOISE_M, rel=0.1)
    assert case.cover == "other"


def test_one_place_and_direction_at_every_error(world):
    near, far = world.case(2, 10.0), world.case(2, 100.0)
    off = [moved(c.T_true, c.source_m).mean(0)[:2] - c.source_m.mean(0)[:2] for c in (near, far)]
    assert off[1] == pytest.approx(10 * off[0], abs=0.2)
    assert far.prior.sigma_horizontal_m == pytest.approx(10 * near.prior.sigma_horizontal_m)


def test_elsewhere_has_no_right_place_and_lies_at_its_own_height(world):
    other = LandscapeWorld(4, world.surface, world.reference_m + np.array([0, 0, 500]))
    case = world.elsewhere(1, other)
    assert case.T_true is None
    assert np.median(case.reference_m[:, 2]) == pytest.approx(np.median(world.reference_m[:, 2]))


def test_training_takes_every_place_once_and_the_world_before_for_other_ground(world, monkeypatch):
    monkeypatch.setattr(LandscapeWorld, "built", lambda seed: LandscapeWorld(seed, world.surface, world.reference_m))
    cases = [c for before, seed in ((None, 7), (7, 8)) for c in cloud_landscape.training_cases(seed, before)]
    each = sum(n for _, n in TRAINING)
    assert len({c.name.split("_on_")[0] for c in cases}) == len(cases) == 2 * each + TRAINING_ELSEWHERE
    assert sum(c.T_true is None for c in cases) == TRAINING_ELSEWHERE


def test_reach_counts_what_is_accepted_and_wrong(world, monkeypatch):
    def method(source, reference, prior: RegistrationPrior) -> Registered | NotRegistered:
        return Registered(np.eye(4), np.eye(3), 0.01, 0.01, 0.02, ())

    monkeypatch.setattr(cloud_reach, "make_registration", lambda name, limit: method)
    lines = list(cloud_reach.rows("made", [partial(world.case, k) for k in range(3)], [0.01, 100.0]))
    cells = [[c.strip() for c in line.strip("|").split("|")] for line in lines]
    assert all(len(row) == cloud_reach.HEADER.count("|") - 1 for row in cells)
    columns = [name.strip() for name in cloud_reach.HEADER.strip("| ").split("|")]
    wrong = columns.index("accepted, wrong")
    assert [row[wrong] for row in cells] == ["0", "3"]
