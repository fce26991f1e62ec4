"""Clock, map, words and odds: the small parts of the verdict."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest

from visloc_companion.core.satellites import gnss_odds, gnss_words
from visloc_companion.core.satellites.gnss_clock import SIGN_NS, GnssClock
from visloc_companion.core.satellites.gnss_map import MapCheck
from visloc_companion.types import GeoPoint, Gnss, GnssTime, GnssVerdict, MapAtGnss, Notice, RequestMessage, Severity, Verdict

S = 1_000_000_000
UNIX = 1_750_000_000 * S
HERE = GeoPoint(59.0, 18.0, 50.0)


def clock(*times: tuple[float, float, float]) -> GnssClock:
    """A clock fed with (arrival, boot time, calendar time) in seconds."""
    got = GnssClock()
    for rx_s, boot_s, unix_s in times:
        got.on_time(GnssTime(round(rx_s * S), round(boot_s * S), UNIX + round(unix_s * S)))
    return got


def test_a_clock_that_runs_evenly_is_no_sign() -> None:
    late = clock((1.0, 1.0, 0.0), (3.3, 3.0, 2.004), (5.0, 4.9, 3.85), (3600.0, 3599.0, 3590.0))
    assert late.signs(3600 * S) == ()  # nothing was heard for an hour: there is nothing to compare


def test_a_jump_of_gnss_time_is_a_sign_for_a_while_and_then_the_new_time_counts() -> None:
    jumped = clock((1.0, 1.0, 0.0), (2.0, 2.0, 1.0), (3.0, 3.0, 4.5))
    assert jumped.jump_s == pytest.approx(2.5)
    assert jumped.signs(4 * S) == ("clock_jump",)
    assert jumped.signs(3 * S + SIGN_NS + 1) == ()
    jumped.on_time(GnssTime(20 * S, 20 * S, UNIX + round(21.5 * S)))
    assert jumped.signs(20 * S) == ()


def test_a_restarted_autopilot_or_a_time_without_boot_time_is_nothing_to_compare() -> None:
    assert clock((100.0, 100.0, 0.0), (110.0, 2.0, 10.0)).signs(110 * S) == ()
    assert clock((1.0, 1.0, 0.0), (2.0, 0.0, 1.0)).signs(2 * S) == ()
    by_arrival = [(1.0, 0.0, 0.0), (2.9, 0.0, 1.0)]
    assert clock(*by_arrival).signs(3 * S) == ()
    assert clock(*by_arrival, (4.0, 0.0, 9.0)).signs(4 * S) == ("clock_jump",)


def ground(height_m: float | None, inside: bool = True) -> MapCheck:
    check = MapCheck()
    surface = None if height_m is None else HERE.h_amsl_m - height_m
    check.on_map(MapAtGnss(10 * S, HERE, inside, surface))
    return check


GNSS = Gnss(10 * S, 0, 3, 14, HERE, 1.0, 2.0, None)


def test_before_arming_gnss_must_be_on_the_map_and_on_its_surface() -> None:
    assert ground(1.0).signs(11 * S, GNSS, flies=False) == ()
    assert ground(None).signs(11 * S, GNSS, flies=False) == ()
    assert ground(None, inside=False).signs(11 * S, GNSS, flies=False) == ("off_map",)
    high = ground(-60.0)
    assert high.signs(11 * S, GNSS, flies=False) == ("off_surface",)
    assert high.height_above_surface_m == pytest.approx(-60.0)


def test_the_map_is_not_asked_in_flight_nor_believed_for_long() -> None:
    assert ground(100.0).signs(11 * S, GNSS, flies=True) == ()
    assert ground(100.0).signs(20 * S, GNSS, flies=False) == ()
    assert MapCheck().signs(11 * S, GNSS, flies=False) == ()


def test_every_reason_has_words_that_fit_a_statustext() -> None:
    for reason in gnss_words.WORDS:
        for verdict in Verdict:
            for ever in (True, False):
                text = gnss_words.text(GnssVerdict(verdict, 0, (reason,), ()), ever)
                assert text.endswith(gnss_words.WORDS[reason]), text  # nothing was cut off
    assert gnss_words.text(GnssVerdict(Verdict.OK, 0, (), ())) == "visloc: GNSS trusted"
    assert gnss_words.text(GnssVerdict(Verdict.DENIED, 0, ("no_fix",), ()), False) == "visloc: GNSS waiting, no fix"


def test_a_notice_carries_evidence_and_probability() -> None:
    got = gnss_words.notice(GnssVerdict(Verdict.SUSPECT, 0, ("vision_disagrees",), (("drift_sum", 12.0, 10.5),), 0.8))
    assert (got.severity, got.to_operator) == (Severity.WARNING, True)
    assert got.text == "visloc: GNSS not trusted, camera says elsewhere"
    assert dict(got.data) == {"drift_sum": 12.0, "probability_false": 0.8, "reasons": "vision_disagrees"}
    assert gnss_words.notice(GnssVerdict(Verdict.OK, 0, (), ())).severity is Severity.NOTICE


def test_odds() -> None:
    assert gnss_odds.probability_false(-math.inf, -math.inf) == 0.0
    half = math.log(1 / gnss_odds.RATE_PER_S)
    assert gnss_odds.probability_false(half) == pytest.approx(0.5)
    assert gnss_odds.probability_false(half, half) == pytest.approx(2 / 3)
    assert gnss_odds.probability_false(1e6, 0.0) == 1.0
    assert gnss_odds.probability_false(-1e6) == 0.0
    assert gnss_odds.log_r(0.5) == pytest.approx(half)
    assert gnss_odds.probability_false(math.log(gnss_odds.first_weight_s(0.1))) == pytest.approx(0.1)


def test_the_operator_is_told_two_things_at_most() -> None:
    lost = gnss_words.notice(GnssVerdict(Verdict.DENIED, 0, ("no_fix",), ()))
    mode = Notice(Severity.NOTICE, "visloc: AIDING", to_operator=True)
    switch = Notice(Severity.CRITICAL, "visloc: set EKF position source to VISION", to_operator=True)
    other = RequestMessage(24, 5.0)
    assert gnss_words.two_at_most([lost, other, mode]) == [lost, other, mode]
    assert gnss_words.two_at_most([lost, mode, switch]) == [lost, replace(mode, to_operator=False), switch]
