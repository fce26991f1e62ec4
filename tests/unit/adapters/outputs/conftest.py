"""Injections and what an autopilot makes of them."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from visloc_companion.adapters.mavlink.dialect import Message, mav
from visloc_companion.geo.se3 import quat_from_euler
from visloc_companion.geo.wgs84 import geo_from_autopilot_ned
from visloc_companion.types import AutopilotKind, GeoPoint, Injection

ORIGIN = GeoPoint(47.3977, 8.5456, 488.0)
MakeInjection = Callable[..., Injection]


def make_injection(kind: AutopilotKind = AutopilotKind.ARDUPILOT, **changes: object) -> Injection:
    """A sound injection; its place follows from `p_ned_m` unless it is given."""
    p_ned_m = changes.get("p_ned_m", (120.0, -80.0, -42.0))
    place = geo_from_autopilot_ned(kind, p_ned_m, ORIGIN)  # type: ignore[arg-type]
    values: dict[str, object] = {
        "t_ns": 7_000_123_456,
        "p_ned_m": p_ned_m,
        "place": place,
        "q_ned_frd": quat_from_euler(0.1, -0.2, 2.5),
        "cov_ne_m2": ((4.0, 0.5), (0.5, 1.0)),
        "sigma_d_m": 3.0,
        "sigma_yaw_rad": 0.09,
        "reset_counter": 3,
        "v_ned_mps": (9.0, -4.0, 0.5),
        "cov_v_ne_m2ps2": ((0.36, 0.05), (0.05, 0.16)),
    }
    return Injection(**(values | changes))  # type: ignore[arg-type]


def over_the_wire(message: Message) -> Message:
    """The message after packing and parsing: what is lost to float32 is lost."""
    packer = mav.MAVLink(None, 1, 197)
    return packer.decode(bytearray(message.pack(packer)))


@pytest.fixture(scope="session")
def injection() -> MakeInjection:
    """`make_injection`."""
    return make_injection


@pytest.fixture(scope="session")
def wire() -> Callable[[Message], Message]:
    """`over_the_wire`."""
    return over_the_wire
