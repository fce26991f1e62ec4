"""A lens that is not as configured: nothing of the camera is used."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest

from visloc_companion.errors import Reason
from visloc_companion.geo import se3
from visloc_companion.types import Fix, Injection, LocaliseRequest, NoFix, Notice, Odometry, Turn

COV = ((0.01, 0.0), (0.0, 0.01))
TURN_COV = ((1e-6, 0.0, 0.0), (0.0, 1e-6, 0.0), (0.0, 0.0, 1e-6))
HEIGHT_M = 100.0


def told(w: Any) -> list[str]:
    return [c.text for _, c in w.commands if isinstance(c, Notice) and c.to_operator]


@pytest.fixture
def bent(world: Any) -> type[Any]:
    """Pictures turn as those of an unstated distortion, and what fixes and motion there are is wrong."""

    @dataclass
    class Bent(world):  # type: ignore[misc]
        k1: float = 0.0

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
            motion = Odometry(0, seen.t_from_ns, fix.t_ns, (north * off, east * off, 0.0), COV, 0.01, 0.03)
            if self.k1 and self.k % 3:
                ids = fix.request_id, fix.frame_id, "test"
                answer: Fix | NoFix = NoFix(0, fix.t_ns, *ids, Reason.NO_MATCH, 5.0, motion=motion, turn=seen)
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


def test_a_lens_as_configured_says_nothing(bent: Any) -> None:
    w = bent()
    w.start()
    w.fly(60.0)
    assert not [text for text in told(w) if "lens" in text or "not trusted" in text]
