"""Matching soundings with elevations: right to a fraction of a cell, or refused with the reason."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from visloc_companion.errors import Reason
from visloc_companion.localise.terrain.base import NoTerrainFix, Soundings, TerrainFix, TerrainPrior
from visloc_companion.localise.terrain.elevation import ElevationMap
from visloc_companion.localise.terrain.match import locate
from visloc_companion.localise.terrain.settings import TerrainSettings

SETTINGS = TerrainSettings()


def error(fix: TerrainFix | NoTerrainFix, world: SimpleNamespace) -> np.ndarray:
    assert isinstance(fix, TerrainFix), fix
    return np.array([*np.subtract(fix.p_ne_m, world.true_ne), fix.h_amsl_m - world.true_h])


def test_a_shift_is_found_to_a_fraction_of_a_cell_and_the_height_with_it(world: SimpleNamespace) -> None:
    ground = world.waves(30)
    fix = locate(world.patch(ground), world.prior(h_off_m=6.0), world.elevation(ground), SETTINGS)
    off = error(fix, world)
    assert np.hypot(off[0], off[1]) < 1.0
    assert abs(off[2]) < 0.5


@pytest.mark.parametrize("h_off_m", [-20.0, 15.0])
def test_an_offset_of_the_barometer_is_found(world: SimpleNamespace, h_off_m: float) -> None:
    ground = world.waves(30)
    fix = locate(world.patch(ground), world.prior(h_off_m=h_off_m), world.elevation(ground), SETTINGS)
    assert abs(error(fix, world)[2]) < 0.5


def test_a_height_that_drifts_over_the_stretch_is_told_of_its_middle(world: SimpleNamespace) -> None:
    """The barometer falls by 4 m in 12 s: its mean error over the stretch is that of the middle, 2 m from that of the end."""
    ground = world.waves(60.0)
    seen = world.patch(ground)
    drifting = np.column_stack([seen.points_m[:, :2], seen.points_m[:, 2] + 4.0 * seen.age_s / 12])
    walking = replace(world.prior(), sigma_h_walk=0.5)
    model = world.elevation(ground, sigma_m=0.1)  # errors that are alike nearby would make the outer soundings weigh more
    fix = locate(replace(seen, points_m=drifting), walking, model, SETTINGS)
    assert isinstance(fix, TerrainFix)
    middle = float(seen.age_s.mean())
    assert fix.height_age_s == pytest.approx(middle, abs=0.5)
    assert fix.h_amsl_m + 4.0 * middle / 12 == pytest.approx(world.true_h, abs=0.3)
    still = locate(seen, replace(walking, sigma_h_walk=0.0), model, SETTINGS)
    assert isinstance(still, TerrainFix)
    assert still.sigma_h_m == still.sigma_h_then_m < fix.sigma_h_then_m
    assert fix.sigma_h_m**2 - still.sigma_h_m**2 == pytest.approx(0.5**2 * 12 / 3, rel=0.15)
    assert fix.sigma_h_then_m**2 - still.sigma_h_m**2 < 0.4


def test_an_error_of_heading_and_tilt_is_borne(world: SimpleNamespace) -> None:
    ground = world.waves(30)
    seen, angle, tilt = world.patch(ground), 0.03, 0.004
    c, s = np.cos(angle), np.sin(angle)
    n, e, up = seen.points_m.T
    turned = Soundings(9, np.column_stack([c * n - s * e, s * n + c * e, up - tilt * n]), seen.age_s, seen.sigma_m)
    off = error(
        locate(turned, replace(world.prior(), sigma_yaw_rad=0.03, sigma_tilt_rad=0.004), world.elevation(ground), SETTINGS), world
    )
    assert np.hypot(off[0], off[1]) < 5.0


def test_an_error_of_heading_turns_what_is_seen_and_not_the_track(world: SimpleNamespace) -> None:
    ground = world.waves(30)
    rng, angle, length = np.random.default_rng(7), 0.02, 1500.0
    age = rng.uniform(0, length / 50, 3000)
    track = np.column_stack([-50 * age, np.zeros(len(age))])
    level = np.column_stack([np.zeros(len(age)), rng.uniform(-300, 300, len(age))])
    up = ground(track + level + np.array(world.true_ne)) - world.true_h + rng.normal(0, 0.3, len(age))
    turned = level @ np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    beam = np.column_stack([turned, up])
    seen = Soundings(9, beam + np.column_stack([track, np.zeros(len(age))]), age, 0.4, beam_m=beam)
    off = error(locate(seen, replace(world.prior(), sigma_yaw_rad=0.02), world.elevation(ground), SETTINGS), world)
    assert np.hypot(off[0], off[1]) < 2.0


def test_flat_ground_is_refused(world: SimpleNamespace) -> None:
    answer = locate(world.patch(world.waves(0.0)), world.prior(), world.elevation(world.waves(0.0), noise_m=1.0), SETTINGS)
    assert isinstance(answer, NoTerrainFix)
    assert answer.reason is Reason.LOW_TEXTURE


def test_a_plane_is_refused_for_it_says_nothing_along_its_contours(world: SimpleNamespace) -> None:
    def plane(ne: np.ndarray) -> np.ndarray:
        return 300 + 0.1 * ne[:, 0]

    answer = locate(world.patch(plane), world.prior(), world.elevation(plane), SETTINGS)
    assert isinstance(answer, NoTerrainFix)
    assert answer.reason is Reason.LOW_TEXTURE


def test_a_lake_that_sends_nothing_back_is_refused(world: SimpleNamespace) -> None:
    answer = locate(Soundings(9, np.zeros((3, 3)), np.zeros(3), 0.4), world.prior(), world.elevation(world.waves(30)), SETTINGS)
    assert isinstance(answer, NoTerrainFix)
    assert answer.reason is Reason.TOO_FEW_FEATURES


def test_of_two_valleys_alike_neither_is_believed(world: SimpleNamespace) -> None:
    once = world.waves(20)

    def twice(ne: np.ndarray) -> np.ndarray:
        folded = ne.copy()
        folded[:, 1] = np.mod(ne[:, 1] + 200, 400) - 200  # the same ground every 400 m to the east
        return once(folded) * np.cos(folded[:, 1] * np.pi / 400) ** 2

    where = (63.0, -200.0)
    seen = world.patch(twice, half_m=200, at=where)
    answer = locate(seen, world.prior(sigma_m=200.0), world.elevation(twice), SETTINGS)
    assert isinstance(answer, NoTerrainFix)
    assert answer.reason is Reason.AMBIGUOUS


def test_trees_hardly_lift_the_height(world: SimpleNamespace) -> None:
    ground = world.waves(30)
    off = error(locate(world.patch(ground, trees=0.3, tree_m=22.0), world.prior(), world.elevation(ground), SETTINGS), world)
    assert np.hypot(off[0], off[1]) < 3.0
    assert abs(off[2]) < 1.0


def test_low_crowns_that_are_taken_for_ground_are_in_the_sigma_of_the_height(world: SimpleNamespace) -> None:
    ground = world.waves(30)
    model = world.elevation(ground)
    bare = locate(world.patch(ground), world.prior(), model, SETTINGS)
    bushes = locate(world.patch(ground, trees=0.9, tree_m=4.0), world.prior(), model, SETTINGS)
    assert isinstance(bare, TerrainFix)
    assert isinstance(bushes, TerrainFix)
    lifted_m = world.true_h - bushes.h_amsl_m
    assert lifted_m > 1.0
    assert lifted_m < 1.5 * bushes.sigma_h_m
    assert lifted_m > 2 * bare.sigma_h_m


def test_voids_are_left_out(world: SimpleNamespace) -> None:
    ground = world.waves(30)
    model = world.elevation(ground)
    holed = model.height_amsl_m.copy()
    holed[95:103, 98:106] = np.nan
    off = error(locate(world.patch(ground), world.prior(), replace(model, height_amsl_m=holed), SETTINGS), world)
    assert np.hypot(off[0], off[1]) < 2.0


def test_a_prior_outside_the_model_is_refused(world: SimpleNamespace) -> None:
    ground = world.waves(30)
    answer = locate(world.patch(ground), world.prior(at=(5000.0, 0.0)), world.elevation(ground), SETTINGS)
    assert isinstance(answer, NoTerrainFix)
    assert answer.reason is Reason.OUTSIDE_MAP


def test_a_prior_too_wide_to_search_is_refused(world: SimpleNamespace) -> None:
    ground = world.waves(30)
    answer = locate(world.patch(ground), world.prior(sigma_m=30_000.0), world.elevation(ground), SETTINGS)
    assert isinstance(answer, NoTerrainFix)
    assert answer.reason is Reason.AMBIGUOUS


def test_another_country_is_refused(world: SimpleNamespace) -> None:
    answer = locate(world.patch(world.waves(30)), world.prior(), world.elevation(world.waves(30, seed=8)), SETTINGS)
    assert isinstance(answer, NoTerrainFix)


def test_a_profile_finds_its_drift(world: SimpleNamespace) -> None:
    ground = world.waves(40)
    seen = world.profile(ground, drift_mps=(0.8, -0.5))
    fix = locate(seen, world.prior(sigma_drift_mps=0.7), world.elevation(ground), SETTINGS)
    off = error(fix, world)
    assert np.hypot(off[0], off[1]) < 10.0


def test_a_misplaced_model_is_claimed_once(world: SimpleNamespace) -> None:
    ground = world.waves(30)
    sure = world.elevation(ground)
    fixes = [locate(world.patch(ground), world.prior(), replace(sure, sigma_ne_m=s), SETTINGS) for s in (0.0, 3.0)]
    covariances = [np.array(fix.cov_ne_m2) for fix in fixes if isinstance(fix, TerrainFix)]
    assert np.allclose(covariances[1] - covariances[0], 9.0 * np.eye(2))


def test_the_same_question_gets_the_same_answer(world: SimpleNamespace) -> None:
    ground = world.waves(10)
    first, second = (locate(world.patch(ground), world.prior(), world.elevation(ground), SETTINGS) for _ in range(2))
    assert first == second


def test_bad_input_is_named() -> None:
    with pytest.raises(ValueError, match="not finite"):
        Soundings(1, np.full((3, 3), np.nan), np.zeros(3), 0.3)
    with pytest.raises(ValueError, match=r"\(N, 3\)"):
        Soundings(1, np.zeros((3, 2)), np.zeros(3), 0.3)
    with pytest.raises(ValueError, match="sigma"):
        Soundings(1, np.zeros((3, 3)), np.zeros(3), 0.0)
    with pytest.raises(ValueError, match="beams"):
        Soundings(1, np.zeros((3, 3)), np.zeros(3), 0.3, beam_m=np.zeros((2, 3)))
    with pytest.raises(ValueError, match="positive definite"):
        TerrainPrior((0.0, 0.0), ((1.0, 2.0), (2.0, 1.0)), 100.0, 1.0)
    with pytest.raises(ValueError, match="elevations"):
        ElevationMap(np.zeros(4, np.float32), np.eye(2, 3), 1.0)
    with pytest.raises(ValueError, match="must be positive"):
        ElevationMap(np.zeros((4, 4), np.float32), np.zeros((2, 3)), 1.0)
