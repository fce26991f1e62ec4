from __future__ import annotations

import math
from dataclasses import replace

import pytest

from visloc_companion.geo.se3 import euler_from_quat, quat_from_euler
from visloc_companion.geo.wgs84 import geo_from_ned, ned_from_geo
from visloc_companion.localise.candidates.guess import FROM_SEARCH, Guess, narrowed, prior_sigmas
from visloc_companion.types import Fix, GeoPoint, PosePrior

HOME = GeoPoint(47.0, 8.0, 0.0)
GUESS = Guess(geo_from_ned((30.0, -20.0, -210.0), HOME), quat_from_euler(0.2, -0.1, 1.5), 110.0, 120.0)


def prior_of(support, sigma_h_m: float, sigma_yaw_deg: float, sigma_tilt_deg: float) -> PosePrior:
    asked = support.request_at((0.0, 0.0, -240.0), (0.02, 0.0, 0.6), 60.0, sigma_h_m, sigma_yaw_deg)
    return replace(asked.prior, sigma_tilt_rad=math.radians(sigma_tilt_deg))


def test_what_nobody_knew_is_the_guesss(support):
    found = narrowed(prior_of(support, 40.0, 100.0, 18.0), GUESS, FROM_SEARCH)
    assert found.place == GUESS.place and found.q_ned_frd == GUESS.q_ned_frd
    assert found.sigma_h_m == pytest.approx(0.06 * 110)
    assert found.cov_ne_m2[0][0] == pytest.approx((0.12 * 120) ** 2)
    assert (found.sigma_yaw_rad, found.sigma_tilt_rad) == (FROM_SEARCH.yaw_rad, FROM_SEARCH.tilt_rad)


def test_height_and_tilt_that_are_known_better_stay_the_priors(support):
    prior = prior_of(support, 2.0, 100.0, 0.5)
    found = narrowed(prior, GUESS, FROM_SEARCH)
    assert found.place.h_amsl_m == 240.0 and found.sigma_h_m == 2.0
    assert found.sigma_tilt_rad == prior.sigma_tilt_rad
    roll, pitch, yaw = euler_from_quat(found.q_ned_frd)
    assert (roll, pitch) == pytest.approx(euler_from_quat(prior.q_ned_frd)[:2], abs=1e-9)
    assert yaw == pytest.approx(1.5, abs=0.05), "the heading is the guess's"


@pytest.mark.parametrize(
    ("off", "sigmas"),
    [
        ({"place": geo_from_ned((180.0, 0.0, -240.0), HOME)}, 3.0),
        ({"place": geo_from_ned((0.0, 0.0, -320.0), HOME)}, 2.0),
        ({"q_ned_frd": quat_from_euler(0.02, 0.0, 0.6 + math.radians(60))}, 3.0),
        ({"q_ned_frd": quat_from_euler(0.02 + math.radians(36), 0.0, 0.6)}, 2.0),
    ],
)
def test_the_furthest_of_place_height_heading_and_tilt_counts(support, off, sigmas):
    prior = prior_of(support, 40.0, 20.0, 18.0)
    at_prior = Fix(0, 0, 0, 0, "m", prior.place, prior.q_ned_frd, ((1.0, 0.0), (0.0, 1.0)), 1.0, 0.1, 0.0, 1.0)
    assert prior_sigmas(at_prior, prior) == pytest.approx(0.0, abs=1e-6)
    assert prior_sigmas(replace(at_prior, **off), prior) == pytest.approx(sigmas, rel=0.03)
    assert math.hypot(*ned_from_geo(at_prior.place, HOME)[:2]) < 1e-6


def test_about_a_guess_is_searched_whatever_square_the_first_search_was_of(support):
    """The square is about the prior's place, and says nothing of what lies about the guess's."""
    prior = replace(prior_of(support, 40.0, 100.0, 18.0), within_m=5.0)
    assert narrowed(prior, GUESS, FROM_SEARCH).within_m is None
