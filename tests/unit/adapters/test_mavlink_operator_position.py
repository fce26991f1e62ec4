"""An operator's position over MAVLink: who may say it, what is answered, and the command that says it."""

from __future__ import annotations

import asyncio
import math
import time
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

import pytest

from visloc_companion.adapters.mavlink import operator_position
from visloc_companion.adapters.mavlink.dialect import Message, mav
from visloc_companion.adapters.mavlink.framing import Framer
from visloc_companion.adapters.mavlink.operator_call import Caller, say_here
from visloc_companion.adapters.mavlink.pymavlink_link import open_own_channel
from visloc_companion.adapters.mavlink.session import MavlinkSession
from visloc_companion.adapters.mavlink.settings import SessionSettings
from visloc_companion.adapters.mavlink.signing import SigningSettings, stamp_at_zero
from visloc_companion.errors import LinkError
from visloc_companion.testing.conversation import Conversation
from visloc_companion.testing.fake_autopilot import FakeAutopilot
from visloc_companion.types import GeoPoint, Notice, OperatorFix, Severity

PLACE = GeoPoint(47.4012345, 8.5498765, 0.0)
ORIGIN = GeoPoint(47.3977, 8.5456, 488.0)
US, STATION = 197, (255, 190)


def known(settings: SessionSettings | None = None) -> Conversation:
    """A session that has heard its autopilot and the origin."""
    talk = Conversation(MavlinkSession(settings or SessionSettings()), FakeAutopilot(origin=ORIGIN))
    talk.run(5.0, until=lambda: talk.session.origin is not None)
    assert talk.session.origin is not None
    return talk


def said_by(who: tuple[int, int], message: Message) -> bytes:
    return bytes(message.pack(mav.MAVLink(None, *who)))


def hear(talk: Conversation, message: Message, who: tuple[int, int] = STATION) -> tuple[list[OperatorFix], list[Message]]:
    talk.session.outgoing()
    events = talk.session.receive(said_by(who, message), talk.now_ns)
    answers = [m for m in Framer().feed(talk.session.outgoing()) if m.get_type() == "COMMAND_ACK"]
    return [event for event in events if isinstance(event, OperatorFix)], answers


def here(**changes: object) -> Message:
    command = operator_position.command(1, US, PLACE, 30.0)
    for name, value in changes.items():
        setattr(command, name, value)
    return command


def test_a_ground_stations_word_becomes_an_event_and_is_answered() -> None:
    talk = known()
    (fix,), (ack,) = hear(talk, here())
    assert (fix.t_rx_ns, fix.sigma_m) == (talk.now_ns, 30.0)
    assert (fix.place.lat_deg, fix.place.lon_deg) == pytest.approx((PLACE.lat_deg, PLACE.lon_deg), abs=1e-7)
    assert (ack.command, ack.result) == (43003, mav.MAV_RESULT_ACCEPTED)
    assert (ack.target_system, ack.target_component) == STATION
    assert (ack.get_srcSystem(), ack.get_srcComponent()) == (1, US)


def test_the_long_form_is_taken_to_its_precision() -> None:
    long = mav.MAVLink_command_long_message(1, US, 43003, 0, 0, 0, 0, 0, PLACE.lat_deg, PLACE.lon_deg, 0)
    (fix,), _ = hear(known(), long)
    assert (fix.place.lat_deg, fix.place.lon_deg) == pytest.approx((PLACE.lat_deg, PLACE.lon_deg), abs=4e-6)
    assert fix.sigma_m == operator_position.UNKNOWN_SIGMA_M


@pytest.mark.parametrize(
    ("change", "result"),
    [
        ({"x": 0, "y": 0}, mav.MAV_RESULT_DENIED),
        ({"x": 910_000_000}, mav.MAV_RESULT_DENIED),
        ({"frame": mav.MAV_FRAME_LOCAL_NED}, mav.MAV_RESULT_DENIED),
        ({"param3": -1.0}, mav.MAV_RESULT_DENIED),
        ({"param3": math.inf}, mav.MAV_RESULT_DENIED),
        ({"command": mav.MAV_CMD_COMPONENT_ARM_DISARM}, mav.MAV_RESULT_UNSUPPORTED),
    ],
)
def test_what_is_no_position_is_refused(change: dict[str, object], result: int) -> None:
    fixes, (ack,) = hear(known(), here(**change))
    assert (fixes, ack.result) == ([], result)


@pytest.mark.parametrize(
    ("who", "change"),
    [((254, 190), {}), ((1, 191), {}), (STATION, {"target_system": 2}), (STATION, {"target_component": 0})],
    ids=["stranger", "own vehicle", "another vehicle", "broadcast"],
)
def test_nobody_else_is_heard_and_nothing_is_answered(who: tuple[int, int], change: dict[str, object]) -> None:
    assert hear(known(), here(**change), who) == ([], [])


def test_before_the_origin_it_must_be_said_again() -> None:
    talk = Conversation(MavlinkSession(SessionSettings()), FakeAutopilot(origin=None))
    talk.run(2.0)
    fixes, (ack,) = hear(talk, here())
    assert (fixes, ack.result) == ([], mav.MAV_RESULT_TEMPORARILY_REJECTED)
    assert hear(known(SessionSettings(operator_systems=())), here()) == ([], [])


# ------------------------------------------------------------------------------------------------- from the ground station


class Vehicle(asyncio.DatagramProtocol):
    """Autopilot and daemon behind one port: heartbeats, and what the daemon makes of what comes. Speaks to who is named.

    `n_between`: heartbeats between its acknowledgement and its answer. `word`: "" where the answer is lost.
    """

    def __init__(self, talk: Conversation, n_between: int = 0, word: str = "taken") -> None:
        self.talk, self.n_between, self.word = talk, n_between, word
        self.transport: asyncio.DatagramTransport | None = None

    def connection_made(self, transport: asyncio.DatagramTransport) -> None:  # type: ignore[override]
        self.transport = transport

    def datagram_received(self, data: bytes, addr: tuple[str, int]) -> None:
        assert self.transport is not None
        beat = mav.MAVLink_heartbeat_message(mav.MAV_TYPE_QUADROTOR, mav.MAV_AUTOPILOT_ARDUPILOTMEGA, 0, 0, 4, 3)
        self.transport.sendto(said_by((1, 1), beat), addr)
        self.talk.session.outgoing()
        fixes = [e for e in self.talk.session.receive(data, self.talk.now_ns) if isinstance(e, OperatorFix)]
        self.transport.sendto(self.talk.session.outgoing(), addr)
        if fixes:
            found = Notice(Severity.WARNING, "visloc: position found on the map", to_operator=True)
            self.talk.session.notify(found, self.talk.now_ns)
        for _ in range(self.n_between if fixes else 0):
            self.transport.sendto(said_by((1, 1), beat), addr)
        for fix in fixes if self.word else []:
            text = f"visloc: position {self.word}, {fix.sigma_m:.0f}"
            self.talk.session.notify(Notice(Severity.NOTICE, text, to_operator=True), self.talk.now_ns)
        out = self.talk.session.outgoing()
        if out:
            self.transport.sendto(out, addr)


@asynccontextmanager
async def vehicle(talk: Conversation | None = None, n_between: int = 0, word: str = "taken") -> AsyncIterator[str]:
    end = Vehicle(talk or known(), n_between, word)
    transport, _ = await asyncio.get_running_loop().create_datagram_endpoint(lambda: end, local_addr=("127.0.0.1", 0))
    try:
        yield f"udpout:127.0.0.1:{transport.get_extra_info('sockname')[1]}"
    finally:
        transport.close()


async def test_the_command_reaches_the_daemon_and_its_answer_comes_back() -> None:
    async with vehicle() as url:
        assert await say_here(url, PLACE, 25.0, Caller(), open_own_channel, 0.1) == "visloc: position taken, 25"


async def test_each_call_is_answered_though_the_answer_repeats_the_last() -> None:
    async with vehicle(word="refused") as url:
        answers = [await say_here(url, PLACE, 25.0, Caller(), open_own_channel, 0.1) for _ in range(3)]
    assert answers == ["visloc: position refused, 25"] * 3


async def test_a_busy_link_does_not_hide_the_answer() -> None:
    async with vehicle(n_between=50) as url:
        assert await say_here(url, PLACE, 25.0, Caller(), open_own_channel, 0.1) == "visloc: position taken, 25"


async def test_an_answer_that_is_lost_is_not_taken_for_a_yes() -> None:
    async with vehicle(word="") as url:
        with pytest.raises(LinkError, match=r"its answer did not come: taken or refused\?; remedy: look at its texts"):
            await say_here(url, PLACE, 25.0, Caller(), open_own_channel, 0.02)


async def test_a_daemon_that_does_not_know_the_ground_station_does_not_answer() -> None:
    async with vehicle() as url:
        with pytest.raises(LinkError, match="no daemon answers as component 197"):
            await say_here(url, PLACE, 25.0, Caller(system_id=254), open_own_channel, 0.02)


async def test_a_refusal_and_a_silent_vehicle_are_told_apart() -> None:
    async with vehicle() as url:
        with pytest.raises(LinkError, match="refuses: it is no place to fly"):
            await say_here(url, GeoPoint(0.0, 0.0, 0.0), 25.0, Caller(), open_own_channel, 0.1)
    with pytest.raises(LinkError, match="no autopilot is heard"):
        await say_here("udpin:127.0.0.1:0", PLACE, 25.0, Caller(), open_own_channel, 0.01)


async def test_a_daemon_that_is_not_ready_is_asked_again() -> None:
    talk = Conversation(MavlinkSession(SessionSettings()), FakeAutopilot(origin=None))
    talk.run(2.0)
    async with vehicle(talk) as url:
        with pytest.raises(LinkError, match="no origin from the autopilot yet"):
            await say_here(url, PLACE, 25.0, Caller(), open_own_channel, 0.02)
        asked = asyncio.create_task(say_here(url, PLACE, 25.0, Caller(), open_own_channel, 0.1))
        await asyncio.sleep(0.15)
        assert not asked.done()
        talk.autopilot.origin = ORIGIN
        talk.run(5.0, until=lambda: talk.session.origin is not None)
        assert await asked == "visloc: position taken, 25"


async def test_where_there_is_a_key_only_its_holder_is_heard() -> None:
    key = SigningSettings(bytes(range(32)), stamp_at_zero=stamp_at_zero(time.time_ns(), time.monotonic_ns()))
    other = SigningSettings(bytes(32), stamp_at_zero=key.stamp_at_zero)
    for caller, heard in ((key, True), (None, False), (other, False)):
        signed = MavlinkSession(SessionSettings(system_id=1, signing=key))
        signed.receive(b"", time.monotonic_ns())
        call = mav.MAVLink(None, *STATION)
        if caller is not None:
            call.signing.secret_key, call.signing.sign_outgoing = caller.key, True
            call.signing.timestamp = caller.stamp_at_zero + time.monotonic_ns() // 10_000
        signed.receive(bytes(here().pack(call)), time.monotonic_ns())
        answered = any(m.get_type() == "COMMAND_ACK" for m in Framer().feed(signed.outgoing()))
        assert answered is heard
