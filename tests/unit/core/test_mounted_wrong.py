"""A camera that is mounted otherwise than configured makes a good GNSS look false; once that is known, GNSS is trusted again."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest

from visloc_companion.core.satellites import gnss_words
from visloc_companion.errors import Reason
from visloc_companion.geo import se3
from visloc_companion.types import Attitude, Event, Injection, LocaliseRequest, NoFix, Notice, Odometry, Quat, Turn

COV = ((0.01, 0.0), (0.0, 0.01))
TURN_COV = ((1e-6, 0.0, 0.0), (0.0, 1e-6, 0.0), (0.0, 0.0, 1e-6))
CALM_S = 25.0


def attitude_at(t_s: float) -> Quat:
    """Calm at first, then leaning to and fro by 3 degrees."""
    lean = 0.05 if t_s > CALM_S else 0.0
    return se3.quat_from_euler(lean * math.sin(1.3 * t_s), lean * math.cos(1.7 * t_s), 0.0)


@pytest.fixture
def turned(world: Any) -> type[Any]:
    """No frame is recognised; the camera's top edge points `yaw_deg` to the right of the nose."""

    @dataclass
    class Turned(world):  # type: ignore[misc]
        yaw_deg: float = 0.0
        scale: float = 1.0
        fixes_until_s: float = 0.0

        def send(self, event: Event) -> Any:
            if isinstance(event, Attitude):
                event = replace(event, q_ned_frd=attitude_at(self.t))
            return super().send(event)

        def _localise(self, request: LocaliseRequest) -> None:
            if self.t < self.fixes_until_s:
                super()._localise(request)
                return
            frame, yaw = request.frame, math.radians(self.yaw_deg)
            t0_s, t1_s = frame.t_ns * 1e-9 - self.fix_period_s, frame.t_ns * 1e-9
            mounted = se3.quat_from_euler(0.0, 0.0, yaw)
            a, b = (se3.quat_multiply(attitude_at(t), mounted) for t in (t0_s, t1_s))
            turn = Turn(round(t0_s * 1e9), frame.t_ns, se3.quat_multiply(se3.quat_inverse(a), b), TURN_COV)
            north, east = np.array(self.velocity((t0_s + t1_s) / 2)) * self.fix_period_s
            moved = self.scale * complex(north, east) * complex(math.cos(yaw), -math.sin(yaw))
            motion = Odometry(0, turn.t_from_ns, frame.t_ns, (moved.real, moved.imag, 0.0), COV, 0.01, 0.03)
            ids = request.request_id, frame.frame_id
            self.answers.append(
                (self.t + self.latency_s, NoFix(0, frame.t_ns, *ids, "test", Reason.NO_MATCH, 5.0, motion=motion, turn=turn))
            )

    return Turned


def told(w: Any) -> list[str]:
    return [c.text for _, c in w.commands if isinstance(c, Notice) and c.to_operator]


def test_a_turned_camera_is_named_and_what_it_said_of_gnss_withdrawn(turned: Any) -> None:
    w = turned(yaw_deg=90.0)
    w.start()
    w.fly(CALM_S)
    assert told(w)[-2:] == ["visloc: GNSS not trusted, moves unlike the camera", gnss_words.OR_CAMERA]
    w.fly(90.0)
    said = told(w)
    assert said.count("visloc: camera turned, try mount_yaw_deg = 90") == 1
    named, back = w.notices("try mount_yaw_deg")[0], w.notices("GNSS trusted")[-1]
    assert CALM_S < named < CALM_S + 20
    assert named < back < named + 25
    status, error_m = w.status_at(90.0)
    assert status.verdict.value == "ok"
    assert error_m < 10.0
    assert not any(isinstance(c, Injection) for _, c in w.commands)


def test_what_rests_on_its_fixes_is_sent_no_more(turned: Any) -> None:
    w = turned(yaw_deg=90.0, fixes_until_s=8.0)
    w.start()
    w.fly(CALM_S)
    assert any(isinstance(c, Injection) for _, c in w.commands)
    w.fly(90.0)
    named = w.notices("try mount_yaw_deg")[0]
    assert not [t for t, c in w.commands if isinstance(c, Injection) and t > named + 0.2]
    assert w.status_at(90.0)[0].verdict.value == "ok"
    assert w.source.value == "gnss"


def test_a_scale_that_is_wrong_is_named_and_withdrawn(turned: Any) -> None:
    w = turned(scale=0.67)
    w.start()
    w.fly(150.0)
    assert "visloc: GNSS not trusted, moves unlike the camera" in told(w)
    (named,) = w.notices("fx_px x 0.67, or map")
    assert w.notices("GNSS trusted")[-1] > named
    status, error_m = w.status_at(150.0)
    assert status.verdict.value == "ok"
    assert error_m < 10.0


def test_a_camera_as_configured_says_nothing(turned: Any) -> None:
    w = turned(yaw_deg=0.0)
    w.start()
    w.fly(60.0)
    assert not [text for text in told(w) if "camera" in text or "not trusted" in text]


def test_a_camera_in_which_nothing_is_ever_recognised_is_told_while_gnss_is_good(turned: Any) -> None:
    w = turned(yaw_deg=0.0)
    w.start()
    w.fly(130.0)
    assert [text for text in told(w) if "no fix yet" in text] == ["visloc: no fix yet, no_match"]
