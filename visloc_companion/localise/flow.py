"""Frame-to-frame odometry: the camera's displacement from tracked corners, the autopilot's attitude, and the height.

A frame is compared with a keyframe for as long as enough of it is in view, so that what hovers does not drift, and a straight
flight adds up one error for each leg of about half a footprint. Each frame is drawn as the keyframe's camera would have seen it
(a homography of the level plane), followed there and back by pyramidal Lucas-Kanade (tracks.py), and the motion is solved with
the ground's relief, the attitude and the heights as unknowns with priors (solve.py). What cannot be seen is said (Blind).
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, replace

import numpy as np

from visloc_companion.errors import Reason
from visloc_companion.localise.odometry.base import Blind, FlowSettings, Sight, Step, Surface
from visloc_companion.localise.odometry.below import READING_APART_M, Reading
from visloc_companion.localise.odometry.checks import Refused, refused, why_lost, why_no_ground, why_unsure
from visloc_companion.localise.odometry.claims import odometry_of
from visloc_companion.localise.odometry.follow import Followed, first_guess, follow
from visloc_companion.localise.odometry.keyframe import Keyframe, attitude, keyframe_of, with_readings
from visloc_companion.localise.odometry.picture import Picture, prepared
from visloc_companion.localise.odometry.solve import Motion, MotionPrior, solve
from visloc_companion.localise.seen_before import SeenBefore
from visloc_companion.localise.working_size import reduced_model, resized
from visloc_companion.types import CameraModel, FloatArray, Image

MOST_READINGS = 40
LEFT = 1.6
"""Corners that fit count for so many times their share: some are lost anyway."""
LONG_BASE = 0.2
"""Of the height: from here on a keyframe that looks otherwise is given up for the perspective; water does so long before."""
MOST_ADDED = 0.005
"""Of the height: a correction of the altitude that is larger than this asks for another keyframe."""
NO_PIXELS: Image = np.zeros((0, 0), np.uint8)
"""What is kept of a frame has no pixels: they may lie in memory that the next frame is written to."""


@dataclass(frozen=True, slots=True, eq=False)
class _View:
    """A frame, ready to be followed, and the camera's displacement from the keyframe when it was taken."""

    sight: Sight
    picture: Picture
    d_ned_m: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class _Moved:
    """A motion that was found, and what it was found from."""

    motion: Motion
    followed: Followed


class FrameToFrame:
    """Frames in, displacements out. Deterministic, for one camera; the state is the keyframe, the last frame and its speed."""

    def __init__(self, model: CameraModel, settings: FlowSettings | None = None) -> None:
        self._model, self._settings = model, settings or FlowSettings()
        self._worked = reduced_model(model, self._settings.working_px)
        self._key: Keyframe | None = None
        self._last: _View | None = None
        self._v_ned_mps: FloatArray | None = None
        self._readings: deque[Reading] = deque(maxlen=MOST_READINGS)
        self._doubted = False
        self._seen = SeenBefore()

    def step(self, sight: Sight, surface: Surface | None = None) -> Step | Blind:
        """The displacement from the keyframe to this frame, or why there is none. Never raises for what a frame may contain."""
        newest = None if self._last is None else self._last.sight.t_ns
        why = refused(sight, surface, self._model, self._settings, newest)
        if why is not None:
            return Blind(sight.t_ns, *why)
        picture = prepared(resized(sight.pixels, self._worked), self._worked)
        view = _View(replace(sight, pixels=NO_PIXELS), picture, np.zeros(3))
        last = self._last
        if self._seen.another(sight.t_ns, picture.grey):
            return Blind(sight.t_ns, Reason.FROZEN, "identical to a frame before: the camera is frozen")
        if self._key is None or last is None:
            return self._restarted(view, surface, (Reason.NO_BASELINE, "the first frame of a stretch"))
        key, last = self._at_its_height(self._key, last, view, surface)
        view = replace(view, sight=_with_added(view.sight, key.sight.up_added_m))
        found = self._motion(key, view, last.d_ned_m)
        if isinstance(found, tuple) and found[0] is Reason.MOVING_SURFACE:
            self._doubted = True
        elif isinstance(found, tuple) and last.sight.t_ns > key.sight.t_ns:
            key, found = self._from_last(key, last, view, surface, found)
        if isinstance(found, _Moved):
            return self._unless_doubted(self._answer(key, view, found, surface))
        if found[0] is Reason.LOW_OVERLAP or sight.t_ns - last.sight.t_ns > self._settings.patience_ns:
            return self._restarted(view, surface, found)
        return Blind(sight.t_ns, *found)

    def _from_last(
        self, key: Keyframe, last: _View, view: _View, surface: Surface | None, why: Refused
    ) -> tuple[Keyframe, _Moved | Refused]:
        """Where the keyframe is not found again the last frame may be: it becomes the keyframe."""
        later = self._keyframe_of_last(key, last, view, last.sight, surface)
        found = self._motion(later, view, np.zeros(3)) if isinstance(later, Keyframe) else why
        if not isinstance(later, Keyframe) or not isinstance(found, _Moved):
            return key, why
        self._rekey(later, last)
        return later, found

    def _at_its_height(self, key: Keyframe, last: _View, view: _View, surface: Surface | None) -> tuple[Keyframe, _View]:
        """What is added to the altitude stays as it was for a keyframe: a correction is no climb. Where it changed by much, the
        last frame becomes the keyframe at its corrected height, if it can."""
        sight = view.sight
        if abs(sight.up_added_m - key.sight.up_added_m) <= MOST_ADDED * key.height_m:
            return key, last
        corrected = replace(_with_added(last.sight, sight.up_added_m), sigma_up_m=sight.sigma_up_m)
        later = self._keyframe_of_last(key, last, view, corrected, surface)
        if not isinstance(later, Keyframe):
            return key, last
        moved = _View(corrected, last.picture, np.zeros(3))
        self._rekey(later, moved)
        return later, moved

    def _keyframe_of_last(
        self, key: Keyframe, last: _View, view: _View, sight: Sight, surface: Surface | None
    ) -> Keyframe | Refused:
        """The last frame as a keyframe; a surface is given about the place of this frame, some way on."""
        north, east = sight.place_ne_m
        d = self._travelled(view.sight)
        sight = replace(sight, place_ne_m=(north - float(d[0]), east - float(d[1])))
        return keyframe_of(sight, last.picture, surface, key.place_ne_m + last.d_ned_m[:2], self._settings)

    def _unless_doubted(self, step: Step) -> Step | Blind:
        """After water, and where the ground was lost, a keyframe must hold for a while: waves look like ground for a moment."""
        o = step.odometry
        if self._doubted and o.t_to_ns - o.t_from_ns < self._settings.doubt_ns:
            return Blind(o.t_to_ns, Reason.MOVING_SURFACE, "not followed for long enough yet", anchored=step.closes)
        self._doubted = False
        return step

    def _motion(self, key: Keyframe, view: _View, last_d_m: FloatArray) -> _Moved | Refused:
        """From the place where the last speed leads to; if that fails, from the shift of the picture as a whole."""
        sight, settings = view.sight, self._settings
        down = key.sight.up_m - sight.up_m
        R = attitude(sight)
        start = np.array([*(last_d_m + self._travelled(sight))[:2], down])
        result: _Moved | Refused = (Reason.NO_MATCH, "")
        for attempt in range(2):
            if attempt == 1 or self._v_ned_mps is None:
                guess = first_guess(key, view.picture, R, np.array([0.0, 0.0, down]) if attempt else start)
                if guess is None and attempt:
                    break
                start = start if guess is None else np.array([guess[0], guess[1], down])
            followed = follow(key, view.picture, R, start, settings.min_overlap)
            result = self._solved(key, view, followed, R, start)
            if isinstance(result, _Moved):
                break
        return result

    def _solved(self, key: Keyframe, view: _View, followed: Followed, R: FloatArray, start: FloatArray) -> _Moved | Refused:
        settings = self._settings
        if len(followed.number) < settings.min_tracks:
            return why_lost(view.sight, view.picture, followed, len(key.corners), settings)
        no_ground = why_no_ground(key, view.picture, R, start, followed, settings)
        if no_ground is not None:
            return no_ground
        sigmas = (settings.sigma_turn_rad, key.sight.sigma_tilt_rad, settings.sigma_climb_m)
        prior = MotionPrior(R, start, start[2], *sigmas, key.R_ned_cam[:, 2])
        ground, focal_px = key.ground_of(followed.number), float(np.sqrt(np.linalg.det(view.picture.K)))
        motion = solve(ground, followed.xy, prior, focal_px)
        if motion is not None and ground.coarse and motion.roughness > 1:  # what the points show of the land is all that is known
            motion = solve(ground.rougher(motion.roughness), followed.xy, prior, focal_px)
        if motion is None:
            return Reason.TOO_FEW_FEATURES, "the tracks leave the motion undetermined"
        why = why_unsure(motion, view.sight, view.picture, key.height_m, settings)
        return _Moved(motion, followed) if why is None else why

    def _travelled(self, sight: Sight) -> FloatArray:
        if self._v_ned_mps is None or self._last is None:
            return np.zeros(3)
        return self._v_ned_mps * (sight.t_ns - self._last.sight.t_ns) * 1e-9

    def _answer(self, key: Keyframe, view: _View, found: _Moved, surface: Surface | None) -> Step:
        """The step; where too little of the keyframe is left in view, this frame becomes the next one."""
        sight, motion, settings = view.sight, found.motion, self._settings
        last = self._last
        if last is not None:
            self._v_ned_mps = (motion.d_ned_m - last.d_ned_m) / ((sight.t_ns - last.sight.t_ns) * 1e-9)
        self._last = _View(sight, view.picture, motion.d_ned_m)
        place = key.place_ne_m + motion.d_ned_m[:2]
        self._note(sight, place)
        left = int(motion.fits.sum()) / len(key.corners)
        closes = min(found.followed.overlap, LEFT * left) < settings.keep_overlap
        base = float(np.hypot(motion.d_ned_m[0], motion.d_ned_m[1])) / key.height_m
        closes |= found.followed.unlike > settings.max_unlike and base > LONG_BASE
        if closes:
            later = keyframe_of(sight, view.picture, surface, place, settings)
            closes = isinstance(later, Keyframe)
            if isinstance(later, Keyframe):
                self._rekey(later, self._last)
        if not closes:
            self._key = with_readings(key, self._readings, settings)
        return odometry_of(key, sight, motion, closes)

    def _rekey(self, key: Keyframe, view: _View) -> None:
        """Go on from a frame that a motion was found for."""
        self._key = with_readings(key, self._readings, self._settings)
        self._last = _View(view.sight, view.picture, np.zeros(3))

    def _restarted(self, view: _View, surface: Surface | None, why: Refused) -> Blind:
        """A new stretch, which nothing ties to the one before."""
        key = keyframe_of(view.sight, view.picture, surface, np.zeros(2), self._settings)
        self._doubted |= self._key is not None
        self._key, self._last, self._v_ned_mps = None, None, None
        if not isinstance(key, Keyframe):
            return Blind(view.sight.t_ns, *key)
        self._readings.clear()
        self._note(view.sight, np.zeros(2))
        self._rekey(key, view)
        return Blind(view.sight.t_ns, *why, anchored=True)

    def _note(self, sight: Sight, place_ne_m: FloatArray) -> None:
        """Keep a height above the surface, unless the last one of its kind is near."""
        if not math.isfinite(sight.height_m):
            return
        beam_north, beam_east = sight.beam_ne_m
        north, east = float(place_ne_m[0]) + beam_north, float(place_ne_m[1]) + beam_east
        if self._readings:
            last = self._readings[-1]
            near = math.hypot(north - last.place_ne_m[0], east - last.place_ne_m[1]) < READING_APART_M
            if near and sight.ranged == (last.sigma_range_m is not None):
                return
        added_m, sigma_range_m = (sight.up_added_m, sight.sigma_height_m) if sight.ranged else (0.0, None)
        self._readings.append(Reading((north, east), sight.up_m - added_m, sight.height_m, sigma_range_m))


def _with_added(sight: Sight, up_added_m: float) -> Sight:
    """The sight with another correction of its altitude."""
    return replace(sight, up_m=sight.up_m - sight.up_added_m + up_added_m, up_added_m=up_added_m)
