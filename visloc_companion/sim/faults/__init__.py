"""What goes wrong in a simulated flight. A `FaultSchedule` is a sum of faults; the functions here make the common ones.

`jam(30.0) + baro_drift(40.0, 20.0, 60.0)`: every part of the simulation asks the schedule what is wrong at a time.
"""

from __future__ import annotations

import math

from visloc_companion.errors import ConfigError
from visloc_companion.sim.faults.camera import (
    Blur,
    CameraFreeze,
    CameraSilence,
    FramesLate,
    GimbalSilence,
    Haze,
    Night,
    Optics,
    RollingShutter,
)
from visloc_companion.sim.faults.gnss import GnssEffect, Jam, Meacon, SlowDrag, StepSpoof
from visloc_companion.sim.faults.installation import FocalError, MapShift, MountError
from visloc_companion.sim.faults.onboard import (
    AutopilotClockStep,
    BaroDrift,
    CompanionClockStep,
    CompassError,
    LinkGap,
    WorkerCrash,
)
from visloc_companion.sim.faults.schedule import Fault, FaultSchedule
from visloc_companion.types import Vec3

__all__ = [
    "AutopilotClockStep",
    "BaroDrift",
    "Blur",
    "CameraFreeze",
    "CameraSilence",
    "CompanionClockStep",
    "CompassError",
    "Fault",
    "FaultSchedule",
    "FocalError",
    "FramesLate",
    "GimbalSilence",
    "GnssEffect",
    "Haze",
    "Jam",
    "LinkGap",
    "MapShift",
    "Meacon",
    "MountError",
    "Night",
    "Optics",
    "RollingShutter",
    "SlowDrag",
    "StepSpoof",
    "WorkerCrash",
    "camera_freeze",
    "camera_silence",
    "gnss_returns_bad",
    "intermittent",
    "jam",
    "meaconed",
    "no_gnss",
    "slow_drag",
    "step_spoof",
    "these",
]


def these(*faults: Fault) -> FaultSchedule:
    """A schedule of faults."""
    return FaultSchedule(faults)


def jam(start_s: float, end_s: float = math.inf) -> FaultSchedule:
    """GNSS jammed between two times."""
    return FaultSchedule((Jam(start_s, end_s),))


def no_gnss() -> FaultSchedule:
    """GNSS absent from the boot on."""
    return jam(0.0)


def step_spoof(start_s: float, offset_ned_m: Vec3, end_s: float = math.inf) -> FaultSchedule:
    """GNSS jumps by an offset."""
    return FaultSchedule((StepSpoof(start_s, offset_ned_m, end_s),))


def slow_drag(
    start_s: float,
    rate_mps: float,
    direction_rad: float,
    end_s: float = math.inf,
    release_s: float = math.inf,
    consistent_velocity: bool = True,
) -> FaultSchedule:
    """GNSS is dragged away at a rate in a direction (clockwise from north)."""
    velocity = (rate_mps * math.cos(direction_rad), rate_mps * math.sin(direction_rad), 0.0)
    return FaultSchedule((SlowDrag(start_s, velocity, end_s, release_s, consistent_velocity),))


def gnss_returns_bad(start_s: float, return_s: float, offset_ned_m: Vec3, end_s: float = math.inf) -> FaultSchedule:
    """GNSS is jammed and comes back at a wrong place."""
    return jam(start_s, return_s) + step_spoof(return_s, offset_ned_m, end_s)


def meaconed(start_s: float, return_s: float, place_ned_m: Vec3, end_s: float = math.inf) -> FaultSchedule:
    """GNSS is jammed and then shows the place of another antenna."""
    return FaultSchedule((Jam(start_s, return_s), Meacon(return_s, place_ned_m, end_s)))


def intermittent(start_s: float, on_s: float, off_s: float, end_s: float) -> FaultSchedule:
    """GNSS is jammed for `on_s`, free for `off_s`, and so on until `end_s`. Raises ConfigError for times that are none."""
    if not (on_s > 0 and off_s > 0 and math.inf > end_s > start_s):
        what = f"{on_s:g} s on, {off_s:g} s off from {start_s:g} to {end_s:g} s"
        raise ConfigError(what, where="intermittent", remedy="let both last, and end at a finite time after the start")
    n = math.ceil((end_s - start_s) / (on_s + off_s))
    begins = [start_s + k * (on_s + off_s) for k in range(n)]
    return FaultSchedule(tuple(Jam(begin, min(begin + on_s, end_s)) for begin in begins if begin < end_s))


def camera_freeze(start_s: float, end_s: float = math.inf, *, anew: bool = False) -> FaultSchedule:
    """The camera repeats one picture between two times; `anew`: with other noise each time."""
    return FaultSchedule((CameraFreeze(start_s, end_s, anew),))


def camera_silence(start_s: float, end_s: float = math.inf) -> FaultSchedule:
    """The camera sends nothing between two times."""
    return FaultSchedule((CameraSilence(start_s, end_s),))
