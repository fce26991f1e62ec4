"""A restart that no silence tells of, by the clocks that the autopilot shows."""

from visloc_companion.adapters.mavlink.presence import Presence
from visloc_companion.types import Attitude, Event, TimesyncSample

S = 1_000_000_000
UNIX_NS = 1_800_000_000 * S


def answer(t_ns: int) -> TimesyncSample:
    return TimesyncSample(0, 1000, t_ns)


def attitude(t_ns: int) -> Attitude:
    return Attitude(t_ns, t_ns, (1.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0))


def restarts(*events: Event) -> list[bool]:
    presence = Presence(3.0)
    return [presence.restarted(event) for event in events]


def test_clocks_that_count_from_different_moments_are_no_restart() -> None:
    told = [event for k in range(4) for event in (answer(UNIX_NS + k * S), attitude(60 * S + k * S))]
    assert not any(restarts(*told))


def test_a_restart_is_one_whichever_clock_shows_it_first() -> None:
    before = answer(UNIX_NS + 100 * S), attitude(100 * S)
    assert restarts(*before, attitude(1 * S), answer(UNIX_NS), attitude(2 * S)) == [False, False, True, False, False]
    assert restarts(*before, answer(UNIX_NS), attitude(1 * S), answer(UNIX_NS + S)) == [False, False, True, False, False]


def test_what_comes_late_is_no_restart() -> None:
    assert not any(restarts(attitude(100 * S), attitude(96 * S), answer(100 * S), answer(96 * S)))
