from __future__ import annotations

import numpy as np
import pytest

from visloc_companion.errors import ConfigError
from visloc_companion.evaluate.images.map_sigma import MapSigma, stated, with_map_sigma
from visloc_companion.types import Fix, GeoPoint

FIX = Fix(0, 0, 0, 0, "deep", GeoPoint(47.0, 9.0, 100.0), (1.0, 0.0, 0.0, 0.0), ((1.0, 0.5), (0.5, 2.0)), 3.0, 0.01, 0.02, 5.0)


def test_the_maps_error_is_added_on_each_axis():
    stated = with_map_sigma(FIX, MapSigma(2.0, 1.0, 4.0))
    np.testing.assert_allclose(stated.cov_ne_m2, ((5.0, 0.5), (0.5, 3.0)))
    assert stated.sigma_h_m == pytest.approx(5.0)
    assert (stated.place, stated.probability_wrong) == (FIX.place, FIX.probability_wrong)


def test_an_exact_map_changes_nothing():
    assert with_map_sigma(FIX, MapSigma(0.0, 0.0, 0.0)) == FIX


@pytest.mark.parametrize(
    ("horizontal", "height_m", "expected"),
    [
        (None, None, MapSigma()),
        ("1.5", None, MapSigma(1.5, 1.5)),
        ("0", 0.0, MapSigma(0.0, 0.0, 0.0)),
        ("0.4,0.8", 2.0, MapSigma(0.4, 0.8, 2.0)),
        ("0.4 0.8", None, MapSigma(0.4, 0.8)),
        (None, 2.0, MapSigma(height_m=2.0)),
    ],
)
def test_one_number_is_for_both_axes_and_two_are_north_and_east(horizontal, height_m, expected):
    assert stated(horizontal, height_m) == expected


@pytest.mark.parametrize("text", ["", "a", "-1", "0.4,-0.8", "1,2,3", "nan", "inf", "1e300", "0.4;0.8", ",", "0.4,,0.8", "0.4,"])
def test_what_is_no_error_of_a_map_is_refused_with_the_remedy(text):
    with pytest.raises(ConfigError, match=r"--map-sigma-m: .* is no 1-sigma of a map; remedy: give metres"):
        stated(text, None)
