"""Which part has not beaten."""

from __future__ import annotations

from visloc_companion.app.health import Health

S = 1_000_000_000


def test_all_parts_beat_or_are_named() -> None:
    health = Health({"link": 2.0, "tick": 1.0})
    assert health.late(0) == ["link", "tick"]
    health.start(0)
    assert health.late(1 * S) == []
    assert health.late(1 * S + 1) == ["tick"]
    health.tick(2 * S, 0)
    assert health.late(2 * S + 1) == ["link"]
    health.beat("link", 3 * S)
    assert health.late(3 * S) == []
    assert health.ages_s(4 * S) == {"link": 1.0, "tick": 2.0}


def test_slips_add_up() -> None:
    health = Health({"tick": 1.0})
    for slipped in (0, 2, 0, 1):
        health.tick(5, slipped)
    assert (health.ticks, health.cycle_slips) == (4, 3)


def test_a_part_that_is_not_watched_does_not_matter() -> None:
    health = Health({"tick": 1.0})
    health.start(0)
    health.beat("camera", 7)
    assert health.ages_s(0) == {"tick": 0.0}


def test_a_beat_never_makes_a_part_older() -> None:
    health = Health({"tick": 1.0})
    health.beat("tick", 5 * S)
    health.beat("tick", 3 * S)
    assert health.late(6 * S) == []
