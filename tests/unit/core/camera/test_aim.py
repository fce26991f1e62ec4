from __future__ import annotations

import cmath
import math
from collections.abc import Callable

import numpy as np
import pytest

from visloc_companion.core.camera.aim import AGREED, FEWEST, LARGEST, Aim
from visloc_companion.types import Notice

S = 1_000_000_000
HEIGHT_M, SPEED_MPS = 120.0, 10.0


def north(k: int) -> float:
    return 0.0


def there_and_back(k: int) -> float:
    return math.pi * (k // 30)


class Flown:
    """A second a fix, the nose ahead; `share` of the height to the side, GNSS and map `apart_m` (north + i east)."""

    def __init__(self, noise_m: float = 0.5, claim_m: float | None = None) -> None:
        self.aim, self.texts, self.k = Aim(), list[str](), 0
        claim_m = noise_m if claim_m is None else claim_m
        self._noise_m, self._cov = noise_m, ((claim_m**2, 0.0), (0.0, claim_m**2))
        self._rng = np.random.default_rng(3)

    def fly(
        self,
        n: int,
        share: complex = 0j,
        apart_m: Callable[[int], complex] = lambda k: 0j,
        heading: Callable[[int], float] = north,
        height_m: float = HEIGHT_M,
        speed_mps: float = SPEED_MPS,
        *,
        timed: bool = True,
    ) -> Aim:
        for _ in range(n):
            ahead = cmath.rect(1.0, heading(self.k))
            noise = complex(*(self._noise_m * self._rng.standard_normal(2)))
            off = (share - self.aim.used) * height_m * ahead + apart_m(self.k) + noise
            v = speed_mps * ahead
            fix = (self.k * S, (off.real, off.imag), self._cov, cmath.phase(ahead), (v.real, v.imag), height_m)
            told = self.aim.on_fix(*fix, timed=timed)
            self.texts += [notice.text for notice in told if isinstance(notice, Notice)]
            self.k += 1
        return self.aim


@pytest.mark.parametrize("share", [0.058j, -0.05j, 0.05, -0.058, 0.03 + 0.03j])
def test_what_goes_round_with_the_heading_is_known_and_beside_it_what_gnss_and_map_are_apart(share: complex) -> None:
    flown = Flown()
    aim = flown.fly(90, share, lambda k: 1.5 - 1j, there_and_back)
    assert aim.used == pytest.approx(share, abs=0.01)
    assert aim.doubt < 0.02
    assert len(flown.texts) <= 2
    assert flown.texts[-1].endswith(": cx/cy_px, mount, lever?")


def test_on_one_heading_it_is_doubted_and_the_operator_told_what_it_may_be() -> None:
    for share, text in (
        (0.058j, "visloc: fixes 7 m right: camera's aim, or map?"),
        (-0.058j, "visloc: fixes 7 m left: camera's aim, or map?"),
        (0.058, "visloc: fixes 7 m ahead: aim, delay, or map?"),
        (-0.058, "visloc: fixes 7 m back: aim, delay, or map?"),
    ):
        flown = Flown()
        aim = flown.fly(60, share)
        assert aim.used == 0
        assert 0.6 * abs(share) < aim.doubt < 1.1 * abs(share)
        assert flown.texts == [text]


def test_over_one_ground_the_operator_is_told_of_no_aim() -> None:
    """A wrong match, or a tilt that the autopilot errs by, lasts: all fixes of a hover are no more than one."""
    flown = Flown()
    assert flown.fly(60, 0.058j, speed_mps=0.0).doubt > 0
    assert flown.texts == []


@pytest.mark.parametrize("hovers", [0, 10, 20])
def test_nor_where_other_ground_does_not_show_it_again(hovers: int) -> None:
    flown = Flown()
    flown.fly(hovers, apart_m=lambda k: 7j, speed_mps=0.0)
    flown.fly(8, apart_m=lambda k: 7j)
    flown.fly(40, apart_m=lambda k: 1j)
    assert flown.texts == []


def test_after_a_hover_it_is_told_once_other_ground_shows_it() -> None:
    flown = Flown()
    flown.fly(20, 0.058j, speed_mps=0.0)
    flown.fly(20, 0.058j)
    assert flown.texts == ["visloc: fixes 7 m right: camera's aim, or map?"]


def test_of_less_than_gnss_and_map_are_often_apart_the_operator_hears_once_headings_tell() -> None:
    flown = Flown()
    aim = flown.fly(60, 0.04j)
    assert aim.doubt > 0.025
    assert flown.texts == []
    flown.fly(60, 0.04j, heading=there_and_back)
    assert flown.texts == [f"visloc: fixes {abs(aim.used) * HEIGHT_M:.0f} m right: cx/cy_px, mount, lever?"]


def test_an_offset_that_stays_where_it_is_is_none_of_the_camera() -> None:
    flown = Flown()
    assert flown.fly(30, apart_m=lambda k: 5j).doubt > 0
    aim = flown.fly(30, apart_m=lambda k: 5j, heading=there_and_back)
    assert (aim.used, aim.doubt) == (0, 0.0)


HIGH_M, CLAIM_M = 750.0, 8.7
"""Fixes over a map of 5 m a pixel, while the camera's tilt is known to 0.7 degrees."""


@pytest.mark.parametrize("off_m", [6.0j, 8.0j, -8.0, 5.0 + 5.0j])
def test_what_fixes_claim_to_be_off_by_in_common_is_doubted_no_second_time(off_m: complex) -> None:
    flown = Flown(claim_m=CLAIM_M)
    doubts = [flown.fly(1, off_m / HIGH_M, height_m=HIGH_M).doubt for _ in range(30)]
    assert max(doubts) == 0.0
    assert Flown().fly(30, off_m / HIGH_M, height_m=HIGH_M).doubt > 0.6 * abs(off_m) / HIGH_M, "fixes that claim to be better"


def test_of_more_than_that_the_rest_is_doubted() -> None:
    by_claim = [Flown(claim_m=claim_m).fly(30, 20j / HIGH_M, height_m=HIGH_M).doubt * HIGH_M for claim_m in (0.5, 4.0, CLAIM_M)]
    assert by_claim == sorted(by_claim, reverse=True)
    assert 10.0 < by_claim[-1] < 0.9 * by_claim[0]


def test_over_more_ground_claims_explain_less_of_an_offset_that_stays() -> None:
    flown = Flown(claim_m=CLAIM_M)
    assert flown.fly(30, 8j / HIGH_M, height_m=HIGH_M).doubt == 0.0
    assert flown.fly(570, 8j / HIGH_M, height_m=HIGH_M).doubt > 5.0 / HIGH_M
    hovers = Flown(claim_m=CLAIM_M)
    assert hovers.fly(600, 8j / HIGH_M, height_m=HIGH_M, speed_mps=0.0).doubt == 0.0


@pytest.mark.parametrize("heading", [north, there_and_back])
def test_a_right_camera_is_neither_doubted_nor_corrected(heading: Callable[[int], float]) -> None:
    flown = Flown()
    aim = flown.fly(150, 0.008 + 0.008j, lambda k: 1.5, heading)
    assert (aim.used, aim.doubt, flown.texts) == (0, 0.0, [])


def test_who_agreed_with_gnss_once_is_not_doubted_for_what_gnss_does_later() -> None:
    """Not even where the nose's side is followed; a camera that was right near the ground may be off further up."""
    flown = Flown()
    flown.fly(AGREED + 2)
    assert flown.fly(90, 0.07j, heading=there_and_back).doubt == 0
    assert flown.aim.used == 0
    assert flown.texts == []
    noisy = Flown(1.1)
    noisy.fly(3 * AGREED)
    assert noisy.fly(90, 0.07j, heading=there_and_back).doubt == 0
    assert noisy.aim.used == 0
    low = Flown()
    low.fly(AGREED + 2, 0.058j, height_m=21.0)
    assert low.fly(60, 0.058j).doubt > 0


@pytest.mark.parametrize("mps", [0.5, 1.0, 2.0])
@pytest.mark.parametrize("begins", [0, 5, 12])
def test_a_drag_is_no_aim(mps: float, begins: int) -> None:
    for aside in (1.0, 1j):

        def dragged_m(k: int, way: complex = aside) -> complex:
            return way * mps * max(0, k - begins)

        flown = Flown()
        assert [flown.fly(1, apart_m=dragged_m).doubt for _ in range(30)] == [0.0] * 30


def test_an_aim_has_bounds() -> None:
    flown = Flown()
    aim = flown.fly(90, 1.3j * LARGEST, heading=there_and_back)
    assert (aim.used, aim.doubt) == (0, 0.0)
    assert flown.fly(FEWEST - 1).used == 0
    followed = Flown()
    followed.fly(90, 0.09j, heading=there_and_back)
    assert abs(followed.fly(90, 0.3j, heading=there_and_back).used) <= LARGEST


def test_a_delay_that_nobody_knows_is_taken_off_as_none() -> None:
    assert Flown().fly(90, -0.058, heading=there_and_back, timed=False).used == 0


def test_at_a_planes_speed_the_receivers_delay_may_be_all_of_what_lies_ahead() -> None:
    aim = Flown().fly(120, -0.03, heading=there_and_back, speed_mps=25.0)
    assert aim.used == 0


def test_near_the_ground_nothing_is_learned() -> None:
    aim = Flown().fly(60, 0.5j, height_m=15.0)
    assert (aim.estimate, aim.doubt) == (0, 0.0)


def test_the_texts_fit_the_screen() -> None:
    for share in (0.09, -0.09, 0.09j, -0.09j):
        flown = Flown()
        flown.fly(90, share, heading=there_and_back, height_m=130.0)
        assert len(flown.texts) == 2
        assert max(map(len, flown.texts)) <= 50
