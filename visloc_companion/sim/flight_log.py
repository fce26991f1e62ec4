"""What a simulated flight is made of beside its autopilot, and what it leaves behind."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

from visloc_companion.app.journal import Entry
from visloc_companion.app.terrain import TerrainAnswer
from visloc_companion.geo.wgs84 import distance_m
from visloc_companion.protocols import Localiser, ReferenceMap
from visloc_companion.sim.camera import SimulatedCamera
from visloc_companion.types import FrameRef, GeoPoint, Image, Vec3


@dataclass(frozen=True, slots=True)
class TruthSample:
    """Where the vehicle really was, and where the autopilot believed it to be, at `t_ns` of the navigator's clock."""

    t_ns: int
    place: GeoPoint
    believed: GeoPoint | None

    @property
    def off_m(self) -> float | None:
        """How far the autopilot's belief is from the truth, None while it has none."""
        return None if self.believed is None else distance_m(self.believed, self.place)


@dataclass(slots=True)
class FlightLog:
    """What a flight left behind."""

    entries: list[Entry] = field(default_factory=list)
    truth: list[TruthSample] = field(default_factory=list)
    failsafe: str | None = None
    pulled_m: float = 0.0
    duration_s: float = 0.0


@dataclass(frozen=True, slots=True)
class OperatorEntry:
    """At `at_s` the operator sets the EKF origin from the ground station, and soon after tells the daemon where the vehicle is.

    Both are the true place at that moment plus `error_ned_m`, the origin on home's ground; `sigma_m` is what is claimed.
    """

    at_s: float
    error_ned_m: Vec3
    sigma_m: float


@dataclass(frozen=True, slots=True)
class Eyes:
    """What the navigator sees with: the camera over the scene, the localiser, its map, and how long an answer takes.

    `reopen` makes the localiser anew, as a worker process that was restarted does; `terrain` answers questions about the
    ground below the track, where there is who can. `on_pixels` is shown each frame that is localised, as it is.
    """

    camera: SimulatedCamera
    localiser: Localiser
    reference: ReferenceMap
    rate_hz: float = 5.0
    latency_s: float = 0.15
    structure_latency_s: float = 1.0
    terrain: TerrainAnswer | None = None
    reopen: Callable[[], Localiser] | None = None
    on_pixels: Callable[[FrameRef, Image], None] | None = None
