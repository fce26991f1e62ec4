"""The alert: in time, not at every wobble, and in words that fit into a STATUSTEXT."""

from __future__ import annotations

import itertools

import pytest
from hypothesis import given
from hypothesis import strategies as st

from visloc_companion.core.alert import CLEAR_NS, CLEAR_SHARE, CONFIRM_NS, AlertWatch, Beyond, Levels, Limits, limits_at
from visloc_companion.core.settings import NavigatorSettings
from visloc_companion.types import BeyondLimit, Notice, Severity

S = 1_000_000_000
TICK_NS = S // 5
"""The slowest output rate that the configuration allows."""
LIMITS = Limits(25.0, 50.0)


def seen(levels: list[tuple[float | None, float | None]], policy: BeyondLimit = BeyondLimit.INJECT) -> list[tuple[float, Notice]]:
    """Messages over ticks at 5 Hz, with their times in seconds."""
    watch, told = AlertWatch(policy), []
    for k, pair in enumerate(levels):
        both = Levels(*pair)
        watch.update(both, LIMITS, k * TICK_NS)
        told += [(k * TICK_NS / S, notice) for notice in watch.notices(both, relied_on=True, room=True)]
    return told


def test_a_level_beyond_its_limit_is_told_within_two_seconds_and_once() -> None:
    told = seen([(10.0, 10.0)] * 50 + [(30.0, 10.0)] * 100)
    assert [notice.text for _, notice in told] == ["visloc: POSITION may be off 30 m"]
    assert told[0][0] - 50 * TICK_NS / S <= 2.0
    assert told[0][1].to_operator
    assert told[0][1].severity is Severity.WARNING


def test_no_level_at_all_is_beyond_any_limit() -> None:
    told = seen([(10.0, 10.0)] * 10 + [(None, 10.0)] * 20)
    assert [notice.text for _, notice in told] == ["visloc: POSITION may be off unknown"]
    assert not Levels(None, 10.0).are_within(LIMITS)
    assert not Levels(10.0, None).are_within(LIMITS)
    assert Levels(25.0, 50.0).are_within(LIMITS)


def test_one_odd_level_is_not_told() -> None:
    assert seen([(10.0, 10.0), (400.0, 90.0), (10.0, 10.0)] * 30) == []


def test_well_again_is_told_after_it_lasted() -> None:
    told = seen([(30.0, 10.0)] * 20 + [(24.0, 10.0)] * 100 + [(19.0, 10.0)] * 40)
    assert [notice.text for _, notice in told] == ["visloc: POSITION may be off 30 m", "visloc: position sure again, within 19 m"]
    assert told[1][0] == pytest.approx(120 * TICK_NS / S + CLEAR_NS / S)


def test_height_has_its_own_limit_and_words() -> None:
    told = seen([(10.0, 60.0)] * 20 + [(10.0, 10.0)] * 60)
    assert [notice.text for _, notice in told] == ["visloc: HEIGHT may be off 60 m", "visloc: height sure again, within 10 m"]


def test_both_at_once_are_one_message() -> None:
    told = seen([(40.0, 60.0)] * 20 + [(10.0, 10.0)] * 60)
    texts = [notice.text for _, notice in told]
    assert texts == ["visloc: POSITION may be off 40 m, HEIGHT 60 m", "visloc: position and height sure again"]


def test_what_gets_better_while_something_else_gets_worse_is_told_next() -> None:
    """The vertical level rises so that both change at the same tick: first what is worse, then what is better."""
    steps = round(CLEAR_NS / TICK_NS)
    confirm = round(CONFIRM_NS / TICK_NS)
    better = [(10.0, 10.0)] * (steps - confirm) + [(10.0, 60.0)] * (confirm + 5)
    told = seen([(30.0, 10.0)] * 20 + better)
    assert [notice.text[8:16] for _, notice in told] == ["POSITION", "HEIGHT m", "position"]
    assert told[2][0] - told[1][0] == pytest.approx(TICK_NS / S)


def test_nothing_is_told_while_nobody_relies_on_it_and_at_once_when_somebody_does() -> None:
    watch, far = AlertWatch(BeyondLimit.INJECT), Levels(30.0, 10.0)
    for k in range(20):
        watch.update(far, LIMITS, k * TICK_NS)
        assert watch.notices(far, relied_on=False, room=True) == []
    assert watch.notices(far, relied_on=True, room=False) == []
    assert len(watch.notices(far, relied_on=True, room=True)) == 1
    assert watch.notices(far, relied_on=True, room=True) == []
    assert watch.notices(far, relied_on=False, room=True) == []
    assert len(watch.notices(far, relied_on=True, room=True)) == 1


@pytest.mark.parametrize(
    ("policy", "stops", "widens"),
    [(BeyondLimit.INJECT, False, False), (BeyondLimit.WIDEN, False, True), (BeyondLimit.STOP, True, False)],
)
def test_the_policy_follows_the_horizontal_level_alone(policy: BeyondLimit, stops: bool, widens: bool) -> None:
    for levels, counts in ((Levels(30.0, 10.0), True), (Levels(10.0, 60.0), False)):
        watch = AlertWatch(policy)
        for k in range(20):
            watch.update(levels, LIMITS, k * TICK_NS)
        assert watch.raised
        assert (watch.stops, watch.widens) == (stops and counts, widens and counts)


def test_the_operator_reads_that_nothing_is_sent_any_more() -> None:
    told = seen([(30.0, 10.0)] * 20, BeyondLimit.STOP)
    assert told[0][1].text == "visloc: POSITION may be off 30 m, NOT SENT"
    assert told[0][1].severity is Severity.CRITICAL


@given(st.floats(25.1, 1e9), st.floats(50.1, 1e9), st.sampled_from(BeyondLimit))
def test_messages_fit_into_a_statustext(horizontal_m: float, vertical_m: float, policy: BeyondLimit) -> None:
    for pair in itertools.product((10.0, horizontal_m), (10.0, vertical_m)):
        told = seen([pair] * 10 + [(10.0, 10.0)] * 40, policy)
        assert all(len(notice.text) <= 50 for _, notice in told)
        assert len(told) <= 2


@given(st.lists(st.floats(0.0, 60.0), min_size=1, max_size=200))
def test_a_raised_alert_needs_a_lasting_excess_and_its_end_a_lasting_calm(levels: list[float]) -> None:
    beyond, history = Beyond(), []
    for k, level in enumerate(levels):
        before = beyond.raised
        beyond.update(level, 25.0, k * TICK_NS)
        history.append(level)
        if beyond.raised and not before:
            assert all(level > 25.0 for level in history[-round(CONFIRM_NS / TICK_NS) :])
        if before and not beyond.raised:
            assert all(level < CLEAR_SHARE * 25.0 for level in history[-round(CLEAR_NS / TICK_NS) :])


def test_low_limits_hold_below_the_low_height_by_either_height() -> None:
    settings = NavigatorSettings()
    cruise = Limits(settings.alert_limit_m, settings.vertical_alert_limit_m)
    low = Limits(settings.alert_limit_low_m, settings.vertical_alert_limit_low_m)
    assert limits_at(None, 0.0, settings) == cruise
    assert limits_at(100.0, 0.0, settings) == cruise
    assert limits_at(20.0, 0.0, settings) == low
    assert limits_at(45.0, -20.0, settings) == low  # fixes say that it is 20 m lower than the barometer does
    assert limits_at(20.0, 30.0, settings) == low
