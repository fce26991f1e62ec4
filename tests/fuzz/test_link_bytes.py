"""Whatever comes over the link: the session never raises, stays small, and works afterwards."""

import math
import struct

from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from visloc_companion.adapters.mavlink.dialect import mav
from visloc_companion.adapters.mavlink.framing import MAX_PENDING, Framer
from visloc_companion.adapters.mavlink.outputs.vision_position import vision_position_estimate
from visloc_companion.adapters.mavlink.session import MavlinkSession
from visloc_companion.adapters.mavlink.settings import SessionSettings
from visloc_companion.testing.conversation import Conversation
from visloc_companion.testing.fake_autopilot import FakeAutopilot
from visloc_companion.types import Attitude, AutopilotKind, GeoPoint, Injection, Range

QUICK = settings(max_examples=150, suppress_health_check=[HealthCheck.too_slow])
T = 1_000_000_000
KNOWN_IDS = sorted(i for i in mav.mavlink_map if i >= 0)
OURS = (0, 24, 30, 31, 32, 33, 49, 77, 22, 111, 124, 132, 148, 173, 193, 230, 29)


def frame(message_id: int, payload: bytes, system: int = 1, component: int = 1) -> bytes:
    """A MAVLink 2 frame with a right checksum around any payload."""
    head = bytes((len(payload), 0, 0, 0, system, component)) + message_id.to_bytes(3, "little")
    crc = mav.x25crc(head + payload + bytes((mav.mavlink_map[message_id].crc_extra,))).crc
    return b"\xfd" + head + payload + struct.pack("<H", crc)


def attitude(n: int) -> bytes:
    return bytes(mav.MAVLink_attitude_message(n, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6).pack(mav.MAVLink(None, 1, 1)))


def talking() -> Conversation:
    conversation = Conversation(MavlinkSession(SessionSettings()), FakeAutopilot())
    conversation.run(1.5)
    assert conversation.session.link.up
    return conversation


def works_afterwards(conversation: Conversation) -> None:
    """Good messages come through, and nothing has grown."""
    session, autopilot = conversation.session, conversation.autopilot
    boot_ms = (conversation.now_ns - conversation.boot_offset_ns) // 1_000_000
    for i in range(12):
        autopilot.send(mav.MAVLink_attitude_message(boot_ms + i, 0.1, 0.2, 0.3, 0.0, 0.0, 0.0))
    autopilot.step(conversation.now_ns - conversation.boot_offset_ns + 1_000_000_000)
    events = session.receive(autopilot.outgoing(), conversation.now_ns)
    events += conversation.run(2.0)
    assert session.link.up
    assert len(session.outgoing()) <= 65_536
    assert sum(isinstance(event, Attitude) for event in events) >= 10


@QUICK
@given(noise=st.lists(st.binary(max_size=400), max_size=8))
def test_random_bytes(noise):
    conversation = talking()
    for piece in noise:
        conversation.session.receive(piece, conversation.now_ns)
    works_afterwards(conversation)


@QUICK
@given(noise=st.lists(st.sampled_from([b"\xfd", b"\xfe", b"\xfd\xff\x00", b"\xfe\xff", b"\x00", b"\xfd\x09\x01"]), max_size=300))
def test_floods_of_start_bytes(noise):
    framer = Framer()
    for piece in noise:
        framer.feed(piece)
        assert framer.pending_bytes <= MAX_PENDING
    good = framer.feed(b"".join(attitude(n) for n in range(20)))
    assert [message.time_boot_ms for message in good][-10:] == list(range(10, 20))


@QUICK
@given(data=st.data())
def test_garbled_and_truncated_packets_lose_only_themselves(data):
    """Each packet is left, cut, or has one bit flipped: every untouched one comes out, and no other but by a rare chance."""
    stream, good = bytearray(), []
    for n in range(12):
        packet = bytearray(attitude(n + 1))
        fate = data.draw(st.sampled_from(["good", "good", "cut", "flip"]))
        if fate == "cut":
            del packet[data.draw(st.integers(1, len(packet) - 1)) :]
        elif fate == "flip":
            bit = data.draw(st.integers(0, 8 * len(packet) - 1))
            packet[bit // 8] ^= 1 << bit % 8
        else:
            good.append(n + 1)
        stream += packet
    stream += attitude(100) + attitude(101)
    framer, got, at = Framer(), [], 0
    while at < len(stream):
        size = data.draw(st.integers(1, 200))
        got += [m.time_boot_ms for m in framer.feed(bytes(stream[at : at + size])) if m.get_type() == "ATTITUDE"]
        at += size
    expected = [*good, 100, 101]
    assert [n for n in got if n in expected] == expected
    assert len(got) - len(expected) <= 1, "a checksum of 16 bits lets one damaged packet of 65,536 pass, hardly two"


@QUICK
@given(message_id=st.sampled_from(OURS), payload=st.binary(min_size=1, max_size=80))
def test_our_messages_with_any_payload(message_id, payload):
    """A right checksum and senseless values: the events that come out are finite."""
    conversation = talking()
    before = conversation.session.link
    events = conversation.session.receive(frame(message_id, payload), conversation.now_ns)
    for event in events:
        numbers = [value for name in event.__slots__ for value in _numbers(getattr(event, name))]
        assert all(map(math.isfinite, numbers))
        if isinstance(event, Range):
            assert event.distance_m < 1e39
    assert conversation.session.link.system_id == before.system_id
    conversation.session.poll(conversation.now_ns)


@QUICK
@given(
    message_id=st.sampled_from(KNOWN_IDS),
    payload=st.binary(min_size=1, max_size=255),
    system=st.integers(0, 255),
    component=st.integers(0, 255),
)
def test_any_known_message_from_anybody(message_id, payload, system, component):
    conversation = talking()
    conversation.session.receive(frame(message_id, payload, system, component), conversation.now_ns)
    conversation.session.poll(conversation.now_ns)
    assert conversation.session.link.system_id == 1
    assert conversation.session.outgoing() is not None


@QUICK
@given(message_id=st.integers(0, 2**24 - 1).filter(lambda i: i not in mav.mavlink_map), payload=st.binary(max_size=255))
def test_unknown_ids(message_id, payload):
    head = bytes((len(payload), 0, 0, 0, 1, 1)) + message_id.to_bytes(3, "little")
    conversation = talking()
    conversation.session.receive(b"\xfd" + head + payload + b"\x00\x00", conversation.now_ns)
    works_afterwards(conversation)


finite = st.floats(-1e6, 1e6)


@QUICK
@given(p=st.tuples(finite, finite, finite), sigma_m=st.floats(0.05, 99.0), kind=st.sampled_from(list(AutopilotKind)[:2]))
def test_positions_and_their_sigma_survive_the_wire(p, sigma_m, kind):
    cov = ((sigma_m**2, 0.0), (0.0, sigma_m**2))
    injection = Injection(T, p, GeoPoint(1.0, 2.0, 3.0), (1.0, 0.0, 0.0, 0.0), cov, sigma_m, 0.1, 9)
    autopilot = FakeAutopilot(kind=kind)
    autopilot.receive(vision_position_estimate(injection, kind).pack(mav.MAVLink(None, 1, 197)))
    pose = autopilot.poses[0]
    assert all(abs(got - sent) <= 1e-7 * abs(sent) + 1e-30 for got, sent in zip((pose.x, pose.y, pose.z), p, strict=True))
    assert math.isclose(autopilot.believed_sigma_m(), sigma_m, rel_tol=1e-4)


def _numbers(value: object) -> list[float]:
    if isinstance(value, bool | str) or value is None:
        return []
    if isinstance(value, int | float):
        return [float(value)]
    if isinstance(value, tuple):
        return [number for part in value for number in _numbers(part)]
    return [number for name in getattr(value, "__slots__", ()) for number in _numbers(getattr(value, name))]
