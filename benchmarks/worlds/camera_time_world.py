"""Flights for the time offset of a camera: the simulated vehicle's own motion, rendered frames, and the autopilot's attitudes.

The vehicle flies a bent loop (sim/setup.py) over the procedural landscape in wind with gusts. Its autopilot's attitudes, at 50
Hz, have the errors of the simulated one (yaw 1 degree in 60 s, tilt 0.3 in 20 s), which change evenly from second to second, as
those of a filter do that follows a gyroscope. Frames at 5 Hz, 640 x 480, 73.9 degrees across, kept in a folder.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from random import Random

import cv2
import numpy as np

from visloc_companion.geo.se3 import euler_from_quat, quat_from_euler
from visloc_companion.sim.autopilot import BuiltInAutopilot
from visloc_companion.sim.landscape import build_landscape, home
from visloc_companion.sim.render import CameraSimulator
from visloc_companion.sim.rendering.render_effects import CameraEffects
from visloc_companion.sim.vehicles.vehicle_noise import GaussMarkov
from visloc_companion.types import AutopilotKind, CameraModel, FloatArray, GeoPoint, Image, Vec3

MODEL = CameraModel(640, 480, 425.5, 425.5, 319.5, 239.5, (-0.05, 0.01, 0.0, 0.0, 0.0))
FRAME_S, ATTITUDE_S, STEP_S = 0.2, 0.02, 0.01
SIZE_M, GSD_M, HALF_M = 1300.0, 0.5, 330.0
HEIGHT_M = {"copter": 100.0, "plane": 150.0}
SPEED_MPS = {"copter": (10.0, 20.0), "plane": (20.0, 25.0)}
WIND_NED_MPS: Vec3 = (2.0, -4.0, 0.0)
SETTLE_S = 5.0
TILT_RAD, YAW_RAD = math.radians(0.3), math.radians(1.0)


@dataclass(frozen=True, slots=True, eq=False)
class Flight:
    """`frames` (F, H, W) grey taken at `frame_s` (F,); true attitudes `true_q` (A, 4) and the autopilot's `told_q` (A, 4) at
    `attitude_s` (A,), places of the frames (F, 3) NED metres about home."""

    name: str
    frames: Image
    frame_s: FloatArray
    attitude_s: FloatArray
    true_q: FloatArray
    told_q: FloatArray
    p_ned_m: FloatArray


def mission(height_m: float, half_m: float = HALF_M) -> tuple[Vec3, ...]:
    """The bent loop of the simulated flights."""
    corners = ((1.0, -0.6), (0.8, 1.0), (-0.2, 0.5), (-1.0, 0.9), (-0.7, -1.0))
    return tuple((north * half_m, east * half_m, -height_m) for north, east in corners)


def flight_of(vehicle: str, seed: int, duration_s: float, keep: Path) -> Flight:
    """A flight, from the folder where it is kept if it is there. Odd seeds fly at the slower speed."""
    file = keep / f"{vehicle}-{seed}-{duration_s:g}.npz"
    if not file.exists():
        keep.mkdir(parents=True, exist_ok=True)
        np.savez(file, **_rendered(vehicle, seed, duration_s))
    with np.load(file) as kept:
        return Flight(file.stem, *(kept[name] for name in ("frames", "frame_s", "attitude_s", "true_q", "told_q", "p_ned_m")))


def _rendered(vehicle: str, seed: int, duration_s: float) -> dict[str, np.ndarray]:
    scene = build_landscape(seed, "flight" if seed % 2 else "map", SIZE_M, GSD_M)
    camera = CameraSimulator(scene, MODEL, CameraEffects())
    pilot = pilot_of(vehicle, seed, home(scene))
    frames, frame_s, attitude_s, true_q, places = [], [], [], [], []
    for k in range(round((SETTLE_S + duration_s) / STEP_S)):
        pilot.step(STEP_S)
        t_s = k * STEP_S - SETTLE_S
        if t_s < -1e-9:
            continue
        n = round(t_s / STEP_S)
        if n % round(ATTITUDE_S / STEP_S) == 0:
            attitude_s.append(t_s)
            true_q.append(pilot.truth().q_ned_frd)
        if n % round(FRAME_S / STEP_S) == 0:
            truth = pilot.truth()
            frame_s.append(t_s)
            places.append(truth.p_ned_m)
            frames.append(cv2.cvtColor(camera.frame(truth.place, truth.q_ned_frd, seed * 100_003 + n), cv2.COLOR_RGB2GRAY))
    return {
        "frames": np.array(frames),
        "frame_s": np.array(frame_s),
        "attitude_s": np.array(attitude_s),
        "true_q": np.array(true_q),
        "told_q": told(np.array(true_q), np.array(attitude_s), seed),
        "p_ned_m": np.array(places),
    }


def pilot_of(vehicle: str, seed: int, at: GeoPoint) -> BuiltInAutopilot:
    """The vehicle in the air at its first waypoint."""
    kind = "plane" if vehicle == "plane" else "copter"
    speed = SPEED_MPS[vehicle][1 - seed % 2]
    way = mission(HEIGHT_M[vehicle])
    return BuiltInAutopilot(AutopilotKind.ARDUPILOT, kind, at, way, speed, seed, None, WIND_NED_MPS)


def told(true_q: FloatArray, attitude_s: FloatArray, seed: int) -> FloatArray:
    """(A, 4) what the autopilot believes of true attitudes (A, 4)."""
    rng = Random(f"{seed}/attitude")
    at_s = np.arange(-1.0, attitude_s[-1] + 2.0) + rng.uniform(0.0, 1.0)
    noises = (GaussMarkov(rng, sigma, tau_s) for sigma, tau_s in ((TILT_RAD, 20.0), (TILT_RAD, 20.0), (YAW_RAD, 60.0)))
    errors = [np.interp(attitude_s, at_s, [noise.step(1.0) for _ in at_s]) for noise in noises]
    found = []
    for q, roll, pitch, yaw in zip(true_q, *errors, strict=True):
        r, p, y = euler_from_quat((float(q[0]), float(q[1]), float(q[2]), float(q[3])))
        found.append(quat_from_euler(r + roll, p + pitch, y + yaw))
    return np.array(found)
