from __future__ import annotations

import numpy as np
import pytest

from visloc_companion.core import kalman
from visloc_companion.errors import Reason
from visloc_companion.types import Rejected

H = np.eye(2, 4)
EYE = np.eye(4)


def test_predict_is_the_textbook() -> None:
    F = EYE + np.diag([1.0, 1.0], 2)
    x, P = kalman.predict(np.array([1.0, 2.0, 3.0, 4.0]), 2 * EYE, F, 0.1 * EYE, np.array([10.0, 0.0, 0.0, 0.0]))
    np.testing.assert_allclose(x, [14.0, 6.0, 3.0, 4.0])
    np.testing.assert_allclose(P, 2 * F @ F.T + 0.1 * EYE)


def test_update_equals_the_information_form() -> None:
    rng = np.random.default_rng(1)
    A = rng.standard_normal((4, 4))
    x, P, R = rng.standard_normal(4), A @ A.T + EYE, np.array([[2.0, 0.3], [0.3, 1.0]])
    z = np.array([0.5, -0.2])
    got = kalman.update(x, P, z, R, H)
    assert isinstance(got, kalman.Updated)
    information = np.linalg.inv(P) + H.T @ np.linalg.inv(R) @ H
    np.testing.assert_allclose(got.P, np.linalg.inv(information), atol=1e-10)
    expected = np.linalg.solve(information, np.linalg.inv(P) @ x + H.T @ np.linalg.inv(R) @ z)
    np.testing.assert_allclose(got.x, expected, atol=1e-10)
    innovation = z - H @ x
    np.testing.assert_array_equal(got.innovation, innovation)
    np.testing.assert_allclose(got.seen, H @ P @ H.T, rtol=1e-12)
    assert got.nis == pytest.approx(float(innovation @ np.linalg.inv(H @ P @ H.T + R) @ innovation))


def test_considered_states_do_not_move_and_keep_their_variance() -> None:
    P = EYE.copy()
    P[0, 2] = P[2, 0] = 0.5
    got = kalman.update(np.zeros(4), P, np.array([1.0, 0.0]), np.eye(2), H, n_considered=2)
    best = kalman.update(np.zeros(4), P, np.array([1.0, 0.0]), np.eye(2), H)
    assert isinstance(got, kalman.Updated)
    assert isinstance(best, kalman.Updated)
    np.testing.assert_allclose(got.x, [0.5, 0.0, 0.0, 0.0])
    np.testing.assert_allclose(got.P[2:, 2:], P[2:, 2:])
    np.testing.assert_allclose(got.P[:2, :2], best.P[:2, :2])


def test_gate_and_its_extra_variance() -> None:
    far = np.array([9.0, 0.0])
    refused = kalman.update(np.zeros(4), EYE, far, np.eye(2), H, gate_sigma=4.0)
    assert refused == Rejected(Reason.GATED, 40.5)
    assert isinstance(kalman.update(np.zeros(4), EYE, far, np.eye(2), H, gate_sigma=4.0, gate_extra_m2=4.0), kalman.Updated)


@pytest.mark.parametrize(
    ("z", "R"),
    [
        ([np.nan, 0.0], np.eye(2)),
        ([0.0, np.inf], np.eye(2)),
        ([0.0, 0.0], np.full((2, 2), np.nan)),
        ([0.0, 0.0], np.array([[1.0, 2.0], [2.0, 1.0]])),
        ([0.0, 0.0], np.zeros((2, 2))),
    ],
)
def test_broken_measurements_are_refused(z: list[float], R: np.ndarray) -> None:
    assert kalman.update(np.zeros(4), EYE, np.array(z), R, H) == Rejected(Reason.NOT_FINITE, 0.0)


def test_a_claim_that_rounding_makes_nothing_of_is_refused() -> None:
    """A metre one way and a millimetre the other, by a lens that moves the place by 100 m for 1 %, beside a place known to a
    kilometre: no program's mistake, and no reason to end."""
    H_lens = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 1e4]])
    R = np.array([[1.0, 0.999999e-3], [0.999999e-3, 1e-6]])
    got = kalman.update(np.zeros(3), np.diag([1e6, 1e6, 1e-4]), np.zeros(2), R, H_lens)
    assert got == Rejected(Reason.NOT_FINITE, 0.0)


def test_mistakes_of_the_program_raise() -> None:
    with pytest.raises(ValueError, match="shapes"):
        kalman.predict(np.zeros(3), EYE, EYE, EYE, np.zeros(4))
    with pytest.raises(ValueError, match="shapes"):
        kalman.update(np.zeros(4), EYE, np.zeros((2, 1)), np.eye(3), H)
    with pytest.raises(ValueError, match="prior"):
        kalman.update(np.zeros(4), -0.5 * EYE, np.zeros(2), np.eye(2), H)
    with pytest.raises(ValueError, match="prior"):
        kalman.predict(np.zeros(4), -EYE, EYE, 0.1 * EYE, np.zeros(4))
    with pytest.raises(ValueError, match="prior"):
        kalman.predict(np.full(4, np.nan), EYE, EYE, EYE, np.zeros(4))


def test_considered_states_beside_a_measurement_of_one_or_three_numbers() -> None:
    """The gain of the states that move is that of the textbook, whatever the number of measurements."""
    P = EYE.copy()
    P[0, 3] = P[3, 0] = 0.4
    for m in (1, 3):
        H_m, R = np.eye(m, 4), np.eye(m)
        got = kalman.update(np.zeros(4), P, np.ones(m), R, H_m, n_considered=1)
        assert isinstance(got, kalman.Updated)
        gain = P @ H_m.T @ np.linalg.inv(H_m @ P @ H_m.T + R)
        np.testing.assert_allclose(got.x[:3], (gain @ np.ones(m))[:3])
        assert (got.x[3], got.P[3, 3]) == (0.0, P[3, 3])
