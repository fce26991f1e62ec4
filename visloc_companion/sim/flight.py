"""A whole flight in one process and in simulated time: vehicle, autopilot, MAVLink bytes, navigator, localiser.

Nothing sleeps and nothing is threaded, so a flight is deterministic by its seed and runs as fast as the machine allows.
The bytes between autopilot and navigator are real MAVLink. Each way takes `LINK_DELAY_NS` of the navigator's time, and question
and answer fit into one step of the autopilot: PX4 believes only clock exchanges that are back within 10 ms. The localiser's
answer arrives `latency_s` after it was asked, that of the structure vote `structure_latency_s`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from visloc_companion.adapters.mavlink.session import MavlinkSession
from visloc_companion.app.journal import Entry
from visloc_companion.geo.wgs84 import geo_from_ned
from visloc_companion.sim.autopilot import BuiltInAutopilot
from visloc_companion.sim.flight_eyes import Every, FlightEyes
from visloc_companion.sim.flight_log import Eyes, FlightLog, OperatorEntry, TruthSample
from visloc_companion.types import (
    Command,
    Event,
    GeoPoint,
    Injection,
    LocaliseRequest,
    Notice,
    OperatorFix,
    RequestMessage,
    SwitchSource,
    TerrainRequest,
    Tick,
)

if TYPE_CHECKING:
    from visloc_companion.core.navigator import Navigator

__all__ = ["CLOCK_OFFSET_NS", "LINK_DELAY_NS", "ClosedLoopFlight", "Eyes", "FlightLog", "OperatorEntry", "TruthSample"]

STEP_S = 0.01
STEPS_A_SAMPLE, STEPS_A_PROGRESS = 10, 100
ORIGIN_SETTLES_NS = 500_000_000
LINK_DELAY_NS = 1_000_000
CLOCK_OFFSET_NS = 7_000_000_000
"""The navigator's clock minus the autopilot's boot clock: not zero, so that the time conversion is always exercised."""


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
        on_entry: Callable[[Entry], None] | None = None,
    ) -> None:
        """`on_entry` is told every event and command as it comes."""
        self._autopilot, self._navigator, self._session = autopilot, navigator, session
        self._eyes = None if eyes is None else FlightEyes(eyes, autopilot)
        self._operator = operator
        self._on_entry = on_entry
        self._ticks = Every(output_rate_hz)
        self._origin_due_ns: int | None = None
        self.log = FlightLog()

    def run(self, duration_s: float, on_progress: Callable[[float], None] | None = None) -> FlightLog:
        """Fly for so long; a vehicle that its failsafe has put on the ground stays there."""
        for step in range(round(duration_s / STEP_S)):
            self._autopilot.step(STEP_S)
            now_ns = self._now_ns()
            if step % STEPS_A_SAMPLE == 0:
                self._note_truth(now_ns)
            if self._navigator is not None and self._session is not None:
                self._exchange(self._navigator, self._session, now_ns)
            else:
                self._autopilot.outgoing()
            if on_progress is not None and step % STEPS_A_PROGRESS == 0:
                on_progress(step * STEP_S)
        self._note_truth(self._now_ns() + LINK_DELAY_NS)
        self.log.failsafe, self.log.pulled_m = self._autopilot.failsafe, self._autopilot.pulled_m
        self.log.duration_s = duration_s
        return self.log

    def _now_ns(self) -> int:
        """The companion's clock, with its steps."""
        pilot = self._autopilot
        return pilot.t_sim_ns + CLOCK_OFFSET_NS + pilot.faults.companion_clock_ns(pilot.t_s)

    def _note_truth(self, t_ns: int) -> None:
        """Time that a clock set back goes through twice is that of the first pass."""
        if self.log.truth and t_ns <= self.log.truth[-1].t_ns:
            return
        self.log.truth.append(TruthSample(t_ns, self._autopilot.truth().place, self._autopilot.estimate()))

    def _exchange(self, navigator: Navigator, session: MavlinkSession, sent_ns: int) -> None:
        """What the autopilot sent arrives, the navigator does what is due, and its questions are answered at once."""
        heard_ns = sent_ns + LINK_DELAY_NS
        self._feed(navigator, session, session.receive(self._heard(), heard_ns), heard_ns)
        self._feed(navigator, session, session.poll(heard_ns), heard_ns)
        self._feed(navigator, session, self._operate(heard_ns), heard_ns)
        if self._eyes is not None:
            self._feed(navigator, session, self._eyes.frames(sent_ns, heard_ns), heard_ns)
            self._feed(navigator, session, self._eyes.answers(heard_ns), heard_ns)
        if self._ticks.due(self._autopilot.t_sim_ns):
            self._feed(navigator, session, [Tick(heard_ns)], heard_ns)
        self._tell(session)
        answered_ns = heard_ns + 2 * LINK_DELAY_NS
        self._feed(navigator, session, session.receive(self._heard(), answered_ns), answered_ns)
        self._tell(session)

    def _heard(self) -> bytes:
        data = self._autopilot.outgoing()
        return b"" if self._autopilot.faults.link_down(self._autopilot.t_s) else data

    def _tell(self, session: MavlinkSession) -> None:
        data = session.outgoing()
        if not self._autopilot.faults.link_down(self._autopilot.t_s):
            self._autopilot.receive(data)

    def _feed(self, navigator: Navigator, session: MavlinkSession, events: Sequence[Event], now_ns: int) -> None:
        for event in events:
            self._note(Entry(now_ns, event, None))
            for command in navigator.on(event, now_ns):
                self._note(Entry(now_ns, None, command))
                self._carry_out(command, session, now_ns)

    def _note(self, entry: Entry) -> None:
        self.log.entries.append(entry)
        if self._on_entry is not None:
            self._on_entry(entry)

    def _carry_out(self, command: Command, session: MavlinkSession, now_ns: int) -> None:
        match command:
            case LocaliseRequest() | TerrainRequest():
                if self._eyes is not None:
                    self._eyes.ask(command, now_ns)
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
            self._autopilot.receive(_origin_message(replace(told, h_amsl_m=self._autopilot.flight.plan.home.h_amsl_m)))
            self._origin_due_ns = now_ns + ORIGIN_SETTLES_NS
        if now_ns < self._origin_due_ns:
            return []
        self._operator = None
        return [OperatorFix(now_ns, told, operator.sigma_m)]


def _origin_message(place: GeoPoint) -> bytes:
    """SET_GPS_GLOBAL_ORIGIN as a ground station sends it, with the height of the ground where the autopilot was switched on."""
    station = mavlink.MAVLink(None, srcSystem=255, srcComponent=mavlink.MAV_COMP_ID_MISSIONPLANNER)
    message = mavlink.MAVLink_set_gps_global_origin_message(
        1, round(place.lat_deg * 1e7), round(place.lon_deg * 1e7), round(place.h_amsl_m * 1e3)
    )
    return bytes(message.pack(station))
