"""Signing: the same bytes as pymavlink's, and what is believed."""

import hashlib

import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from visloc_companion.adapters.mavlink.dialect import mav
from visloc_companion.adapters.mavlink.framing import Framer
from visloc_companion.adapters.mavlink.outbox import Outbox
from visloc_companion.adapters.mavlink.session import MavlinkSession
from visloc_companion.adapters.mavlink.settings import SessionSettings
from visloc_companion.adapters.mavlink.signing import (
    MAX_STREAMS,
    UNITS_PER_S,
    Refusal,
    SignatureGuard,
    SigningSettings,
    SigningTime,
    is_signed,
    signature,
    stamp_at_zero,
)
from visloc_companion.testing.conversation import Conversation
from visloc_companion.testing.fake_autopilot import FakeAutopilot
from visloc_companion.testing.signing_peer import PymavlinkSigning
from visloc_companion.types import Attitude, EkfSource, Notice, Severity, SourceSwitched, SwitchSource

KEY, OTHER_KEY = hashlib.sha256(b"key").digest(), hashlib.sha256(b"another").digest()
YEAR_2026 = 11 * 365 * 86_400 * UNITS_PER_S
BEGIN_UNITS = 1000 * UNITS_PER_S
"""Conversations begin 1000 s after our clock's zero."""
SIGNED = SigningSettings(KEY, stamp_at_zero=YEAR_2026)
ARMED = mav.MAVLink_heartbeat_message(mav.MAV_TYPE_QUADROTOR, mav.MAV_AUTOPILOT_ARDUPILOTMEGA, 128, 0, 4, 3)


def attitude(stamp, key=KEY, link_id=0, system=1, component=1, n=1):
    """An ATTITUDE as pymavlink signs it; unsigned where the key is None."""
    packer = mav.MAVLink(None, system, component)
    packer.signing.secret_key, packer.signing.sign_outgoing = key, key is not None
    packer.signing.timestamp, packer.signing.link_id = stamp, link_id
    return bytes(mav.MAVLink_attitude_message(n, 0.1, 0.2, 0.3, 0.0, 0.0, 0.0).pack(packer))


class Bench:
    """A guard and what it warned of."""

    def __init__(self, signing=SIGNED):
        self.told = []
        self.time = SigningTime(signing.stamp_at_zero)
        self.guard = SignatureGuard(signing, self.time, self.told.append)

    def admits(self, packet, message_id=mav.MAVLINK_MSG_ID_ATTITUDE):
        return self.guard.admits(packet, message_id)


def signed_conversation(peer_stamp=YEAR_2026, peer_key=KEY, signing=SIGNED):
    autopilot = FakeAutopilot(signing=PymavlinkSigning(peer_key, peer_stamp, link_id=1))
    begins = SigningSettings(signing.key, stamp_at_zero=signing.stamp_at_zero - BEGIN_UNITS)
    return Conversation(MavlinkSession(SessionSettings(signing=begins)), autopilot)


# ------------------------------------------------------------------------------------------------------------ the bytes


@given(stamp=st.integers(0, 2**48 - 1), link_id=st.integers(0, 255), key=st.binary(min_size=32, max_size=32))
@settings(max_examples=50)
def test_the_signature_is_that_of_pymavlink(stamp, link_id, key):
    packet = attitude(stamp, key, link_id)
    assert is_signed(packet)
    assert signature(key, packet[:-6]) == packet[-6:]
    assert packet[-13] == link_id
    assert int.from_bytes(packet[-12:-6], "little") == stamp


def test_what_the_outbox_signs_pymavlink_believes():
    time = SigningTime(YEAR_2026)
    outbox = Outbox(197, SigningSettings(KEY, link_id=7), time)
    receiver = mav.MAVLink(None)
    receiver.signing.secret_key = KEY
    for _ in range(3):
        outbox.put(mav.MAVLink_timesync_message(0, 5))
    assert [receiver.decode(bytearray(packet)).get_type() for packet in outbox.drain()] == ["TIMESYNC"] * 3
    assert receiver.signing.stream_timestamps == {(7, 1, 197): YEAR_2026 + 3}


def test_stamps_count_ten_microseconds_since_2015():
    unix_ns = 1_420_070_400 * 10**9 + 2 * 10**9
    time = SigningTime(stamp_at_zero(unix_ns, 500_000_000))
    time.advance(500_000_000)
    assert time.latest == 2 * UNITS_PER_S


def test_stamps_rise_whatever_the_clock_does():
    time = SigningTime(stamp_at_zero(0, 0))  # a machine that thinks it is 1970
    first = time.next()
    time.advance(10**9)
    assert (first, time.next()) == (1, 2)
    time.heard(YEAR_2026)
    time.advance(2 * 10**9)
    assert time.next() == YEAR_2026 + 1
    time.heard(2**48 - 1)
    assert time.next() == 2**48 - 1


# ------------------------------------------------------------------------------------------------------------ the judgement


def test_a_right_signature_is_believed_once():
    bench, packet = Bench(), attitude(YEAR_2026)
    assert bench.admits(packet)
    assert not bench.admits(packet)
    assert not bench.admits(attitude(YEAR_2026 - 1))
    assert bench.admits(attitude(YEAR_2026 + 1))
    assert bench.guard.counts == {Refusal.REPLAYED: 2}


def test_each_stream_has_its_own_time():
    bench = Bench()
    assert bench.admits(attitude(YEAR_2026 + 10))
    assert bench.admits(attitude(YEAR_2026, link_id=1))
    assert bench.admits(attitude(YEAR_2026, component=2))
    assert bench.admits(attitude(YEAR_2026, system=2))


def test_a_new_stream_may_be_a_minute_old_and_no_more():
    bench, minute = Bench(), 60 * UNITS_PER_S
    assert not bench.admits(attitude(YEAR_2026 - minute - 1))
    assert bench.admits(attitude(YEAR_2026 - minute))
    assert bench.guard.counts == {Refusal.STALE: 1}


def test_a_forged_stamp_of_the_future_shuts_nobody_out():
    """pymavlink's own check notes the stamp first."""
    bench = Bench()
    assert not bench.admits(attitude(2**48 - 1, OTHER_KEY))
    assert bench.admits(attitude(YEAR_2026))
    assert bench.time.latest == YEAR_2026


def test_our_time_follows_a_holder_of_the_key():
    bench = Bench(SigningSettings(KEY, stamp_at_zero=-5))
    assert bench.admits(attitude(YEAR_2026))
    assert bench.time.next() == YEAR_2026 + 1


def test_unsigned_packets():
    bench, open_bench = Bench(), Bench(SigningSettings(KEY, accept_unsigned=True, stamp_at_zero=YEAR_2026))
    packet = attitude(0, key=None)
    assert not bench.admits(packet)
    assert open_bench.admits(packet)
    assert not open_bench.admits(attitude(YEAR_2026, OTHER_KEY)), "a wrong signature is worse than none"
    for radio in (mav.MAVLINK_MSG_ID_RADIO_STATUS, mav.MAVLINK_MSG_ID_RADIO):
        assert bench.admits(packet, radio)


def test_a_packet_of_version_1_is_unsigned():
    packet = bytes(mav.MAVLink_attitude_message(1, 0, 0, 0, 0, 0, 0).pack(mav.MAVLink(None, 1, 1), force_mavlink1=True))
    bench = Bench()
    assert not bench.admits(packet)
    assert bench.guard.counts == {Refusal.UNSIGNED: 1}


def test_streams_are_bounded():
    bench = Bench()
    admitted = [bench.admits(attitude(YEAR_2026, system=system)) for system in range(1, MAX_STREAMS + 3)]
    assert admitted == [True] * MAX_STREAMS + [False, False]


def test_each_reason_is_told_once():
    bench = Bench()
    for _ in range(3):
        bench.admits(attitude(YEAR_2026, OTHER_KEY))
        bench.admits(attitude(0, key=None))
    assert len(bench.told) == 2
    assert any("wrong signature" in text for text in bench.told)
    assert any("unsigned" in text for text in bench.told)


def test_who_does_not_sign_is_named():
    """An unsigned ground station on the link is no reason to look for the fault in the autopilot."""
    bench = Bench()
    bench.admits(bytearray(mav.MAVLink(None, 255, 190).heartbeat_encode(6, 8, 0, 0, 4, 3).pack(mav.MAVLink(None, 255, 190))))
    bench.admits(attitude(YEAR_2026, OTHER_KEY))
    assert "system 255" in bench.told[0]
    assert "system" not in bench.told[1]


def test_who_does_not_sign_is_named_in_mavlink_1_too():
    bench = Bench()
    packer = mav.MAVLink(None, 200, 190)
    bench.admits(bytearray(packer.heartbeat_encode(6, 8, 0, 0, 4, 3).pack(packer, force_mavlink1=True)))
    assert "system 200" in bench.told[0]


def test_the_key_shows_in_no_text():
    assert repr(KEY) not in repr(SessionSettings(signing=SIGNED))
    assert KEY.hex() not in repr(SIGNED)


# ------------------------------------------------------------------------------------------------------------ the session


def test_a_signed_conversation():
    conversation = signed_conversation()
    conversation.run(3.0)
    session, autopilot = conversation.session, conversation.autopilot
    assert session.link.up
    assert session.link.version == "4.6.3"
    session.switch(SwitchSource(EkfSource.VISION), conversation.now_ns)
    switched = [event for event in conversation.run(2.0) if isinstance(event, SourceSwitched)]
    assert [event.accepted for event in switched] == [True]
    assert (autopilot.source_set, autopilot.signing.refused, sum(session.unbelieved.values())) == (2, 0, 0)


@pytest.mark.parametrize("system_id", [0, 1])
def test_who_has_no_key_changes_nothing(system_id):
    """Unsigned, signed with another key, or recorded: neither the pin, nor the state, nor an event comes of it."""
    session = MavlinkSession(SessionSettings(system_id=system_id, signing=SIGNED))
    stranger = FakeAutopilot(system_id=9)
    forger = FakeAutopilot(signing=PymavlinkSigning(OTHER_KEY, YEAR_2026))
    for peer in (stranger, forger):
        peer.send(ARMED)
        peer.send(mav.MAVLink_attitude_message(5, 0, 0, 0, 0, 0, 0))
        assert session.receive(peer.outgoing(), 10**9) == []
    assert (session.link.up, session.n_heard) == (False, 0)
    conversation = Conversation(session, FakeAutopilot(signing=PymavlinkSigning(KEY, YEAR_2026)))
    conversation.run(2.0)
    assert session.link.system_id == 1
    known = session.link
    for peer in (stranger, forger):
        peer.send(ARMED)
        peer.send(mav.MAVLink_attitude_message(2**31, 0, 0, 0, 0, 0, 0))
        assert session.receive(peer.outgoing(), conversation.now_ns) == []
    assert session.link == known


def test_a_stranger_that_holds_the_key_is_still_a_stranger():
    """One key for several vehicles: signing does not replace the pin."""
    conversation = signed_conversation()
    conversation.run(2.0)
    other = FakeAutopilot(system_id=2, signing=PymavlinkSigning(KEY, YEAR_2026 + 10**6))
    other.send(ARMED)
    other.send(mav.MAVLink_attitude_message(2**31, 0, 0, 0, 0, 0, 0))
    assert conversation.session.receive(other.outgoing(), conversation.now_ns) == []
    assert not conversation.session.link.armed


def test_a_replayed_recording_changes_nothing():
    conversation = signed_conversation()
    recorded = bytearray()
    conversation.run(1.5)
    autopilot = conversation.autopilot
    autopilot.send(ARMED)
    recorded += autopilot.outgoing()
    assert conversation.session.receive(bytes(recorded), conversation.now_ns) != []
    autopilot.send(mav.MAVLink_heartbeat_message(2, 3, 0, 0, 3, 3))
    conversation.session.receive(autopilot.outgoing(), conversation.now_ns)
    assert conversation.session.receive(bytes(recorded), conversation.now_ns) == []
    assert not conversation.session.link.armed


@pytest.mark.parametrize(
    ("ours", "theirs"),
    [(YEAR_2026, 0), (0, YEAR_2026), (-YEAR_2026, YEAR_2026), (2 * YEAR_2026, YEAR_2026)],
    ids=["autopilot without time", "our clock in 2015", "our clock before 2015", "our clock in the future"],
)
def test_wrong_clocks_find_each_other(ours, theirs):
    conversation = signed_conversation(theirs, signing=SigningSettings(KEY, stamp_at_zero=ours))
    conversation.run(4.0)
    assert conversation.session.link.up
    assert conversation.session.link.version == "4.6.3", "what we send is believed, too"


def test_an_autopilot_that_signs_without_our_key_is_told_of():
    conversation = Conversation(MavlinkSession(SessionSettings()), FakeAutopilot(signing=PymavlinkSigning(KEY, YEAR_2026)))
    conversation.run(2.0)
    assert conversation.session.link.up
    told = [text for text in conversation.session.warnings() if "are signed" in text]
    assert len(told) == 1
    assert conversation.session.unbelieved == {}


def test_texts_go_out_signed():
    conversation = signed_conversation()
    conversation.run(2.0)
    conversation.session.notify(Notice(Severity.WARNING, "hello", to_operator=True), conversation.now_ns)
    packets = conversation.session.packets()
    assert packets
    assert all(is_signed(packet) for packet in packets)


# ------------------------------------------------------------------------------------------------------------ fuzzing


@given(data=st.data())
@settings(max_examples=200)
def test_no_damaged_packet_is_believed(data):
    """A flipped bit, with or without a checksum that was made to fit, or a cut: never believed, and the good ones behind it are.

    Only the very next one may be lost: its first bytes stand where the signature was cut off.
    """
    bench = Bench()
    framer = Framer(bench.guard.admits)
    packet = bytearray(attitude(YEAR_2026, n=1))
    bit = data.draw(st.integers(8, 8 * len(packet) - 1))
    packet[bit // 8] ^= 1 << bit % 8
    if data.draw(st.booleans()):
        crc_extra = bytes((mav.MAVLink_attitude_message.crc_extra,))
        packet[-15:-13] = mav.x25crc(bytes(packet[1:-15]) + crc_extra).crc.to_bytes(2, "little")
    if data.draw(st.booleans()):
        del packet[data.draw(st.integers(1, len(packet) - 1)) :]
    assume(packet != attitude(YEAR_2026, n=1))  # a checksum's bit that was made to fit again
    got = framer.feed(bytes(packet) + b"".join(attitude(YEAR_2026 + i, n=i) for i in range(2, 6)) + bytes(300))
    seen = [message.time_boot_ms for message in got if message.get_type() == "ATTITUDE"]
    assert seen in ([2, 3, 4, 5], [3, 4, 5])


@given(order=st.permutations(range(6)), repeats=st.lists(st.integers(0, 5), max_size=6))
@settings(max_examples=100)
def test_only_rising_stamps_are_believed(order, repeats):
    """Any order and any repeats: what is believed is the sequence of new maxima."""
    bench = Bench()
    sequence = [*order, *repeats]
    believed = [n for n in sequence if bench.admits(attitude(YEAR_2026 + n))]
    maxima = [n for i, n in enumerate(sequence) if all(n > before for before in sequence[:i])]
    assert believed == maxima


@given(noise=st.binary(max_size=600))
@settings(max_examples=100)
def test_noise_is_never_believed(noise):
    conversation = signed_conversation()
    conversation.run(1.5)
    events = conversation.session.receive(noise, conversation.now_ns)
    assert events == []
    conversation.autopilot.send(mav.MAVLink_attitude_message(2_000_000, 0, 0, 0, 0, 0, 0))
    packets = conversation.autopilot.outgoing() + bytes(300)
    assert any(isinstance(event, Attitude) for event in conversation.session.receive(packets, conversation.now_ns))
