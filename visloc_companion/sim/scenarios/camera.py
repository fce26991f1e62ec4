"""Flights without GNSS in which the camera, its pictures or their way to the daemon go wrong."""

from __future__ import annotations

import math

from visloc_companion.sim import faults
from visloc_companion.sim.scenarios.base import Expectation, Scenario, by_name
from visloc_companion.sim.scenarios.world import FAULT_S, JAM_S, RATE_HZ, UNSOLVABLE
from visloc_companion.types import Mode

AIR_KNOWN_S = 40.0
"""A plane's wind and pitot tube are known after 20 samples a second apart (velocity/pitot.py). Between frames 7 s apart nothing
else tells its velocity but the autopilot, which rests on what we send."""

CAMERA: dict[str, Scenario] = by_name(
    Scenario(
        "camera_freeze",
        "GNSS is jammed, and for 12 s the camera repeats one picture.",
        130.0,
        faults.jam(30.0) + faults.camera_freeze(60.0, 72.0),
        Expectation(max_error_m=20.0, modes=(Mode.AIDING, Mode.DEAD_RECKONING, Mode.AIDING)),
    ),
    Scenario(
        "camera_stuck",
        "For 20 s, first with good GNSS, the camera repeats one picture, with other noise each time.",
        65.0,
        faults.jam(35.0) + faults.camera_freeze(25.0, 45.0, anew=True),
        Expectation(dead_reckoning_m=20.0, modes=(Mode.DEAD_RECKONING, Mode.AIDING)),
        frame_rate_hz=RATE_HZ,
        pictures=True,
    ),
    Scenario(
        "frames_late",
        "Frames arrive up to 1 s late and overtake each other.",
        90.0,
        faults.jam(30.0) + faults.these(faults.FramesLate(40.0, 0.2, 0.8)),
    ),
    Scenario(
        "blur",
        "The lens is out of focus by 4 px, and frames are exposed for 1/15 s.",
        60.0,
        faults.jam(JAM_S) + faults.these(faults.Blur(FAULT_S, 4.0, 1 / 15)),
        frame_rate_hz=RATE_HZ,
        pictures=True,
    ),
    Scenario(
        "rolling_shutter",
        "The last row of a picture is exposed 50 ms after the first, as configured.",
        60.0,
        faults.jam(JAM_S) + faults.these(faults.RollingShutter(0.05)),
        frame_rate_hz=RATE_HZ,
        pictures=True,
    ),
    Scenario(
        "night",
        "Night falls: the scene gives 1/2000 of the light of day.",
        130.0,
        faults.jam(JAM_S) + faults.these(faults.Night(FAULT_S, 0.0005)),
        UNSOLVABLE,
        frame_rate_hz=1.0,
        pictures=True,
    ),
    Scenario(
        "sharp_turns",
        "A zigzag of sharp turns 60 m above ground with a frame every 7 s: successive frames share less than 5 %.",
        105.0,
        faults.jam(AIR_KNOWN_S),
        Expectation(
            median_error_m=3.0,
            max_error_m=15.0,
            dead_reckoning_m=40.0,
            modes=(Mode.DEAD_RECKONING,),
            final_modes=(Mode.AIDING, Mode.DEAD_RECKONING),
        ),
        course="zigzag",
        height_m=60.0,
        frame_rate_hz=1 / 7,
        pictures=True,
    ),
    Scenario(
        "tilted_mount",
        "The camera is mounted 20 degrees forward, as configured, and 2 degrees otherwise than that.",
        60.0,
        faults.jam(JAM_S) + faults.these(faults.MountError(roll_rad=math.radians(1.5), pitch_rad=math.radians(-1.5))),
        Expectation(median_error_m=5.0, max_error_m=12.0, wrong_fix_m=12.0),
        mount_pitch_rad=math.radians(20.0),
        frame_rate_hz=RATE_HZ,
        pictures=True,
    ),
    Scenario(
        "wrong_focal_length",
        "The lens is 3 % longer than calibrated.",
        60.0,
        faults.jam(JAM_S) + faults.these(faults.FocalError(0.03)),
        Expectation(median_error_m=1.5),
        frame_rate_hz=RATE_HZ,
        pictures=True,
    ),
)
