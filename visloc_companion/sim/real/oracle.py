"""Eyes that know the simulator's truth: frames without pixels, and a worker that answers with the truth and stated noise."""

from __future__ import annotations

import asyncio
import heapq
import random
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from visloc_companion.app.mailbox import Mailbox
from visloc_companion.errors import Reason
from visloc_companion.geo.wgs84 import geo_from_ned, ned_from_geo
from visloc_companion.protocols import Clock
from visloc_companion.sim.odometry_model import drawn_for, stretched
from visloc_companion.types import (
    Fix,
    FrameRef,
    GeoPoint,
    LocaliseRequest,
    NoFix,
    Odometry,
    PosePrior,
    Quat,
    TerrainRequest,
    Vec2,
    WorkerState,
)

METHOD, HEIGHT_SIGMA_M = "truth", 1.0
_SIZE_PX = (640, 480)
_KEPT = 60
LEAST_HEIGHT_M = 10.0
FOLLOWED_NS = 2_000_000_000
"""Over a longer time between two frames the ground is not followed."""


def answered_height(seen_amsl_m: float, prior: PosePrior, seen_sigma_m: float = HEIGHT_SIGMA_M) -> tuple[float, float]:
    """Height (m above sea level) and its 1-sigma (m) of a fix that saw this one to a 1-sigma: as in a localiser's, the prior of
    the request is in them (core/heights/height.py takes it out again)."""
    own, known = seen_sigma_m**-2, prior.sigma_h_m**-2
    whole = own + known
    return (own * seen_amsl_m + known * prior.place.h_amsl_m) / whole, whole**-0.5


@dataclass(frozen=True, slots=True)
class OracleSettings:
    """How many frames a second are asked about at most, 1-sigma of the fixes per axis (white), how long an answer takes, and what
    it claims of itself. `camera_hz`: how many the camera takes, where that are more; the newest is asked about.

    `frame_delay_s`: how long a picture travels before the daemon has it (its time is known); `jitter_s`: what an answer takes
    longer at most (uniform). In seconds since the circuit was begun: `blind` are spans in which nothing is recognised, in
    `moved` (from, to, north and east m) fixes are off by so much. `odometry`: answers bring the camera's motion, too
    (sim/odometry_model.py), as those of the daemon's localiser do. `recognised_of`: of so many pictures that are asked about one
    is recognised; the others show the motion alone.
    """

    rate_hz: float = 4.0
    camera_hz: float | None = None
    sigma_m: float = 0.7
    latency_s: float = 0.25
    claimed_sigma_m: float = 0.7
    frame_delay_s: float = 0.0
    jitter_s: float = 0.0
    blind: tuple[tuple[float, float], ...] = ()
    moved: tuple[tuple[float, float, float, float], ...] = ()
    odometry: bool = False
    recognised_of: int = 1

    @property
    def frames_hz(self) -> float:
        """Frames a second."""
        return self.rate_hz if self.camera_hz is None else self.camera_hz

    def sees(self, at_s: float) -> bool:
        """Whether a picture of that time is recognised."""
        return not any(start <= at_s < end for start, end in self.blind)

    def offset_ne_m(self, at_s: float) -> Vec2:
        """What fixes from pictures of that time are off by, beside their noise."""
        spans = [span for span in self.moved if span[0] <= at_s < span[1]]
        return sum(span[2] for span in spans), sum(span[3] for span in spans)


class MotionSeen:
    """The camera's motion from the true places of the frames that are asked about, one after the other."""

    def __init__(self, seed: int, ground_amsl_m: float) -> None:
        self._model, self._rng = drawn_for(seed)
        self._ground_amsl_m = ground_amsl_m
        self._origin: GeoPoint | None = None
        self._seen_ns: int | None = None

    def lose(self) -> None:
        """The ground was not seen."""
        self._model.lose()

    def look(self, t_ns: int, place: GeoPoint, prior: PosePrior) -> Odometry | None:
        """The displacement that a frame from this place shows; None of the first one, and of one too long after the last.

        It comes out too long by as much as the height of the request is too great over the ground, and claims that.
        """
        self._origin = self._origin or place
        if self._seen_ns is not None and t_ns - self._seen_ns > FOLLOWED_NS:
            self.lose()
        self._seen_ns = t_ns
        seen = self._model.look(t_ns, np.array(ned_from_geo(place, self._origin)[:2]), self._rng)
        height_m = max(LEAST_HEIGHT_M, place.h_amsl_m - self._ground_amsl_m)
        up_m = prior.place.h_amsl_m - place.h_amsl_m
        return None if seen is None else stretched(seen, up_m / height_m, prior.sigma_h_m / height_m)


@dataclass(frozen=True, slots=True)
class View:
    """From where and how a frame was taken, at `t_boot_ns` of the autopilot's clock."""

    t_boot_ns: int
    place: GeoPoint
    q_ned_frd: Quat


Localise = Callable[[LocaliseRequest, View], Fix | NoFix]


class Oracle:
    """Takes the truth as it comes, shows it as frames, and answers requests about them.

    It stands where the daemon's worker stands (`submit`, `events` and the states that the daemon shows). Frames go to
    `on_frame` once `shows` is set. `begun_boot_ns` is when the circuit was begun. With `localise` that answers, not the truth.
    The ground lies at `ground_amsl_m`.
    """

    def __init__(
        self, settings: OracleSettings, clock: Clock, seed: int, localise: Localise | None = None, ground_amsl_m: float = 0.0
    ) -> None:
        self.on_frame: Callable[[FrameRef], None] = lambda _frame: None
        self.events: Mailbox[Fix | NoFix | WorkerState] = Mailbox(16, newest_wins=True)
        self.up, self.overdue, self.given_up = True, False, False
        self.pid, self.restarts, self.pack_seal = None, 0, ""
        self.shows = False
        self.begun_boot_ns: int | None = None
        self._settings, self._clock = settings, clock
        self._localise = localise or self._from_truth
        self._rng = random.Random(f"{seed}/oracle")
        self._motion = MotionSeen(seed, ground_amsl_m) if settings.odometry else None
        self._views: dict[int, View] = {}
        self._due: list[tuple[int, int, Fix | NoFix]] = []
        self._travelling: list[tuple[int, int, int]] = []
        self._frame_id, self._next_ns, self._asked = 0, 0, 0

    def see(self, t_boot_ns: int, place: GeoPoint, q_ned_frd: Quat) -> None:
        """The truth at an instant of the autopilot's clock; every so often it is a frame."""
        if t_boot_ns < self._next_ns or not self.shows:
            return
        period_ns = round(1e9 / self._settings.frames_hz)
        self._next_ns = max(self._next_ns + period_ns, t_boot_ns + period_ns // 2)
        self._frame_id += 1
        self._views[self._frame_id] = View(t_boot_ns, place, q_ned_frd)
        self._views.pop(self._frame_id - _KEPT, None)
        now_ns = self._clock.now_ns()
        due_ns = now_ns + round(self._settings.frame_delay_s * 1e9)
        heapq.heappush(self._travelling, (due_ns, self._frame_id, now_ns))
        self._deliver()

    def _deliver(self) -> None:
        now_ns = self._clock.now_ns()
        while self._travelling and self._travelling[0][0] <= now_ns:
            _, frame_id, t_ns = heapq.heappop(self._travelling)
            view = self._views.get(frame_id)
            if view is not None:
                self.on_frame(FrameRef(now_ns, t_ns, frame_id, 0, *_SIZE_PX, 3, t_boot_ns=view.t_boot_ns))

    def submit(self, request: LocaliseRequest | TerrainRequest) -> None:
        """Answer about a frame, in a while."""
        if isinstance(request, TerrainRequest):
            return
        takes_s = self._settings.latency_s + self._rng.uniform(0.0, self._settings.jitter_s)
        due_ns = self._clock.now_ns() + round(takes_s * 1e9)
        heapq.heappush(self._due, (due_ns, request.request_id, self._answer(request, due_ns)))

    def forget(self) -> None:
        """The daemon died, and its worker with it: what it was asked is never answered."""
        self._due.clear()
        if self._motion is not None:
            self._motion.lose()
        self.on_frame = lambda _frame: None
        self.events = Mailbox(16, newest_wins=True)

    def _answer(self, request: LocaliseRequest, due_ns: int) -> Fix | NoFix:
        frame, settings = request.frame, self._settings
        view = self._views.get(frame.frame_id)
        ids = request.request_id, frame.frame_id
        if view is None:
            return NoFix(due_ns, frame.t_ns, *ids, METHOD, Reason.BAD_FRAME, 0.0)
        if not settings.sees(self.flight_s(view.t_boot_ns)):
            if self._motion is not None:
                self._motion.lose()
            return NoFix(due_ns, frame.t_ns, *ids, METHOD, Reason.NO_MATCH, 0.0)
        self._asked += 1
        if self._asked % settings.recognised_of:
            return NoFix(due_ns, frame.t_ns, *ids, METHOD, Reason.NO_MATCH, 0.0, motion=self._motion_seen(request, view))
        return replace(self._localise(request, view), t_rx_ns=due_ns)

    def _motion_seen(self, request: LocaliseRequest, view: View) -> Odometry | None:
        return None if self._motion is None else self._motion.look(request.frame.t_ns, view.place, request.believed)

    def _from_truth(self, request: LocaliseRequest, view: View) -> Fix | NoFix:
        frame, settings = request.frame, self._settings
        ids = request.request_id, frame.frame_id
        north, east = settings.offset_ne_m(self.flight_s(view.t_boot_ns))
        sigma = settings.sigma_m
        off = north + self._rng.gauss(0.0, sigma), east + self._rng.gauss(0.0, sigma), self._rng.gauss(0.0, HEIGHT_SIGMA_M)
        variance = settings.claimed_sigma_m**2
        cov = ((variance, 0.0), (0.0, variance))
        place, took_ms = geo_from_ned(off, view.place), 1e3 * settings.latency_s
        h_m, sigma_h_m = answered_height(place.h_amsl_m, request.prior)
        place = replace(place, h_amsl_m=h_m)
        motion = self._motion_seen(request, view)
        return Fix(0, frame.t_ns, *ids, METHOD, place, view.q_ned_frd, cov, sigma_h_m, 0.01, 1e-4, took_ms, motion=motion)

    def flight_s(self, t_boot_ns: int) -> float:
        """Seconds since the circuit was begun; before that below 0."""
        return -1.0 if self.begun_boot_ns is None else (t_boot_ns - self.begun_boot_ns) * 1e-9

    def offset_ne_m(self, t_boot_ns: int) -> Vec2:
        """What fixes are off by on purpose at a time of the autopilot's clock."""
        return self._settings.offset_ne_m(self.flight_s(t_boot_ns))

    async def serve(self) -> None:
        """Hand out frames and answers when they are due, for ever."""
        while True:
            self._deliver()
            while self._due and self._due[0][0] <= self._clock.now_ns():
                self.events.put(heapq.heappop(self._due)[2])
            await asyncio.sleep(0.002)

    async def close(self) -> None:
        """Nothing to release."""
