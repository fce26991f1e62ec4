"""Electronic stabilisation that is switched on in flight: named, the camera unused until it is switched off, and what it said
against GNSS withdrawn."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest

from visloc_companion.errors import Reason
from visloc_companion.geo import se3
from visloc_companion.types import Attitude, Event, Fix, LocaliseRequest, NoFix, Notice, Odometry, Quat, Turn

COV = ((0.01, 0.0), (0.0, 0.01))
TURN_COV = ((1e-6, 0.0, 0.0), (0.0, 1e-6, 0.0), (0.0, 0.0, 1e-6))
HEIGHT_M, ON_S, OFF_S = 100.0, 30.0, 60.0


def attitude_at(t_s: float) -> Quat:
    return se3.quat_from_euler(0.03 * math.sin(1.3 * t_s), -0.15 + 0.03 * math.cos(1.7 * t_s), 0.0)


@pytest.fixture
def stabilised(world: Any) -> type[Any]:
    """While it is on the picture looks straight down: no frame is recognised, and the lean that the autopilot states is taken for
    a way."""

    @dataclass
    class Stabilised(world):  # type: ignore[misc]
        def send(self, event: Event) -> Any:
            return super().send(replace(event, q_ned_frd=attitude_at(self.t)) if isinstance(event, Attitude) else event)

        def _localise(self, request: LocaliseRequest) -> None:
            super()._localise(request)
            when, answer = self.answers.pop()
            t1_s = answer.t_ns * 1e-9
            t0_s = t1_s - self.fix_period_s
            before, now = attitude_at(t0_s), attitude_at(t1_s)
            on = ON_S < t1_s < OFF_S
            turned = (1.0, 0.0, 0.0, 0.0) if on else se3.quat_multiply(se3.quat_inverse(before), now)
            turn = Turn(round(t0_s * 1e9), answer.t_ns, turned, TURN_COV)
            (roll0, pitch0, _), (roll1, pitch1, _) = se3.euler_from_quat(before), se3.euler_from_quat(now)
            moved = np.array(self.velocity((t0_s + t1_s) / 2)) * self.fix_period_s
            if on:
                moved = moved + 0.5 * HEIGHT_M * np.array((pitch1 - pitch0, roll0 - roll1)) + 1.5 * self.fix_period_s
            motion = Odometry(0, turn.t_from_ns, turn.t_to_ns, (*moved.tolist(), 0.0), COV, 0.01, 0.03)
            ids = request.request_id, request.frame.frame_id, "test"
            if on or not isinstance(answer, Fix):
                answer = NoFix(0, answer.t_ns, *ids, Reason.NO_MATCH, 5.0)
            self.answers.append((when, replace(answer, motion=motion, turn=turn)))

    return Stabilised


def told(w: Any) -> list[str]:
    return [c.text for _, c in w.commands if isinstance(c, Notice) and c.to_operator]


def test_it_is_named_and_gnss_is_trusted_and_its_end_brings_the_fixes_back(stabilised: Any) -> None:
    w = stabilised()
    w.start()
    w.fly(120.0)
    (named_s,), (back_s,) = w.notices("picture keeps level"), w.notices("picture tilts with the vehicle again")
    assert ON_S < named_s < ON_S + 8
    assert OFF_S < back_s < OFF_S + 8
    assert all(t < named_s for t in w.notices("not trusted"))
    assert w.notices("zoom") == w.notices("mount_") == []
    status, error_m = w.status_at(119.0)
    assert (status.verdict.value, error_m < 5.0) == ("ok", True)
    assert status.age_of_fix_s is not None
    assert status.age_of_fix_s < 2.0


def test_what_is_reckoned_on_with_after_a_jam_is_within_its_level(stabilised: Any) -> None:
    w = stabilised(jammed=lambda t: t > ON_S + 15)
    w.start()
    w.fly(OFF_S)
    assert len(w.notices("picture keeps level")) == 1
    sent = [(s, off_m) for t, s, off_m in w.statuses if t > ON_S + 18 and s.mode.value == "dead_reckoning"]
    assert sent
    assert all(off_m < s.protection_level_m for s, off_m in sent)


def test_a_false_gnss_that_fixes_found_before_stays_found_and_the_position_goes_on(stabilised: Any) -> None:
    """GNSS is pulled 60 m away at 8 s and the autopilot flies on fixes: what they said was right then."""
    w = stabilised(pull_m=lambda t: (60.0 * (t > 8), 0.0))
    w.start()
    w.fly(OFF_S)
    assert len(w.notices("picture keeps level")) == 1
    assert w.notices("GNSS not trusted")[0] < ON_S - 10
    after = [(s, off_m) for t, s, off_m in w.statuses if t > ON_S + 2]
    assert {s.verdict.value for s, _ in after} == {"suspect"}
    assert {s.mode.value for s, _ in after} <= {"aiding", "dead_reckoning"}
    assert w.source.value == "vision"
    assert all(off_m < s.protection_level_m for s, off_m in after)
