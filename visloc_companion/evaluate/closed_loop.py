"""Closed-loop flights over a pack, flown in this process: set up, fly with and without the daemon's part, judge."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from visloc_companion.adapters.mavlink.session import MavlinkSession
from visloc_companion.adapters.mavlink.settings import SessionSettings
from visloc_companion.app.journal import Entry
from visloc_companion.app.localiser import configured_localiser
from visloc_companion.app.settings import core_settings
from visloc_companion.config import DEFAULT_METHOD, Config, InjectionConfig, LocaliserConfig, NavigatorConfig
from visloc_companion.config_camera import CameraConfig
from visloc_companion.errors import MapError
from visloc_companion.evaluate.expected import ALERT_LIMIT_M, checks_of
from visloc_companion.evaluate.flight_area import flight_area
from visloc_companion.evaluate.gate import Check
from visloc_companion.evaluate.metrics import Interval, flight_summary
from visloc_companion.evaluate.record import FlightRecord, from_entries
from visloc_companion.evaluate.sim_journal import JournalChoice, flight_journal, journalled_config
from visloc_companion.maps.pack import PackMap
from visloc_companion.protocols import Localiser
from visloc_companion.sim.flight import CLOCK_OFFSET_NS, ClosedLoopFlight, Eyes, FlightLog, OperatorEntry
from visloc_companion.sim.scenarios import Scenario
from visloc_companion.sim.scene import Scene
from visloc_companion.sim.seen import simulated_camera
from visloc_companion.sim.setup import FlightArea, FlightSetup
from visloc_companion.types import GeoPoint

OPERATOR_SIGMA_M = 20.0


__all__ = ["ALERT_LIMIT_M", "FlightWorld", "FlownScenario", "fly", "fly_with", "judged"]


@dataclass(frozen=True, slots=True, eq=False)
class FlightWorld:
    """The map that the navigator has, and the scene that its camera sees: another date of the same place."""

    pack: Path
    reference: PackMap
    scene: Scene

    def area(self) -> FlightArea:
        """Home on the map's surface in the middle, and how far map and scene reach around it.

        Raises MapError where the middle has no height, the scene does not show it, or it is 0°, 0°.
        """
        easting, northing = self.reference.center_map_m
        lat, lon = self.reference.to_geo(easting, northing)
        if round(lat * 1e7) == round(lon * 1e7) == 0:
            why = "has its middle at latitude 0, longitude 0, by which autopilots say that they know no position"
            raise MapError(why, where=str(self.pack), remedy="fly over a map whose middle is a metre beside")
        height = self.reference.height_amsl_m(easting, northing)
        if not np.isfinite(height):
            raise MapError("has no surface height in its middle", where=str(self.pack), remedy="give a pack without a hole there")
        home = GeoPoint(lat, lon, float(height))
        seen_m = self.scene.reach_m(home)
        if seen_m <= 0:
            raise MapError(
                f"lies {-seen_m:.0f} m beyond what the camera is to see",
                where=f"the middle of {self.pack}",
                remedy="give --camera-ortho of the same place as --map",
            )
        return flight_area(self.reference, self.scene, home)


@dataclass(frozen=True, slots=True, eq=False)
class FlownScenario:
    """A flight and what it showed."""

    setup: FlightSetup
    log: FlightLog
    record: FlightRecord
    summary: dict[str, Any]
    checks: list[Check]

    @property
    def passed(self) -> bool:
        """Whether all that the scenario expects came out."""
        return all(check.passed for check in self.checks)


def fly(
    setup: FlightSetup,
    world: FlightWorld,
    *,
    method: str = DEFAULT_METHOD,
    with_daemon: bool = True,
    on_progress: Callable[[float], None] | None = None,
    kept: JournalChoice | None = None,
) -> FlownScenario:
    """Fly one scenario in simulated time over a world; `kept`: the journal to write. Raises MapError, ConfigError, JournalError.

    Without the daemon only the autopilot flies, nothing is expected, and there is no journal.
    """
    eyes = eyes_over(setup, world, method) if with_daemon else None
    if eyes is None or kept is None:
        return fly_with(setup, eyes, on_progress)
    config = journalled_config(simulated_config(setup), eyes.camera.model, world.pack, method)
    with flight_journal(kept.path, config, frames=kept.frames) as journal:
        return fly_with(setup, replace(eyes, on_pixels=journal.pixels), on_progress, journal.entry)


def fly_with(
    setup: FlightSetup,
    eyes: Eyes | None,
    on_progress: Callable[[float], None] | None = None,
    on_entry: Callable[[Entry], None] | None = None,
) -> FlownScenario:
    """Fly one scenario with these eyes; with None nobody helps the autopilot, and nothing is expected. `on_entry` is told every
    event and command of the navigator."""
    pilot = setup.autopilot()
    if eyes is None:
        log = ClosedLoopFlight(pilot, None, None, None).run(setup.scenario.duration_s, on_progress)
        record = from_entries(log.entries, log.truth, t0_ns=CLOCK_OFFSET_NS)
        return FlownScenario(setup, log, record, flight_summary(record, alert_limit_m=ALERT_LIMIT_M), [])
    from visloc_companion.core.navigator import Navigator  # loads filterpy, as long as all else: only who flies waits

    navigator = Navigator(core_settings(simulated_config(setup)))
    session, operator = MavlinkSession(SessionSettings()), _operator(setup.scenario)
    flight = ClosedLoopFlight(pilot, navigator, session, eyes, operator=operator, on_entry=on_entry)
    log = flight.run(setup.scenario.duration_s, on_progress)
    return judged(setup, log, from_entries(log.entries, log.truth, t0_ns=CLOCK_OFFSET_NS))


def eyes_over(setup: FlightSetup, world: FlightWorld, method: str) -> Eyes:
    """The rendering camera and the localiser of a name, on the network that came with this version.

    Raises ConfigError for a name that there is not, ModelError where the network cannot be used.
    """
    camera = simulated_camera(setup, world.scene)
    chosen = LocaliserConfig(threads=1, structure=setup.structure)
    chosen = chosen.model_copy(update={"method": method})  # unchecked: the registry refuses a wrong name

    def opened() -> Localiser:
        return configured_localiser(chosen, camera.model)[0]

    return Eyes(camera, opened(), world.reference, setup.scenario.frame_rate_hz, reopen=opened)


def simulated_config(setup: FlightSetup) -> Config:
    """The configuration of the daemon on the simulated vehicle; it may switch the autopilot's source."""
    readout_s = setup.scenario.faults.optics(0.0).readout_s  # as the sensor's data sheet says
    return Config(
        camera=CameraConfig(
            mount="fixed" if setup.scenario.gimbal is None else "gimbal",
            mount_pitch_deg=math.degrees(setup.scenario.mount_pitch_rad),
            readout_ms=1e3 * readout_s,
        ),
        injection=InjectionConfig(switch_source=True),
        navigator=NavigatorConfig(map_sigma_m=map_sigma_m(setup.area.gsd_m)),
        localiser=LocaliserConfig(
            max_rate_hz=max(1.0, setup.scenario.frame_rate_hz),
            structure=setup.structure,
            rangefinder=setup.rangefinder is not None,
        ),
        seed=setup.seed,
    )


def map_sigma_m(gsd_m: float) -> float:
    """1-sigma of a map's own registration where nobody measured it: half a pixel, at least half a metre."""
    return max(0.5, 0.5 * gsd_m)


def fault_intervals(scenario: Scenario) -> list[Interval]:
    """When GNSS is really bad, seconds since the start."""
    return scenario.faults.gnss_intervals_s(scenario.duration_s)


def judged(setup: FlightSetup, log: FlightLog, record: FlightRecord) -> FlownScenario:
    """The flight's figures and the checks that its scenario asks for."""
    summary = flight_summary(record, alert_limit_m=ALERT_LIMIT_M, gnss_faults_s=fault_intervals(setup.scenario))
    return FlownScenario(setup, log, record, summary, checks_of(setup.judged_as, log, record, summary, setup.area.gsd_m))


def _operator(scenario: Scenario) -> OperatorEntry | None:
    at_s = scenario.operator_fix_at_s
    error_ned_m = (0.6 * OPERATOR_SIGMA_M, -0.5 * OPERATOR_SIGMA_M, 0.0)
    return None if at_s is None else OperatorEntry(at_s, error_ned_m, OPERATOR_SIGMA_M)
