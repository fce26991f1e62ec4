"""How high the vehicle is above where it took off, although its home is moved in flight.

Whoever sets the home of a flying vehicle to where it is (MAV_CMD_DO_SET_HOME with param1 = 1; ArduPilot takes the height, too)
makes its height above home nothing. It would count as too low for its camera, and as landing, over whatever height it flies. Such
a step is of the height above home alone: the height above the sea goes on as before. Of a vehicle that was found flying on
vision nobody has seen the take-off, or such a step: there a fix tells how far the ground lies below.
"""

from __future__ import annotations

from visloc_companion.types import PriorPose

MOVED_M = 5.0
"""Less may be what the autopilot corrects its home by, and matters to nobody."""
SETTLES_NS = 5_000_000_000
"""An autopilot sets its home when it is armed: of that time the new one is the ground."""

GLIDES_NS = 120_000_000_000
"""Longer than a plane with a glide ratio of ten at 15 m/s takes from 150 m down."""


class TakeoffHeight:
    """Keeps by how much home was moved since the vehicle was armed. An autopilot without a home counts from the sea: the first
    one that it has is none that was moved. `unseen`: the vehicle was found flying."""

    def __init__(self) -> None:
        self.unseen = False
        self._last: PriorPose | None = None
        self._armed_ns: int | None = None
        self._moved_m = 0.0

    def above_m(self, prior: PriorPose, *, disarmed: bool) -> float:
        """Height above the take-off by the autopilot's word, m."""
        last, self._last = self._last, prior
        if disarmed:
            self.unseen, self._armed_ns, self._moved_m = False, None, 0.0
            return prior.h_rel_m
        self._armed_ns = prior.t_rx_ns if self._armed_ns is None else self._armed_ns
        if last is not None and prior.t_rx_ns - self._armed_ns >= SETTLES_NS:
            self._moved_m += _home_moved_m(last, prior)
        return prior.h_rel_m + self._moved_m

    def found_m(self, above_ground_m: float) -> float:
        """The same where the vehicle is known to be so high over the ground, although the autopilot's last word is another."""
        if self._last is not None:
            self._moved_m = above_ground_m - self._last.h_rel_m
        return above_ground_m


class RestartedAloft:
    """Whether a vehicle flies on although its autopilot restarted in flight, and calls where that was the ground."""

    def __init__(self) -> None:
        self._flew = False
        self._since_ns: int | None = None

    def restarted(self, *, flew: bool) -> None:
        """The autopilot restarted; `flew`: it was not low then."""
        self._flew, self._since_ns = self._flew or flew, None

    def flies(self, t_rx_ns: int, *, disarmed: bool, ground_seen: bool) -> bool:
        """Whether its height above home says nothing; until a fix has shown the ground, or whom nothing drives is down."""
        self._since_ns = t_rx_ns if self._since_ns is None else self._since_ns
        down = disarmed and t_rx_ns - self._since_ns >= GLIDES_NS
        self._flew = self._flew and not (ground_seen or down)
        return self._flew


def _home_moved_m(last: PriorPose, now: PriorPose) -> float:
    """By how much home is higher than before, m; 0 where it was the height above the sea that jumped."""
    moved_m = _home_amsl_m(now) - _home_amsl_m(last)
    climbed_m = -last.v_ned_mps[2] * (now.t_rx_ns - last.t_rx_ns) * 1e-9
    stepped_m = abs(now.h_rel_m - last.h_rel_m - climbed_m)
    above_sea_m = abs(now.place.h_amsl_m - last.place.h_amsl_m - climbed_m)
    without = last.h_rel_m == last.place.h_amsl_m
    return 0.0 if abs(moved_m) < MOVED_M or stepped_m <= above_sea_m or without else moved_m


def _home_amsl_m(prior: PriorPose) -> float:
    return prior.place.h_amsl_m - prior.h_rel_m
