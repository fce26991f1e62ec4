"""A small simulated flight that drives a Navigator: truth, an autopilot whose filter follows its source, GNSS, camera, worker."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
import pytest

from visloc_companion.core.navigator import Navigator
from visloc_companion.core.settings import CoreSettings, InjectionSettings
from visloc_companion.errors import Reason
from visloc_companion.geo import wgs84
from visloc_companion.types import (
    Attitude,
    AutopilotKind,
    Command,
    EkfSource,
    EstimatorStatus,
    Event,
    Fix,
    FrameRef,
    GeoPoint,
    Gnss,
    Injection,
    LinkChanged,
    LocaliseRequest,
    NoFix,
    Notice,
    OriginChanged,
    PriorPose,
    SourceSwitched,
    Status,
    SwitchSource,
    Tick,
    TiltSeen,
)

ORIGIN = GeoPoint(59.3, 18.1, 40.0)
HEIGHT_M = 100.0
BOOT_OFFSET_NS = 5_000_000_000


def ns(t_s: float) -> int:
    return round(t_s * 1e9)


def place_of(ne_m: np.ndarray, h_amsl_m: float = ORIGIN.h_amsl_m + HEIGHT_M) -> GeoPoint:
    return wgs84.geo_from_ned((float(ne_m[0]), float(ne_m[1]), ORIGIN.h_amsl_m - h_amsl_m), ORIGIN)


class Nobody:
    """In the place of a navigator while no daemon runs."""

    def on(self, *_: object) -> list[object]:
        return []


@dataclass
class World:
    """Truth and sensors. Functions of time say what goes wrong: pull (metres NE added to GNSS), jammed, blind (no fix), deaf (to
    orders to switch the source)."""

    settings: CoreSettings = field(default_factory=lambda: CoreSettings(injection=InjectionSettings(switch_source=True)))
    seed: int = 1
    fix_sigma_m: float = 1.5
    claimed_share: float = 1.0
    fix_period_s: float = 0.5
    latency_s: float = 0.35
    speed_mps: float = 10.0
    pull_m: Callable[[float], tuple[float, float]] = lambda t: (0.0, 0.0)
    jammed: Callable[[float], bool] = lambda t: False
    blind: Callable[[float], bool] = lambda t: False
    why_blind: Reason = Reason.NO_MATCH
    camera: Callable[[float], bool] = lambda t: True
    frozen: Callable[[float], bool] = lambda t: False
    height_m: Callable[[float], float] = lambda t: HEIGHT_M
    false_velocity_mps: Callable[[float], tuple[float, float]] = lambda t: (0.0, 0.0)
    unused: Callable[[float, EkfSource], bool] = lambda t, source: False
    deaf: Callable[[float], bool] = lambda t: False
    accel_bias_mps2: tuple[float, float] = (0.02, -0.02)
    map_error_m: tuple[float, float] = (0.4, -0.3)
    tilt: TiltSeen | None = None

    def __post_init__(self) -> None:
        self.rng = np.random.default_rng(self.seed)
        self.navigator = Navigator(self.settings)
        self.source = EkfSource.GNSS
        self.p = self.seen = np.zeros(2)
        self.ekf_p, self.ekf_v = np.zeros(2), np.array(self.velocity(0.0))
        self.gnss_walk = np.zeros(2)
        self.last_injection: Injection | None = None
        self.answers: list[tuple[float, Event]] = []
        self.statuses: list[tuple[float, Status, float]] = []
        self.commands: list[tuple[float, Command]] = []
        self.requests: list[tuple[float, LocaliseRequest, float]] = []
        self.k = 0

    def velocity(self, t_s: float) -> tuple[float, float]:
        return self.speed_mps * math.cos(t_s / 40), self.speed_mps * math.sin(t_s / 40)

    @property
    def t(self) -> float:
        return self.k * 0.05

    def send(self, event: Event) -> list[Command]:
        commands = self.navigator.on(event, ns(self.t))
        self.commands += [(self.t, command) for command in commands]
        for command in commands:
            match command:
                case Injection():
                    self.last_injection = command
                case SwitchSource():
                    heard, after_s = (False, 2.1) if self.deaf(self.t) else (True, 0.1)
                    self.answers.append((self.t + after_s, SourceSwitched(0, command.source, accepted=heard, answered=heard)))
                case LocaliseRequest():
                    self._localise(command)
                case Status():
                    self.statuses.append((self.t, command, self.error_m(command)))
                case _:
                    pass
        return commands

    def error_m(self, status: Status) -> float:
        return math.nan if status.place is None else wgs84.distance_m(status.place, place_of(self.p))

    def _localise(self, request: LocaliseRequest) -> None:
        frame = request.frame
        self.requests.append((self.t, request, wgs84.distance_m(request.prior.place, place_of(self.p))))
        if self.blind(self.t):
            answer: Event = NoFix(0, frame.t_ns, request.request_id, frame.frame_id, "test", self.why_blind, 5.0)
        else:
            self.seen = self.seen if self.frozen(self.t) else self.p
            measured = self.seen + np.array(self.map_error_m) + self.fix_sigma_m * self.rng.standard_normal(2)
            claimed = (self.fix_sigma_m * self.claimed_share) ** 2
            cov = ((claimed, 0.0), (0.0, claimed))
            place, q = place_of(measured), request.prior.q_ned_frd
            answer = Fix(0, frame.t_ns, request.request_id, frame.frame_id, "test", place, q, cov, 2.0, 0.05, 0.002, 5.0)
            answer = replace(answer, tilt=self.tilt)
        self.answers.append((self.t + self.latency_s, answer))

    def start(self) -> None:
        self.send(LinkChanged(0, up=True, autopilot=AutopilotKind.ARDUPILOT, system_id=1))
        self.send(OriginChanged(0, ORIGIN))

    def step(self) -> None:
        """One step of 50 ms: truth, the autopilot's filter, telemetry, frames, answers that are due, Tick every 100 ms."""
        self.k += 1
        t, dt = self.t, 0.05
        v0, v1 = np.array(self.velocity(t - dt)), np.array(self.velocity(t))
        self.p = self.p + (v0 + v1) / 2 * dt
        self.ekf_v = self.ekf_v + (v1 - v0) + np.array(self.accel_bias_mps2) * dt
        self.ekf_p = self.ekf_p + self.ekf_v * dt
        self.gnss_walk = 0.998 * self.gnss_walk + 0.05 * self.rng.standard_normal(2)
        gnss = self.p + np.array(self.pull_m(t)) + self.gnss_walk
        jammed = self.jammed(t)
        if self.source is EkfSource.GNSS and not jammed and self.k % 4 == 0:
            self._correct(gnss, 0.3)
        if self.source is EkfSource.VISION and self.last_injection is not None and self.k % 2 == 0:
            self._correct(np.array(wgs84.ned_from_geo(self.last_injection.place, ORIGIN)[:2]), 0.12)
        self._telemetry(t, gnss, jammed)
        due = [event for when, event in self.answers if when <= t + 1e-9]
        self.answers = [(when, event) for when, event in self.answers if when > t + 1e-9]
        for event in due:
            if isinstance(event, SourceSwitched) and event.accepted:
                self.source = event.source
            self.send(replace(event, t_rx_ns=ns(t)))
        if self.k % round(self.fix_period_s / dt) == 0 and self.camera(t):
            self.send(FrameRef(ns(t), ns(t), self.k, self.k % 3, 640, 480, 1))
        if self.k % 2 == 0:
            self.send(Tick(ns(t)))

    def _correct(self, measured: np.ndarray, gain: float) -> None:
        innovation = measured - self.ekf_p
        if np.hypot(*innovation) > 15:  # an autopilot resets its position after a jump, not its velocity
            self.ekf_p = measured
            return
        self.ekf_p = self.ekf_p + gain * innovation
        self.ekf_v = self.ekf_v + 0.3 * gain * innovation

    def _telemetry(self, t: float, gnss: np.ndarray, jammed: bool) -> None:
        now, boot = ns(t), ns(t) - BOOT_OFFSET_NS + ns(1000)
        false = self.false_velocity_mps(t)
        v = (float(self.ekf_v[0]) + false[0], float(self.ekf_v[1]) + false[1], 0.0)
        self.send(Attitude(now, boot, (1.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0)))
        if self.k % 2 == 0:
            self.send(PriorPose(now, boot, place_of(self.ekf_p), v, self.height_m(t)))
        if self.k % 4 == 0:
            fix, sats = (1, 3) if jammed else (3, 14)
            self.send(Gnss(now, boot, fix, sats, place_of(gnss), 1.0, 1.5, None))
        if self.k % 10 == 0:
            ratio = 0.2 if self.unused(t, self.source) else 0.2 + 0.01 * (self.k % 7)  # another one with each position fused
            self.send(EstimatorStatus(now, ratio, 0.2, 0.2, horizontal_position_ok=True, gnss_glitch=False, gnss_in_use=None))

    def fly(self, until_s: float) -> World:
        while self.t < until_s:
            self.step()
        return self

    def first(self, kind: type, since_s: float = 0.0, **fields: object) -> float:
        """Time of the first command of a type with such fields."""
        for t, command in self.commands:
            if t >= since_s and isinstance(command, kind) and all(getattr(command, k) == v for k, v in fields.items()):
                return t
        return math.inf

    def notices(self, part: str) -> list[float]:
        return [t for t, c in self.commands if isinstance(c, Notice) and part in c.text]

    def status_at(self, t_s: float) -> tuple[Status, float]:
        _, status, error = min(self.statuses, key=lambda item: abs(item[0] - t_s))
        return status, error


@pytest.fixture
def world() -> type[World]:
    """The class, so that a test sets its faults."""
    return World
