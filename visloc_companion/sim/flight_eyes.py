"""The camera's and the worker's part of a flight: exposures, frames that arrive, questions, answers, and the worker's death.

Times are the simulation's own (`t_sim_ns`); the shell's clock, which may step, only stamps what arrives.
"""

from __future__ import annotations

import heapq
from collections import deque
from dataclasses import dataclass, replace

from visloc_companion.app.worker_process import about_terrain, no_fix
from visloc_companion.errors import Reason
from visloc_companion.sim.autopilot import BuiltInAutopilot
from visloc_companion.sim.flight_log import Eyes
from visloc_companion.sim.rendering.render_motion import Shot
from visloc_companion.types import Event, Fix, FrameRef, GeoPoint, LocaliseRequest, NoFix, Quat, TerrainRequest, Vote, WorkerState

VIEWS_KEPT = 50
"""Of frames that have arrived; those under way are kept however long that takes."""


class Every:
    """Says when it is time again. What was missed is left out, not made up for."""

    def __init__(self, rate_hz: float) -> None:
        self._period_ns = round(1e9 / rate_hz)
        self._next_ns = -2 * self._period_ns  # the first call begins the grid

    def due(self, now_ns: int) -> bool:
        """Whether a period has passed since the last time that it was due."""
        if now_ns < self._next_ns:
            return False
        on_time = now_ns < self._next_ns + self._period_ns
        self._next_ns = (self._next_ns if on_time else now_ns) + self._period_ns
        return True


@dataclass(frozen=True, slots=True)
class View:
    """From where, by what carries the camera, and how a frame is taken; only frames that are asked for are rendered."""

    place: GeoPoint
    q_ned_carrier: Quat
    frame_id: int
    shot: Shot


class FlightEyes:
    """What of a flight goes through the camera and the localiser, with what is wrong with them."""

    def __init__(self, eyes: Eyes, pilot: BuiltInAutopilot) -> None:
        self._eyes, self._pilot, self._localiser = eyes, pilot, eyes.localiser
        self._exposures = Every(eyes.rate_hz)
        self._frame_id = 0
        self._views: dict[int, View] = {}
        self._arrived: deque[int] = deque()
        self._view: View | None = None
        self._under_way: list[tuple[int, int, FrameRef]] = []
        self._due: list[tuple[int, int, LocaliseRequest | TerrainRequest, Fix | NoFix]] = []
        self._worker_up, self._deaths = True, 0

    def frames(self, exposed_ns: int, now_ns: int) -> list[Event]:
        """Frames that arrive now (`now_ns`, the shell's clock; `exposed_ns` is the same clock at this step's exposure)."""
        pilot, faults = self._pilot, self._pilot.faults
        t_sim_ns = pilot.t_sim_ns
        if not faults.camera_silent(pilot.t_s) and self._exposures.due(t_sim_ns):
            frame = self._exposed(exposed_ns, now_ns)
            late_s = faults.frame_delay_s(pilot.t_s, frame.frame_id, pilot.flight.plan.seed)
            heapq.heappush(self._under_way, (t_sim_ns + round(late_s * 1e9), frame.frame_id, frame))
        arrived: list[Event] = []
        while self._under_way and self._under_way[0][0] <= t_sim_ns:
            frame = heapq.heappop(self._under_way)[2]
            arrived.append(replace(frame, t_rx_ns=now_ns))
            self._arrived.append(frame.frame_id)
            if len(self._arrived) > VIEWS_KEPT:
                del self._views[self._arrived.popleft()]
        return arrived

    def _exposed(self, exposed_ns: int, now_ns: int) -> FrameRef:
        pilot = self._pilot
        self._frame_id += 1
        if self._view is None or not pilot.faults.camera_frozen(pilot.t_s):
            truth, optics = pilot.truth(), pilot.faults.optics(pilot.t_s)
            q_ned_carrier, rate_radps = pilot.camera_carrier()
            shot = Shot(truth.v_ned_mps, rate_radps, optics.readout_s, optics.exposure_s, optics.effects)
            self._view = View(truth.place, q_ned_carrier, self._frame_id, shot)
        elif pilot.faults.camera_anew(pilot.t_s):
            self._view = replace(self._view, frame_id=self._frame_id)  # which feeds the noise
        self._views[self._frame_id] = self._view
        model = self._eyes.camera.model
        size_px = model.width_px, model.height_px
        return FrameRef(now_ns, exposed_ns, self._frame_id, 0, *size_px, 3, pilot.t_boot_ns, checksum=self._view.frame_id)

    def ask(self, request: LocaliseRequest | TerrainRequest, now_ns: int) -> None:
        """Work out the answer; it is given after the time that such an answer takes."""
        eyes = self._eyes
        answer: Fix | NoFix
        latency_s = eyes.latency_s
        if not self._worker_up:
            answer, latency_s = no_fix(request, self._localiser.method, Reason.WORKER_DIED, "there is no worker", now_ns), 0.0
        elif isinstance(request, TerrainRequest):
            answer = about_terrain(eyes.terrain, request)
        else:
            view = self._views[request.frame.frame_id]
            pixels = eyes.camera.render(view.place, view.q_ned_carrier, view.frame_id, view.shot)
            if eyes.on_pixels is not None:
                eyes.on_pixels(request.frame, pixels)
            answer = self._localiser.localise(request, pixels, eyes.reference)
            latency_s = eyes.structure_latency_s if request.vote is Vote.STRUCTURE else latency_s
        due_ns = self._pilot.t_sim_ns + round(latency_s * 1e9)
        heapq.heappush(self._due, (due_ns, request.request_id, request, answer))

    def answers(self, now_ns: int) -> list[Event]:
        """Answers that are ready, and what became of the worker."""
        events = self._worker(now_ns)
        while self._due and self._due[0][0] <= self._pilot.t_sim_ns:
            events.append(replace(heapq.heappop(self._due)[3], t_rx_ns=now_ns))
        return events

    def _worker(self, now_ns: int) -> list[Event]:
        """As app/worker.py tells it: what was asked is answered by its death, then it is down, and later up again."""
        down = self._pilot.faults.worker_down(self._pilot.t_s)
        if down is not self._worker_up:
            return []
        self._worker_up = not down
        if not down:
            self._localiser = self._eyes.reopen() if self._eyes.reopen is not None else self._localiser
            return [WorkerState(now_ns, True, self._deaths, "ready")]
        self._deaths += 1
        lost, self._due = [request for _, _, request, _ in sorted(self._due, key=lambda item: item[:2])], []
        why = "the worker ended with signal 9"
        died: list[Event] = [no_fix(r, self._localiser.method, Reason.WORKER_DIED, why, now_ns) for r in lost]
        return [*died, WorkerState(now_ns, False, self._deaths, why)]
