"""PX4 without GNSS from boot has no global position, and a local one whose velocity drifts; the navigator finds its place."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from tests.unit.core.conftest import BOOT_OFFSET_NS, HEIGHT_M, ORIGIN, ns, place_of
from visloc_companion.core.settings import CoreSettings, InjectionSettings
from visloc_companion.types import (
    Attitude,
    AutopilotKind,
    EstimatorStatus,
    Gnss,
    Injection,
    LinkChanged,
    LocalPose,
    Mode,
    OriginChanged,
    PriorPose,
)

World = Any
SETTINGS = CoreSettings(injection=InjectionSettings(switch_source=True))


def px4(world: type[World], *, armed: bool = True, **faults: Any) -> World:
    """PX4's telemetry: nothing global and nothing vouched for until external positions have come for a second."""

    class Px4(world):  # type: ignore[misc]
        aided = False

        def _telemetry(self, t: float, gnss: np.ndarray, jammed: bool) -> None:
            now, boot = ns(t), ns(t) - BOOT_OFFSET_NS + ns(1000)
            self.aided = self.aided or t - self.first(Injection) > 1.0
            v = (float(self.ekf_v[0]), float(self.ekf_v[1]), 0.0)
            self.send(Attitude(now, boot, (1.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0)))
            if self.k % 2 == 0:
                self.send(LocalPose(now, boot, (float(self.ekf_p[0]), float(self.ekf_p[1]), -self.height_m(t)), v))
                if self.aided:
                    self.send(PriorPose(now, boot, place_of(self.ekf_p), v, self.height_m(t)))
            if self.k % 4 == 0:
                self.send(Gnss(now, boot, 1, 0, place_of(gnss), None, None, None))
            if self.k % 10 == 0:
                self.send(EstimatorStatus(now, 0.2, 0.2, 0.2, self.aided, False, False, self.aided, velocity_ok=self.aided))

    w = Px4(settings=SETTINGS, jammed=lambda t: True, **faults)
    w.send(LinkChanged(0, up=True, autopilot=AutopilotKind.PX4, system_id=1, armed=armed))
    w.send(OriginChanged(0, ORIGIN))
    return w


def test_a_velocity_that_drifts_does_not_lead_the_search_astray(world: type[World]) -> None:
    w = px4(world, accel_bias_mps2=(0.24, -0.1))
    w.p = np.array([300.0, -200.0])
    w.ekf_v = w.ekf_v + np.array([40.0, -15.0])  # what a minute or two of it came to
    w.fly(45)
    (found_s,) = w.notices("position found on the map")
    assert found_s < 15
    assert not w.notices("relocalised")
    assert w.status_at(43)[0].mode is Mode.AIDING
    errors_m = [error for t, _, error in w.statuses if t > found_s + 3]
    assert np.median(errors_m) < 6
    assert max(errors_m) < 25  # its own velocity is still off by that much a second when it is believed again


def test_on_the_ground_no_picture_is_asked_about_although_there_is_no_global_position(world: type[World]) -> None:
    w = px4(world, armed=False, height_m=lambda t: 0.0 if t < 10 else min(HEIGHT_M, 10 * (t - 10)))
    w.fly(9)
    w.send(LinkChanged(ns(w.t), up=True, autopilot=AutopilotKind.PX4, system_id=1, armed=True))
    w.fly(20)
    first_s = min(t for t, _, _ in w.requests)
    assert 11.5 <= first_s < 13


def test_a_daemon_that_is_started_in_flight_takes_no_height_for_the_ground(world: type[World]) -> None:
    w = px4(world)
    w.p = np.array([300.0, -200.0])
    w.fly(10)
    assert w.requests
    assert math.isfinite(w.requests[0][0])
