from __future__ import annotations

import numpy as np
import pytest

from visloc_companion.evaluate.map_sigma import MapSigma, with_map_sigma
from visloc_companion.types import Fix, GeoPoint

FIX = Fix(0, 0, 0, 0, "deep", GeoPoint(47.0, 9.0, 100.0), (1.0, 0.0, 0.0, 0.0), ((1.0, 0.5), (0.5, 2.0)), 3.0, 0.01, 0.02, 5.0)


def test_the_maps_error_is_added_on_each_axis():
    stated = with_map_sigma(FIX, MapSigma(2.0, 4.0))
    np.testing.assert_allclose(stated.cov_ne_m2, ((5.0, 0.5), (0.5, 6.0)))
    assert stated.sigma_h_m == pytest.approx(5.0)
    assert (stated.place, stated.probability_wrong) == (FIX.place, FIX.probability_wrong)


def test_an_exact_map_changes_nothing():
    assert with_map_sigma(FIX, MapSigma(0.0, 0.0)) == FIX
