"""Which frame is localised next, and from which prior: newest frame wins, one request at a time."""

from __future__ import annotations

import math

from visloc_companion.core.covariance import largest_sigma_m
from visloc_companion.core.turns import Turns
from visloc_companion.geo import se3, wgs84
from visloc_companion.types import Cov2, FrameRef, GeoPoint, LocaliseRequest, NavState, PosePrior, Quat, Vote

SIGMA_YAW_RAD = math.radians(5.0)
MOST_PULL_RAD = math.radians(15.0)
"""However far a compass has pulled the heading since the last fixes, no wider is searched for that: it takes longer."""
HEIGHT_SIGMA_M = 3.0
HEIGHT_SIGMA_SHARE = 0.01
LEARNED_HEIGHT_SIGMA_M, LEARNED_HEIGHT_SIGMA_SHARE = 0.7, 0.0025
UNSEEN_MPS = 0.5
"""By so much a second it grows while no fix is taken: a wrong height may be why."""
UNKNOWN_HEIGHT_SIGMA_M = 20.0
"""1-sigma of a height that nobody measured yet; no prior is wider."""
RATE_SLACK = 0.8
"""Frames may come this much earlier than the greatest rate allows: cameras jitter."""
HELD_AFTER_S = 5.0
DRAG_MPS = 0.8
MAX_DRAG_M = 40.0
"""What a GNSS that is followed may have pulled undetected, for each second without a fix, as 1-sigma, and its limit."""
MAX_FRAME_AGE_NS = 3_000_000_000
SEED_STEP = 1_000_003
MAX_SEED = 2**31


def height_sigma_m(height_above_home_m: float) -> float:
    """1-sigma of the autopilot's height above sea level: 3 m and 1 % of the height flown."""
    return HEIGHT_SIGMA_M + HEIGHT_SIGMA_SHARE * abs(height_above_home_m)


def least_height_sigma_m(height_above_home_m: float, unseen_s: float = 0.0) -> float:
    """1-sigma of that height, however well fixes have taught how far it is off: the wind about the vehicle moves a barometer.
    `unseen_s`: how long no fix has been taken."""
    least_m = LEARNED_HEIGHT_SIGMA_M + LEARNED_HEIGHT_SIGMA_SHARE * abs(height_above_home_m) + UNSEEN_MPS * unseen_s
    return min(least_m, height_sigma_m(height_above_home_m))


class FrameQueue:
    """A busy flag and one waiting frame. The worker's answer, or its end, frees it."""

    def __init__(self, max_rate_hz: float, seed: int, turns: Turns) -> None:
        self._min_interval_ns = round(RATE_SLACK * 1e9 / max_rate_hz)
        self._seed, self._turns = seed, turns
        self._waiting: FrameRef | None = None
        self._busy_id: int | None = None
        self._aside_id: int | None = None
        self._asked_ns: int | None = None
        self._last_id = 0
        self._worker_up = True

    @property
    def busy(self) -> bool:
        """Whether an answer is outstanding."""
        return self._busy_id is not None

    @property
    def free(self) -> bool:
        """Whether the worker is there and has nothing to do."""
        return self._worker_up and not self.busy

    def claimed(self) -> int:
        """The number of a question that is about no frame; it is outstanding from now on."""
        self._last_id += 1
        self._busy_id = self._aside_id = self._last_id
        return self._last_id

    def offer(self, frame: FrameRef) -> None:
        """A new frame; it takes the place of one that still waits."""
        if self._waiting is None or frame.t_ns >= self._waiting.t_ns:
            self._waiting = frame

    def answered(self, request_id: int, found: bool, lost: bool = False) -> None:
        """The worker answered a request, with a fix or without; `lost` with its life."""
        if request_id == self._busy_id:
            self._busy_id = None
            if request_id != self._aside_id:
                self._turns.answered(found, lost)

    def worker(self, up: bool) -> None:
        """The worker came up or ended; either way nothing is outstanding any more."""
        self._worker_up, self._busy_id = up, None

    def next_frame(self, now_ns: int) -> FrameRef | None:
        """The frame to be localised now, if one may be; it stays until `taken` or `dropped`."""
        if self._waiting is not None and now_ns - self._waiting.t_ns > MAX_FRAME_AGE_NS:
            self._waiting = None
        too_soon = self._asked_ns is not None and now_ns - self._asked_ns < self._min_interval_ns
        return None if self.busy or too_soon or not self._worker_up else self._waiting

    @property
    def next_id(self) -> int:
        """The number that the next request will have."""
        return self._last_id + 1

    def taken(
        self,
        frame: FrameRef,
        prior: PosePrior,
        now_ns: int,
        aside: bool = False,
        zoom: float = 1.0,
        try_zoom: float | None = None,
    ) -> LocaliseRequest:
        """The request for a frame; it is outstanding from now on. `aside`: it asks for the image's vote out of turn."""
        self._last_id += 1
        self._busy_id, self._asked_ns, self._waiting = self._last_id, now_ns, None
        self._aside_id = self._last_id if aside else self._aside_id
        seed = (self._seed * SEED_STEP + self._last_id) % MAX_SEED
        vote = Vote.IMAGE if aside else self._turns.vote
        return LocaliseRequest(self._last_id, frame, prior, seed, vote, zoom=zoom, try_zoom=try_zoom)


def heading_sigma_rad(of_carrier_rad: float, pulled_rad: float) -> float:
    """1-sigma of the heading: the autopilot's, that of what carries the camera, and a compass's pull since the last fixes."""
    return math.hypot(SIGMA_YAW_RAD, of_carrier_rad, min(pulled_rad, MOST_PULL_RAD))


def pose_prior(
    state: NavState,
    origin: GeoPoint,
    q_ned_carrier: Quat,
    q_carrier_cambody: Quat,
    height_offset_m: float,
    least_sigma_h_m: float,
    sigma_tilt_rad: float,
    max_search_radius_m: float,
    sigma_yaw_rad: float = SIGMA_YAW_RAD,
) -> PosePrior:
    """The localiser's prior: the filter's own state at image time, never the autopilot's position.

    Height is the autopilot's above sea level and the offset that earlier fixes found, known no better than `least_sigma_h_m`.
    """
    place = wgs84.geo_from_ned(state.p_ned_m, origin)
    return PosePrior(
        GeoPoint(place.lat_deg, place.lon_deg, place.h_amsl_m + height_offset_m),
        se3.quat_multiply(q_ned_carrier, q_carrier_cambody),
        bounded(state.cov_ne_m2, max_search_radius_m / 3),
        min(max(state.sigma_d_m, least_sigma_h_m), UNKNOWN_HEIGHT_SIGMA_M),
        sigma_yaw_rad,
        sigma_tilt_rad,
        height_offset_m,
    )


def as_wide_as(cov_ne_m2: Cov2, sigma_m: float) -> Cov2:
    """The covariance, grown in all directions alike until its largest 1-sigma is no less than this."""
    share = max(1.0, sigma_m / largest_sigma_m(cov_ne_m2)) ** 2
    (nn, ne), (en, ee) = cov_ne_m2
    return (share * nn, share * ne), (share * en, share * ee)


def dragged_m(since_fix_s: float) -> float:
    """1-sigma of what a GNSS that was followed may have pulled since the last fix."""
    return min(DRAG_MPS * since_fix_s, MAX_DRAG_M)


def held_by_gnss(cov_ne_m2: Cov2, since_fix_s: float, seed_sigma_m: float) -> Cov2:
    """The covariance of the search while GNSS, not vision, holds the filter.

    Nothing checks GNSS then, so the truth may be where a drag has left it behind; a search no wider than the filter's own
    covariance would never see it again.
    """
    if since_fix_s < HELD_AFTER_S:
        return cov_ne_m2
    extra = seed_sigma_m**2 + dragged_m(since_fix_s) ** 2
    (nn, ne), (en, ee) = cov_ne_m2
    return (nn + extra, ne), (en, ee + extra)


def bounded(cov_ne_m2: Cov2, max_sigma_m: float) -> Cov2:
    """The covariance, scaled so that its largest sigma is at most a bound."""
    scale = min(1.0, (max_sigma_m / largest_sigma_m(cov_ne_m2)) ** 2)
    (nn, ne), (en, ee) = cov_ne_m2
    return (scale * nn, scale * ne), (scale * en, scale * ee)
