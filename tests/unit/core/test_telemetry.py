"""Single messages of the autopilot and its sensors, and what the navigator keeps of them."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import pytest

from tests.unit.core.conftest import ORIGIN, ns
from tests.unit.core.flown import errors, frame, quiet, requests, started
from visloc_companion.core.filter.driving import Velocity
from visloc_companion.core.filter.propagation import Drive
from visloc_companion.core.gnss import GnssMonitor
from visloc_companion.core.gnss_aiding import GnssAiding
from visloc_companion.core.navigator import Navigator
from visloc_companion.core.settings import CoreSettings
from visloc_companion.core.tracking import Tracker
from visloc_companion.errors import Reason
from visloc_companion.geo import se3
from visloc_companion.types import (
    Attitude,
    Baro,
    Fix,
    GimbalAttitude,
    GimbalFrame,
    GnssIntegrity,
    Imu,
    NoFix,
    Odometry,
    Turn,
    Vec2,
    Verdict,
)

World = Any
LEVEL = (1.0, 0.0, 0.0, 0.0)
COV = ((1.0, 0.0), (0.0, 1.0))


def fix(method: str) -> Fix:
    return Fix(0, 0, 1, 1, method, ORIGIN, LEVEL, COV, 1.0, 0.05, 0.001, 5.0, per_focal_ne_m=(3.0, 0.0))


def test_an_acceleration_of_no_known_attitude_is_left_out(monkeypatch: pytest.MonkeyPatch) -> None:
    navigator, taken = Navigator(CoreSettings()), []
    monkeypatch.setattr(navigator._tracker, "on_force", lambda *given: taken.append(given))
    imu = Imu(ns(1.0), ns(1.0), (0.1, 0.0, -9.8))
    assert navigator.on(imu, ns(1.0)) == []
    assert taken == []
    navigator.on(Attitude(ns(1.0), ns(1.0), LEVEL, (0.0, 0.0, 0.0)), ns(1.0))
    navigator.on(imu, ns(1.0))
    assert taken == [(ns(1.0), imu.force_frd_mps2, LEVEL)]


@pytest.mark.parametrize(("speed_mps", "heard"), [(20.0, True), (5.0, False)])
def test_a_pressure_of_the_air_ahead_is_a_velocity_along_the_heading(
    monkeypatch: pytest.MonkeyPatch, speed_mps: float, *, heard: bool
) -> None:
    navigator, taken = Navigator(CoreSettings()), list[tuple[int, Vec2]]()
    monkeypatch.setattr(navigator._tracker, "on_airspeed", lambda *given: taken.append(given))
    baro = Baro(ns(1.0), ns(1.0), 1013.25, 15.0, 1.225 * speed_mps**2 / 200)
    navigator.on(baro, ns(1.0))
    assert taken == []
    navigator.on(Attitude(ns(1.0), ns(1.0), se3.quat_from_euler(0.1, 0.1, 2.0), (0.0, 0.0, 0.0)), ns(1.0))
    navigator.on(baro, ns(1.0))
    assert len(taken) == heard
    for t_boot_ns, v_ne_mps in taken:
        assert t_boot_ns == ns(1.0)
        assert v_ne_mps == pytest.approx((speed_mps * math.cos(2.0), speed_mps * math.sin(2.0)), rel=5e-3)


def test_what_a_receiver_says_of_interference_reaches_the_verdict(world: type[World]) -> None:
    w = quiet(world)
    assert w.status_at(w.t)[0].verdict is Verdict.OK
    for _ in range(20):
        w.fly(w.t + 0.1)
        assert w.send(GnssIntegrity(ns(w.t), 0, None, True, None)) == []
    assert w.statuses[-1][1].verdict is not Verdict.OK
    assert "receiver_spoofing" in w.statuses[-1][1].reasons


def test_odometry_of_its_own_holds_the_velocity_where_nothing_else_does(world: type[World]) -> None:
    """The autopilot's is off by 3 m/s behind a jam; a camera's odometry is not."""
    off_m = []
    for sees in (False, True):

        class Sees(world):  # type: ignore[misc]
            def step(self) -> None:
                before = self.p
                super().step()
                if sees:  # noqa: B023 (flown within the loop)
                    north, east = (self.p - before).tolist()
                    cov, times = ((1e-4, 0.0), (0.0, 1e-4)), (ns(self.t), ns(self.t - 0.05), ns(self.t))
                    assert self.send(Odometry(*times, (north, east, 0.0), cov, 0.01, 0.02)) == []

        w = started(Sees, jammed=lambda t: t > 20, blind=lambda t: t > 25, false_velocity_mps=lambda t: (3.0 * (t > 25), 0.0))
        off_m.append(max(errors(w.fly(50), 45)))
    assert off_m[1] < 0.3 * off_m[0]


def test_a_gimbal_that_is_not_configured_moves_no_camera(world: type[World]) -> None:
    w = quiet(world)
    aside = GimbalAttitude(ns(w.t), ns(w.t), 1, se3.quat_from_euler(0.0, 0.6, 0.0), GimbalFrame.NORTH)
    assert w.send(aside) == []
    (request,) = requests(w.send(frame(w.t)))
    assert request.prior.q_ned_frd == pytest.approx(LEVEL)


def test_a_turn_before_a_velocity_is_known_shows_no_bend_of_the_lens(world: type[World]) -> None:
    """What a height of way turns pictures by is not known then."""
    w = quiet(world)
    w.navigator._tracker.forget_velocity()
    seen = Turn(ns(w.t - 0.5), ns(w.t), LEVEL, ((1e-6, 0.0, 0.0), (0.0, 1e-6, 0.0), (0.0, 0.0, 1e-6)))
    w.send(NoFix(ns(w.t), ns(w.t), 1, 1, "test", Reason.NO_MATCH, 5.0, turn=seen))
    assert w.navigator._tracker.alike.lens_bend == 0.0
    assert w.navigator._onboard._distortion.bend == 0.0


@pytest.mark.parametrize(
    ("method", "following", "share"), [("structure", True, 45.0), ("structure", False, 3.0), ("t", True, 3.0)]
)
def test_while_a_lens_is_in_doubt_a_fix_by_shape_has_the_last_pictures_share_of_it(
    world: type[World], method: str, *, following: bool, share: float
) -> None:
    onboard = quiet(world).navigator._onboard
    onboard.ramp.following, onboard.ramp._per_focal_ne_m = following, (45.0, 0.0)
    assert onboard.stated(fix(method), None) == replace(fix(method), per_focal_ne_m=(share, 0.0))


def aided() -> tuple[GnssAiding, Tracker, GnssMonitor]:
    settings = CoreSettings()
    tracker, monitor = Tracker(settings.navigator), GnssMonitor(settings.gnss)
    return GnssAiding(settings, tracker, monitor), tracker, monitor


def test_a_camera_that_gave_no_fix_is_disowned_without_a_new_start(world: type[World]) -> None:
    for flies_s, forgets in ((2.0, False), (10.0, True)):
        w = started(world, camera=lambda t: t > 5.0).fly(flies_s)
        assert w.navigator._tracker.belief is not None
        w.navigator._aiding.disown_camera()
        assert (w.navigator._tracker.belief is None) is forgets


def test_a_fix_before_the_origin_is_shown_without_the_ground_that_it_looks_at(monkeypatch: pytest.MonkeyPatch) -> None:
    aiding, tracker, monitor = aided()
    shown: list[Any] = []
    monkeypatch.setattr(monitor, "on_vision", lambda *given: shown.append(given))
    tracker.drive(Velocity(ns(1.0), (0.0, 0.0, 0.0), 140.0, 0.3, Drive.AUTOPILOT), ns(1.0), alone=False)
    for k in range(4):
        tracker.gnss.add(ns(0.8 + 0.2 * k), ORIGIN)
    aiding.shown(replace(fix("t"), t_ns=ns(1.0)))
    assert [given[5] for given in shown] == [None]
