from __future__ import annotations

import numpy as np
import pytest

from visloc_companion.localise.pinhole import projected

FOCAL_PX = 220.0


def test_the_derivative_is_that_of_the_pixels() -> None:
    rng = np.random.default_rng(1)
    q = rng.uniform((-20, -20, 10), (20, 20, 90), (6, 3))
    _, J, ahead = projected(q, FOCAL_PX)
    assert ahead.all()
    for axis in range(3):
        step = 1e-5 * np.eye(3)[axis]
        numeric = FOCAL_PX * (projected(q + step, FOCAL_PX)[0] - projected(q - step, FOCAL_PX)[0]) / 2e-5
        assert J[:, :, axis] == pytest.approx(numeric, rel=1e-6, abs=1e-6)


def test_what_lies_behind_is_finite_and_said() -> None:
    xy, J, ahead = projected(np.array([[1.0, 2.0, -5.0], [0.0, 0.0, 0.0], [1.0, 2.0, 5.0]]), FOCAL_PX)
    assert ahead.tolist() == [False, False, True]
    assert np.isfinite(xy).all()
    assert np.isfinite(J).all()
    assert xy[2] == pytest.approx((0.2, 0.4))
