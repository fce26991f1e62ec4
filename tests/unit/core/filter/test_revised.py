from __future__ import annotations

import numpy as np
import pytest

from visloc_companion.core.filter import revised
from visloc_companion.core.filter.belief import Belief, seeded
from visloc_companion.core.filter.fusion import UNAIDED_SIGMA_MPS, propagated
from visloc_companion.core.filter.propagation import POSITION, VELOCITY, Drive
from visloc_companion.core.settings import NavigatorSettings

SETTINGS = NavigatorSettings()
S = 1_000_000_000


def flown(s: int = 10) -> Belief:
    """So long after the last fix."""
    return propagated(seeded(0, (5.0, -2.0), 2.0, 0.3, Drive.AUTOPILOT, SETTINGS).after_fix(0, 1.0), s * S, (3.0, -1.0), SETTINGS)


def test_a_shift_moves_places_and_nothing_else() -> None:
    before, after = flown(), revised.shifted(flown(), (100.0, -50.0))
    np.testing.assert_allclose((after.x - before.x)[POSITION], (100.0, -50.0))
    np.testing.assert_allclose(np.delete(after.x - before.x, [0, 1]), 0.0)
    np.testing.assert_array_equal(after.P, before.P)


def test_time_that_no_clock_showed_costs_what_a_silent_link_does() -> None:
    before, after = flown(), revised.stood(flown(), 4.0)
    np.testing.assert_array_equal(after.x, before.x)
    np.testing.assert_allclose((after.P - before.P)[POSITION, POSITION], (4 * UNAIDED_SIGMA_MPS) ** 2 * np.eye(2), atol=1e-9)


def test_time_that_did_not_go_by_is_way_that_was_not_gone() -> None:
    before, after = flown(), revised.leapt(flown(), (3.0, -1.0), 2.0)
    np.testing.assert_allclose((after.x - before.x)[POSITION], (-6.0, 2.0))
    np.testing.assert_allclose((after.P - before.P)[POSITION, POSITION], (2 * UNAIDED_SIGMA_MPS) ** 2 * np.eye(2), atol=1e-9)


def test_frames_that_were_taken_later_leave_the_way_of_that_time_along_the_track() -> None:
    more = revised.retimed(flown(), (30.0, 0.0), 0.1).P - flown().P
    assert more[0, 0] == pytest.approx(9.0)
    np.testing.assert_allclose(np.delete(more.ravel(), 0), 0.0, atol=1e-12)


def test_odometry_that_was_wrong_has_led_the_position_away_since_the_last_fix() -> None:
    """A velocity that is false by 2 m/s, and that the position was carried by for ten seconds: off by 20 m, along it."""
    more = revised.motion_doubted(flown(), (3.0, 0.0), (1.0, 0.0)).P - flown().P
    position, velocity = more[POSITION, POSITION], more[VELOCITY, VELOCITY]
    np.testing.assert_allclose(np.sqrt(np.diag(position)), 20.0)
    np.testing.assert_allclose(np.sqrt(np.diag(velocity)), 2.0)
    np.testing.assert_allclose(np.diag(more[POSITION, VELOCITY]), -40.0)
    assert np.linalg.eigvalsh(more).min() > -1e-6
