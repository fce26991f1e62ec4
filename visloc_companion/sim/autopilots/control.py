"""Guidance along a mission of waypoints, from the autopilot's own estimate of where it is."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, Protocol

from visloc_companion.types import Vec3

Manner = Literal["mission", "hold", "land"]


@dataclass(slots=True)
class Estimated:
    """What the control knows: the estimate in the autopilot's local metres. `position_ok` False means height only."""

    north: float
    east: float
    down: float
    v_north: float
    v_east: float
    v_down: float
    yaw: float
    position_ok: bool


@dataclass(frozen=True, slots=True)
class PathPoint:
    """The state relative to the current leg: unit direction, cross-track vector, distance to go and the height to hold."""

    along_north: float
    along_east: float
    cross_north: float
    cross_east: float
    remaining_m: float
    down_m: float
    single: bool


class MissionPath:
    """Waypoints in local metres, flown in a loop. One waypoint alone is a place to stay at."""

    def __init__(self, waypoints_m: Sequence[Vec3]) -> None:
        if not waypoints_m:
            raise ValueError("a mission needs at least one waypoint")
        self._points = list(waypoints_m)
        self._next = 1 % len(self._points)

    def at(self, north: float, east: float, accept_m: float) -> PathPoint:
        """Where a position lies relative to the leg; goes on to the next leg within `accept_m` of its end."""
        if len(self._points) == 1:
            end = self._points[0]
            return PathPoint(0.0, 0.0, north - end[0], east - end[1], 0.0, end[2], True)
        for _ in self._points:
            start, end = self._points[self._next - 1], self._points[self._next]
            d_n, d_e = end[0] - start[0], end[1] - start[1]
            length = math.hypot(d_n, d_e)
            if length > 1e-6:
                d_n, d_e = d_n / length, d_e / length
                remaining = (end[0] - north) * d_n + (end[1] - east) * d_e
                if remaining > accept_m:
                    break
            self._next = (self._next + 1) % len(self._points)
        else:
            return PathPoint(0.0, 0.0, north - end[0], east - end[1], 0.0, end[2], True)
        along = (north - start[0]) * d_n + (east - start[1]) * d_e
        cross_n, cross_e = north - start[0] - along * d_n, east - start[1] - along * d_e
        share = min(max(along / length, 0.0), 1.0)
        return PathPoint(d_n, d_e, cross_n, cross_e, remaining, start[2] + share * (end[2] - start[2]), False)


class Control(Protocol):
    """The law that flies one kind of vehicle."""

    path: MissionPath | None

    def fly(self, manner: Manner, at: Estimated, hold_down_m: float, wind_ned_mps: Vec3, dt_s: float) -> None:
        """Decide from the estimate and advance the true vehicle by one step of physics.

        `hold` keeps the place (a plane: circles) at the height `hold_down_m`; `mission` without a path holds too.
        """
