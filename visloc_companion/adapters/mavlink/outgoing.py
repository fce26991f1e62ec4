"""The positions that a session sends: which output, how often, and those that it refuses to send."""

from __future__ import annotations

from collections.abc import Callable

from visloc_companion.adapters.mavlink.dialect import Message, mav
from visloc_companion.adapters.mavlink.outbox import Outbox
from visloc_companion.adapters.mavlink.outputs.choice import Choice, choose_output, parameter_names
from visloc_companion.adapters.mavlink.outputs.encoding import encode
from visloc_companion.adapters.mavlink.outputs.fence import Gate
from visloc_companion.adapters.mavlink.outputs.kinds import Output, Vehicle
from visloc_companion.adapters.mavlink.parameters import ParameterReader
from visloc_companion.adapters.mavlink.refusals import Refusals
from visloc_companion.adapters.mavlink.settings import SessionSettings
from visloc_companion.errors import Reason
from visloc_companion.types import EkfSource, GeoPoint, Injection, LinkChanged, Notice, Severity

_NS_PER_S = 1_000_000_000
_ACTIVE_FOR_NS = 2 * _NS_PER_S
_SINCE_2017_US = 1_483_228_800_000_000
"""A calendar time before this comes from a clock that nobody set."""


class PositionSender:
    """Chooses the output for the autopilot at hand and encodes injections; `n_sent` counts them, `refusals` those not sent.

    Each choice is told of once: what is sent with the first position, what cannot be at once.
    """

    def __init__(
        self, settings: SessionSettings, outbox: Outbox, warn: Callable[[str], None], say: Callable[[Notice], None]
    ) -> None:
        self.refusals = Refusals(warn, say)
        self.n_sent = 0
        self._settings, self._outbox, self._warn, self._say = settings, outbox, warn, say
        self._reader = ParameterReader()
        self._gate = Gate(settings.fence, settings.max_step_m)
        self._vehicle = Vehicle(vision_source_set=settings.vision_source_set, sensor_id=settings.position_sensor_id)
        self._choice = choose_output(settings.output, self._vehicle)
        self._told: Choice | None = None
        self._plane: bool | None = None
        self._unix_at_zero_ns: int | None = None
        self._last_ns = -_ACTIVE_FOR_NS

    @property
    def choice(self) -> Choice:
        """What is sent to the autopilot as far as it is known, and why."""
        return self._choice

    def active(self, now_ns: int) -> bool:
        """Whether positions flow."""
        return now_ns - self._last_ns < max(_ACTIVE_FOR_NS, 2 * round(self._period_s * _NS_PER_S))

    def shows_use(self, source: EkfSource) -> bool:
        """Whether the autopilot's reports will tell that it uses a source (types.SourceSwitched)."""
        return source is EkfSource.GNSS or self._choice.output is not Output.EXTERNAL_POSITION_ESTIMATE

    @property
    def withheld(self) -> str:
        """Why the positions of now are not sent, in a few words; empty where they are."""
        return self._choice.remedy if self._choice.output is None else self.refusals.lasting

    @property
    def why_nothing(self) -> str:
        """Why no position can be sent as the autopilot's parameters are; empty where one can, and while they are being read."""
        return str(self._choice) if self._choice.output is None and self._reader.complete else ""

    def hear(self, msg: Message, now_ns: int) -> bool:
        """Take a message of the autopilot; True for what is but the echo of a receiver that we play."""
        match msg.get_type():
            case "HEARTBEAT":
                self._plane = msg.type == mav.MAV_TYPE_FIXED_WING
            case "PARAM_VALUE":
                self._reader.take(msg)
            case "SYSTEM_TIME" if self._unix_at_zero_ns is None and msg.time_unix_usec > _SINCE_2017_US:
                self._unix_at_zero_ns = msg.time_unix_usec * 1000 - now_ns
            case "GPS_RAW_INT":
                return self._choice.output is Output.GPS_INPUT and self._vehicle.gps_instance == 0
            case "GPS2_RAW":
                return self._choice.output is Output.GPS_INPUT and self._vehicle.gps_instance != 0
        return False

    def restart(self, link: LinkChanged) -> None:
        """The autopilot came (back): its parameters are read anew."""
        self._know(link)
        self._reader.start(link.autopilot, parameter_names(self._vehicle))

    def poll(self, link: LinkChanged, now_ns: int) -> None:
        """Ask for parameters, and decide once they are known; what cannot be sent is told at once."""
        for request in self._reader.poll(link.system_id, now_ns):
            self._outbox.put(request)
        self._know(link)
        if self._choice.output is None and self._reader.complete:
            self._tell()

    def send(self, injection: Injection, link: LinkChanged, origin: GeoPoint | None, now_ns: int) -> bool:
        """Queue the message; False, with a count and one warning a reason, where it must not be sent (yet)."""
        output = self._choice.output
        if not link.up or output is None:
            return False
        if 0 <= injection.t_ns - self._last_ns < round(self._period_s * _NS_PER_S):
            return False
        admitted = self._gate.judge(injection, output, link.autopilot, origin, now_ns)
        message = admitted if isinstance(admitted, Reason) else encode(output, admitted, self._vehicle, self._unix_ns(admitted))
        if isinstance(message, Reason):
            self.refusals.refused(message, now_ns)
            return False
        self.refusals.sent()
        self._tell()
        self._last_ns = injection.t_ns
        self._outbox.put(message)
        self.n_sent += 1
        return True

    @property
    def _period_s(self) -> float:
        """The least time between two positions; a message that comes at a slow period of its own is not late by a tick."""
        output = self._choice.output
        if output is Output.EXTERNAL_POSITION_ESTIMATE:
            return 0.99 * self._settings.external_estimate_period_s
        return 0.0 if output is None else output.least_period_s

    def _unix_ns(self, injection: Injection) -> int | None:
        return None if self._unix_at_zero_ns is None else self._unix_at_zero_ns + injection.t_ns

    def _know(self, link: LinkChanged) -> None:
        """Parameters count once all are read: half of them may tell another tale. Until then those of before the silence do."""
        before = self._vehicle
        known = before.parameters if before.complete and before.kind is link.autopilot else {}
        complete = self._reader.complete
        vehicle = Vehicle(
            link.autopilot,
            link.system_id,
            self._plane,
            dict(self._reader.values) if complete else known,
            complete or bool(known),
            self._settings.vision_source_set,
            self._settings.position_sensor_id,
        )
        if vehicle != before:
            self._vehicle = vehicle
            self._choice = choose_output(self._settings.output, vehicle)

    def _tell(self) -> None:
        if self._choice == self._told:
            return
        self._told = self._choice
        self._warn(str(self._choice))
        if self._choice.output is None:
            self._say(Notice(Severity.CRITICAL, f"visloc NOT SENT: {self._choice.remedy}", to_operator=True))
