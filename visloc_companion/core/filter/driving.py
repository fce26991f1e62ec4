"""The velocity and height that drive the position filter, between their samples and beyond the last.

Between two samples both are interpolated linearly, unless they are different velocities; after the last the velocity is held, and
the height goes on with it for a while. Over a gap of the link different velocities are interpolated, too: what a plane turns by
meanwhile is far more than what they differ by.
"""

from __future__ import annotations

from dataclasses import dataclass

from visloc_companion.core.filter.propagation import UNAIDED_GAP_S, Drive
from visloc_companion.types import Vec2, Vec3

MAX_CLIMB_HELD_S = 1.0
"""A vertical velocity is held no longer than this beyond its sample."""
JUMP_M, JUMP_MPS = 0.2, 1.0
"""A height that changes by so much more than its climb is another one: an autopilot turns from one source to another, or comes
right after it had none."""


def jumped_m(step_m: float, dt_s: float) -> float:
    """What a height that changed by so much more than its climb over a time has jumped by; 0 where it need not have."""
    return step_m if abs(step_m) >= JUMP_M + JUMP_MPS * dt_s else 0.0


@dataclass(frozen=True, slots=True)
class Velocity:
    """The driving velocity and the autopilot's height at a time; `sigma_mps`: how far an autopilot's velocity is believed.

    `sigma_a_mps2`: 1-sigma of the slow error of the accelerations that an inertial one is integrated from; `more_heading_rad2`:
    by how much the variance of the heading that turned them has grown since the sample before.
    """

    t_ns: int
    v_ned_mps: Vec3
    h_amsl_m: float
    sigma_mps: float
    drive: Drive
    sigma_a_mps2: float = 0.0
    more_heading_rad2: float = 0.0


Around = tuple[Velocity, Velocity | None]
"""The sample before a time, and the one after it."""


def velocity_at(t_ns: int, around: Around) -> Vec2:
    """North and east, m/s."""
    before, after, share = _share(t_ns, around)
    (n0, e0, _), (n1, e1, _) = before.v_ned_mps, after.v_ned_mps
    return n0 + share * (n1 - n0), e0 + share * (e1 - e0)


def mean_and_change(from_ns: int, to_ns: int, around: Around) -> tuple[Vec2, Vec2]:
    """Of the velocity over an interval without another sample, north and east, m/s: `velocity_at` both ends tells the same."""
    before, after = around
    north, east, _ = before.v_ned_mps
    if after is None or after.t_ns <= before.t_ns or _another(before, after):
        return (north, east), (0.0, 0.0)
    (n1, e1, _), gap_ns = after.v_ned_mps, after.t_ns - before.t_ns
    at_start, at_end = (from_ns - before.t_ns) / gap_ns, (to_ns - before.t_ns) / gap_ns
    start_n, start_e = north + at_start * (n1 - north), east + at_start * (e1 - east)
    end_n, end_e = north + at_end * (n1 - north), east + at_end * (e1 - east)
    return ((start_n + end_n) / 2, (start_e + end_e) / 2), (end_n - start_n, end_e - start_e)


def height_at(t_ns: int, around: Around) -> float:
    """The autopilot's height above mean sea level, m."""
    before, after, share = _share(t_ns, around)
    if after is not before:
        return before.h_amsl_m + share * (after.h_amsl_m - before.h_amsl_m)
    held_s = min(MAX_CLIMB_HELD_S, max(0.0, (t_ns - before.t_ns) * 1e-9))
    return before.h_amsl_m - before.v_ned_mps[2] * held_s


def _share(t_ns: int, around: Around) -> tuple[Velocity, Velocity, float]:
    before, after = around
    if after is None or after.t_ns <= before.t_ns or _another(before, after):
        return before, before, 0.0
    return before, after, (t_ns - before.t_ns) / (after.t_ns - before.t_ns)


def _another(before: Velocity, after: Velocity) -> bool:
    """Whether one velocity says nothing of the other; an inertial one begins with what was there before it."""
    drives = before.drive, after.drive
    if before.drive is after.drive or after.drive is Drive.INERTIAL:
        return False
    if Drive.NONE in drives:
        return True
    return before.drive is Drive.INERTIAL and after.t_ns - before.t_ns <= UNAIDED_GAP_S * 1e9
