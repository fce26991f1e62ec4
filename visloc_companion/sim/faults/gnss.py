"""What goes wrong with satellite navigation, and what then reaches the antenna."""

from __future__ import annotations

import math
from dataclasses import dataclass

from visloc_companion.geo.se3 import plus
from visloc_companion.types import Vec3

REGAIN_S = 3.0
"""What a receiver that was jammed needs to have a fix again."""


@dataclass(frozen=True, slots=True)
class GnssEffect:
    """What reaches the antenna: nothing usable (`jammed`), or a position and a velocity that are off by so much.

    `offset_ned_m` and `offset_v_ned_mps` are added to the true position and velocity (north, east, down). Signals received
    elsewhere and sent on (meaconing) show that antenna's place: `meacon_ned_m` stands for the true position then, and zero for
    the true velocity.
    """

    jammed: bool = False
    offset_ned_m: Vec3 = (0.0, 0.0, 0.0)
    offset_v_ned_mps: Vec3 = (0.0, 0.0, 0.0)
    meacon_ned_m: Vec3 | None = None

    @property
    def spoofed(self) -> bool:
        """Whether the receiver is made to report a false place."""
        false = self.meacon_ned_m is not None or any(self.offset_ned_m) or any(self.offset_v_ned_mps)
        return not self.jammed and false


@dataclass(frozen=True, slots=True)
class Jam:
    """No fix from `start_s` until `end_s`."""

    start_s: float
    end_s: float = math.inf


@dataclass(frozen=True, slots=True)
class StepSpoof:
    """A position that jumps by an offset at `start_s` and stays there until `end_s`; the velocity stays true."""

    start_s: float
    offset_ned_m: Vec3
    end_s: float = math.inf


@dataclass(frozen=True, slots=True)
class SlowDrag:
    """A position that is dragged away at a constant velocity from `start_s` to `end_s`, then held until `release_s`.

    With `consistent_velocity` the reported velocity is dragged too, as a transmitter that spoofs signals does it; without,
    only the position is (ArduPilot's SIM_GPS1_GLTCH, the drag of docs/ardupilot.md).
    """

    start_s: float
    velocity_ned_mps: Vec3
    end_s: float = math.inf
    release_s: float = math.inf
    consistent_velocity: bool = True


@dataclass(frozen=True, slots=True)
class Meacon:
    """Signals received at another antenna (NED about home) and sent on from `start_s` to `end_s`: that place is reported."""

    start_s: float
    place_ned_m: Vec3
    end_s: float = math.inf


GnssFault = Jam | StepSpoof | SlowDrag | Meacon


def effect_of(faults: tuple[GnssFault, ...], t_s: float) -> GnssEffect:
    """What the receiver gets at a time: offsets add up, jamming wins over spoofing."""
    offset, velocity = (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
    meacon: Vec3 | None = None
    for fault in faults:
        match fault:
            case Jam(start_s, end_s) if start_s <= t_s < end_s:
                return GnssEffect(jammed=True)
            case StepSpoof(start_s, shift, end_s) if start_s <= t_s < end_s:
                offset = plus(offset, shift)
            case Meacon(start_s, place, end_s) if start_s <= t_s < end_s:
                meacon = place
            case SlowDrag() if fault.start_s <= t_s < fault.release_s:
                offset = plus(offset, _scaled(fault.velocity_ned_mps, min(t_s, fault.end_s) - fault.start_s))
                if fault.consistent_velocity and t_s < fault.end_s:
                    velocity = plus(velocity, fault.velocity_ned_mps)
    return GnssEffect(False, offset, velocity, meacon)


def bad_s(fault: GnssFault) -> tuple[float, float]:
    """From when to when the receiver has no fix or a false one; after jamming it needs REGAIN_S to find the sky again."""
    match fault:
        case Jam():
            return fault.start_s, fault.end_s + REGAIN_S
        case SlowDrag():
            return fault.start_s, fault.release_s
        case StepSpoof() | Meacon():
            return fault.start_s, fault.end_s


def _scaled(a: Vec3, factor: float) -> Vec3:
    return a[0] * factor, a[1] * factor, a[2] * factor
