from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from visloc_companion.core.covariance import floored, largest_sigma_m

COV = ((4.0, 1.5), (1.5, 2.0))


def test_largest_sigma_is_that_of_the_eigenvalues() -> None:
    assert largest_sigma_m(COV) == pytest.approx(math.sqrt(np.linalg.eigvalsh(np.array(COV))[-1]))
    assert largest_sigma_m(((2.5, 1.5), (1.5, 2.5))) == pytest.approx(2.0)


def test_sigma_has_a_floor_in_every_direction() -> None:
    narrow = ((1.0, 0.9999), (0.9999, 1.0))
    lifted = np.array(floored(narrow, 0.5))
    values = np.linalg.eigvalsh(lifted)
    assert values[0] == pytest.approx(0.25)
    assert values[1] == pytest.approx(1.9999)
    assert lifted[0, 1] == lifted[1, 0]


@given(st.floats(0.01, 100), st.floats(0.01, 100), st.floats(-1.5, 1.5), st.floats(0.0, 20))
def test_the_floor_lifts_the_eigenvalues_and_keeps_their_axes(nn: float, ee: float, correlation: float, least_m: float) -> None:
    ne = correlation * (nn * ee) ** 0.5
    values, axes = np.linalg.eigh(np.array([[nn, ne], [ne, ee]]))
    expected = axes @ np.diag(np.maximum(values, least_m**2)) @ axes.T
    np.testing.assert_allclose(floored(((nn, ne), (ne, ee)), least_m), expected, rtol=1e-9, atol=1e-9)
