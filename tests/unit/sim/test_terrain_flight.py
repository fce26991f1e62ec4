"""A copter over hills, jammed after dusk: the ground below its track holds its position; without that it drifts and must land."""

from __future__ import annotations

import numpy as np
import pytest

from visloc_companion.adapters.mavlink.session import MavlinkSession
from visloc_companion.adapters.mavlink.settings import SessionSettings
from visloc_companion.app.replay import command_lines, recorded_commands, replay_entries
from visloc_companion.app.terrain import configured_terrain
from visloc_companion.config import LocaliserConfig
from visloc_companion.core.navigator import Navigator
from visloc_companion.core.settings import CoreSettings, InjectionSettings, NavigatorSettings
from visloc_companion.core.terrain_aiding import METHOD
from visloc_companion.errors import Reason
from visloc_companion.geo.wgs84 import distance_m
from visloc_companion.protocols import ReferenceMap
from visloc_companion.sim import faults
from visloc_companion.sim.autopilot import BuiltInAutopilot
from visloc_companion.sim.flight import ClosedLoopFlight, Eyes, FlightLog
from visloc_companion.sim.rangefinder import Rangefinder
from visloc_companion.testing.hills import HillyMap
from visloc_companion.types import (
    AutopilotKind,
    CameraModel,
    Fix,
    GeoPoint,
    Image,
    LocaliseRequest,
    NoFix,
    Quat,
    Status,
    TerrainRequest,
)

HOME = GeoPoint(47.4, 8.55, 480.0)
MISSION = ((-3500.0, -1500.0, -300.0), (3500.0, -1500.0, -300.0), (3500.0, 1500.0, -300.0))
DUSK_S, JAM_S, END_S = 10.0, 15.0, 160.0
ONE_M = ((1.0, 0.0), (0.0, 1.0))


class Darkness:
    """A camera and a localiser that knows the place until dusk, and then nothing."""

    model = CameraModel(64, 48, 50.0, 50.0, 31.5, 23.5)
    method = "eye"

    def __init__(self, pilot: BuiltInAutopilot) -> None:
        self._pilot = pilot

    def render(self, place: GeoPoint, q_ned_frd: Quat, frame_id: int) -> Image:
        return np.zeros((48, 64), np.uint8)

    def localise(self, request: LocaliseRequest, pixels: Image, ref: ReferenceMap) -> Fix | NoFix:
        frame, truth = request.frame, self._pilot.truth()
        about = (frame.t_rx_ns, frame.t_ns, request.request_id, frame.frame_id, self.method)
        if self._pilot.t_s > DUSK_S:
            return NoFix(*about, Reason.LOW_TEXTURE, 1.0)
        return Fix(*about, truth.place, truth.q_ned_frd, ONE_M, 1.0, 0.1, 1e-3, 1.0)


def fly(settings: CoreSettings) -> FlightLog:
    hills = HillyMap(HOME, 6000.0, 80.0)
    sensor = Rangefinder(lambda place: hills.height_amsl_m(*hills.to_map(place.lat_deg, place.lon_deg)), max_m=600.0)
    pilot = BuiltInAutopilot(
        AutopilotKind.ARDUPILOT, "copter", HOME, MISSION, 18.0, 1, faults.jam(JAM_S), (2.0, -4.0, 0.0), rangefinder=sensor
    )
    dark = Darkness(pilot)
    terrain = configured_terrain(LocaliserConfig(terrain=True, terrain_sigma_m=1.0), hills)
    eyes = Eyes(dark, dark, hills, 2.0, terrain=terrain)  # type: ignore[arg-type]
    return ClosedLoopFlight(pilot, Navigator(settings), MavlinkSession(SessionSettings()), eyes).run(END_S)


def settings(terrain: bool) -> CoreSettings:
    navigator = NavigatorSettings(lost_sigma_m=150.0)
    return CoreSettings(navigator=navigator, injection=InjectionSettings(switch_source=True), terrain=terrain)


def errors_m(log: FlightLog) -> np.ndarray:
    """(N, 2): seconds since the start, and how far the stated position is off then, after the jam."""
    truth = {sample.t_ns // 50_000_000: sample.place for sample in log.truth}
    stated = [e.command for e in log.entries if isinstance(e.command, Status) and e.command.place is not None]
    start_ns = log.truth[0].t_ns
    rows = [
        ((s.t_ns - start_ns) * 1e-9, distance_m(s.place, truth[s.t_ns // 50_000_000]))
        for s in stated
        if s.t_ns // 50_000_000 in truth and s.place is not None
    ]
    every = np.array(rows)
    return every[every[:, 0] > JAM_S]


@pytest.fixture(scope="module")
def by_terrain() -> FlightLog:
    return fly(settings(terrain=True))


def test_terrain_holds_the_position_and_without_it_the_position_drifts_until_the_copter_lands(by_terrain: FlightLog) -> None:
    alone = fly(settings(terrain=False))
    held, drifting = errors_m(by_terrain), errors_m(alone)
    assert held[:, 1].max() < 80
    assert np.median(held[:, 1]) < 40
    assert by_terrain.failsafe is None
    assert drifting[-1, 1] > 1.5 * held[:, 1].max()
    assert alone.failsafe is not None


def test_the_fixes_are_near_the_truth_and_say_how_near(by_terrain: FlightLog) -> None:
    truth = {sample.t_ns // 100_000_000: sample.place for sample in by_terrain.truth}
    fixes = [e.event for e in by_terrain.entries if isinstance(e.event, Fix) and e.event.method == METHOD]
    assert len(fixes) >= 2
    for fix in fixes:
        off_m = distance_m(fix.place, truth[fix.t_ns // 100_000_000])
        assert off_m < 20
        assert off_m**2 < 9.2 * (fix.cov_ne_m2[0][0] + fix.cov_ne_m2[1][1])


def test_a_replay_of_the_journal_asks_and_says_the_same(by_terrain: FlightLog) -> None:
    recorded = list(command_lines(recorded_commands(by_terrain.entries)))
    assert any(isinstance(e.command, TerrainRequest) for e in by_terrain.entries)
    assert list(command_lines(replay_entries(by_terrain.entries, settings(terrain=True)))) == recorded
