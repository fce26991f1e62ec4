"""Azimuths of the sun, in axes that are turned and beside each other."""

from __future__ import annotations

import pytest

from visloc_companion.geo.sun import turn_between_deg, turned
from visloc_companion.types import Sun


@pytest.mark.parametrize(
    ("azimuth_deg", "turn_deg", "found_deg"), [(10.0, 20.0, 30.0), (350.0, 20.0, 10.0), (10.0, -20.0, 350.0)]
)
def test_axes_that_are_turned_to_the_left_have_the_sun_further_to_the_right(azimuth_deg, turn_deg, found_deg) -> None:
    assert turned(Sun(azimuth_deg, 40.0), turn_deg) == Sun(found_deg, 40.0)


@pytest.mark.parametrize(
    ("a_deg", "b_deg", "apart_deg"), [(350.0, 10.0, 20.0), (10.0, 350.0, 20.0), (0.0, 180.0, 180.0), (90.0, 90.0, 0.0)]
)
def test_two_suns_are_as_far_apart_as_the_shorter_way_round(a_deg, b_deg, apart_deg) -> None:
    assert turn_between_deg(Sun(a_deg, 30.0), Sun(b_deg, 60.0)) == pytest.approx(apart_deg)
