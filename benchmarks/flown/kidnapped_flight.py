"""A flight that begins somewhere over a map, without GNSS and without a first position: the navigator and its localiser only.

The autopilot knows attitude (a compass off by some degrees for good), height (off by metres) and a velocity that is off by about
1 m/s and that it does not trust itself; its position is nonsense. Frames are rendered only when they are asked for. An answer
takes as long as the localiser computed on one core (CPU time, stated for a quiet computer or one that is named: pace.py), so the
time that is needed holds for such a core.
"""

from __future__ import annotations

import math
import time
from dataclasses import dataclass, field, replace

import numpy as np

from benchmarks.machine.pace import Pace
from visloc_companion.core.navigator import Navigator
from visloc_companion.core.places.place_search import MOST_WRONG
from visloc_companion.core.settings import CoreSettings
from visloc_companion.geo.se3 import body_rates, quat_from_euler
from visloc_companion.geo.wgs84 import distance_m, geo_from_ned
from visloc_companion.protocols import Localiser, ReferenceMap
from visloc_companion.sim.render import CameraSimulator
from visloc_companion.types import (
    Attitude,
    AutopilotKind,
    CameraModel,
    EstimatorStatus,
    Event,
    Fix,
    FrameRef,
    GeoPoint,
    Gnss,
    LinkChanged,
    LocaliseRequest,
    NoFix,
    Notice,
    OriginChanged,
    PriorPose,
    Quat,
    Status,
    Tick,
    Vec2,
    Vec3,
)

STEP_S, FRAME_EVERY, TICK_EVERY = 0.05, 4, 2
BOOT_NS = 1_000_000_000_000
LEAST_LATENCY_S, TRANSFER_S = 0.02, 0.03
SIGMA_V_MPS, SIGMA_H_M, SIGMA_TILT_RAD, SIGMA_YAW_RAD = 1.0, 3.0, math.radians(0.5), math.radians(3.0)
SWAY_RAD = math.radians(2.0)


@dataclass(frozen=True, slots=True)
class Way:
    """Where the vehicle begins, its course (radians), speed, rate of turn (radians a second), and the EKF origin."""

    start: GeoPoint
    course_rad: float
    speed_mps: float
    turn_radps: float
    origin: GeoPoint

    def at(self, t_s: float) -> tuple[GeoPoint, float, Vec2]:
        """Place, course and velocity (north, east) at a time."""
        c0, w, v = self.course_rad, self.turn_radps, self.speed_mps
        course = c0 + w * t_s
        if abs(w) < 1e-6:
            north, east = v * t_s * math.cos(c0), v * t_s * math.sin(c0)
        else:
            north, east = v / w * (math.sin(course) - math.sin(c0)), v / w * (math.cos(c0) - math.cos(course))
        return geo_from_ned((north, east, 0.0), self.start), course, (v * math.cos(course), v * math.sin(course))


@dataclass(slots=True)
class Outcome:
    """How a flight ended: when the navigator was anchored (s), how far off (m), and what the answers cost (CPU ms).

    `elsewhere` counts the tests about places where the vehicle is not, `mistaken` those of them that gave a fix which counts,
    `false_listed` the tiles that gave a fix which would count, elsewhere than where the vehicle is; `slower` by what factor the
    computer was slower than the one that times are for.
    """

    anchored_s: float | None = None
    off_m: float | None = None
    tile_ms: list[float] = field(default_factory=list)
    test_ms: list[float] = field(default_factory=list)
    elsewhere: int = 0
    mistaken: int = 0
    false_listed: int = 0
    slower: list[float] = field(default_factory=list)

    def line(self) -> str:
        """For the progress of a run."""
        cpu = f"{len(self.tile_ms)} tiles {sum(self.tile_ms):.0f} ms, {len(self.test_ms)} tests {sum(self.test_ms):.0f} ms"
        cpu += f", {self.mistaken} of {self.elsewhere} mistaken"
        return f"not anchored, {cpu}" if self.off_m is None else f"{self.anchored_s:.1f} s, {self.off_m:.1f} m off, {cpu}"


class KidnappedFlight:
    """One flight; `far_m`: searches with a larger 1-sigma are those of tiles."""

    def __init__(
        self,
        way: Way,
        camera: CameraSimulator,
        model: CameraModel,
        localiser: Localiser,
        reference: ReferenceMap,
        seed: int,
        far_m: float,
        pace: Pace,
    ) -> None:
        self._way, self._camera, self._model = way, camera, model
        self._localiser, self._reference, self._seed, self._far_m = localiser, reference, seed, far_m
        self._pace = pace
        rng = np.random.default_rng(seed)
        self._v_off, self._h_off = rng.normal(0, SIGMA_V_MPS, 2), float(rng.normal(0, SIGMA_H_M))
        self._yaw_off = float(rng.normal(0, SIGMA_YAW_RAD))
        self._tilt_off = rng.normal(0, SIGMA_TILT_RAD, 2)
        self._sway = rng.uniform(0, 2 * math.pi, 2)
        self._navigator = Navigator(CoreSettings())
        self._answers: list[tuple[float, Fix | NoFix]] = []
        self._t_s = 0.0
        self.outcome = Outcome()

    def fly(self, limit_s: float) -> Outcome:
        """Until the navigator is anchored, or for so long."""
        self._send(LinkChanged(0, up=True, autopilot=AutopilotKind.ARDUPILOT, system_id=1, armed=True))
        self._send(OriginChanged(0, self._way.origin))
        for k in range(1, round(limit_s / STEP_S) + 1):
            self._t_s = k * STEP_S
            self._telemetry(k)
            due = [answer for when, answer in self._answers if when <= self._t_s]
            self._answers = [item for item in self._answers if item[0] > self._t_s]
            for answer in due:
                self._send(replace(answer, t_rx_ns=_ns(self._t_s)))
            if k % FRAME_EVERY == 0:
                self._send(FrameRef(_ns(self._t_s), _ns(self._t_s), k, 0, self._model.width_px, self._model.height_px, 3))
            if k % TICK_EVERY == 0:
                self._send(Tick(_ns(self._t_s)))
            if self.outcome.off_m is not None:
                break
        return self.outcome

    def _attitude(self, t_s: float, course_rad: float) -> tuple[float, float, float]:
        """True roll, pitch, yaw."""
        roll, pitch = (SWAY_RAD * math.sin(t_s / 1.7 + phase) for phase in self._sway)
        return roll, pitch, course_rad

    def _rates(self, t_s: float, course_rad: float) -> Vec3:
        """True body rates, radians a second: without them the autopilot's own turning would look like a pull on its compass."""
        turned = self._way.turn_radps * STEP_S / 2
        before = quat_from_euler(*self._attitude(t_s - STEP_S / 2, course_rad - turned))
        after = quat_from_euler(*self._attitude(t_s + STEP_S / 2, course_rad + turned))
        return body_rates(before, after, STEP_S)

    def _believed(self, t_s: float, course_rad: float) -> Quat:
        roll, pitch, yaw = self._attitude(t_s, course_rad)
        return quat_from_euler(roll + self._tilt_off[0], pitch + self._tilt_off[1], yaw + self._yaw_off)

    def _telemetry(self, k: int) -> None:
        now, boot = _ns(self._t_s), _ns(self._t_s) + BOOT_NS
        place, course, (north, east) = self._way.at(self._t_s)
        self._send(Attitude(now, boot, self._believed(self._t_s, course), self._rates(self._t_s, course)))
        if k % TICK_EVERY == 0:
            v = (north + float(self._v_off[0]), east + float(self._v_off[1]), 0.0)
            h_m = place.h_amsl_m + self._h_off
            self._send(PriorPose(now, boot, replace(self._way.origin, h_amsl_m=h_m), v, h_m - self._way.origin.h_amsl_m))
        if k % FRAME_EVERY == 0:
            self._send(Gnss(now, boot, 1, 0, self._way.origin, None, None, None))
            self._send(EstimatorStatus(now, None, None, None, horizontal_position_ok=False, gnss_glitch=False, gnss_in_use=None))

    def _send(self, event: Event) -> None:
        for command in self._navigator.on(event, _ns(self._t_s)):
            if isinstance(command, LocaliseRequest):
                self._ask(command)
            elif isinstance(command, Notice) and "position found" in command.text:
                self.outcome.anchored_s = self._t_s
            elif isinstance(command, Status) and command.place is not None and self.outcome.off_m is None:
                self.outcome.off_m = distance_m(command.place, self._way.at(self._t_s)[0])

    def _ask(self, request: LocaliseRequest) -> None:
        t_s = request.frame.t_ns * 1e-9
        place, course, _ = self._way.at(t_s)
        pixels = self._camera.frame(
            place, quat_from_euler(*self._attitude(t_s, course)), self._seed * 1000 + request.frame.frame_id
        )
        started = time.process_time()
        answer = self._localiser.localise(request, pixels, self._reference)
        took_s = time.process_time() - started
        self._pace.measure()
        slower = self._pace.slower()
        took_s /= slower
        self.outcome.slower.append(slower)
        is_tile = math.sqrt(request.prior.cov_ne_m2[0][0]) > self._far_m
        (self.outcome.tile_ms if is_tile else self.outcome.test_ms).append(1e3 * took_s)
        if self.outcome.anchored_s is None:  # what is asked from then on is about the filter's own place
            self._count(request, answer, place, is_tile)
        self._answers.append((self._t_s + TRANSFER_S + max(LEAST_LATENCY_S, took_s), answer))

    def _count(self, request: LocaliseRequest, answer: Fix | NoFix, truth: GeoPoint, is_tile: bool) -> None:
        """Note an answer about a place where the vehicle is not. A search that finds it all the same is no mistake."""
        reach_m = 3 * math.sqrt(max(request.prior.cov_ne_m2[0][0], request.prior.cov_ne_m2[1][1]))
        counts = isinstance(answer, Fix) and answer.probability_wrong <= MOST_WRONG
        if is_tile:
            self.outcome.false_listed += isinstance(answer, Fix) and counts and distance_m(answer.place, truth) > self._far_m
        elif distance_m(request.prior.place, truth) > 1.5 * reach_m:
            self.outcome.elsewhere += 1
            self.outcome.mistaken += counts


def _ns(t_s: float) -> int:
    return round(t_s * 1e9)
