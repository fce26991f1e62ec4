from __future__ import annotations

import math

import numpy as np
import pytest

from visloc_companion.core.integrity import PROTECTION_FACTOR, largest_sigma_m, protection_level_m

COV = ((4.0, 1.5), (1.5, 2.0))


def test_largest_sigma_is_that_of_the_eigenvalues() -> None:
    assert largest_sigma_m(COV) == pytest.approx(math.sqrt(np.linalg.eigvalsh(np.array(COV))[-1]))


def test_factor_is_exceeded_once_in_1e5_by_a_circular_gaussian() -> None:
    assert math.exp(-(PROTECTION_FACTOR**2) / 2) == pytest.approx(1e-5, rel=0.02)


def test_grows_with_age_and_with_doubt() -> None:
    fresh = protection_level_m(COV, 0.0, 0.0)
    assert fresh == pytest.approx(4.80 * largest_sigma_m(COV))
    assert protection_level_m(COV, 30.0, 0.0) == pytest.approx(2 * fresh)
    assert protection_level_m(COV, 0.0, 0.01) == pytest.approx(1.1 * fresh)
    assert protection_level_m(COV, -1.0, 2.0) == pytest.approx(11 * fresh)
