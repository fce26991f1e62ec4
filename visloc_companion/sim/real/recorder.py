"""Watches both links of a flight: drives the clock, shows the oracle the truth, and writes the samples."""

from __future__ import annotations

from dataclasses import replace

from visloc_companion.adapters.mavlink.dialect import Message
from visloc_companion.app.journal import JournalWriter
from visloc_companion.geo.wgs84 import autopilot_ned_from_geo, geo_from_ned
from visloc_companion.sim.real.clock import EPOCH_NS, SlavedClock
from visloc_companion.sim.real.oracle import Oracle
from visloc_companion.sim.real.pilot import Pilot, Truth
from visloc_companion.sim.real.record import RealLog, RealSample
from visloc_companion.sim.real.station import Station
from visloc_companion.types import (
    Command,
    EkfSource,
    Event,
    FrameRef,
    GeoPoint,
    Image,
    Injection,
    LinkChanged,
    Notice,
    OriginChanged,
    SourceSwitched,
    TimesyncSample,
    Vec3,
)

_TIMED = ("ATTITUDE", "ATTITUDE_QUATERNION", "LOCAL_POSITION_NED", "GLOBAL_POSITION_INT", "SCALED_IMU")
_NS_PER_MS = 1_000_000
GNSS, VISION = "gnss", "vision"
SILENCE_NS = 300_000_000
"""An autopilot that has said nothing of its position for so long has none."""


def moved(truth: Truth, dt_s: float) -> Truth:
    """The truth a moment later: neither simulator dates it, and messages of one instant come one after another."""
    v = truth.v_ned_mps
    return replace(truth, place=geo_from_ned((v[0] * dt_s, v[1] * dt_s, v[2] * dt_s), truth.place))


class Recorder:
    """Samples are of the instants of the autopilot's own local position.

    Truth and estimate come on the ground station's link, in order, and are dated by the times on it: where the process was
    held up, the daemon's link may be read to its end before.

    Stands where the daemon's journal stands and hands everything on to the real one.

    The phase is `vision` from the autopilot's confirmation of that source to that of the other.
    """

    def __init__(self, pilot: Pilot, clock: SlavedClock, log: RealLog) -> None:
        self.clock, self.log = clock, log
        self.station: Station | None = None
        self.oracle: Oracle | None = None
        self.journal: JournalWriter | None = None
        self.failed = False
        self.dropped, self.problem = 0, ""
        self._pilot = pilot
        self._t_boot_ns = self._station_ns = self._truth_ns = self._sampled_ns = 0
        self._truth: Truth | None = None
        self._phase = GNSS
        self._origin: GeoPoint | None = None
        self._injected: Vec3 | None = None

    def show_frames(self, *, begun: bool = False) -> None:
        """From now on the daemon's camera sees the ground; `begun`: the circuit begins now."""
        if self.oracle is not None:
            self.oracle.shows = True
            if begun:
                self.oracle.begun_boot_ns = self._t_boot_ns

    def mark(self, name: str) -> None:
        """Something happens now."""
        self.log.marks.append((self._t_boot_ns * 1e-9, name))

    def switched(self, source: EkfSource) -> None:
        """The autopilot has confirmed a source."""
        self._phase = VISION if source is EkfSource.VISION else GNSS
        self.mark(f"source {self._phase}")

    # ---------------------------------------------------------------------------------------------- the ground station's

    def hear(self, message: Message) -> None:
        """Take a message of the autopilot to the ground station."""
        self.overhear(message)
        kind = message.get_type()
        if kind in _TIMED:
            self._station_ns = max(self._station_ns, message.time_boot_ms * _NS_PER_MS)
        if kind == "STATUSTEXT" and self._pilot.failsafe(message.text) and self.log.at("begun") is not None:
            self.failed = True
            self.log.failsafes.append((self._t_boot_ns * 1e-9, message.text.rstrip("\x00\t ")))
        elif kind == "GPS_GLOBAL_ORIGIN":
            self._origin = GeoPoint(message.latitude * 1e-7, message.longitude * 1e-7, message.altitude * 1e-3)
        truth = self._pilot.truth(message)
        if truth is not None:
            self._truth, self._truth_ns = truth, self._station_ns
            if self.oracle is not None:
                self.oracle.see(self._station_ns, truth.place, truth.q_ned_frd)
            if self._station_ns - self._sampled_ns > SILENCE_NS:
                self._sample(truth, None)
        elif kind == "LOCAL_POSITION_NED" and self._truth is not None:
            self._sample(moved(self._truth, (self._station_ns - self._truth_ns) * 1e-9), message)

    def overhear(self, message: Message) -> None:
        """Take the time from a message, on whichever link it comes."""
        if message.get_type() in _TIMED:
            self._t_boot_ns = max(self._t_boot_ns, message.time_boot_ms * _NS_PER_MS)
            self.clock.hear(self._t_boot_ns)

    def _sample(self, truth: Truth, local: Message | None) -> None:
        station, origin = self.station, self._origin
        if station is None or origin is None:
            return
        self._sampled_ns = self._station_ns
        world, heartbeat = station.last.get("GLOBAL_POSITION_INT"), station.last.get("HEARTBEAT")
        self.log.samples.append(
            RealSample(
                self._station_ns * 1e-9,
                self._phase,
                truth.place,
                autopilot_ned_from_geo(self._pilot.kind, truth.place, origin),
                truth.v_ned_mps,
                truth.q_ned_frd,
                None if local is None else (local.x, local.y, local.z),
                None if local is None else (local.vx, local.vy, local.vz),
                None if world is None else (world.vx * 0.01, world.vy * 0.01, world.vz * 0.01),
                self._injected,
                (0.0, 0.0) if self.oracle is None else self.oracle.offset_ne_m(self._station_ns),
                self._pilot.position_ratio(station),
                self._pilot.position_ok(station),
                0 if heartbeat is None else int(heartbeat.custom_mode),
                heartbeat is not None and bool(heartbeat.base_mode & 128),
            )
        )

    # ------------------------------------------------------------------------------------------------------ the journal's

    def event(self, now_ns: int, event: Event) -> None:
        """What the navigator is given."""
        if isinstance(event, SourceSwitched) and event.accepted:
            self.switched(event.source)
        elif isinstance(event, OriginChanged):
            self._origin = event.origin
        elif isinstance(event, TimesyncSample):
            self.log.round_trips.append((self._t_boot_ns * 1e-9, (event.t_rx_ns - event.t_sent_ns) * 1e-9))
        elif isinstance(event, LinkChanged) and event.version:
            self.log.version = f"{event.autopilot.value} {event.version}"
        if self.journal is not None:
            self.journal.event(now_ns, event)

    def command(self, now_ns: int, command: Command) -> None:
        """What the navigator answered."""
        if isinstance(command, Injection):
            self._injected = command.p_ned_m
            self.log.injected_s.append(self._t_boot_ns * 1e-9)
        if self.journal is not None:
            self.journal.command(now_ns, command)

    def notice(self, now_ns: int, notice: Notice) -> None:
        """What the daemon's shell reports."""
        if self.journal is not None:
            self.journal.notice(now_ns, notice)

    def frame(self, now_ns: int, frame: FrameRef, pixels: Image) -> None:
        """Frames have no pixels here."""

    def raw(self, data: bytes, t_ns: int, outgoing: bool) -> None:
        """Bytes of the daemon's link."""
        if self.journal is not None:
            self.journal.mavlink(t_ns, data, outgoing=outgoing)

    @property
    def t_s(self) -> float:
        """The autopilot's boot clock, seconds."""
        return (self.clock.now_ns() - EPOCH_NS) * 1e-9
