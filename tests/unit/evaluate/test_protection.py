"""The bound follows the largest axis, whichever way it points."""

import numpy as np
import pytest

from visloc_companion.evaluate.protection import horizontal_bound_m


@pytest.mark.parametrize("covariance", [[[1.0, 0.0], [0.0, 9.0]], [[9.0, 0.0], [0.0, 1.0]], [[5.0, 4.0], [4.0, 5.0]]])
def test_the_bound_uses_the_largest_axis(covariance: list[list[float]]) -> None:
    assert horizontal_bound_m(np.array(covariance)) == pytest.approx(14.39, abs=0.02)
