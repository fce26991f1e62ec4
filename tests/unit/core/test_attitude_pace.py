"""Attitudes that come too seldom: told once, and no mode that changes with each of them."""

from __future__ import annotations

import random
from dataclasses import dataclass

import pytest

from tests.unit.core.conftest import World
from visloc_companion.core.attitude_pace import AGE_NS, RARE_N, SLOW_AGE_NS, AttitudePace
from visloc_companion.types import Attitude, Command, Event, Injection, Mode, Notice, Severity

S = 1_000_000_000


@dataclass
class Seldom(World):
    """Attitudes come this far apart, within so much, from a time on."""

    period_s: float = 0.05
    jitter_s: float = 0.0
    since_s: float = 0.0

    def __post_init__(self) -> None:
        super().__post_init__()
        self.dice, self.next_s = random.Random(1), 0.0

    def send(self, event: Event) -> list[Command]:
        if isinstance(event, Attitude) and self.t >= self.since_s:
            if self.t + 1e-9 < self.next_s:
                return []
            self.next_s = self.t + self.period_s + self.dice.uniform(-1, 1) * self.jitter_s
        return super().send(event)

    def changes(self, since_s: float, *modes: Mode) -> int:
        """How often it went to one of these modes."""
        return sum(t > since_s for mode in modes for t in self.notices(f"visloc: {mode.value.upper()}"))


def flown(until_s: float, period_s: float, jitter_s: float = 0.0, since_s: float = 0.0) -> Seldom:
    """GNSS is jammed from 20 s on."""
    flight = Seldom(jammed=lambda t: t > 20, period_s=period_s, jitter_s=jitter_s, since_s=since_s)
    flight.start()
    flight.fly(until_s)
    return flight


@pytest.mark.parametrize(("period_s", "jitter_s"), [(5.0, 0.0), (2.0, 0.2), (2.0, 0.0)])
def test_the_mode_does_not_change_with_each_attitude(period_s: float, jitter_s: float) -> None:
    flight = flown(80.0, period_s, jitter_s, since_s=40.0)
    assert flight.changes(60.0, Mode.WAITING, Mode.SHADOW, Mode.LOST) == 0
    told = flight.notices("too slow")
    assert len(told) == 1, "once"
    assert 40.0 < told[0] <= 65.0


@pytest.mark.parametrize(("period_s", "rate"), [(5.0, "0.2"), (2.0, "0.5"), (1.0, "1.0")])
def test_the_operator_reads_the_rate(period_s: float, rate: str) -> None:
    flight = flown(25.0, period_s)
    [notice] = [c for _, c in flight.commands if isinstance(c, Notice) and "attitude" in c.text]
    assert notice.text == f"visloc: attitude comes at {rate} Hz, too slow"
    assert (notice.severity, notice.to_operator) == (Severity.WARNING, True)
    assert len(notice.text) <= 50


def test_useless_attitudes_carry_no_position_and_good_ones_do_again() -> None:
    """One in 5 s: between them there is nothing that a velocity could be turned by."""
    flight = flown(70.0, 5.0, since_s=40.0)
    assert not [t for t, c in flight.commands if isinstance(c, Injection) and t > 55]
    assert flight.status_at(69.0)[0].mode is Mode.WAITING
    flight.period_s = 0.05
    flight.fly(80.0)
    assert flight.status_at(76.0)[0].mode is not Mode.WAITING, "5 s for the last slow one"
    assert flight.first(Injection, since_s=70.0) < 80.0


@pytest.mark.parametrize("period_s", [0.05, 0.25, 0.5])
def test_as_soon_as_twice_a_second_nothing_is_said(period_s: float) -> None:
    assert flown(40.0, period_s).notices("attitude") == []


def test_a_link_that_is_away_for_seconds_counts_for_nothing() -> None:
    pace, now_ns = AttitudePace(), 0
    for gap_ns in (20_000_000, 4 * S, 20_000_000, 6 * S, 20_000_000):
        now_ns += gap_ns
        assert pace.came(now_ns) == []
        assert pace.fresh(now_ns)
        assert pace.fresh(now_ns + AGE_NS)
        assert not pace.fresh(now_ns + AGE_NS + 1)


def test_what_is_out_of_date_twice_is_held_against_the_stream_until_three_come_in_time() -> None:
    pace, now_ns = AttitudePace(), 0
    assert not pace.fresh(0)
    said = [pace.came(now_ns := now_ns + gap_ns) for gap_ns in (0, SLOW_AGE_NS + 1, SLOW_AGE_NS + 1)]
    assert [len(each) for each in said] == [0, 0, 1]
    fresh = []
    for gap_ns in (AGE_NS, AGE_NS, SLOW_AGE_NS, AGE_NS, AGE_NS, AGE_NS):
        pace.came(now_ns := now_ns + gap_ns)
        fresh.append(pace.fresh(now_ns))
    assert fresh == [False] * 5 + [True]
    assert pace.fresh(now_ns + SLOW_AGE_NS)
    assert not pace.fresh(now_ns + SLOW_AGE_NS + 1)


def test_a_rare_one_among_others_is_not_told() -> None:
    pace, now_ns = AttitudePace(), 0
    gaps_ns = [*[S] * (RARE_N - 1), S // 2] * 5
    assert [pace.came(now_ns := now_ns + gap_ns) for gap_ns in [0, *gaps_ns]] == [[]] * (1 + 5 * RARE_N)
