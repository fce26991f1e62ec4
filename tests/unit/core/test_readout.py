"""What requests say of the camera's motion while a rolling shutter reads a frame."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import pytest

from visloc_companion.app.serialise import from_json, to_json
from visloc_companion.core.settings import CoreSettings
from visloc_companion.geo import se3
from visloc_companion.types import Attitude, Event

World = Any
READOUT_S = 0.03
TO_THE_RIGHT = se3.quat_from_euler(0.0, 0.0, math.pi / 2)


def rolling(world: type[World], settings: CoreSettings) -> World:
    """A vehicle that rolls to and fro by 0.1 rad, 2 rad/s."""

    class Rolls(world):  # type: ignore[misc]
        def send(self, event: Event) -> Any:
            if isinstance(event, Attitude):
                roll, rate = 0.1 * math.sin(2 * self.t), 0.2 * math.cos(2 * self.t)
                event = replace(event, q_ned_frd=se3.quat_from_euler(roll, 0.0, 0.0), rate_frd_radps=(rate, 0.0, 0.0))
            return super().send(event)

    w = Rolls(settings=settings)
    w.start()
    return w.fly(12)


def test_a_request_says_how_the_camera_moves_in_its_own_frame(world: type[World]) -> None:
    w = rolling(world, CoreSettings(readout_s=READOUT_S, q_frd_cambody=TO_THE_RIGHT, structure=False))
    assert len(w.requests) > 10
    for t, request, _ in w.requests:
        readout = request.readout
        assert readout is not None
        assert readout.readout_s == READOUT_S
        rate = 0.2 * math.cos(2 * t)
        assert readout.rate_frd_radps == pytest.approx((0.0, -rate, 0.0), abs=0.02), "the vehicle's nose is the camera's left"
        assert readout.v_ned_mps[:2] == pytest.approx(w.velocity(t), abs=1.0)
        assert readout.height_m == pytest.approx(w.height_m(t), abs=5.0)
        assert from_json(to_json(request)) == request


def test_a_global_shutter_says_nothing(world: type[World]) -> None:
    assert {request.readout for _, request, _ in rolling(world, CoreSettings(structure=False)).requests} == {None}
