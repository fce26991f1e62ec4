"""How far the reported heading is off: as recent fixes found it, carried on by what pictures show of turns.

A heading that rests on our own positions wanders by degrees within seconds (PX4 without a compass that it trusts), and where
nothing is recognised no fix tells of it. How the camera turned about the vertical against the change of the reported attitude is
by how much the heading's error has changed since. A lens that is longer than calibrated, and a camera that is turned about its
axis, make every turn wrong alike: what that comes to is claimed beside what fixes are good for.
"""

from __future__ import annotations

import math
from collections import deque
from statistics import median
from typing import NamedTuple

import numpy as np

from visloc_companion.geo.tilt import CAMERA_SIGMA, heading_by_camera, heading_gained
from visloc_companion.types import FloatArray, Quat, Turn

HEADINGS = 5
AGE_NS = 60_000_000_000
SIGMA_RAD = math.radians(1.0)
"""1-sigma of the heading that recent fixes corrected, where no turn has carried it on."""
MOST_FRAMES = 300
"""Frames that displacements may begin at; one from before has the oldest of these for its own, for only who hovers keeps it."""
NOTHING = np.zeros(3)
"""It is never changed."""


class Heading(NamedTuple):
    """The turn about the vertical (rad, clockwise) that sets the reported heading right, and its 1-sigma."""

    turn_rad: float
    sigma_rad: float


class _Found(NamedTuple):
    t_ns: int
    turn_rad: float
    carried: FloatArray


class TrueHeading:
    """`seen` takes each frame with its turn, `found` what a fix says of the heading of one; `at` answers for any frame."""

    def __init__(self) -> None:
        self._last: tuple[int, Quat] | None = None
        self._carried = NOTHING
        self._frames: dict[int, FloatArray] = {}
        self._found: deque[_Found] = deque(maxlen=HEADINGS)

    def seen(self, t_ns: int, q_ned_cambody: Quat, turn: Turn | None) -> None:
        """Take a frame, the attitude that was reported of it, and how the camera turned since the one before; without a turn the
        error of the heading is taken to be what it was."""
        last, self._last = self._last, (t_ns, q_ned_cambody)
        if last is not None and turn is not None and (turn.t_from_ns, turn.t_to_ns) == (last[0], t_ns):
            gained = heading_gained(last[1], turn, q_ned_cambody)
            self._carried = self._carried + np.array([gained, *heading_by_camera(last[1], q_ned_cambody)])
        self._frames[t_ns] = self._carried
        if len(self._frames) > MOST_FRAMES:
            del self._frames[next(iter(self._frames))]

    def found(self, t_ns: int, turn_rad: float) -> None:
        """Take the turn that a fix says would set the heading right that was reported of its frame."""
        self._found.append(_Found(t_ns, turn_rad, self._frames.get(t_ns, NOTHING)))

    def at(self, t_ns: int, now_ns: int) -> Heading | None:
        """The heading of a frame, as it is known at a later one; None where too few fixes have told of late."""
        recent = [found for found in self._found if 0 <= now_ns - found.t_ns <= AGE_NS]
        if len(recent) < HEADINGS:
            return None
        carried = self._frames.get(t_ns, next(iter(self._frames.values()), NOTHING))
        since = [carried - found.carried for found in recent]
        turn_rad = median(found.turn_rad + float(gained[0]) for found, gained in zip(recent, since, strict=True))
        by_camera = np.mean(since, axis=0)[1:] * CAMERA_SIGMA
        return Heading(turn_rad, math.hypot(SIGMA_RAD, *by_camera.tolist()))
