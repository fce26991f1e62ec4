"""Eyes that know the simulator's truth: frames without pixels, and a worker that answers with the truth and stated noise."""

from __future__ import annotations

import asyncio
import heapq
import random
from collections.abc import Callable
from dataclasses import dataclass

from visloc_companion.app.mailbox import Mailbox
from visloc_companion.errors import Reason
from visloc_companion.geo.wgs84 import geo_from_ned
from visloc_companion.protocols import Clock
from visloc_companion.types import Fix, FrameRef, GeoPoint, LocaliseRequest, NoFix, Quat, TerrainRequest, WorkerState

METHOD = "truth"
_SIZE_PX = (640, 480)
_KEPT = 60


@dataclass(frozen=True, slots=True)
class OracleSettings:
    """Frames a second, 1-sigma of the fixes per axis (white), how long an answer takes, and what it claims of itself."""

    rate_hz: float = 4.0
    sigma_m: float = 0.7
    latency_s: float = 0.25
    claimed_sigma_m: float = 0.7


class Oracle:
    """Takes the truth as it comes, shows it as frames, and answers requests about them.

    It stands where the daemon's worker stands (`submit`, `events` and the states that the daemon shows). Frames go to
    `on_frame` once `shows` is set.
    """

    def __init__(self, settings: OracleSettings, clock: Clock, seed: int) -> None:
        self.on_frame: Callable[[FrameRef], None] = lambda _frame: None
        self.events: Mailbox[Fix | NoFix | WorkerState] = Mailbox(16, newest_wins=True)
        self.up, self.overdue, self.given_up = True, False, False
        self.pid, self.restarts = None, 0
        self.shows = False
        self._settings, self._clock = settings, clock
        self._rng = random.Random(f"{seed}/oracle")
        self._views: dict[int, tuple[GeoPoint, Quat]] = {}
        self._due: list[tuple[int, int, Fix | NoFix]] = []
        self._frame_id, self._next_ns = 0, 0

    def see(self, t_boot_ns: int, place: GeoPoint, q_ned_frd: Quat) -> None:
        """The truth at an instant of the autopilot's clock; every so often it is a frame."""
        if t_boot_ns < self._next_ns or not self.shows:
            return
        period_ns = round(1e9 / self._settings.rate_hz)
        self._next_ns = max(self._next_ns + period_ns, t_boot_ns + period_ns // 2)
        self._frame_id += 1
        self._views[self._frame_id] = (place, q_ned_frd)
        self._views.pop(self._frame_id - _KEPT, None)
        now_ns = self._clock.now_ns()
        self.on_frame(FrameRef(now_ns, now_ns, self._frame_id, 0, *_SIZE_PX, 3, t_boot_ns=t_boot_ns))

    def submit(self, request: LocaliseRequest | TerrainRequest) -> None:
        """Answer about a frame, in a while."""
        if isinstance(request, TerrainRequest):
            return
        due_ns = self._clock.now_ns() + round(self._settings.latency_s * 1e9)
        heapq.heappush(self._due, (due_ns, request.request_id, self._answer(request, due_ns)))

    def _answer(self, request: LocaliseRequest, due_ns: int) -> Fix | NoFix:
        frame, settings = request.frame, self._settings
        view = self._views.get(frame.frame_id)
        if view is None:
            return NoFix(due_ns, frame.t_ns, request.request_id, frame.frame_id, METHOD, Reason.BAD_FRAME, 0.0)
        noise = self._rng.gauss(0.0, settings.sigma_m), self._rng.gauss(0.0, settings.sigma_m), self._rng.gauss(0.0, 1.0)
        variance = settings.claimed_sigma_m**2
        return Fix(
            due_ns,
            frame.t_ns,
            request.request_id,
            frame.frame_id,
            METHOD,
            geo_from_ned(noise, view[0]),
            view[1],
            ((variance, 0.0), (0.0, variance)),
            1.0,
            0.01,
            1e-4,
            1e3 * settings.latency_s,
        )

    async def serve(self) -> None:
        """Hand out answers when they are due, for ever."""
        while True:
            while self._due and self._due[0][0] <= self._clock.now_ns():
                self.events.put(heapq.heappop(self._due)[2])
            await asyncio.sleep(0.002)

    async def close(self) -> None:
        """Nothing to release."""
