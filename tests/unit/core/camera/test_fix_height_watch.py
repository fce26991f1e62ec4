"""Fixes that lie above or below a good GNSS all by as much are told with the lens that would explain it."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest

from visloc_companion.core.camera.fix_height_watch import FEWEST, LEAST_M, FixHeightWatch
from visloc_companion.geo.wgs84 import geo_from_ned
from visloc_companion.types import Fix, GeoPoint, Notice, Quat

MS = 1_000_000
GNSS_AMSL_M = 520.0
LEVEL: Quat = (1.0, 0.0, 0.0, 0.0)
COV = ((0.5, 0.0), (0.0, 0.5))


def said(above_m: Callable[[int], float], n: int = 60, every_ms: int = 500, height_m: float = 120.0) -> list[Notice]:
    watch, told = FixHeightWatch(), []
    for k in range(n):
        place = GeoPoint(48.0, 11.0, GNSS_AMSL_M + above_m(k))
        fix = Fix(0, k * every_ms * MS, k, k, "image", place, LEVEL, COV, 1.0, 0.005, 1e-4, 1.0)
        told += watch.on_fix(fix, GNSS_AMSL_M, height_m)
    return [notice for notice in told if isinstance(notice, Notice)]


def test_a_lens_that_is_longer_puts_fixes_low() -> None:
    (notice,) = said(lambda k: 120.0 / 1.1 - 120.0 + 0.5 * math.sin(k))
    assert notice.text == "visloc: fixes 11 m low, fx_px x 1.10? datum?"
    assert notice.to_operator
    assert dict(notice.data)["longer"] == pytest.approx(1.1, abs=0.005)


def test_a_lens_that_is_shorter_puts_them_high() -> None:
    (notice,) = said(lambda k: 400.0 / 0.92 - 400.0, height_m=400.0)
    assert notice.text == "visloc: fixes 35 m high, fx_px x 0.92? datum?"


@pytest.mark.parametrize(
    "above_m",
    [lambda k: 0.9 * LEAST_M, lambda k: 14.0 * (k % 2), lambda k: -12.0 if k % 20 < 8 else 0.0],
    ids=["receivers differ", "scattered", "now and then"],
)
def test_what_a_receiver_or_single_fixes_explain_is_not_told(above_m: Callable[[int], float]) -> None:
    assert said(above_m) == []


def test_high_up_a_share_of_the_height_counts() -> None:
    assert said(lambda k: 25.0, height_m=600.0) == []
    assert said(lambda k: 45.0, height_m=600.0) != []


def test_it_takes_fixes_and_time_without_a_pause() -> None:
    assert said(lambda k: -12.0, n=FEWEST - 1) == []
    assert said(lambda k: -12.0, every_ms=100, n=50) == []
    assert said(lambda k: -12.0, every_ms=6000) == []


def along(
    above_m: Callable[[float], float],
    seconds: float,
    speed_mps: float = 10.0,
    every_s: float = 0.5,
    paused: Callable[[float], bool] = lambda t_s: False,
) -> tuple[list[float], list[tuple[float, float]]]:
    """When it was told, and by how much longer than calibrated the lens was taken to be after each fix: north at 120 m."""
    watch, told, shares, rng = FixHeightWatch(), [], [], np.random.default_rng(4)
    for k in range(round(seconds / every_s)):
        t_s = k * every_s
        if paused(t_s):
            continue
        above = GNSS_AMSL_M + above_m(t_s) + float(rng.normal(0.0, 1.0))
        place = geo_from_ned((speed_mps * t_s, 0.0, 0.0), GeoPoint(48.0, 11.0, above))
        fix = Fix(0, round(t_s * 1000) * MS, k, k, "image", place, LEVEL, COV, 1.0, 0.005, 1e-4, 1.0)
        told += [t_s for _ in watch.on_fix(fix, GNSS_AMSL_M, 120.0)]
        shares.append((t_s, watch.longer_share))
    return told, shares


def test_ground_that_the_map_has_too_low_is_doubted_until_other_ground_shows_the_lens_right() -> None:
    told, shares = along(lambda t_s: 8.0 if t_s < 8 else 0.0, 60.0)
    assert told == []
    assert any(share == pytest.approx(-8 / 128, abs=0.01) for t_s, share in shares if t_s < 8)
    assert all(share == 0 for t_s, share in shares if t_s > 30)


def test_over_such_ground_for_good_it_stays_in_doubt() -> None:
    """A vehicle that hovers learns nothing of other ground."""
    told, shares = along(lambda t_s: 8.0 if t_s < 3 else 0.0, 60.0, speed_mps=0.5)
    assert told == []
    assert all(share < -0.05 for t_s, share in shares if t_s > 3)


def test_it_is_doubted_again_for_no_less_than_is_told() -> None:
    """Once other ground showed the lens right, some seconds of ground after a pause are that."""
    told, shares = along(lambda t_s: 8.0 if t_s < 3 or 40 < t_s < 43 else 0.0, 60.0)
    assert told == []
    assert all(share == 0 for t_s, share in shares if t_s > 25)
    told, shares = along(lambda t_s: 8.0 if t_s < 3 or t_s > 40 else 0.0, 45.0, paused=lambda t_s: 33 < t_s < 41)
    assert told == []
    assert all(share == 0 for t_s, share in shares if t_s > 25)
    assert shares[-1][0] > 44
    told, shares = along(lambda t_s: 8.0 if t_s < 3 or t_s > 40 else 0.0, 100.0)
    assert len(told) == 1
    assert shares[-1][1] < -0.05


def test_a_lens_that_is_shorter_stays_in_doubt_over_ground_that_hides_it() -> None:
    told, shares = along(lambda t_s: 0.0 if 30 < t_s < 36 else 10.0, 60.0)
    assert len(told) == 1
    assert told[0] < 15
    assert all(share < -0.05 for t_s, share in shares if t_s > 3)


@pytest.mark.parametrize("speed_mps", [0.0, 2.0, 10.0])
@pytest.mark.parametrize("every_s", [0.125, 0.25, 1.0])
def test_a_lens_that_is_shorter_is_told_however_slow_the_flight_and_fast_the_fixes(speed_mps: float, every_s: float) -> None:
    told, _ = along(lambda t_s: 12.0, 40.0, speed_mps, every_s)
    assert len(told) == 1
    assert told[0] < (16 if speed_mps == 10 else 23)


def test_the_text_fits_the_screen() -> None:
    assert max(len(notice.text) for notice in said(lambda k: -600.0, height_m=1000.0)) <= 50


@pytest.mark.parametrize("height_m", [0.0, -40.0])
def test_at_home_or_below_it_no_lens_is_told(height_m: float) -> None:
    """By no height of its own."""
    assert said(lambda k: 30.0, height_m=height_m) == []
