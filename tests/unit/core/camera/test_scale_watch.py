"""Motion that is GNSS's times a factor is told with the lens or the height that would explain it; a drag is not."""

from __future__ import annotations

import cmath
import re
from collections.abc import Callable

import numpy as np
import pytest

from visloc_companion.core.camera.scale_watch import FEWEST, ScaleWatch
from visloc_companion.core.filter.motion import Motion
from visloc_companion.types import Notice

S = 1_000_000_000
COV = ((0.01, 0.0), (0.0, 0.01))


def way(k: int) -> complex:
    """Ten metres a second, round corners."""
    return 5.0 * cmath.exp(0.5j * np.pi * (k // 20))


def said(seen_of: Callable[[complex], complex], n: int = 60, way: Callable[[int], complex] = way) -> list[Notice]:
    watch, told, rng = ScaleWatch(), [], np.random.default_rng(1)
    for k in range(n):
        gnss, seen = way(k), seen_of(way(k)) + complex(*rng.normal(0.0, 0.1, 2))
        motion = Motion(k * S // 2 + S // 2, k * S // 2, (seen.real, seen.imag), COV, 0.02, 0.03, 0.0, (0.0, 0.0))
        told += watch.on_motion(motion, (gnss.real, gnss.imag), 120.0)
    assert watch.wrong == bool(told)
    return [notice for notice in told if isinstance(notice, Notice)]


@pytest.mark.parametrize(
    ("factor", "text"),
    [(1.25, "visloc: fx_px x 1.25, or map 30 m too low?"), (0.67, "visloc: fx_px x 0.67, or map 40 m too high?")],
)
def test_another_scale_is_told_once_with_both_remedies(factor: float, text: str) -> None:
    (notice,) = said(lambda v: factor * v)
    assert re.sub(r"\d\d m", "N m", notice.text) == re.sub(r"\d\d m", "N m", text)
    assert abs(float(dict(notice.data)["map_higher_m"])) == pytest.approx(abs(120 * (1 - factor)), abs=2)
    assert notice.to_operator
    assert dict(notice.data)["factor"] == pytest.approx(factor, abs=0.01)


@pytest.mark.parametrize(
    "seen_of",
    [
        lambda v: v,
        lambda v: 1.08 * v,
        lambda v: v - complex(1.5, -0.5),
        lambda v: 0.8 * v - complex(1.5, -0.5),
        lambda v: v * cmath.exp(0.35j),
        lambda v: 0.8 * v * cmath.exp(0.35j),
    ],
    ids=["right", "what others learn", "a drag", "a drag beside it", "turned", "turned beside it"],
)
def test_what_is_right_or_has_another_cause_is_not_told(seen_of: Callable[[complex], complex]) -> None:
    assert said(seen_of) == []


def test_straight_ahead_a_drag_looks_the_same() -> None:
    assert said(lambda v: 0.8 * v, way=lambda k: 5.0 + 0.3j * (k % 2)) == []


def test_hovering_and_a_few_intervals_say_nothing() -> None:
    assert said(lambda v: 0.8 * v, way=lambda k: 0.1 * way(k)) == []
    assert said(lambda v: 0.8 * v, n=FEWEST - 1, way=lambda k: way(4 * k)) == []


def test_a_wrong_lens_that_bends_turns_as_well_is_told() -> None:
    """As in a simulated flight with a lens 1.25 x as long: what no factor explains was 0.37 of the rms displacement."""
    rng = np.random.default_rng(2)
    (notice,) = said(lambda v: 1.25 * v + complex(*rng.normal(0.0, 1.3, 2)), n=200)
    assert dict(notice.data)["factor"] == pytest.approx(1.25, abs=0.1)


def test_scales_that_change_over_the_ground_are_not_one() -> None:
    scales = iter([0.2, 1.4] * 60)
    assert said(lambda v: next(scales) * v) == []
