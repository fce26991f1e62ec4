"""Fixes that lie above or below a good GNSS all by as much are told with the lens that would explain it."""

from __future__ import annotations

import math
from collections.abc import Callable

import pytest

from visloc_companion.core.fix_height_watch import FEWEST, LEAST_M, FixHeightWatch
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


def test_the_text_fits_the_screen() -> None:
    assert max(len(notice.text) for notice in said(lambda k: -600.0, height_m=1000.0)) <= 50
