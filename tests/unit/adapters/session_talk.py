"""The session in conversation with the stand-in for an autopilot, and something to send it."""

from visloc_companion.adapters.mavlink.session import MavlinkSession
from visloc_companion.adapters.mavlink.settings import SessionSettings
from visloc_companion.geo.wgs84 import geo_from_ned
from visloc_companion.testing.conversation import Conversation
from visloc_companion.testing.fake_autopilot import FakeAutopilot
from visloc_companion.types import GeoPoint, Injection

ORIGIN = GeoPoint(47.3977, 8.5456, 488.0)


def injection(t_ns: int, reset_counter: int = 0, north_m: float = 10.0) -> Injection:
    cov = ((4.0, 0.0), (0.0, 4.0))
    p_ned_m = (north_m, -3.0, -42.0)
    place = geo_from_ned(p_ned_m, ORIGIN) if abs(north_m) < 1e6 else ORIGIN
    return Injection(t_ns, p_ned_m, place, (1.0, 0.0, 0.0, 0.0), cov, 1.0, 0.02, reset_counter)


def talk(**autopilot: object) -> Conversation:
    return Conversation(MavlinkSession(SessionSettings()), FakeAutopilot(**autopilot))  # type: ignore[arg-type]
