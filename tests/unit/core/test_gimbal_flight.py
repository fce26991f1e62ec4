"""The navigator with a camera on a gimbal: what localisers are asked with, what is learned, and what is said when it fails."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import pytest

from tests.unit.core.conftest import BOOT_OFFSET_NS, World, ns
from tests.unit.core.flown import errors, modes, started, texts
from visloc_companion.core.camera.camera_time import ASK_AFTER_NS
from visloc_companion.core.requests import SIGMA_YAW_RAD
from visloc_companion.core.settings import CoreSettings, GimbalSettings, InjectionSettings
from visloc_companion.geo import se3, wgs84
from visloc_companion.types import (
    Attitude,
    GimbalAttitude,
    GimbalFrame,
    Mode,
    Notice,
    Quat,
    RequestMessage,
    Severity,
)

GIMBAL = GimbalSettings()
SETTINGS = CoreSettings(injection=InjectionSettings(switch_source=True), gimbal=GIMBAL, has_camera=True)
JAM_S = 20.0
LEANING = se3.quat_from_euler(math.radians(20.0), 0.0, math.radians(70.0))


def pitched(pitch_deg: float, yaw_deg: float = 0.0) -> Quat:
    return se3.quat_from_euler(0.0, math.radians(pitch_deg), math.radians(yaw_deg))


@dataclass
class Gimballed(World):
    """Its gimbal says where it points 20 times a second, until it is silent; the vehicle leans by 20 degrees all the time."""

    settings: CoreSettings = SETTINGS
    pitch_deg: Callable[[float], float] = lambda t: -90.0
    silent: Callable[[float], bool] = lambda t: False
    frame: GimbalFrame = GimbalFrame.HEADING
    vehicle: Quat = LEANING
    restart_s: float = math.inf

    def send(self, event: Any) -> Any:
        if isinstance(event, Attitude):
            event = replace(event, q_ned_frd=self.vehicle)
        if self.t > self.restart_s and getattr(event, "t_boot_ns", None):
            event = replace(event, t_boot_ns=ns(self.t - self.restart_s))
        return super().send(event)

    def _telemetry(self, t: float, gnss: Any, jammed: bool) -> None:
        super()._telemetry(t, gnss, jammed)
        if not self.silent(t):
            boot_ns = ns(t) - BOOT_OFFSET_NS + ns(1000)
            self.send(GimbalAttitude(ns(t), boot_ns, 1, pitched(self.pitch_deg(t), 10.0), self.frame))


def operator_texts(w: World, about: str) -> list[tuple[float, Severity, str]]:
    return [(t, c.severity, c.text) for t, c in w.commands if isinstance(c, Notice) and c.to_operator and about in c.text]


def test_its_attitude_is_asked_for_with_a_gimbal_only() -> None:
    asked = {c.message_id: c.rate_hz for _, c in started(Gimballed).commands if isinstance(c, RequestMessage)}
    assert asked[285] == GIMBAL.rate_hz == 25.0
    w = started(World)
    assert 285 not in {c.message_id for _, c in w.commands if isinstance(c, RequestMessage)}


@pytest.mark.parametrize(
    ("frame", "heading_deg"), [(GimbalFrame.HEADING, 80.0), (GimbalFrame.NORTH, 10.0)], ids=["heading", "north"]
)
def test_localisers_are_asked_with_the_attitude_of_the_gimbal(frame: GimbalFrame, heading_deg: float) -> None:
    w = started(Gimballed, frame=frame).fly(6)
    assert w.requests
    for _, request, _ in w.requests:
        assert math.degrees(se3.angle_between(request.prior.q_ned_frd, pitched(0.0, heading_deg))) < 1e-6
        assert request.prior.sigma_yaw_rad == pytest.approx(math.hypot(SIGMA_YAW_RAD, GIMBAL.sigma_yaw_rad))
        assert request.prior.sigma_tilt_rad == w.settings.mount_sigma_rad


def test_the_mounting_is_that_on_the_gimbal() -> None:
    """A camera that looks 10 degrees above where a gimbal points that looks 20 degrees ahead."""
    settings = replace(SETTINGS, q_frd_cambody=pitched(10.0))
    w = started(Gimballed, settings=settings, pitch_deg=lambda t: -70.0).fly(6)
    assert math.degrees(se3.angle_between(w.requests[-1][1].prior.q_ned_frd, pitched(0.0, 80.0))) == pytest.approx(30.0)


def test_a_rolling_shutter_is_told_how_the_gimbal_turns() -> None:
    """It rises by 5 degrees a second beneath a vehicle that does not turn at all."""
    settings = replace(SETTINGS, readout_s=0.05)
    w = started(Gimballed, settings=settings, pitch_deg=lambda t: -90.0 + 5.0 * min(max(t - 8, 0.0), 5.0)).fly(13)
    rates = [request.readout.rate_frd_radps for t, request, _ in w.requests if 9 < t < 12.5 and request.readout is not None]
    assert len(rates) > 3
    for rate in rates:
        assert [math.degrees(axis) for axis in rate] == pytest.approx([0.0, 5.0, 0.0], abs=1e-3)


def test_a_jam_is_flown_as_with_a_fixed_camera() -> None:
    fixed, held = (
        started(kind, settings=settings, jammed=lambda t: t > JAM_S).fly(90)
        for kind, settings in ((World, replace(SETTINGS, gimbal=None)), (Gimballed, SETTINGS))
    )
    assert modes(held) == modes(fixed) == [Mode.WAITING, Mode.SHADOW, Mode.AIDING]
    assert max(errors(held, 30)) < 1.1 * max(errors(fixed, 30)) + 0.5
    assert "gimbal" not in " ".join(texts(held))


def test_a_gimbal_that_falls_silent_ends_the_fixes_and_is_told_once() -> None:
    """Three seconds of grace; meanwhile and after it nothing is asked with an attitude that nobody knows."""
    w = started(Gimballed, jammed=lambda t: t > JAM_S, silent=lambda t: 40 < t < 60).fly(80)
    assert not [t for t, _, _ in w.requests if 40.3 < t < 60]
    assert [t for t, _, _ in w.requests if t > 60.5]
    told = operator_texts(w, "gimbal")
    assert [(severity, text) for _, severity, text in told] == [
        (Severity.WARNING, "visloc: no gimbal attitude"),
        (Severity.NOTICE, "visloc: gimbal attitude is back"),
    ]
    assert told[0][0] == pytest.approx(43.1, abs=0.2)
    assert modes(w) == [Mode.WAITING, Mode.SHADOW, Mode.AIDING, Mode.DEAD_RECKONING, Mode.AIDING]
    for _, status, error_m in w.statuses:
        level_m = status.protection_level_m
        assert level_m is None or math.isnan(error_m) or error_m <= level_m


def test_one_that_never_speaks_is_told_before_the_take_off() -> None:
    w = started(Gimballed, silent=lambda t: True, height_m=lambda t: 0.0).fly(10)
    assert [text for _, _, text in operator_texts(w, "gimbal")] == ["visloc: no gimbal attitude"]
    assert w.requests == []


def test_a_short_silence_is_no_news() -> None:
    w = started(Gimballed, silent=lambda t: 10 < t < 12).fly(20)
    assert operator_texts(w, "gimbal") == []


def test_one_that_looks_away_is_told_again_when_positions_begin_to_be_needed() -> None:
    w = started(Gimballed, jammed=lambda t: t > 30, pitch_deg=lambda t: 0.0 if 10 < t < 50 else -90.0).fly(60)
    assert not [t for t, _, _ in w.requests if 10.5 < t < 50]
    told = operator_texts(w, "gimbal")
    assert [(severity, text) for _, severity, text in told] == [
        (Severity.NOTICE, "visloc: gimbal looks away from the ground"),
        (Severity.WARNING, "visloc: gimbal looks away from the ground"),
        (Severity.NOTICE, "visloc: gimbal looks at the ground again"),
    ]
    assert told[0][0] == pytest.approx(13.0, abs=1.0)
    assert 30 < told[1][0] < 33
    assert [c.data for _, c in w.commands if isinstance(c, Notice) and "away" in c.text] == [(("reason", "horizon_in_view"),)] * 2


def test_a_glance_to_the_horizon_is_no_news() -> None:
    w = started(Gimballed, pitch_deg=lambda t: 0.0 if 10 < t < 12 else -90.0).fly(20)
    assert operator_texts(w, "gimbal") == []
    assert not [t for t, _, _ in w.requests if 10.5 < t < 12]


def test_on_the_ground_it_may_look_where_it_likes() -> None:
    w = started(Gimballed, pitch_deg=lambda t: 0.0, height_m=lambda t: 0.0).fly(15)
    assert operator_texts(w, "gimbal") == []


def test_after_a_restart_of_the_autopilot_old_words_are_forgotten() -> None:
    """Its clock begins anew: what it says now is earlier than what it said before."""
    w = started(Gimballed, restart_s=10.0).fly(25)
    assert [text for text in texts(w) if "autopilot clock stepped" in text]
    assert [t for t, _, _ in w.requests if t > 15]
    assert operator_texts(w, "gimbal") == []


def test_the_lever_arm_is_the_vehicles() -> None:
    """A gimbal 3 m ahead of the IMU of a vehicle that heads east: the camera is there, wherever it looks."""
    level = se3.quat_from_euler(0.0, 0.0, math.radians(90.0))
    with_lever, without = (
        started(Gimballed, settings=replace(SETTINGS, lever_frd_m=lever), vehicle=level, pitch_deg=lambda t: -60.0).fly(6)
        for lever in ((3.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    )
    north_m, east_m, _ = wgs84.ned_from_geo(with_lever.requests[0][1].prior.place, without.requests[0][1].prior.place)
    assert (north_m, east_m) == pytest.approx((0.0, 3.0), abs=1e-3)


def test_fixes_are_those_of_the_vehicle_behind_its_camera() -> None:
    """A gimbal 10 m ahead of the IMU of a vehicle that heads east, looking 40 degrees ahead and 10 to the right."""
    level = se3.quat_from_euler(0.0, 0.0, math.radians(90.0))
    settings = replace(SETTINGS, lever_frd_m=(10.0, 0.0, 0.0))
    w = started(
        Gimballed, settings=settings, vehicle=level, jammed=lambda t: t > JAM_S, map_error_m=(0.0, 10.0), fix_sigma_m=0.3,
        pitch_deg=lambda t: -50.0,
    ).fly(60)  # fmt: skip
    status, error_m = w.status_at(60)
    assert status.mode is Mode.AIDING
    assert error_m < 1.0, "cameras 10 m east of the vehicle are fixed 10 m east of it"


def test_what_pictures_tell_of_the_clock_is_not_learned() -> None:
    """They turn with the gimbal, whose word comes late by an unknown time itself; nobody is asked to fly turns for it."""
    w = started(Gimballed).fly(ASK_AFTER_NS / 1e9 + 10)
    assert not [text for text in texts(w) if "delay" in text]
    fixed = started(World, settings=replace(SETTINGS, gimbal=None)).fly(ASK_AFTER_NS / 1e9 + 10)
    assert [text for text in texts(fixed) if "delay unknown" in text], "as a fixed camera's operator is"
