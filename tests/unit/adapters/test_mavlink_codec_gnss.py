"""Interference, GNSS time and the second receiver."""

import pytest
from pymavlink.dialects.v20 import development

from visloc_companion.adapters.mavlink.codec import decode
from visloc_companion.adapters.mavlink.dialect import mav
from visloc_companion.adapters.mavlink.framing import Framer
from visloc_companion.types import Gnss, GnssIntegrity, GnssTime

T = 5_000_000_000


def one(msg):
    (event,) = decode(msg, T)
    assert event.t_rx_ns == T
    return event


def integrity(authentication=0, jamming=0, spoofing=0, receiver=0):
    return development.MAVLink_gnss_integrity_message(receiver, 0, authentication, jamming, spoofing, 0, 0, 0, 0, 0, 0, 0)


@pytest.mark.parametrize(("state", "seen"), [(0, None), (1, False), (2, False), (3, True)])
def test_states_of_interference(state, seen):
    event = one(integrity(jamming=state, receiver=1))
    assert event == GnssIntegrity(T, 1, seen, None, None)
    assert one(integrity(spoofing=state)).spoofed is seen


@pytest.mark.parametrize(("state", "authentic"), [(0, None), (1, None), (2, False), (3, True), (4, None)])
def test_authentication(state, authentic):
    assert one(integrity(authentication=state)).authentic is authentic


def test_gnss_integrity_comes_through_the_live_parser():
    packed = integrity(jamming=3).pack(mav.MAVLink(None, srcSystem=1, srcComponent=1))
    (message,) = Framer().feed(bytes(packed))
    assert one(message).jammed is True


@pytest.mark.parametrize(
    ("text", "jammed", "spoofed"),
    [
        (b"GNSS signal spoofed\t", None, True),
        (b"Preflight Fail: GPS signal spoofed\t", None, True),
        (b"GNSS signal jammed\t", True, None),
        (b"Preflight Fail: GPS signal jammed\t", True, None),
        (b"GPS reports critical jamming state\t", True, None),
    ],
)
def test_texts_of_px4(text, jammed, spoofed):
    assert one(mav.MAVLink_statustext_message(2, text)) == GnssIntegrity(T, 0, jammed, spoofed, None)


def test_other_texts_say_nothing():
    assert decode(mav.MAVLink_statustext_message(4, b"GPS 1: detected u-blox"), T) == []


def test_gnss_time_stands_beside_boot_time_once_there_is_one():
    unix_us = 1_750_000_000_000_000
    assert one(mav.MAVLink_system_time_message(unix_us, 12_345)) == GnssTime(T, 12_345_000_000, unix_us * 1000)
    assert decode(mav.MAVLink_system_time_message(0, 12_345), T) == []


def test_a_place_off_the_globe_is_dropped():
    args = (0, 3, 910_000_000, 180_000_000, 40_000, 100, 100, 0, 0, 12)
    assert decode(mav.MAVLink_gps_raw_int_message(*args), T) == []
    assert isinstance(one(mav.MAVLink_gps_raw_int_message(*args[:2], 590_000_000, *args[3:])), Gnss)
