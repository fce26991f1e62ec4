"""How the camera turned from one frame to the next, and since one further back, by the picture alone.

From frame to frame it tells a clock that is off (core/camera/camera_time.py) and how the attitude's error changes. Errors of
turns that follow each other add up, to 0.34 degrees within 3 s over rendered flights; a turn since a frame of 3 s ago, over the
same ground, errs by 0.2 (decision 43).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from visloc_companion.geo.camera import R_FRD_CAM
from visloc_companion.geo.se3 import R_from_quat
from visloc_companion.localise.odometry.turn_follow import Follower, HeightsAbove, Seen, turn_of
from visloc_companion.localise.odometry.turn_solve import Turned
from visloc_companion.types import CameraModel, FloatArray, Image, Quat, Turn

MAX_GAP_NS = 1_000_000_000
KEPT_NS = 3_000_000_000
"""So long a frame is turned from: footprints of 65 degrees overlap by two thirds then, 120 m up at 10 m/s."""


@dataclass(frozen=True, slots=True)
class Turns:
    """The turn since the last frame, and since one further back; of which the latter is the former where a new one was chosen."""

    since_last: Turn | None = None
    since_kept: Turn | None = None


@dataclass(slots=True, eq=False)
class _Kept:
    """The frame that is turned from, and what is between it and the last one."""

    frame: Seen
    R_last: FloatArray
    moved_ned: FloatArray


class TurnWatch:
    """Frames in, turns out. Deterministic; the state is the last frame, how fast the ground went by, and a frame further back."""

    def __init__(self, model: CameraModel) -> None:
        self._follower = Follower(model)
        self._last: Seen | None = None
        self._kept: _Kept | None = None
        self._moved_ned_per_s = np.zeros(3)

    def forget(self) -> None:
        """The last frame was none of its time: what comes is not turned from it."""
        self._last = self._kept = None

    def step(self, pixels: Image, t_ns: int, q_ned_cambody: Quat, heights: HeightsAbove | None = None) -> Turns:
        """The turns that end here; none where there is no frame near, or too little is found again. `heights`: of the camera
        above what rays meet, where there is a surface model."""
        before, now = self._last, self._follower.seen(pixels, t_ns, R_from_quat(q_ned_cambody) @ R_FRD_CAM, heights)
        self._last = now
        if before is None or now is None or not 0 < t_ns - before.t_ns <= MAX_GAP_NS:
            self._kept = None
            return Turns()
        dt_s = (t_ns - before.t_ns) * 1e-9
        R_ba = np.asarray(now.R_ned_cam.T @ before.R_ned_cam, dtype=np.float64)
        turned = self._follower.between(before, now, R_ba, self._moved_ned_per_s * dt_s)
        if turned is None:
            self._kept, self._moved_ned_per_s = None, np.zeros(3)
            return Turns()
        moved_ned = before.R_ned_cam @ turned.moved
        self._moved_ned_per_s = moved_ned / dt_s
        turn = turn_of(before, now, turned)
        return Turns(turn, self._since_kept(before, now, turned, moved_ned) or turn)

    def _since_kept(self, before: Seen, now: Seen, turned: Turned, moved_ned: FloatArray) -> Turn | None:
        """The turn since the kept frame; where that is too long ago or out of sight, the frame before is kept."""
        kept = self._kept
        if kept is not None and now.t_ns - kept.frame.t_ns <= KEPT_NS:
            found = self._follower.between(kept.frame, now, turned.R_ba @ kept.R_last, kept.moved_ned + moved_ned)
            if found is not None:
                self._kept = _Kept(kept.frame, found.R_ba, kept.frame.R_ned_cam @ found.moved)
                return turn_of(kept.frame, now, found)
        self._kept = _Kept(before, turned.R_ba, moved_ned)
        return None
