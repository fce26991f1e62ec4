"""A whole flight in one process and in simulated time: vehicle, autopilot, MAVLink bytes, navigator, localiser.

Nothing sleeps and nothing is threaded, so a flight is deterministic by its seed and runs as fast as the machine allows.
The bytes between autopilot and navigator are real MAVLink. Each way takes `LINK_DELAY_NS` of the navigator's time, and question
and answer fit into one step of the autopilot: PX4 believes only clock exchanges that are back within 10 ms. The localiser's
answer arrives `latency_s` after it was asked, that of the structure vote `structure_latency_s`.
"""

from __future__ import annotations

import heapq
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from visloc_companion.adapters.mavlink.session import MavlinkSession
from visloc_companion.app.journal import Entry
from visloc_companion.app.terrain import TerrainAnswer
from visloc_companion.app.worker_process import about_terrain
from visloc_companion.core.navigator import Navigator
from visloc_companion.geo.wgs84 import distance_m, geo_from_ned
from visloc_companion.protocols import Localiser, ReferenceMap
from visloc_companion.sim.autopilot import BuiltInAutopilot
from visloc_companion.sim.camera import SimulatedCamera
from visloc_companion.types import (
    Command,
    Event,
    Fix,
    FrameRef,
    GeoPoint,
    Injection,
    LocaliseRequest,
    NoFix,
    Notice,
    OperatorFix,
    Quat,
    RequestMessage,
    SwitchSource,
    TerrainRequest,
    Tick,
    Vec3,
    Vote,
)

STEP_S = 0.01
STEPS_A_SAMPLE, STEPS_A_PROGRESS = 10, 100
VIEWS_KEPT = 50
ORIGIN_SETTLES_NS = 500_000_000
LINK_DELAY_NS = 1_000_000
CLOCK_OFFSET_NS = 7_000_000_000
"""The navigator's clock minus the autopilot's boot clock: not zero, so that the time conversion is always exercised."""


@dataclass(frozen=True, slots=True)
class TruthSample:
    """Where the vehicle really was, and where the autopilot believed it to be, at `t_ns` of the navigator's clock."""

    t_ns: int
    place: GeoPoint
    believed: GeoPoint | None

    @property
    def off_m(self) -> float | None:
        """How far the autopilot's belief is from the truth, None while it has none."""
        return None if self.believed is None else distance_m(self.believed, self.place)


@dataclass(slots=True)
class FlightLog:
    """What a flight left behind."""

    entries: list[Entry] = field(default_factory=list)
    truth: list[TruthSample] = field(default_factory=list)
    failsafe: str | None = None
    pulled_m: float = 0.0
    duration_s: float = 0.0


@dataclass(frozen=True, slots=True)
class View:
    """From where a frame is rendered; only frames that are asked for are."""

    place: GeoPoint
    q_ned_frd: Quat
    frame_id: int


@dataclass(frozen=True, slots=True)
class OperatorEntry:
    """At `at_s` the operator sets the EKF origin from the ground station, and soon after tells the daemon where the vehicle is.

    Both are the true place at that moment plus `error_ned_m`; `sigma_m` is what is claimed.
    """

    at_s: float
    error_ned_m: Vec3
    sigma_m: float


@dataclass(frozen=True, slots=True)
class Eyes:
    """What the navigator sees with: the camera over the scene, the localiser, its map, and how long an answer takes;
    `terrain` answers questions about the ground below the track, where there is who can."""

    camera: SimulatedCamera
    localiser: Localiser
    reference: ReferenceMap
    rate_hz: float = 5.0
    latency_s: float = 0.15
    structure_latency_s: float = 1.0
    terrain: TerrainAnswer | None = None


class ClosedLoopFlight:
    """Steps the autopilot and, where there is one, the navigator with its link and its eyes."""

    def __init__(
        self,
        autopilot: BuiltInAutopilot,
        navigator: Navigator | None,
        session: MavlinkSession | None,
        eyes: Eyes | None,
        *,
        operator: OperatorEntry | None = None,
        output_rate_hz: float = 10.0,
    ) -> None:
        self._autopilot, self._navigator, self._session, self._eyes = autopilot, navigator, session, eyes
        self._operator = operator
        self._ticks = _Every(output_rate_hz)
        self._exposures = _Every(eyes.rate_hz if eyes is not None else 1.0)
        self._frame_id = 0
        self._origin_due_ns: int | None = None
        self._views: dict[int, View] = {}
        self._view: View | None = None
        self._due: list[tuple[int, int, Fix | NoFix]] = []
        self.log = FlightLog()

    def run(self, duration_s: float, on_progress: Callable[[float], None] | None = None) -> FlightLog:
        """Fly for so long; a vehicle that its failsafe has put on the ground stays there."""
        for step in range(round(duration_s / STEP_S)):
            self._autopilot.step(STEP_S)
            now_ns = self._autopilot.t_boot_ns + CLOCK_OFFSET_NS
            if step % STEPS_A_SAMPLE == 0:
                self._note_truth(now_ns)
            if self._navigator is not None and self._session is not None:
                self._exchange(self._navigator, self._session, now_ns)
            else:
                self._autopilot.outgoing()
            if on_progress is not None and step % STEPS_A_PROGRESS == 0:
                on_progress(step * STEP_S)
        self._note_truth(self._autopilot.t_boot_ns + CLOCK_OFFSET_NS + LINK_DELAY_NS)
        self.log.failsafe, self.log.pulled_m = self._autopilot.failsafe, self._autopilot.pulled_m
        self.log.duration_s = duration_s
        return self.log

    def _note_truth(self, t_ns: int) -> None:
        self.log.truth.append(TruthSample(t_ns, self._autopilot.truth().place, self._autopilot.estimate()))

    def _exchange(self, navigator: Navigator, session: MavlinkSession, sent_ns: int) -> None:
        """What the autopilot sent arrives, the navigator does what is due, and its questions are answered at once."""
        heard_ns = sent_ns + LINK_DELAY_NS
        self._feed(navigator, session, session.receive(self._autopilot.outgoing(), heard_ns), heard_ns)
        self._feed(navigator, session, session.poll(heard_ns), heard_ns)
        self._feed(navigator, session, self._operate(heard_ns), heard_ns)
        self._feed(navigator, session, self._frame(sent_ns, heard_ns), heard_ns)
        self._feed(navigator, session, self._answers(heard_ns), heard_ns)
        if self._ticks.due(heard_ns):
            self._feed(navigator, session, [Tick(heard_ns)], heard_ns)
        self._autopilot.receive(session.outgoing())
        answered_ns = heard_ns + 2 * LINK_DELAY_NS
        self._feed(navigator, session, session.receive(self._autopilot.outgoing(), answered_ns), answered_ns)
        self._autopilot.receive(session.outgoing())

    def _feed(self, navigator: Navigator, session: MavlinkSession, events: Sequence[Event], now_ns: int) -> None:
        for event in events:
            self.log.entries.append(Entry(now_ns, event, None))
            for command in navigator.on(event, now_ns):
                self.log.entries.append(Entry(now_ns, None, command))
                self._carry_out(command, session, now_ns)

    def _carry_out(self, command: Command, session: MavlinkSession, now_ns: int) -> None:
        match command:
            case LocaliseRequest():
                self._localise(command, now_ns)
            case TerrainRequest():
                self._sound(command, now_ns)
            case Injection():
                session.send(command, now_ns)
            case RequestMessage():
                session.request(command, now_ns)
            case SwitchSource():
                session.switch(command, now_ns)
            case Notice(to_operator=True):
                session.notify(command, now_ns)

    def _operate(self, now_ns: int) -> list[Event]:
        operator = self._operator
        if operator is None or self._autopilot.t_s < operator.at_s:
            return []
        told = geo_from_ned(operator.error_ned_m, self._autopilot.truth().place)
        if self._origin_due_ns is None:
            self._autopilot.receive(_origin_message(told))
            self._origin_due_ns = now_ns + ORIGIN_SETTLES_NS
        if now_ns < self._origin_due_ns:
            return []
        self._operator = None
        return [OperatorFix(now_ns, told, operator.sigma_m)]

    def _frame(self, exposed_ns: int, now_ns: int) -> list[Event]:
        eyes, pilot = self._eyes, self._autopilot
        if eyes is None or pilot.faults.camera_silent(pilot.t_s) or not self._exposures.due(exposed_ns):
            return []
        self._frame_id += 1
        if self._view is None or not pilot.faults.camera_frozen(pilot.t_s):
            truth = pilot.truth()
            self._view = View(truth.place, truth.q_ned_frd, self._frame_id)
        self._views[self._frame_id] = self._view
        self._views.pop(self._frame_id - VIEWS_KEPT, None)
        model = eyes.camera.model
        size_px = model.width_px, model.height_px
        return [FrameRef(now_ns, exposed_ns, self._frame_id, 0, *size_px, 3, t_boot_ns=pilot.t_boot_ns)]

    def _localise(self, request: LocaliseRequest, now_ns: int) -> None:
        eyes = self._eyes
        if eyes is None:
            return
        view = self._views[request.frame.frame_id]
        pixels = eyes.camera.render(view.place, view.q_ned_frd, view.frame_id)
        answer = eyes.localiser.localise(request, pixels, eyes.reference)
        latency_s = eyes.structure_latency_s if request.vote is Vote.STRUCTURE else eyes.latency_s
        heapq.heappush(self._due, (now_ns + round(latency_s * 1e9), request.request_id, answer))

    def _sound(self, request: TerrainRequest, now_ns: int) -> None:
        eyes = self._eyes
        if eyes is not None:
            answer = about_terrain(eyes.terrain, request)
            heapq.heappush(self._due, (now_ns + round(eyes.latency_s * 1e9), request.request_id, answer))

    def _answers(self, now_ns: int) -> list[Event]:
        answers: list[Event] = []
        while self._due and self._due[0][0] <= now_ns:
            answers.append(replace(heapq.heappop(self._due)[2], t_rx_ns=now_ns))
        return answers


class _Every:
    """Says when it is time again. What was missed is left out, not made up for."""

    def __init__(self, rate_hz: float) -> None:
        self._period_ns = round(1e9 / rate_hz)
        self._next_ns = 0

    def due(self, now_ns: int) -> bool:
        """Whether a period has passed since the last time that it was due."""
        if now_ns < self._next_ns:
            return False
        on_time = now_ns < self._next_ns + self._period_ns
        self._next_ns = (self._next_ns if on_time else now_ns) + self._period_ns
        return True


def _origin_message(place: GeoPoint) -> bytes:
    """SET_GPS_GLOBAL_ORIGIN as a ground station sends it."""
    station = mavlink.MAVLink(None, srcSystem=255, srcComponent=mavlink.MAV_COMP_ID_MISSIONPLANNER)
    message = mavlink.MAVLink_set_gps_global_origin_message(
        1, round(place.lat_deg * 1e7), round(place.lon_deg * 1e7), round(place.h_amsl_m * 1e3)
    )
    return bytes(message.pack(station))
