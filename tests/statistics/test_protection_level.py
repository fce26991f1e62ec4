"""Monte-Carlo with wrong matches: the protection level holds, one that believes every match does not."""

from __future__ import annotations

from dataclasses import replace

from benchmarks.flown.integrity_kinds import Flight, Tally
from benchmarks.integrity import flown
from visloc_companion.core.settings import NavigatorSettings

SETTINGS = replace(NavigatorSettings(), velocity_sigma_aiding_mps=0.2)
FLIGHT = Flight(velocity_sigma_mps=0.2, duration_s=150.0, inertial=False)


def flights(flight: Flight, *, blind: bool) -> Tally:
    tally = Tally()
    for seed in range(5):
        tally.add(flown(flight, seed, SETTINGS, blind=blind))
    return tally


def test_holds_where_the_filter_takes_wrong_matches() -> None:
    tally = flights(FLIGHT, blind=False)
    figures = tally.figures(alert_limit_m=25.0)
    assert tally.n_wrong_taken >= 8
    assert figures["misleading"] == figures["hmi"] == 0
    assert figures["level_over_error"] < 8


def test_on_accelerations_and_with_odometry_it_is_small() -> None:
    tally = Tally()
    for seed in range(3):
        tally.add(flown(Flight(votes=("image", "odometry"), duration_s=150.0), seed))
    figures = tally.figures(alert_limit_m=25.0)
    assert figures["misleading"] == 0
    assert figures["level_over_error"] < 6.5


def test_a_level_that_believes_every_match_fails_the_same_check() -> None:
    lasting = replace(FLIGHT, lasts_m=100.0)
    assert flights(lasting, blind=True).figures(alert_limit_m=25.0)["misleading"] > 5
