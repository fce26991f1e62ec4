"""Pictures whose scale drifts: it begins with heights that go away, and the side of the lean tells a lens from ground."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest

from visloc_companion.core.camera.scale_drift import SURE, ScaleDrift, Sight
from visloc_companion.core.filter.propagation import Drive
from visloc_companion.core.filter.reckoned import Reckoned
from visloc_companion.types import Vec2

HEIGHT_M, EVERY_S, BEGIN_S = 120.0, 0.5, 15.0
COV = ((0.8, 0.0), (0.0, 0.8))
RATE = 0.025
KNOWN = np.diag([0.1**2, 0.03**2])


def ramp(t_s: float) -> float:
    """By how much the ground is enlarged."""
    return 1.0 + RATE * max(0.0, t_s - BEGIN_S)


def seen(
    until_s: float,
    enlarged: Callable[[float], float] = ramp,
    *,
    lens: bool = True,
    per_focal_ne_m: Vec2 = (5.0, -45.0),
    gnss: bool = True,
    drive: Drive = Drive.INERTIAL,
    claims_m: float = 0.4,
) -> ScaleDrift:
    """Fixes of a vehicle that flies north by 10 m/s; what enlarges the ground is the lens, or ground that is nearer."""
    drift, rng = ScaleDrift(), np.random.default_rng(3)
    for k in range(round(until_s / EVERY_S)):
        t_s = k * EVERY_S
        share = enlarged(t_s) - 1
        off = np.array(per_focal_ne_m) * share * lens + 0.7 * rng.standard_normal(2)
        place = np.array((10.0 * t_s, 0.0)) + off
        reckoned = Reckoned((10.0 * t_s, 0.0), (0.0, 0.0), (0.0, 0.0), KNOWN, drive, 1)
        minus = (float(-off[0]), float(-off[1])) if gnss else None
        sight = Sight(round(t_s * 1e9), (float(place[0]), float(place[1])), COV, per_focal_ne_m, minus, reckoned)
        drift.on_fix(sight, HEIGHT_M / (1 + share) - HEIGHT_M + 0.4 * rng.standard_normal(), claims_m, HEIGHT_M)
    if drift.begun:
        drift.tell_apart()
    return drift


def test_a_ramp_begins_soon_and_tells_how_much_nearer_the_ground_seems() -> None:
    assert not seen(BEGIN_S).begun
    assert seen(BEGIN_S + 2.5).begun
    assert seen(BEGIN_S + 8.0).nearer == pytest.approx(ramp(BEGIN_S + 7.5) - 1, abs=0.015)


def test_a_picture_that_becomes_smaller_begins_it_as_well() -> None:
    assert seen(BEGIN_S + 8.0, lambda t: 2 - ramp(t)).nearer == pytest.approx(-0.18, abs=0.02)


@pytest.mark.parametrize("share", [lambda t: 1.0, lambda t: 1 + 0.008 * math.sin(t / 3)], ids=["still", "trees come and go"])
def test_heights_that_stay_begin_nothing(share: Callable[[float], float]) -> None:
    assert not seen(60.0, share).begun


def test_heights_that_are_known_to_metres_begin_nothing() -> None:
    """The first fixes over a wood said 4 m too high, claimed 3 m, and all after them were held for a drift."""

    def stepped(t_s: float) -> float:
        return 1.0 if t_s < 15.0 else 1.04

    assert seen(25.0, stepped).begun
    assert not seen(25.0, stepped, claims_m=3.0).begun


def test_heights_that_stay_where_they_went_are_steady() -> None:
    def hill(t_s: float) -> float:
        return 1 + 0.1 * min(1.0, max(0.0, (t_s - BEGIN_S) / 3))

    drifting, stayed = seen(BEGIN_S + 10.0, hill), seen(BEGIN_S + 16.0, hill)
    assert (drifting.begun, drifting.steady(HEIGHT_M)) == (True, False)
    assert (stayed.begun, stayed.steady(HEIGHT_M)) == (True, True)


def test_it_is_over_when_heights_are_back() -> None:
    def hill(t_s: float) -> float:
        return 1 + 0.2 * math.exp(-(((t_s - 22) / 4) ** 2))

    assert seen(22.0, hill).begun
    assert not seen(38.0, hill).begun


@pytest.mark.parametrize("gnss", [True, False])
def test_the_side_of_the_lean_tells_a_lens_from_ground(gnss: bool) -> None:
    """Beside GNSS, or by the accelerations since before."""
    until_s = BEGIN_S + (6.0 if gnss else 8.0)
    assert seen(until_s, gnss=gnss).odds > SURE
    assert seen(until_s, gnss=gnss, lens=False).odds < -SURE


def silent_after(last_m: float) -> ScaleDrift:
    """Heights of 0 m, a last one, and two fixes that tell none, one a second until 8 s."""
    drift = ScaleDrift()
    for k in range(9):
        if k < 7:
            sight = Sight(k * 10**9, (10.0 * k, 0.0), COV, (0.0, 0.0), None, None)
            drift.on_fix(sight, last_m if k == 6 else 0.0, 0.4, HEIGHT_M)
        drift.told(k * 10**9, height=k < 7)
    return drift


def test_heights_are_let_loose_where_fixes_cease_to_tell_them() -> None:
    drift = silent_after(-1.5)
    assert drift.loose(9 * 10**9)
    assert not drift.loose(11 * 10**9)
    drift.told(9 * 10**9, height=False)
    drift.told(10 * 10**9, height=True)
    assert not drift.loose(12 * 10**9)


def test_heights_that_stayed_are_held_where_the_ground_tells_little() -> None:
    """A copter that came over a wood had its height let loose there, and crowns 4 m above the map taken for it."""
    assert not silent_after(-0.4).loose(9 * 10**9)


def test_who_looks_straight_down_cannot_tell() -> None:
    assert abs(seen(BEGIN_S + 8.0, per_focal_ne_m=(0.0, 0.0)).odds) < 1.0


def test_a_velocity_that_rests_on_fixes_tells_nothing() -> None:
    assert seen(BEGIN_S + 6.0, gnss=False, drive=Drive.FED_BACK).odds == 0.0


def test_fixes_that_go_elsewhere_are_no_lens() -> None:
    """Off by far more than the lens makes them: somebody else is wrong."""
    drift = seen(BEGIN_S + 6.0)
    sights = [s._replace(gnss_minus_ne_m=(0.0, 60.0 * s.nearer * 12)) for s in drift._sights]
    drift._sights.clear()
    drift._sights.extend(sights)
    drift.tell_apart()
    assert drift.odds <= 0
