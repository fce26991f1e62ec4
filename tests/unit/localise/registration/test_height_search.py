from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from visloc_companion.errors import Reason
from visloc_companion.localise.registration.base import NotRegistered, Registered
from visloc_companion.localise.registration.height_search import HeightSearchRegistration
from visloc_companion.localise.registration.registry import make_registration

RNG = np.random.default_rng(8)


def flat(side_m: float, noise_m: float) -> np.ndarray:
    xy = RNG.uniform(-side_m / 2, side_m / 2, (int(3 * side_m**2), 2))
    return np.column_stack([xy, RNG.normal(0, noise_m, len(xy))])


def test_finds_the_place_and_claims_it(scene):
    found = make_registration("height-search")(scene.source_m, scene.reference_m, scene.prior)
    assert isinstance(found, Registered)
    off = scene.offset_m(found.T_reference_source)
    assert np.abs(off.mean(0)).max() < 0.3
    assert np.linalg.norm(off, axis=1).mean() < 0.4
    sigma = np.sqrt(np.diag(found.covariance_m2))
    assert (np.abs(off.mean(0)) < 4 * sigma).all()
    assert (sigma < 2).all()
    assert found.probability_wrong < 0.02
    assert dict(found.evidence)["correlation"] > 0.8


def test_is_the_same_again_to_the_last_bit(scene):
    first, second = (HeightSearchRegistration(1.0)(scene.source_m, scene.reference_m, scene.prior) for _ in range(2))
    assert first.T_reference_source.tobytes() == second.T_reference_source.tobytes()
    assert first.covariance_m2.tobytes() == second.covariance_m2.tobytes()
    assert first.evidence == second.evidence


def test_declines_water(scene):
    found = make_registration("height-search")(flat(60, 0.1), flat(150, 0.03), scene.prior)
    assert isinstance(found, NotRegistered)
    assert found.reason in {Reason.LOW_TEXTURE, Reason.NO_MATCH, Reason.AMBIGUOUS, Reason.REFINEMENT_DIVERGED}


def test_declines_rows_that_look_alike(scene):
    def rows(points: np.ndarray) -> np.ndarray:
        off = np.hypot((points[:, 0] + 5) % 10 - 5, (points[:, 1] + 5) % 10 - 5)
        return points + np.column_stack([np.zeros((len(points), 2)), 6 * np.clip(1 - (off / 3) ** 2, 0, 1)])

    found = make_registration("height-search")(rows(flat(60, 0.1)), rows(flat(150, 0.03)), scene.prior)
    assert isinstance(found, NotRegistered)
    assert found.reason == Reason.AMBIGUOUS


def test_declines_another_place(scene):
    mirrored = scene.source_m * [1, -1, 1]
    assert isinstance(make_registration("height-search")(mirrored, scene.reference_m, scene.prior), NotRegistered)


def test_declines_what_the_reference_does_not_hold(scene):
    away = make_registration("height-search")(scene.source_m + np.array([1000.0, 0, 0]), scene.reference_m, scene.prior)
    assert isinstance(away, NotRegistered)
    assert away.reason == Reason.OUTSIDE_MAP


def test_a_stray_point_far_away_changes_nothing(scene):
    stray = np.vstack([scene.source_m, [3e5, 3e5, 0]])
    found = HeightSearchRegistration(1.0)(stray, scene.reference_m, scene.prior)
    assert np.abs(scene.offset_m(found.T_reference_source).mean(0)).max() < 0.3


@pytest.mark.parametrize("name", ["height-search", "gicp"])
def test_refuses_what_is_no_cloud(scene, name):
    method = make_registration(name)
    with pytest.raises(ValueError, match="source: points are"):
        method(scene.source_m[:, :2], scene.reference_m, scene.prior)
    broken = scene.reference_m.copy()
    broken[3, 1] = np.nan
    with pytest.raises(ValueError, match="reference: 1 of"):
        method(scene.source_m, broken, scene.prior)
    few = method(scene.source_m[:10], scene.reference_m, scene.prior)
    assert isinstance(few, NotRegistered)
    assert few.reason == Reason.TOO_FEW_FEATURES


@pytest.mark.parametrize("name", ["height-search", "gicp"])
def test_values_for_no_data_among_the_points_change_nothing(scene, name):
    """Half a percent of the points at ±9,999 m had it refused, and a hole of -9,999 m in both clouds had hole laid on hole."""
    prior = replace(scene.prior, sigma_horizontal_m=10.0)
    clean = make_registration(name, 1.0)(scene.source_m, scene.reference_m, prior)
    source, reference = scene.source_m.copy(), scene.reference_m.copy()
    for points in (source, reference):
        points[::400, 2], points[7::400, 2] = 9999, -9999
        points[(np.abs(points[:, :2] - points[:, :2].mean(0) - 5) < 3).all(1), 2] = -9999
    found = make_registration(name, 1.0)(source, reference, prior)
    off = scene.offset_m(found.T_reference_source) - scene.offset_m(clean.T_reference_source)
    assert np.abs(off.mean(0)).max() < (0.15 if name == "height-search" else 1.0)
    counted = dict(found.evidence)
    assert counted["source_strays"] == np.count_nonzero(np.abs(source[:, 2]) > 999)
    assert 0 < counted["reference_strays"] <= np.count_nonzero(np.abs(reference[:, 2]) > 999)
    assert dict(clean.evidence)["source_strays"] == dict(clean.evidence)["reference_strays"] == 0
