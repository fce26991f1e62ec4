"""What the worker is asked next, and the prior that goes with it: the filter's own state, never the autopilot's position."""

from __future__ import annotations

import math
from dataclasses import replace

from visloc_companion.core import requests
from visloc_companion.core.attitude import AttitudeBuffer
from visloc_companion.core.propagation import Drive
from visloc_companion.core.settings import CoreSettings
from visloc_companion.core.terrain_aiding import TerrainAiding
from visloc_companion.core.timesync import ClockOffset
from visloc_companion.core.tracking import Tracker
from visloc_companion.types import Command, FrameRef, NavState, PosePrior, Quat

LEVEL: Quat = (1.0, 0.0, 0.0, 0.0)


class Asking:
    """Makes the requests from what the navigator knows; `queue` holds the frame that waits and what is outstanding."""

    def __init__(
        self,
        settings: CoreSettings,
        queue: requests.FrameQueue,
        tracker: Tracker,
        clock: ClockOffset,
        attitude: AttitudeBuffer,
        terrain: TerrainAiding | None,
    ) -> None:
        self._settings, self._queue, self._tracker = settings, queue, tracker
        self._clock, self._attitude, self._terrain = clock, attitude, terrain

    def next(self, now_ns: int, *, injecting: bool, gnss_trusted: bool) -> list[Command]:
        """The worker's next question: about the ground below the track where that is due, else about a frame."""
        return self._about_terrain(now_ns, injecting, gnss_trusted) or self._about_frame(now_ns, injecting)

    def attitude_now(self, now_ns: int) -> Quat | None:
        """The vehicle's attitude at a shell time, the newest one known where that is ahead of it."""
        t_boot_ns, newest = self._clock.boot_ns(now_ns), self._attitude.newest_boot_ns()
        if t_boot_ns is None or newest is None:
            return None
        return self._attitude.at(t_boot_ns) or self._attitude.at(newest)

    def _about_terrain(self, now_ns: int, injecting: bool, gnss_trusted: bool) -> list[Command]:
        terrain, belief = self._terrain, self._tracker.belief
        if terrain is None or belief is None or not self._queue.free or not terrain.due(now_ns):
            return []
        state, q_ned_frd = self._tracker.at(now_ns), self.attitude_now(now_ns)
        if state is None or q_ned_frd is None:
            return []
        prior = self._prior(state, q_ned_frd, LEVEL, injecting)
        steady = gnss_trusted and belief.drive is Drive.AUTOPILOT
        known_mps = math.sqrt(max(float(belief.P[2, 2]), float(belief.P[3, 3])))
        sigma_v_mps = belief.sigma_v_mps if belief.drive is Drive.INERTIAL else known_mps  # of the autopilot's own velocity
        asked = None if prior is None else terrain.request(self._queue.claimed(), now_ns, prior, sigma_v_mps, steady)
        return [] if asked is None else [asked]

    def _about_frame(self, now_ns: int, injecting: bool) -> list[Command]:
        frame = self._queue.next_frame(now_ns)
        state = None if frame is None else self._tracker.at(frame.t_ns)
        if frame is None or state is None:
            return []
        height = self._tracker.height_above_home_m
        if height is not None and height < self._settings.navigator.min_height_m:
            return []
        q_ned_frd = self._attitude_at(frame)
        if q_ned_frd is None:
            return []
        prior = self._prior(state, q_ned_frd, self._settings.q_frd_cambody, injecting)
        return [] if prior is None else [self._queue.taken(frame, prior, now_ns)]

    def _prior(self, state: NavState, q_ned_frd: Quat, q_frd_body: Quat, injecting: bool) -> PosePrior | None:
        """The prior of a state for the camera's body, or for another one that is mounted so."""
        origin, belief = self._tracker.origin, self._tracker.belief
        if origin is None or belief is None:
            return None
        if not injecting:
            cov = requests.held_by_gnss(state.cov_ne_m2, state.age_of_fix_s, self._settings.navigator.seed_sigma_m)
            state = replace(state, cov_ne_m2=cov)
        return requests.pose_prior(
            state,
            origin,
            q_ned_frd,
            q_frd_body,
            belief.height_offset_m,
            self._tracker.height_above_home_m or 0.0,
            self._settings.mount_sigma_rad,
            self._settings.max_search_radius_m,
        )

    def _attitude_at(self, frame: FrameRef) -> Quat | None:
        t_boot_ns = self._clock.boot_ns(frame.t_ns) if frame.t_boot_ns is None else frame.t_boot_ns
        return None if t_boot_ns is None else self._attitude.at(t_boot_ns)
