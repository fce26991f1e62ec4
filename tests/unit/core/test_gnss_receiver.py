from __future__ import annotations

from dataclasses import replace

import pytest

from visloc_companion.core.gnss_receiver import Talk, integrity_signs, receiver_sign, receivers_apart_m
from visloc_companion.core.settings import GnssSettings
from visloc_companion.geo import wgs84
from visloc_companion.types import GeoPoint, Gnss, GnssIntegrity

S = 1_000_000_000
HERE = GeoPoint(59.0, 18.0, 50.0)
FIRST = Gnss(10 * S, 0, 3, 14, HERE, 1.0, 1.5, (0.0, 10.0, 0.0))
LIMITS = GnssSettings()


def second(east_m: float, **changes: object) -> Gnss:
    place = wgs84.geo_from_ned((0.0, east_m, 0.0), HERE)
    return replace(FIRST, receiver=1, place=place, **changes)  # type: ignore[arg-type]


def test_two_receivers_that_see_different_places() -> None:
    assert receivers_apart_m(FIRST, second(30.0), LIMITS) == pytest.approx(30.0, abs=0.01)
    assert receiver_sign(FIRST, second(30.0), 1.5, LIMITS) == ("receivers_differ",)
    assert receiver_sign(FIRST, second(12.0), 1.5, LIMITS) == ()  # 5 m of antennas, 5 m of delay, 8.5 m of noise
    assert receiver_sign(replace(FIRST, v_ned_mps=None), second(14.0), 1.5, LIMITS) == ("receivers_differ",)


@pytest.mark.parametrize("other", [None, second(90.0, fix_type=1), second(90.0, t_rx_ns=5 * S)])
def test_receivers_that_cannot_be_compared(other: Gnss | None) -> None:
    assert receivers_apart_m(FIRST, other, LIMITS) is None
    assert receiver_sign(FIRST, other, 1.5, LIMITS) == ()


def test_a_receiver_that_knows_no_place_yet_is_not_compared() -> None:
    assert receivers_apart_m(FIRST, replace(FIRST, receiver=1, place=GeoPoint(0.0, 0.0, 0.0)), LIMITS) is None


def test_what_the_receiver_says_of_interference() -> None:
    report = GnssIntegrity(10 * S, 0, jammed=True, spoofed=True, authentic=False)
    signs = ("receiver_spoofing", "receiver_authentication", "receiver_jamming")
    assert integrity_signs(report, 11 * S, vision_agrees=False) == signs
    assert integrity_signs(report, 11 * S, vision_agrees=True) == signs[:2]  # jamming that does no harm
    assert integrity_signs(report, 30 * S, vision_agrees=False) == ()
    assert integrity_signs(GnssIntegrity(10 * S, 0, False, None, None), 10 * S, vision_agrees=False) == ()
    assert integrity_signs(None, 10 * S, vision_agrees=False) == ()


def test_silence_counts_only_while_the_autopilot_talks() -> None:
    talk = Talk()
    assert not talk.silent(2 * S, 0, 2.0)
    assert talk.silent(3 * S, 0, 2.0)
    for k in range(5, 8):
        talk.heard(k * S)
        assert not talk.silent(k * S, 0, 2.0)  # the link has just come back
    talk.heard(8 * S)
    assert talk.silent(8 * S, 0, 2.0)
    assert not talk.silent(20 * S, 0, 2.0)
