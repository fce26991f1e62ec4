"""A lens that is not as configured: what it does to fixes and motion is reckoned with, or nothing of the camera is used."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest

from visloc_companion.errors import Reason
from visloc_companion.geo import se3, wgs84
from visloc_companion.types import Fix, Injection, LocaliseRequest, NoFix, Notice, Odometry, Turn

COV = ((0.01, 0.0), (0.0, 0.01))
TURN_COV = ((1e-6, 0.0, 0.0), (0.0, 1e-6, 0.0), (0.0, 0.0, 1e-6))
HEIGHT_M, JAM_S = 100.0, 45.0


def told(w: Any) -> list[str]:
    return [c.text for _, c in w.commands if isinstance(c, Notice) and c.to_operator]


@pytest.fixture
def longer(world: Any) -> type[Any]:
    """The lens is longer than calibrated by a share: fixes lie low, and to the side to which the camera leans, and so do motions
    in which it swings over."""

    @dataclass
    class Longer(world):  # type: ignore[misc]
        share: float = 0.0
        fix_sigma_m: float = 0.7
        ground_m: Callable[[float], float] = lambda t: 0.0
        """How much higher the ground is than on the map."""

        def leans_m(self, t_s: float) -> np.ndarray:
            """What a lens that is twice as long would add to a fix."""
            return np.array((20 * math.sin(0.5 * t_s), -50 + 30 * math.cos(0.35 * t_s)))

        def _localise(self, request: LocaliseRequest) -> None:
            super()._localise(request)
            when, fix = self.answers.pop()
            t1_s, t0_s = fix.t_ns * 1e-9, fix.t_ns * 1e-9 - self.fix_period_s
            leans, swung = self.leans_m(t1_s), self.leans_m(t1_s) - self.leans_m(t0_s)
            low_m = HEIGHT_M * (1 - 1 / (1 + self.share)) - self.ground_m(t1_s)
            north, east, down = wgs84.ned_from_geo(fix.place, request.prior.place)
            off = self.share * leans
            place = wgs84.geo_from_ned((north + off[0], east + off[1], down + low_m), request.prior.place)
            moved = np.array(self.velocity((t0_s + t1_s) / 2)) * self.fix_period_s + self.share * 2 * swung
            motion = Odometry(
                0,
                round(t0_s * 1e9),
                fix.t_ns,
                (*moved.tolist(), 0.0),
                COV,
                0.01,
                0.02,
                sigma_focal=0.015,
                per_focal_ne_m=tuple((2 * swung).tolist()),
            )
            self.answers.append((when, replace(fix, place=place, motion=motion, per_focal_ne_m=tuple(leans.tolist()))))

    return Longer


@pytest.mark.parametrize("share", [0.1, -0.09])
def test_a_lens_of_another_length_is_named_and_neither_gnss_is_called_false_nor_too_little_claimed(
    longer: Any, share: float
) -> None:
    w = longer(share=share, jammed=lambda t: t > JAM_S)
    w.start()
    w.fly(90.0)
    assert len(w.notices("fx_px x")) == 1
    assert w.notices("not trusted") == w.notices("off GNSS") == w.notices("or map") == []
    aided = [(s, off_m) for t, s, off_m in w.statuses if t > JAM_S + 2]
    assert any(isinstance(c, Injection) for _, c in w.commands)
    assert all(off_m < s.protection_level_m for s, off_m in aided)
    assert max(off_m for _, off_m in aided) < 6.0


def test_what_heights_showed_of_a_lens_beside_gnss_outlasts_a_drift_of_scale_that_was_none(longer: Any) -> None:
    """GNSS is jammed just before heights are taken for those of other ground, which was a doubt of the lens, too."""
    w = longer(share=0.1, jammed=lambda t: t > 24.0)
    w.start()
    w.fly(80.0)
    aided = [(s, off_m) for t, s, off_m in w.statuses if t > 26.0]
    assert all(off_m < 0.6 * s.protection_level_m for s, off_m in aided)
    assert max(off_m for _, off_m in aided) < 4.0


def test_a_lens_as_calibrated_costs_nothing(longer: Any) -> None:
    w = longer(jammed=lambda t: t > JAM_S)
    w.start()
    w.fly(90.0)
    assert w.notices("fx_px x") == []
    assert max(s.protection_level_m for t, s, _ in w.statuses if t > JAM_S + 2) < 8.0


def test_ground_higher_than_on_the_map_for_some_seconds_is_no_lens_for_the_flight(longer: Any) -> None:
    """It was in level and gates ten minutes later, with GNSS good and fixes right all the time."""
    levels = {}
    for high_m in (0.0, 8.0):
        w = longer(jammed=lambda t: t > JAM_S, ground_m=lambda t, high_m=high_m: high_m * (t < 5))
        w.start()
        w.fly(90.0)
        assert w.notices("fx_px x") == []
        levels[high_m] = [s.protection_level_m for t, s, _ in w.statuses if t > JAM_S + 2]
    assert np.mean(levels[8.0]) < 1.05 * np.mean(levels[0.0])


@pytest.fixture
def bent(world: Any) -> type[Any]:
    """Pictures turn as those of an unstated distortion, and what fixes and motion there are is wrong; `tilted`: turns add up to
    a tilt, by which fixes come to lie beside their place, and no frame is refused."""

    @dataclass
    class Bent(world):  # type: ignore[misc]
        k1: float = 0.0
        tilted: bool = False

        def _localise(self, request: LocaliseRequest) -> None:
            super()._localise(request)
            when, fix = self.answers.pop()
            assert isinstance(fix, Fix)
            t1_s, t0_s = fix.t_ns * 1e-9, fix.t_ns * 1e-9 - self.fix_period_s
            north, east = np.array(self.velocity((t0_s + t1_s) / 2)) * self.fix_period_s
            bend = -2 * self.k1 / HEIGHT_M
            noise = self.rng.normal(0.0, math.radians(0.1), 3)
            turn = np.array((bend * east, -bend * north, 0.0)) + noise
            seen = Turn(round(t0_s * 1e9), fix.t_ns, se3.quat_from_vector(tuple(turn.tolist())), TURN_COV)
            off = 1 + 0.6 * self.k1
            moved = (north * (1 - 2 * self.k1), east * (1 - 2 * self.k1), 0.0)
            motion = Odometry(0, seen.t_from_ns, fix.t_ns, (north * off, east * off, 0.0), COV, 0.01, 0.03)
            if self.tilted:
                behind_m = -2 * self.k1 * min(HEIGHT_M, 10.0 * t1_s)
                place = wgs84.geo_from_ned((*(-behind_m * np.array(self.velocity(t1_s)) / 10.0).tolist(), 0.0), fix.place)
                answer: Fix | NoFix = replace(fix, place=place, motion=replace(motion, displacement_ned_m=moved), turn=seen)
            elif self.k1 and self.k % 3:
                ids = fix.request_id, fix.frame_id, "test"
                answer = NoFix(0, fix.t_ns, *ids, Reason.NO_MATCH, 5.0, motion=motion, turn=seen)
            else:
                answer = replace(fix, motion=motion, turn=seen)
            self.answers.append((when, answer))

    return Bent


def test_a_lens_that_bends_the_picture_is_named_and_used_no_more(bent: Any) -> None:
    w = bent(k1=-0.15)
    w.start()
    w.fly(90.0)
    (named,) = w.notices("calibrate")
    assert named < 25
    (text,) = (text for text in told(w) if "calibrate" in text)
    assert float(text.split()[6].rstrip(":")) == pytest.approx(-0.15, abs=0.04)
    assert not [t for t, c in w.commands if isinstance(c, Injection) and t > named + 0.2]
    status, error_m = w.status_at(90.0)
    assert status.verdict.value == "ok"
    assert error_m < 10.0


@pytest.mark.parametrize("jam_s", [9.0, 60.0])
def test_what_a_lens_bends_is_in_the_level_before_it_is_sure_and_gnss_is_not_called_false_for_it(bent: Any, jam_s: float) -> None:
    w = bent(k1=-0.05, tilted=True, fix_sigma_m=0.7, jammed=lambda t: t > jam_s)
    w.start()
    w.fly(40.0)
    (named,) = w.notices("calibrate")
    assert named > jam_s or jam_s > 40
    assert w.notices("camera says elsewhere") == w.notices("moves unlike") == w.notices("off GNSS") == []
    sent = [t for t, c in w.commands if isinstance(c, Injection)]
    assert bool(sent) == (jam_s < 40)
    assert all(off_m < s.protection_level_m for t, s, off_m in w.statuses if sent and sent[0] <= t <= sent[-1])


def test_a_lens_as_configured_says_nothing(bent: Any) -> None:
    w = bent()
    w.start()
    w.fly(60.0)
    assert not [text for text in told(w) if "lens" in text or "not trusted" in text]
