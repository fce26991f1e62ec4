"""Frames that come much later than they bear: found by their turns, and what they said before that is taken back."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest

from tests.unit.core.conftest import place_of
from tests.unit.core.flown import started
from visloc_companion.geo import se3
from visloc_companion.types import Attitude, Event, Fix, LocaliseRequest, Odometry, Quat, Turn, Verdict

World = Any
COV, TURN_COV = ((0.01, 0.0), (0.0, 0.01)), ((1e-6, 0.0, 0.0), (0.0, 1e-6, 0.0), (0.0, 0.0, 1e-6))
LATE_S = 0.8


def attitude_at(t_s: float) -> Quat:
    return se3.quat_from_euler(0.05 * np.sin(2.3 * t_s), 0.05 * np.sin(1.6 * t_s + 1), 0.0)


@pytest.fixture
def late(world: Any) -> type[Any]:
    @dataclass
    class Late(world):  # type: ignore[misc]
        """A vehicle that rocks; frames show what was LATE_S before they arrive."""

        def __post_init__(self) -> None:
            super().__post_init__()
            self.been: dict[int, np.ndarray] = {}
            self.before: tuple[int, int] | None = None

        def send(self, event: Event) -> Any:
            if isinstance(event, Attitude):
                self.been[self.k] = self.p
                event = replace(event, q_ned_frd=attitude_at(self.t))
            return super().send(event)

        def _localise(self, request: LocaliseRequest) -> None:
            super()._localise(request)
            when, fix = self.answers.pop()
            frame, taken = request.frame, request.frame.frame_id - round(LATE_S / 0.05)
            north, east = self.been.get(taken, np.zeros(2)) + self.fix_sigma_m * self.rng.standard_normal(2)
            answer = replace(fix, place=place_of(np.array((north, east)))) if isinstance(fix, Fix) else fix
            if self.before is not None and self.before[0] in self.been:
                first, first_ns = self.before
                turned = se3.quat_multiply(se3.quat_inverse(attitude_at(0.05 * first)), attitude_at(0.05 * taken))
                moved = self.been[taken] - self.been[first]
                motion = Odometry(0, first_ns, frame.t_ns, (float(moved[0]), float(moved[1]), 0.0), COV, 0.01, 0.03)
                answer = replace(answer, turn=Turn(first_ns, frame.t_ns, turned, TURN_COV), motion=motion)
            self.before = taken, frame.t_ns
            self.answers.append((when, answer))

    return Late


def test_what_late_frames_said_is_taken_back_as_soon_as_they_are_found(late: type[Any]) -> None:
    """The filter was 8 m behind, sure to 1 m: it took no better fix for five seconds."""
    w = started(late).fly(10)
    (found_s,) = w.notices("frames late, corrected: latency_s = 0.8")
    before, off_m = w.status_at(found_s - 0.1)
    assert off_m > 6.0
    after, off_m = w.status_at(found_s + 1.6)
    assert off_m < 3.0
    assert after.cov_ne_m2[0][0] < 3.0**2, "nor is what they and GNSS differed by the map's any more"
    assert before.cov_ne_m2[0][0] > 4.0**2
    assert {status.verdict for t, status, _ in w.statuses if t > 3} == {Verdict.OK}
