"""What a flight needs of a real autopilot, whichever it is."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from visloc_companion.adapters.mavlink.dialect import Message
from visloc_companion.sim.real.station import Station
from visloc_companion.types import AutopilotKind, EkfSource, GeoPoint, Quat, Vec3

HOME = GeoPoint(47.3977, 8.5456, 488.0)
STATION_PORT, SIMULATOR_PORT, DAEMON_PORT = 14550, 14540, 14541
"""Where the ground station listens, where the simulator sends what is for the daemon, and where the daemon listens."""
FIRST_POSITION_S = 120.0
"""Within so long after a climb by hand the autopilot must have a position."""


@dataclass(frozen=True, slots=True)
class Leg:
    """A waypoint north and east of home, metres; `hold_s` is how long a copter stands there (0 passes by)."""

    north_m: float
    east_m: float
    hold_s: float = 0.0


@dataclass(frozen=True, slots=True)
class Route:
    """A circuit that is flown until the flight ends, at a height above home and a speed (ground speed of a copter)."""

    legs: tuple[Leg, ...]
    height_m: float
    speed_mps: float


@dataclass(frozen=True, slots=True)
class Truth:
    """Where the simulated vehicle really is."""

    place: GeoPoint
    v_ned_mps: Vec3
    q_ned_frd: Quat


class Pilot(Protocol):
    """The particulars of one simulator. Methods that wait raise LinkError."""

    @property
    def kind(self) -> AutopilotKind:
        """Which autopilot it is."""

    @property
    def station_url(self) -> str:
        """Where its ground station listens."""

    @property
    def daemon_url(self) -> str:
        """What the daemon is told as link.url."""

    def command(self, program: Path, folder: Path, speed: float, gnss: bool = True) -> tuple[Sequence[str], Mapping[str, str]]:
        """How to start it in a folder, with or without GNSS: the command and the environment; writes the files that it needs."""

    def passed(self, message: Message) -> bytes:
        """In which bytes a message reaches the daemon; empty for one that this simulator falsifies."""

    def truth(self, message: Message) -> Truth | None:
        """The truth, where the message holds it."""

    def position_ok(self, station: Station) -> bool | None:
        """Whether the autopilot says that it has an absolute horizontal position; None while it has not said."""

    def position_ratio(self, station: Station) -> float | None:
        """The innovation test ratio of the horizontal position (above 1 is rejected); None while it is not known."""

    async def prepare(self, station: Station, gnss: bool = True) -> None:
        """Have its messages come, and wait until it has a position; without `gnss` give it an origin instead."""

    async def take_off(self, station: Station, route: Route) -> None:
        """Arm, climb, and begin the circuit."""

    async def climb_by_hand(self, station: Station, route: Route) -> None:
        """Take off and climb without a position (copters), hold the height until there is one, and begin the circuit."""

    async def set_gnss(self, station: Station, on: bool) -> None:
        """Give or take the simulated receiver its signals."""

    async def drag_gnss(self, station: Station, offset_ne_m: tuple[float, float]) -> None:
        """Add an offset to the position (not to the velocity) that the simulated receiver reports."""

    async def brake(self, station: Station) -> None:
        """Stop as hard as the autopilot can (copters)."""

    async def resume(self, station: Station) -> None:
        """Go on with the circuit."""

    async def set_source(self, station: Station, source: EkfSource) -> None:
        """Switch the autopilot's horizontal position source, as an operator does."""

    async def land(self, station: Station) -> None:
        """Land where it is (a plane: go home), and for a copter wait until it is disarmed."""

    def failsafe(self, text: str) -> bool:
        """Whether a STATUSTEXT says that a failsafe took over."""
