from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest

from visloc_companion.core.satellites.gnss_receiver import (
    Interference,
    Reports,
    Talk,
    receiver_sign,
    receiver_signs,
    receivers_apart_m,
)
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


def signs(first: Gnss, other: Gnss, now_ns: int = 10 * S) -> tuple[str, ...]:
    reports = Reports()
    reports.on_gnss(first)
    reports.on_gnss(other)
    return receiver_sign(reports.compared, now_ns, 1.5, LIMITS)


def test_two_receivers_that_see_different_places() -> None:
    assert receivers_apart_m(FIRST, second(30.0), LIMITS) == pytest.approx(30.0, abs=0.01)
    assert signs(FIRST, second(30.0)) == ("receivers_differ",)
    assert signs(FIRST, second(12.0)) == ()  # 5 m of antennas, 5 m of delay, 8.5 m of noise
    assert signs(replace(FIRST, v_ned_mps=None), second(14.0)) == ("receivers_differ",)


@pytest.mark.parametrize(
    "other",
    [
        second(90.0, fix_type=1),
        second(90.0, t_rx_ns=5 * S),
        second(90.0, n_satellites=4),  # it says itself that it is poor
        second(90.0, h_acc_m=40.0),
    ],
)
def test_receivers_that_cannot_be_compared(other: Gnss) -> None:
    assert signs(FIRST, other) == ()


def test_a_receiver_that_knows_no_place_yet_is_not_compared() -> None:
    assert receivers_apart_m(FIRST, replace(FIRST, receiver=1, place=GeoPoint(0.0, 0.0, 0.0)), LIMITS) is None


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({}, ()),
        ({"fix_type": 2}, ("no_fix",)),
        ({"place": GeoPoint(0.0, 0.0, 0.0)}, ("no_fix",)),  # a fix at no place
        ({"n_satellites": 5, "h_acc_m": 20.0}, ("few_satellites", "accuracy")),
        ({"n_satellites": None, "h_acc_m": None, "fix_type": 8}, ()),
    ],
)
def test_what_a_receiver_shows_of_itself(changes: dict[str, Any], expected: tuple[str, ...]) -> None:
    assert receiver_signs(replace(FIRST, **changes), LIMITS) == expected


def test_a_second_receiver_that_is_streamed_slowly_differs_all_the_time() -> None:
    reports, seen = Reports(), []
    for k in range(100):  # the first five times a second, the second every other second
        if k % 10 == 0:
            reports.on_gnss(second(90.0, t_rx_ns=k * S // 5))
        reports.on_gnss(replace(FIRST, t_rx_ns=k * S // 5))
        seen.append(receiver_sign(reports.compared, k * S // 5, 1.5, LIMITS))
    assert set(seen) == {("receivers_differ",)}
    reports.on_gnss(replace(FIRST, t_rx_ns=24 * S))
    assert receiver_sign(reports.compared, 24 * S, 1.5, LIMITS) == ()  # it speaks no more


@pytest.mark.parametrize("every", [5, 15])
@pytest.mark.parametrize("boot_ns", [0, S])
def test_two_good_receivers_of_a_fast_plane_agree_however_slowly_the_second_is_streamed(every: int, boot_ns: int) -> None:
    """At 40 m/s the vehicle is 40 m further in the second by which their reports may lie apart."""
    reports, seen = Reports(), []
    for k in range(60):
        t_ns = k * S // 5
        place = wgs84.geo_from_ned((0.0, 40.0 * k / 5, 0.0), HERE)
        now = replace(FIRST, t_rx_ns=t_ns, t_boot_ns=boot_ns and boot_ns + t_ns, place=place, v_ned_mps=(0.0, 40.0, 0.0))
        if k % every == 0:
            reports.on_gnss(replace(now, receiver=1))
        reports.on_gnss(now)
        seen.append(receiver_sign(reports.compared, t_ns, 1.5, LIMITS))
    assert set(seen) == {()}


def test_a_place_that_lies_as_far_across_the_way_differs_all_the_same() -> None:
    first = replace(FIRST, t_rx_ns=10 * S + 900_000_000, v_ned_mps=(40.0, 0.0, 0.0))
    behind = wgs84.geo_from_ned((-36.0, 0.0, 0.0), HERE)
    assert signs(first, replace(second(0.0), place=behind)) == ()
    assert signs(first, replace(second(0.0), place=wgs84.geo_from_ned((-36.0, 34.0, 0.0), HERE))) == ("receivers_differ",)


def interference(*reports: GnssIntegrity, now_ns: int = 11 * S, agrees: bool = False) -> tuple[str, ...]:
    said = Interference()
    for report in reports:
        said.on_report(report)
    return said.signs(now_ns, agrees)


def test_what_the_receiver_says_of_interference() -> None:
    report = GnssIntegrity(10 * S, 0, jammed=True, spoofed=True, authentic=False)
    all_three = ("receiver_spoofing", "receiver_authentication", "receiver_jamming")
    assert interference(report) == all_three
    assert interference(report, agrees=True) == all_three[:2]  # jamming that does no harm
    assert interference(report, now_ns=30 * S) == ()
    assert interference(GnssIntegrity(10 * S, 0, False, None, None)) == ()
    assert interference() == ()


def test_what_one_receiver_says_of_interference_another_does_not_take_back() -> None:
    spoofed, fine = GnssIntegrity(10 * S, 0, False, True, None), GnssIntegrity(10 * S, 1, False, False, None)
    assert interference(spoofed, fine) == interference(fine, spoofed) == ("receiver_spoofing",)
    assert interference(spoofed, replace(fine, receiver=0)) == ()


def test_a_text_about_jamming_does_not_take_back_the_one_about_spoofing() -> None:
    spoofed, jammed = GnssIntegrity(10 * S, 0, None, True, None), GnssIntegrity(11 * S, 0, True, None, None)
    assert interference(spoofed, jammed) == ("receiver_spoofing", "receiver_jamming")


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
