"""Flights for `benchmarks.error_budget`: one source of error at a time, in closed loop, and the difference that it makes.

Without pictures the localiser knows the truth at the exposure and adds what is asked for; what it claims is always the same. With
pictures it is the real one, over the procedural world of two dates. GNSS is jammed from JAM_S on, errors count from COUNT_S on.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import cast

import numpy as np

from visloc_companion.adapters.mavlink.session import MavlinkSession
from visloc_companion.adapters.mavlink.settings import SessionSettings
from visloc_companion.app.settings import core_settings
from visloc_companion.config import DEFAULT_METHOD
from visloc_companion.core.navigator import Navigator
from visloc_companion.errors import Reason
from visloc_companion.evaluate.closed_loop import FlightWorld, eyes_over, simulated_config
from visloc_companion.geo import wgs84
from visloc_companion.geo.se3 import euler_from_quat
from visloc_companion.maps.pack import PackMap
from visloc_companion.prepare.world import procedural_world
from visloc_companion.protocols import ReferenceMap
from visloc_companion.sim.camera import SimulatedCamera
from visloc_companion.sim.faults import FaultSchedule, jam
from visloc_companion.sim.flight import ClosedLoopFlight, Eyes, FlightLog
from visloc_companion.sim.rendering.render_motion import STILL, Shot
from visloc_companion.sim.scenarios import Scenario
from visloc_companion.sim.scene import Scene
from visloc_companion.sim.setup import FlightArea, FlightSetup, VehicleKind
from visloc_companion.testing.hills import HillyMap
from visloc_companion.types import (
    Attitude,
    AutopilotKind,
    CameraModel,
    Command,
    Event,
    Fix,
    FloatArray,
    FrameRef,
    GeoPoint,
    Image,
    LocaliseRequest,
    NoFix,
    Quat,
    Status,
    Vec2,
)

HOME = GeoPoint(59.3, 18.1, 40.0)
JAM_S, COUNT_S, SECONDS = 40.0, 55.0, 115.0
RATE_HZ, LATENCY_S = 2.0, 0.25
HEIGHT_M = 120.0
WIDTH_PX = 320
WORLD_SEED = 1
MODEL = CameraModel(64, 48, 50.0, 50.0, 31.5, 23.5)


@dataclass(frozen=True, slots=True)
class Source:
    """What is wrong: faults of the simulation, and what stands in for those of them that need pictures."""

    faults: FaultSchedule = field(default_factory=FaultSchedule)
    map_ne_m: Vec2 = (0.0, 0.0)
    time_s: float = 0.0
    matching_m: float = 0.0
    dark_s: tuple[float, float] = (math.inf, math.inf)


@dataclass(frozen=True, slots=True, eq=False)
class Errors:
    """Of every output: time (N,), error and true velocity (N, 2) north and east; and what fixes claimed on an axis (M,), and
    their errors (M, 2); roll and pitch (A, 2) and the true horizontal acceleration (N, 2)."""

    t_s: FloatArray
    error_ne_m: FloatArray
    v_ne_mps: FloatArray
    claimed_m: FloatArray
    fix_error_ne_m: FloatArray
    lean_rad: FloatArray
    acceleration_ne_mps2: FloatArray

    def along_across(self, vectors_ne: FloatArray) -> FloatArray:
        """(N, 2) of the outputs' vectors (N, 2), turned to along and across (to the right of) the course."""
        ahead = self.v_ne_mps / np.maximum(np.hypot(*self.v_ne_mps.T), 1e-6)[:, None]
        right = np.column_stack([-ahead[:, 1], ahead[:, 0]])
        return np.column_stack([(vectors_ne * ahead).sum(1), (vectors_ne * right).sum(1)])


@dataclass(slots=True)
class KnowingEyes:
    """Camera and localiser without pictures: the truth, the source's errors, and a claim that does not depend on them."""

    source: Source
    seed: int
    claimed_m: float
    model: CameraModel = MODEL
    method: str = "deep"
    _rng: np.random.Generator = field(init=False)
    _places: dict[int, tuple[GeoPoint, Quat]] = field(default_factory=dict)
    _first_ns: int | None = None

    def __post_init__(self) -> None:
        self._rng = np.random.default_rng([self.seed, 78])

    def render(self, place: GeoPoint, q_ned_frd: Quat, frame_id: int, shot: Shot = STILL) -> Image:
        """Remembers from where the frame is."""
        self._places = {frame_id: (place, q_ned_frd)}
        return np.zeros((48, 64), np.uint8)

    def localise(self, request: LocaliseRequest, pixels: Image, ref: ReferenceMap) -> Fix | NoFix:
        """The truth, with the source's errors."""
        frame = request.frame
        self._first_ns = frame.t_ns if self._first_ns is None else self._first_ns
        about = (frame.t_rx_ns, frame.t_ns, request.request_id, frame.frame_id, self.method)
        noise = self._rng.standard_normal(2)
        if self.source.dark_s[0] <= (frame.t_ns - self._first_ns) * 1e-9 < self.source.dark_s[1]:
            return NoFix(*about, Reason.NO_MATCH, 60.0)
        place, q_ned_frd = self._places[frame.frame_id]
        north, east = np.array(self.source.map_ne_m) + self.source.matching_m * noise
        seen = wgs84.geo_from_ned((float(north), float(east), 0.0), place)
        cov = ((self.claimed_m**2, 0.0), (0.0, self.claimed_m**2))
        return Fix(*about, seen, q_ned_frd, cov, 1.5, 0.02, 1e-3, 60.0)


class Mistimed:
    """A navigator whose frames bear a wrong time."""

    def __init__(self, navigator: Navigator, late_s: float) -> None:
        self._navigator, self._late_ns = navigator, round(late_s * 1e9)

    def on(self, event: Event, now_ns: int) -> list[Command]:
        """As protocols.NavigatorLike."""
        if isinstance(event, FrameRef):
            boot_ns = None if event.t_boot_ns is None else event.t_boot_ns + self._late_ns
            event = replace(event, t_ns=event.t_ns + self._late_ns, t_boot_ns=boot_ns)
        return self._navigator.on(event, now_ns)


def without_pictures(vehicle: VehicleKind, seed: int, source: Source, claimed_m: float, seconds: float = SECONDS) -> Errors:
    """One flight with a localiser that knows the truth."""
    setup = _setup(vehicle, seed, source, FlightArea(HOME, 1000.0, 0.5), seconds)
    knowing = KnowingEyes(source, seed, claimed_m)
    ground = HillyMap(HOME, 3000.0, 1.0, seed=1)
    return _flown(setup, Eyes(cast("SimulatedCamera", knowing), knowing, ground, RATE_HZ, LATENCY_S), source)


def with_pictures(vehicle: VehicleKind, seed: int, source: Source, seconds: float = SECONDS) -> Errors:
    """One flight over the procedural world."""
    world = _world()
    setup = _setup(vehicle, seed, source, world.area(), seconds)
    eyes = replace(eyes_over(setup, world, DEFAULT_METHOD), rate_hz=RATE_HZ, latency_s=LATENCY_S)
    return _flown(setup, eyes, source)


@lru_cache(maxsize=1)
def _world() -> FlightWorld:
    made = procedural_world(WORLD_SEED)
    return FlightWorld(made.pack, PackMap.open(made.pack, verify_hashes=False), Scene.load(made.flight_ortho, made.flight_dsm))


def _setup(vehicle: VehicleKind, seed: int, source: Source, area: FlightArea, seconds: float) -> FlightSetup:
    scenario = Scenario("budget", "", seconds, jam(JAM_S) + source.faults, frame_rate_hz=RATE_HZ)
    return FlightSetup(scenario, area, AutopilotKind.ARDUPILOT, vehicle, seed, HEIGHT_M, structure=False, width_px=WIDTH_PX)


def _flown(setup: FlightSetup, eyes: Eyes, source: Source) -> Errors:
    navigator = Navigator(core_settings(simulated_config(setup)))
    heard = navigator if source.time_s == 0.0 else cast("Navigator", Mistimed(navigator, source.time_s))
    flight = ClosedLoopFlight(setup.autopilot(), heard, MavlinkSession(SessionSettings()), eyes)
    return _errors(flight.run(setup.scenario.duration_s), setup.area.home)


def _errors(log: FlightLog, home: GeoPoint) -> Errors:
    t0_ns = log.truth[0].t_ns
    truth_s = np.array([sample.t_ns - t0_ns for sample in log.truth]) * 1e-9
    truth_m = np.array([wgs84.ned_from_geo(sample.place, home)[:2] for sample in log.truth])
    v_mps = np.gradient(truth_m, truth_s, axis=0)
    a_mps2 = np.gradient(v_mps, truth_s, axis=0)
    stated = [e.command for e in log.entries if isinstance(e.command, Status) and (e.command.t_ns - t0_ns) * 1e-9 >= COUNT_S]
    t_s = np.array([(s.t_ns - t0_ns) * 1e-9 for s in stated])
    ours = np.array([(math.nan, math.nan) if s.place is None else wgs84.ned_from_geo(s.place, home)[:2] for s in stated])
    events = [e.event for e in log.entries if e.event is not None and (e.now_ns - t0_ns) * 1e-9 >= COUNT_S]
    fixes = [e for e in events if isinstance(e, Fix)]
    fix_s = np.array([(fix.t_ns - t0_ns) * 1e-9 for fix in fixes])
    seen = np.array([wgs84.ned_from_geo(fix.place, home)[:2] for fix in fixes])
    return Errors(
        t_s,
        ours - _at(t_s, truth_s, truth_m),
        _at(t_s, truth_s, v_mps),
        np.array([math.sqrt((fix.cov_ne_m2[0][0] + fix.cov_ne_m2[1][1]) / 2) for fix in fixes]),
        seen - _at(fix_s, truth_s, truth_m),
        np.array([euler_from_quat(e.q_ned_frd)[:2] for e in events if isinstance(e, Attitude)]),
        _at(t_s, truth_s, a_mps2),
    )


def _at(t_s: FloatArray, sampled_s: FloatArray, values: FloatArray) -> FloatArray:
    return np.stack([np.interp(t_s, sampled_s, values[:, k]) for k in range(values.shape[1])], axis=1)
