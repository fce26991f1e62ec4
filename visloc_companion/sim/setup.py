"""From a scenario and a place to a flight: the mission that fits the map, the camera, and the built-in autopilot."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Literal

from visloc_companion.errors import MapError
from visloc_companion.geo.pinhole_view import pinhole_view
from visloc_companion.sim.autopilot import BuiltInAutopilot
from visloc_companion.sim.scenarios import Course, Scenario
from visloc_companion.sim.vehicles.rangefinder import Rangefinder
from visloc_companion.types import AutopilotKind, CameraModel, GeoPoint, Vec3

VehicleKind = Literal["copter", "plane"]
WIND_NED_MPS: Vec3 = (2.0, -4.0, 0.0)
SPEED_MPS: dict[VehicleKind, float] = {"copter": 10.0, "plane": 25.0}
LEAST_HALF_M = 60.0
ZIG_M, ZAG_M, BEYOND_M = 35.0, 30.0, 130.0
FIELD_OF_VIEW_RAD = math.radians(60.0)
LONGEST_WAY_M = 6000.0
"""More than a plane flies in 190 s with the wind."""


def _loop(half_m: float, reach_m: float) -> list[tuple[float, float]]:
    """A bent loop about home."""
    del reach_m
    return [
        (half_m, -0.6 * half_m),
        (0.8 * half_m, half_m),
        (-0.2 * half_m, 0.5 * half_m),
        (-half_m, 0.9 * half_m),
        (-0.7 * half_m, -half_m),
    ]


def _zigzag(half_m: float, reach_m: float) -> list[tuple[float, float]]:
    """Legs of 70 m with turns of 120 degrees, southwards along the middle."""
    del reach_m
    turns = max(3, int(1.8 * half_m / ZIG_M))
    return [(0.9 * half_m - k * ZIG_M, ZAG_M if k % 2 else -ZAG_M) for k in range(turns)]


def _over_the_edge(half_m: float, reach_m: float) -> list[tuple[float, float]]:
    """Straight out over the northern edge, and back 40 m beside."""
    del half_m
    inside, outside = max(0.0, reach_m - 300.0), reach_m + BEYOND_M
    return [(inside, 0.0), (outside, 0.0), (outside, 40.0), (inside, 40.0)]


def _out_to_sea(half_m: float, reach_m: float) -> list[tuple[float, float]]:
    """Along the southern edge, then rounds in the north, so many that no vehicle comes back to the first leg."""
    del reach_m
    south_m = 0.4 * half_m
    lap = [(half_m, half_m), (half_m, -half_m), (south_m, -half_m), (south_m, half_m)]
    length_m = 2 * (2 * half_m + half_m - south_m)
    return [(-half_m, -half_m), (-half_m, half_m)] + math.ceil(LONGEST_WAY_M / length_m) * lap


COURSES: dict[Course, Callable[[float, float], list[tuple[float, float]]]] = {
    "loop": _loop,
    "zigzag": _zigzag,
    "over_the_edge": _over_the_edge,
    "out_to_sea": _out_to_sea,
}
"""Ways (north, east of home, metres, of an area that is not turned) from the half width that keeps the footprint on the map, and
from the map's reach."""


@dataclass(frozen=True, slots=True)
class FlightArea:
    """Where a flight takes place: home on the ground in the middle, how far the map reaches, and its ground sample distance.

    `reach_m` is the distance from home to the nearest edge of the map and of the camera's scene, along the course's axes, which
    are turned by `turn_rad` clockwise from north and east where the map itself is turned (evaluate.flight_area).
    """

    home: GeoPoint
    reach_m: float
    gsd_m: float
    turn_rad: float = 0.0


@dataclass(frozen=True, slots=True)
class FlightSetup:
    """Everything that makes a flight repeatable. `structure`: whether that vote is asked for where the image fails.

    `width_px`: the columns of a pinhole camera; a coarse one is rendered sooner. `camera`: another one in its place.
    `rangefinder`: one that odometry is to use. `speed_mps`: another one than the vehicle's usual (SPEED_MPS).
    """

    scenario: Scenario
    area: FlightArea
    kind: AutopilotKind
    vehicle: VehicleKind
    seed: int
    height_asked_m: float | None = None
    structure: bool = True
    width_px: int = 640
    camera: CameraModel | None = None
    rangefinder: Rangefinder | None = None
    speed_mps: float | None = None

    @property
    def height_m(self) -> float:
        """Height above home: as asked; else the scenario's; else low where the map is fine, and 170 pixels of a coarse one to a
        frame."""
        return self.height_asked_m or self.scenario.height_m or max(120.0, 150.0 * self.area.gsd_m)

    @property
    def judged_as(self) -> Scenario:
        """The scenario with what is expected of this vehicle."""
        plane = self.vehicle == "plane"
        return replace(self.scenario, expected=self.scenario.expected.of_a_plane) if plane else self.scenario

    def camera_model(self) -> CameraModel:
        """As the daemon believes the camera to be: 640 x 480 pixels (or a coarser 4:3) over 60 degrees, or what was asked for."""
        if self.camera is not None:
            return self.camera
        width, height = self.width_px, self.width_px * 3 // 4
        focal_px = width / 2 / math.tan(FIELD_OF_VIEW_RAD / 2)
        return CameraModel(width, height, focal_px, focal_px, (width - 1) / 2, (height - 1) / 2)

    def mission_ned_m(self) -> tuple[Vec3, ...]:
        """The scenario's course (NED about home), which keeps the camera's footprint on the map or leaves it on purpose.

        Raises MapError where the map is too small.
        """
        view = pinhole_view(self.camera_model())
        footprint_m = self.height_m * view.width_px / 2 / view.fx_px
        half_m = min(400.0, 0.9 * (self.area.reach_m - 1.3 * footprint_m))
        if half_m < LEAST_HALF_M:
            needed_m = LEAST_HALF_M / 0.9 + 1.3 * footprint_m
            raise MapError(
                f"map and scene reach {self.area.reach_m:.0f} m from the middle, "
                f"too little for a flight {self.height_m:.0f} m above",
                remedy=f"give a map and an orthophoto that reach {needed_m:.0f} m in every direction",
            )
        s, c = math.sin(self.area.turn_rad), math.cos(self.area.turn_rad)
        course = COURSES[self.scenario.course](half_m, self.area.reach_m)
        return tuple((c * ahead - s * right, s * ahead + c * right, -self.height_m) for ahead, right in course)

    def autopilot(self, boot_age_s: float = 0.0) -> BuiltInAutopilot:
        """The vehicle at its first waypoint, in the air. Raises MapError where the map is too small."""
        return BuiltInAutopilot(
            self.kind,
            self.vehicle,
            self.area.home,
            self.mission_ned_m(),
            self.speed_mps or SPEED_MPS[self.vehicle],
            self.seed,
            self.scenario.faults,
            WIND_NED_MPS,
            boot_age_s=boot_age_s,
            rangefinder=self.rangefinder,
            gimbal=self.scenario.gimbal,
        )
