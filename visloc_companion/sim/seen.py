"""What the camera of a flight really looks at, and how it is really mounted: the scenario's part in it."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from visloc_companion.errors import MapError
from visloc_companion.geo.raster import apply_affine, invert_affine
from visloc_companion.geo.se3 import quat_from_euler, quat_multiply
from visloc_companion.geo.wgs84 import geo_from_ned
from visloc_companion.sim.camera import SimulatedCamera
from visloc_companion.sim.changes import Change, beyond_the_map, changed, lies
from visloc_companion.sim.render import CameraSimulator
from visloc_companion.sim.rendering.render_effects import CameraEffects
from visloc_companion.sim.rendering.render_rays import Mask
from visloc_companion.sim.scene import Scene
from visloc_companion.sim.setup import BEYOND_M, FIELD_OF_VIEW_RAD, SPEED_MPS, FlightSetup
from visloc_companion.types import FloatArray, GeoPoint, Quat


def simulated_camera(setup: FlightSetup, scene: Scene) -> SimulatedCamera:
    """The camera of a flight over the scene that the map is of: with its true lens and mounting, over the ground as it is now.

    Raises MapError where the way leads into the ground.
    """
    require_clear_way(setup, scene)
    believed, error = setup.camera_model(), setup.scenario.faults.mount_error
    scale = setup.scenario.faults.focal_scale
    lens = replace(believed, fx_px=believed.fx_px * scale, fy_px=believed.fy_px * scale)
    ground, water = seen_ground(setup, scene)
    mounted = quat_multiply(mounting(setup), quat_from_euler(error.roll_rad, error.pitch_rad, error.yaw_rad))
    return SimulatedCamera(CameraSimulator(ground, lens, CameraEffects(), water), believed, mounted, seed=setup.seed)


def require_clear_way(setup: FlightSetup, scene: Scene) -> None:
    """Raises MapError where land reaches up to the way: within a hillside a camera would show a picture all the same."""
    corners = way_pix(setup, scene)
    width, height = scene.size_px
    highest_m = -math.inf
    for start, end in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        steps = 1 + int(np.abs(end - start).max())
        u, v = np.rint(np.linspace(start, end, steps)).astype(int).T
        on = (u >= 0) & (v >= 0) & (u < width) & (v < height)
        highest_m = max(highest_m, float(scene.dsm_amsl_m[v[on], u[on]].max(initial=-math.inf)))
    above_m = highest_m - setup.area.home.h_amsl_m
    if above_m >= setup.height_m:
        raise MapError(
            f"rises to {above_m:.0f} m above its middle below a way that is flown {setup.height_m:.0f} m above it",
            where="what the camera is to see",
            remedy="fly over flatter land: give a map whose middle lies higher, or a smaller one",
        )


def mounting(setup: FlightSetup) -> Quat:
    """Attitude of the camera's body in the vehicle's body, as configured."""
    return quat_from_euler(0.0, setup.scenario.mount_pitch_rad, 0.0)


def seen_ground(setup: FlightSetup, scene: Scene) -> tuple[Scene, Mask | None]:
    """The scene with all that the scenario changes, and where there is water (H, W, 255), None without any."""
    scenario = setup.scenario
    if scenario.course == "over_the_edge":
        scene = beyond_the_map(scene, BEYOND_M + 2 * setup.height_m * float(np.tan(FIELD_OF_VIEW_RAD)))
    water: Mask | None = None
    for change in (met_in_time(change, setup) for change in scenario.changes):
        way = way_pix(setup, scene)
        scene = changed(scene, change, way, setup.seed)
        if change.kind == "water":
            flooded = lies(change, scene, way)
            water = flooded if water is None else np.maximum(water, flooded)
    north_m, east_m = scenario.faults.map_shift_ne_m
    return (scene if north_m == east_m == 0.0 else _moved(scene, setup.area.home, -north_m, -east_m)), water


def met_in_time(change: Change, setup: FlightSetup) -> Change:
    """A change where this vehicle meets it when the copter, whose way a scenario's metres are, would; as long as it was.

    Else a plane had most of it behind itself when GNSS ends. Where the closed way is too short the change stays where it was.
    """
    later_m = change.begin_m * (SPEED_MPS[setup.vehicle] / SPEED_MPS["copter"] - 1.0)
    way = setup.mission_ned_m()
    length_m = sum(math.dist(a[:2], b[:2]) for a, b in zip(way, (*way[1:], way[0]), strict=True))
    last_m = change.end_m if math.isfinite(change.end_m) else change.begin_m + 2 * change.half_width_m
    if last_m + later_m > length_m:
        return change
    return replace(change, begin_m=change.begin_m + later_m, end_m=change.end_m + later_m)


def way_pix(setup: FlightSetup, scene: Scene) -> FloatArray:
    """(N, 2) the mission's waypoints as scene pix."""
    to_pix = invert_affine(scene.T_map_pix)
    places = [geo_from_ned(point, setup.area.home) for point in setup.mission_ned_m()]
    return np.array([apply_affine(to_pix, np.array(scene.projection_at(place).origin_map_m)) for place in places])


def _moved(scene: Scene, about: GeoPoint, north_m: float, east_m: float) -> Scene:
    """The scene elsewhere."""
    T = scene.T_map_pix.copy()
    T[:, 2] += scene.projection_at(about).J_map_ne @ np.array([north_m, east_m])
    return replace(scene, T_map_pix=T)
