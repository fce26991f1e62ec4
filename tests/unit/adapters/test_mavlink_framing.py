"""Bytes to messages: pieces, noise, false starts, unknown ids, MAVLink 1, signatures."""

import random

import pytest
from pymavlink.dialects.v10 import ardupilotmega as v10
from pymavlink.dialects.v20 import development

from visloc_companion.adapters.mavlink.dialect import mav
from visloc_companion.adapters.mavlink.framing import MAX_PENDING, Framer


def attitude(n: int) -> bytes:
    return bytes(mav.MAVLink_attitude_message(n, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6).pack(mav.MAVLink(None, 1, 1)))


def times(messages: list[object]) -> list[int]:
    return [message.time_boot_ms for message in messages]  # type: ignore[attr-defined]


@pytest.mark.parametrize("piece", [1, 7, 30, 1000])
def test_any_pieces_give_the_same_messages(piece):
    data = b"".join(attitude(n) for n in range(50))
    framer = Framer()
    messages = [m for i in range(0, len(data), piece) for m in framer.feed(data[i : i + piece])]
    assert times(messages) == list(range(50))
    assert (framer.counts.garbage_bytes, framer.pending_bytes) == (0, 0)


def test_garbage_between_messages_is_counted_and_loses_none():
    rng = random.Random(1)
    noise = [bytes(b for b in rng.randbytes(rng.randrange(60)) if b not in (0xFD, 0xFE)) for _ in range(100)]
    framer = Framer()
    messages = framer.feed(b"".join(noise[n] + attitude(n) for n in range(100)))
    assert times(messages) == list(range(100))
    assert framer.counts.garbage_bytes == sum(map(len, noise))


@pytest.mark.parametrize("false_start", [b"\xfd", b"\xfe", b"\xfd\xff\x00", b"\xfe\xff", b"\xfd\xff\x01", b"\xfd\x21\x02"])
def test_a_false_start_does_not_swallow_what_follows(false_start):
    """pymavlink's own parser loses up to 280 bytes of good messages here."""
    framer = Framer()
    assert times(framer.feed(false_start + attitude(1) + attitude(2))) == [1, 2]
    assert framer.counts.garbage_bytes == len(false_start)


def test_a_wrong_checksum_costs_one_message():
    broken = bytearray(attitude(2))
    broken[15] ^= 0x40
    framer = Framer()
    assert times(framer.feed(attitude(1) + bytes(broken) + attitude(3))) == [1, 3]
    assert framer.counts.garbage_bytes == len(broken)


def test_a_truncated_message_gives_way_to_the_next():
    framer = Framer()
    assert times(framer.feed(attitude(1)[:20])) == []
    assert times(framer.feed(attitude(2))) == [2]


def test_mavlink_1_is_read_too():
    data = v10.MAVLink_attitude_message(77, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6).pack(v10.MAVLink(None, 1, 1))
    assert data[0] == 0xFE
    assert times(Framer().feed(data)) == [77]


def test_a_signed_message_is_read():
    packer = mav.MAVLink(None, 1, 1)
    packer.signing.secret_key = b"0" * 32
    packer.signing.sign_outgoing = True
    data = mav.MAVLink_attitude_message(5, 0, 0, 0, 0, 0, 0).pack(packer)
    framer = Framer()
    assert times(framer.feed(data + attitude(6))) == [5, 6]
    assert framer.counts.garbage_bytes == 0


def test_a_message_of_another_dialect_is_unknown_not_garbage():
    unknown_id = next(i for i in development.mavlink_map if i not in mav.mavlink_map)
    payload = bytes(12)
    frame = bytes((0xFD, len(payload), 0, 0, 0, 1, 1)) + unknown_id.to_bytes(3, "little") + payload + b"\x12\x34"
    framer = Framer()
    assert times(framer.feed(attitude(1) + frame + attitude(2))) == [1, 2]
    assert (framer.counts.unknown, framer.counts.garbage_bytes) == (1, 0)


@pytest.mark.parametrize("inside", [b"\xfd\x40\x00", b"\xfe\x60"])
def test_an_unknown_message_that_holds_start_bytes_is_no_garbage_where_a_good_one_follows(inside):
    """PX4 sends many that our dialect lacks; each start byte in their payloads was reported as damage on the link."""
    unknown_id = next(i for i in development.mavlink_map if i not in mav.mavlink_map)
    payload = b"\x01\x02" + inside + bytes(20)
    frame = bytes((0xFD, len(payload), 0, 0, 0, 1, 1)) + unknown_id.to_bytes(3, "little") + payload + b"\x12\x34"
    framer = Framer()
    messages = [*framer.feed(attitude(1) + frame), *framer.feed(attitude(2))]
    assert times(messages) == [1, 2]
    assert (framer.counts.unknown, framer.counts.garbage_bytes) == (1, 0)


@pytest.mark.parametrize("cut", range(1, 40))
def test_a_cut_message_that_reads_as_an_unknown_one_does_not_swallow_the_next(cut):
    """Cut inside its header, the id comes from the next message; byte by byte the claimed length ends inside that one."""
    framer = Framer()
    data = attitude(1)[:cut] + attitude(2) + attitude(3)
    assert times([m for i in range(len(data)) for m in framer.feed(data[i : i + 1])]) == [2, 3]


def test_a_flood_of_start_bytes_keeps_memory_bounded():
    framer = Framer()
    for _ in range(20):
        framer.feed(b"\xfd" * 500 + b"\xfe\xff" * 200)
        assert framer.pending_bytes <= MAX_PENDING
    assert times(framer.feed(attitude(9) + attitude(10)))[-1] == 10
