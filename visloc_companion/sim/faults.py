"""What goes wrong in a simulated flight, as a pure function of the time since its start.

A `FaultSchedule` is a sum of faults; `schedule.gnss(t_s)` says what the receiver sees, `schedule.camera_frozen(t_s)` and
`schedule.camera_silent(t_s)` what the camera's side has to do.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from visloc_companion.types import Vec3


@dataclass(frozen=True, slots=True)
class GnssEffect:
    """What reaches the antenna: nothing usable (`jammed`), or a position and a velocity that are off by so much.

    `offset_ned_m` and `offset_v_ned_mps` are added to the true position and velocity (north, east, down). Signals received
    elsewhere and sent on (meaconing) show that antenna's place: `meacon_ned_m` stands for the true position then, and the
    velocity is zero.
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
    only the position is (ArduPilot's SIM_GPS1_GLTCH, the case that the facts sheet measured).
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


@dataclass(frozen=True, slots=True)
class CameraFreeze:
    """The camera goes on sending one and the same picture."""

    start_s: float
    end_s: float = math.inf


@dataclass(frozen=True, slots=True)
class CameraSilence:
    """The camera sends nothing."""

    start_s: float
    end_s: float = math.inf


GnssFault = Jam | StepSpoof | SlowDrag | Meacon
Fault = GnssFault | CameraFreeze | CameraSilence


@dataclass(frozen=True, slots=True)
class FaultSchedule:
    """Faults that act together; offsets add up, jamming wins over spoofing. Empty means a flight without faults."""

    faults: tuple[Fault, ...] = ()

    def __add__(self, other: FaultSchedule) -> FaultSchedule:
        return FaultSchedule(self.faults + other.faults)

    def gnss(self, t_s: float) -> GnssEffect:
        """What the receiver gets at a time since the start of the flight, seconds."""
        offset, velocity = (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
        meacon: Vec3 | None = None
        for fault in self.faults:
            match fault:
                case Jam(start_s, end_s) if start_s <= t_s < end_s:
                    return GnssEffect(jammed=True)
                case StepSpoof(start_s, shift, end_s) if start_s <= t_s < end_s:
                    offset = _sum(offset, shift)
                case Meacon(start_s, place, end_s) if start_s <= t_s < end_s:
                    meacon = place
                case SlowDrag() if fault.start_s <= t_s < fault.release_s:
                    offset = _sum(offset, _scaled(fault.velocity_ned_mps, min(t_s, fault.end_s) - fault.start_s))
                    if fault.consistent_velocity and t_s < fault.end_s:
                        velocity = _sum(velocity, fault.velocity_ned_mps)
        return GnssEffect(False, offset, velocity, meacon)

    def camera_frozen(self, t_s: float) -> bool:
        """Whether the camera repeats its last picture."""
        return any(isinstance(f, CameraFreeze) and f.start_s <= t_s < f.end_s for f in self.faults)

    def camera_silent(self, t_s: float) -> bool:
        """Whether the camera sends nothing."""
        return any(isinstance(f, CameraSilence) and f.start_s <= t_s < f.end_s for f in self.faults)

    @property
    def gnss_start_s(self) -> float | None:
        """When the first fault of GNSS begins, None without any."""
        return min((f.start_s for f in self.faults if isinstance(f, GnssFault)), default=None)


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
    """GNSS is jammed for `on_s`, free for `off_s`, and so on until `end_s`."""
    n = math.ceil((end_s - start_s) / (on_s + off_s))
    begins = [start_s + k * (on_s + off_s) for k in range(n)]
    return FaultSchedule(tuple(Jam(begin, min(begin + on_s, end_s)) for begin in begins))


def camera_freeze(start_s: float, end_s: float = math.inf) -> FaultSchedule:
    """The camera repeats one picture between two times."""
    return FaultSchedule((CameraFreeze(start_s, end_s),))


def camera_silence(start_s: float, end_s: float = math.inf) -> FaultSchedule:
    """The camera sends nothing between two times."""
    return FaultSchedule((CameraSilence(start_s, end_s),))


def _sum(a: Vec3, b: Vec3) -> Vec3:
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


def _scaled(a: Vec3, factor: float) -> Vec3:
    return a[0] * factor, a[1] * factor, a[2] * factor
