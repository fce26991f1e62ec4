"""The clock that a simulator drives."""

from __future__ import annotations

from visloc_companion.sim.real.clock import EPOCH_NS, MAX_AHEAD_NS, SlavedClock


class Wall:
    def __init__(self) -> None:
        self.ns = 5_000_000_000

    def __call__(self) -> int:
        return self.ns


def test_it_follows_the_messages_and_runs_on_at_the_speed_between_them() -> None:
    wall = Wall()
    clock = SlavedClock(4.0, wall)
    clock.hear(10_000_000_000)
    assert clock.now_ns() == EPOCH_NS + 10_000_000_000
    wall.ns += 2_000_000
    assert clock.now_ns() == EPOCH_NS + 10_008_000_000


def test_it_waits_for_a_simulator_that_stalls() -> None:
    wall = Wall()
    clock = SlavedClock(4.0, wall)
    clock.hear(10_000_000_000)
    wall.ns += 60_000_000_000
    assert clock.now_ns() == EPOCH_NS + 10_000_000_000 + MAX_AHEAD_NS


def test_it_never_goes_back() -> None:
    wall = Wall()
    clock = SlavedClock(1.0, wall)
    clock.hear(10_000_000_000)
    wall.ns += 30_000_000
    ahead = clock.now_ns()
    clock.hear(10_020_000_000)
    assert clock.now_ns() == ahead
    clock.hear(9_000_000_000)
    assert clock.now_ns() == ahead


async def test_sleeping_ends_when_the_simulator_says_so() -> None:
    wall = Wall()
    clock = SlavedClock(1000.0, wall)
    clock.hear(1_000_000_000)
    clock.hear(3_000_000_000)
    await clock.sleep_until(EPOCH_NS + 2_500_000_000)
    assert clock.now_ns() >= EPOCH_NS + 2_500_000_000
