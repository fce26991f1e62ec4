"""A daemon that hears no autopilot says so, and what it hears."""

from __future__ import annotations

import re

import pytest

from visloc_companion.adapters.mavlink.dialect import mav
from visloc_companion.adapters.mavlink.session import MavlinkSession
from visloc_companion.adapters.mavlink.settings import SessionSettings
from visloc_companion.adapters.mavlink.unheard import PATIENCE_NS

S = 1_000_000_000


def heartbeat(system: int, component: int, autopilot: int = mav.MAV_AUTOPILOT_PX4, kind: int = mav.MAV_TYPE_QUADROTOR) -> bytes:
    return bytes(mav.MAVLink_heartbeat_message(kind, autopilot, 0, 0, 4, 3).pack(mav.MAVLink(None, system, component)))


STATION = heartbeat(255, 190, mav.MAV_AUTOPILOT_INVALID, mav.MAV_TYPE_GCS)


def told(said: bytes, system_id: int = 0, seconds: int = 60) -> list[str]:
    """What is warned of while these bytes come once a second."""
    session, warned = MavlinkSession(SessionSettings(system_id=system_id)), list[str]()
    for k in range(4 * seconds):
        now_ns = 1000 * S + k * S // 4
        session.poll(now_ns)
        session.receive(said if k % 4 == 0 else b"", now_ns)
        warned += session.warnings()
    return warned


@pytest.mark.parametrize(
    ("said", "system_id", "what"),
    [
        (b"", 0, "no autopilot is heard: no message arrives; .*link.url"),
        (heartbeat(1, 2), 0, "no autopilot is heard: one speaks as component 2, which has to be 1 .PX4: MAV_COMP_ID"),
        (STATION, 7, r"no autopilot of system id 7 is heard: others are .system/component 255/190.; .*link.system_id"),
    ],
)
def test_that_no_autopilot_is_heard_is_told_once_with_what_is(said: bytes, system_id: int, what: str) -> None:
    (warning,) = told(said, system_id)
    assert re.match(what, warning)


def test_one_that_is_heard_is_not_missed_whoever_else_speaks() -> None:
    assert told(STATION + heartbeat(1, 1)) == []
    assert told(b"", seconds=PATIENCE_NS // S) == []


def test_bytes_that_are_no_messages_are_told_as_such_alone() -> None:
    (warning,) = told(bytes(range(200)))
    assert "not MAVLink" in warning
