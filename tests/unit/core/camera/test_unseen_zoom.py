"""What a zoom that nobody sees may make of odometry."""

from __future__ import annotations

import math

import numpy as np
import pytest

from visloc_companion.core.camera.unseen_zoom import LEAST_SHARE, MOST_SHARE, UnseenZoom, doubted
from visloc_companion.errors import Reason
from visloc_companion.types import Cov2, Fix, GeoPoint, NoFix, Odometry

S = 1_000_000_000
COV: Cov2 = ((0.04, 0.0), (0.0, 0.04))


def fix(t_ns: int, method: str = "deep") -> Fix:
    return Fix(0, t_ns, 1, 1, method, GeoPoint(59.0, 18.0, 100.0), (1.0, 0.0, 0.0, 0.0), COV, 1.0, 0.05, 0.001, 5.0)


def test_the_doubt_grows_as_fast_as_the_lens_did_until_that_is_known() -> None:
    unseen = UnseenZoom()
    assert unseen.share(100 * S) == 0.0
    unseen.seen(100 * S, 0.02)
    assert unseen.share(101 * S) == LEAST_SHARE
    assert not unseen.goes_on(101 * S)
    assert unseen.share(102 * S) == pytest.approx(math.expm1(0.04))
    assert unseen.share(120 * S) == pytest.approx(math.expm1(0.4))
    assert unseen.goes_on(120 * S)
    assert unseen.share(1000 * S) == MOST_SHARE
    unseen.seen(121 * S, 0.02)
    assert unseen.share(122 * S) == LEAST_SHARE
    unseen.clear()
    assert unseen.share(1000 * S) == 0.0


def test_what_is_recognised_by_its_picture_alone_shows_the_lens() -> None:
    unseen = UnseenZoom()
    unseen.seen(100 * S, 0.05)
    t_ns = 104 * S
    assert unseen.share_in(NoFix(0, t_ns, 1, 1, "deep", Reason.NO_MATCH, 5.0)) == pytest.approx(math.expm1(0.2))
    assert unseen.share_in(fix(t_ns)) == LEAST_SHARE
    assert unseen.share_in(fix(t_ns, "structure")) == pytest.approx(math.expm1(0.2))


def test_a_displacement_in_doubt_is_so_along_the_way_alone() -> None:
    seen = Odometry(0, S, 2 * S, (6.0, -8.0, 0.0), COV, sigma_scale=0.01, sigma_heading_rad=0.02)
    got = doubted(seen, 0.3)
    assert (got.displacement_ned_m, got.sigma_heading_rad) == (seen.displacement_ned_m, seen.sigma_heading_rad)
    assert got.sigma_scale == pytest.approx(math.hypot(0.01, 0.3))
    cov, along, across = np.array(got.cov_ne_m2), np.array([0.6, -0.8]), np.array([0.8, 0.6])
    assert along @ cov @ along == pytest.approx(0.04 + (0.3 * 10.0) ** 2)
    assert across @ cov @ across == pytest.approx(0.04)
    assert across @ cov @ along == pytest.approx(0.0, abs=1e-12)
