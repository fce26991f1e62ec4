"""Texts for the ground station: pieces that fit together again, repeats and floods held back."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from visloc_companion.adapters.mavlink.dialect import mav
from visloc_companion.adapters.mavlink.texts import BURST, MAX_LENGTH, TextSender
from visloc_companion.types import Notice, Severity

S = 1_000_000_000


def note(text, severity=Severity.WARNING):
    return Notice(severity, text, to_operator=True)


def received(messages):
    """The messages as they come out of the wire: (id, chunk_seq, text)."""
    parser, packer = mav.MAVLink(None), mav.MAVLink(None, 1, 197)
    decoded = [parser.decode(bytearray(message.pack(packer))) for message in messages]
    return [(message.id, message.chunk_seq, message.text) for message in decoded]


@given(text=st.text(st.characters(min_codepoint=32, max_codepoint=126), min_size=51, max_size=300))
def test_pieces_fit_together_and_the_last_is_short(text):
    pieces = received(TextSender().messages(note(text), 0))
    assert "".join(piece for _, _, piece in pieces) == text[:MAX_LENGTH]
    assert [(number, sequence) for number, sequence, _ in pieces] == [(1, i) for i in range(len(pieces))]
    assert [len(piece) == 50 for _, _, piece in pieces] == [True] * (len(pieces) - 1) + [False]


@pytest.mark.parametrize("text", ["short", "x" * 50])
def test_what_fits_is_one_message_of_its_own(text):
    assert received(TextSender().messages(note(text), 0)) == [(0, 0, text)]


def test_ids_differ_and_are_never_zero():
    sender = TextSender()
    sender._id = 65534
    numbers = [received(sender.messages(note(f"{i}" * 60), 0))[0][0] for i in range(3)]
    assert numbers == [65535, 1, 2]


def test_a_repeat_is_held_back_for_ten_seconds():
    sender = TextSender()
    sent = [bool(sender.messages(note("again"), t * S)) for t in range(12)]
    assert sent == [True] + [False] * 9 + [True, False]
    assert sender.held_back == {Severity.WARNING: 10}


def test_a_state_that_comes_back_is_said_again():
    sender = TextSender()
    assert [bool(sender.messages(note(text), i)) for i, text in enumerate(["off", "sure", "off"])] == [True, True, True]


def test_a_flood_is_cut_and_critical_texts_still_pass():
    sender = TextSender()
    assert sum(bool(sender.messages(note(f"text {i}"), 0)) for i in range(100)) == BURST
    assert sender.messages(note("falling", Severity.CRITICAL), 0)
    assert sum(bool(sender.messages(note(f"later {i}"), 3 * S)) for i in range(100)) == 3
    assert sum(bool(sender.messages(note(f"worse {i}", Severity.CRITICAL), 0)) for i in range(100)) == BURST - 1
