"""The events of a flight as a companion computer hears them, for `benchmarks.navigator`: no pictures, every stream at its rate.

A vehicle circles at 10 m/s, 100 m up. GNSS is jammed after a minute and stays so: the navigator injects for the rest, on image
fixes at its own rate, structure fixes in between, and the camera's motion with every answer. Or it is never jammed: then each fix
is held against it.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field, replace

import numpy as np

from visloc_companion.errors import Reason
from visloc_companion.geo import wgs84
from visloc_companion.types import (
    Attitude,
    AutopilotKind,
    Baro,
    Command,
    EstimatorStatus,
    Event,
    Fix,
    FrameRef,
    GeoPoint,
    Gnss,
    GnssTime,
    LinkChanged,
    LocaliseRequest,
    LocalPose,
    NoFix,
    Odometry,
    OriginChanged,
    PriorPose,
    Tick,
    TimesyncSample,
    Vec3,
)

ORIGIN = GeoPoint(59.3, 18.1, 40.0)
HEIGHT_M, SPEED_MPS, RADIUS_M = 100.0, 10.0, 500.0
STEP_MS, BOOT_MS, LATENCY_MS = 20, 5_000, 250
JAMMED_S = 60.0
LEVEL = (1.0, 0.0, 0.0, 0.0)
FIX_SIGMA_M, STRUCTURE_EVERY, REFUSED_SHARE = 0.8, 10, 0.05


def events(seconds: float, jammed_s: float = JAMMED_S) -> Iterator[tuple[int, Event]]:
    """Telemetry, frames and ticks, each with its time of arrival (ns); answers to requests come from `Answers`. GNSS is jammed
    from a time on."""
    yield 0, LinkChanged(0, True, AutopilotKind.ARDUPILOT, "4.6.3", 1, armed=True)
    yield 1, OriginChanged(1, ORIGIN)
    for t_ms in range(BOOT_MS, BOOT_MS + round(seconds * 1e3), STEP_MS):
        for event in _at(t_ms, jammed_s):
            yield t_ms * 1_000_000, event


def _at(t_ms: int, jammed_s: float) -> Iterator[Event]:
    t, boot, t_s = t_ms * 1_000_000, (t_ms - BOOT_MS + 1) * 1_000_000, t_ms / 1e3
    yield Attitude(t, boot, LEVEL, (0.0, 0.0, SPEED_MPS / RADIUS_M))
    north, east, v = *_place(t_s), _velocity(t_s)
    if t_ms % 100 == 0:
        yield PriorPose(t, boot, _geo(north, east), v, HEIGHT_M)
        yield LocalPose(t, boot, (north, east, -HEIGHT_M), v)
        yield FrameRef(t, t - 30_000_000, t_ms, (t_ms // 100) % 3, 640, 480, 1)
    if t_ms % 200 == 0:
        jammed = t_s > jammed_s
        yield Gnss(t, boot, 1 if jammed else 3, 3 if jammed else 14, _geo(north, east), None if jammed else 0.9, 1.2, v)
    if t_ms % 500 == 0:
        yield EstimatorStatus(t, 0.1, 0.1, 0.1, True, False, None)
    if t_ms % 260 == 0:
        yield TimesyncSample(t, t - 3_000_000, boot - 1_500_000)
    if t_ms % 1000 == 0:
        yield Baro(t, boot, 1000.0, 15.0)
        yield GnssTime(t, boot, t + 1_800_000_000_000_000_000)
    if t_ms % 100 == 0:
        yield Tick(t)


@dataclass(slots=True)
class Answers:
    """The worker: answers come `LATENCY_MS` after their requests."""

    rng: np.random.Generator = field(default_factory=lambda: np.random.default_rng(1))
    due: list[tuple[int, Fix | NoFix]] = field(default_factory=list)
    keyframe_ns: int = 0

    def ask(self, now_ns: int, commands: list[Command]) -> None:
        """Take the requests among the commands."""
        for command in commands:
            if isinstance(command, LocaliseRequest):
                self.due.append((now_ns + LATENCY_MS * 1_000_000, self._answer(command)))

    def until(self, now_ns: int) -> Iterator[tuple[int, Fix | NoFix]]:
        """The answers that have arrived by now."""
        while self.due and self.due[0][0] <= now_ns:
            at_ns, answer = self.due.pop(0)
            yield at_ns, replace(answer, t_rx_ns=at_ns)

    def _answer(self, request: LocaliseRequest) -> Fix | NoFix:
        frame = request.frame
        motion = self._motion(frame.t_ns)
        if self.rng.random() < REFUSED_SHARE:
            named = (request.request_id, frame.frame_id, "deep")
            return NoFix(0, frame.t_ns, *named, Reason.NO_MATCH, 120.0, motion=motion)
        north, east = np.array(_place(frame.t_ns * 1e-9)) + FIX_SIGMA_M * self.rng.standard_normal(2)
        method = "structure" if request.request_id % STRUCTURE_EVERY == 0 else "deep"
        cov, place = ((FIX_SIGMA_M**2, 0.0), (0.0, FIX_SIGMA_M**2)), _geo(float(north), float(east))
        claim = float(10 ** self.rng.uniform(-4, -2))
        named = (request.request_id, frame.frame_id, method)
        return Fix(0, frame.t_ns, *named, place, LEVEL, cov, 2.0, 0.02, claim, 120.0, motion=motion)

    def _motion(self, t_ns: int) -> Odometry | None:
        since_ns = self.keyframe_ns
        if t_ns - since_ns > 2_000_000_000:
            self.keyframe_ns = t_ns
        if since_ns == 0 or since_ns >= t_ns:
            return None
        moved = np.array(_place(t_ns * 1e-9)) - np.array(_place(since_ns * 1e-9)) + 0.1 * self.rng.standard_normal(2)
        cov = ((0.02, 0.0), (0.0, 0.02))
        return Odometry(t_ns, since_ns, t_ns, (float(moved[0]), float(moved[1]), 0.0), cov, 0.01, 0.01, 0.9, "flow")


def _place(t_s: float) -> tuple[float, float]:
    angle = SPEED_MPS * t_s / RADIUS_M
    return RADIUS_M * math.sin(angle), RADIUS_M * (1 - math.cos(angle))


def _velocity(t_s: float) -> Vec3:
    """What the autopilot says: true, and an error that changes slowly."""
    angle, error = SPEED_MPS * t_s / RADIUS_M, 0.3 * math.sin(t_s / 20)
    return SPEED_MPS * math.cos(angle) + error, SPEED_MPS * math.sin(angle) - error, 0.0


def _geo(north_m: float, east_m: float) -> GeoPoint:
    return wgs84.geo_from_ned((north_m, east_m, -HEIGHT_M), ORIGIN)
