"""What the benchmark of kidnapped starts computes from its flights."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import pytest

from benchmarks.flown.kidnapped_flight import STEP_S, KidnappedFlight, Outcome, Way
from benchmarks.kidnapped import HEADER, Kept, main, row, summary
from benchmarks.worlds.kidnapped_worlds import MODEL
from visloc_companion.core.velocity.heading_pull import HeadingPull
from visloc_companion.geo.wgs84 import distance_m, ned_from_geo
from visloc_companion.types import Attitude, Event, GeoPoint

HOME = GeoPoint(47.0, 8.0, 600.0)


def test_ways_are_straight_or_turn() -> None:
    straight = Way(HOME, math.pi / 2, 10.0, 0.0, HOME)
    place, course, v = straight.at(6.0)
    assert ned_from_geo(place, HOME)[:2] == pytest.approx((0.0, 60.0), abs=1e-3)
    assert (course, v) == (math.pi / 2, pytest.approx((0.0, 10.0)))
    circle = Way(HOME, 0.0, 10.0, 2 * math.pi / 60, HOME)
    assert distance_m(circle.at(60.0)[0], HOME) == pytest.approx(0.0, abs=1e-3)
    assert distance_m(circle.at(30.0)[0], HOME) == pytest.approx(2 * 10.0 * 60 / (2 * math.pi), rel=1e-3)


def test_late_and_wrong_flights_are_told_apart() -> None:
    flown = [
        Outcome(12.0, 1.0, [1000.0], [200.0, 300.0], elsewhere=5),
        Outcome(45.0, 2.0, [2000.0], [], elsewhere=7, mistaken=1),
        Outcome(20.0, 400.0),
        Outcome(),
    ]
    figures = summary(flown, 15.0)
    assert (figures["trials"], figures["wrong"], figures["mistaken"], figures["tests_elsewhere"]) == (4, 1, 1, 12)
    assert (figures["right_within_30_s"], figures["right"], figures["refused"]) == (1, 2, 1)
    assert figures["wrong_at_most"] is None
    assert figures["anchored_s"]["median"] == 28.5
    assert figures["off_m"]["max"] == 2.0
    assert row("test", figures).count("|") == HEADER.count("|")
    assert "not anchored" in flown[3].line()
    assert flown[0].line() == "12.0 s, 1.0 m off, 1 tiles 1000 ms, 2 tests 500 ms, 0 of 5 mistaken"


def test_where_there_is_no_right_place_any_is_wrong() -> None:
    figures = summary([Outcome(12.0, 1.0), Outcome(), Outcome()], None)
    assert (figures["right"], figures["refused"], figures["wrong"]) == (0, 2, 1)
    assert summary([Outcome()] * 60, None)["wrong_at_most"] == pytest.approx(0.05)


@pytest.mark.parametrize("world", ["mars=3", "naip=0", "naip=x"])
def test_a_world_that_is_none_is_refused(world: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        main(["--worlds", world])
    assert "is no world" in capsys.readouterr().err


def test_flights_that_find_nothing_have_no_figures_to_show() -> None:
    figures = summary([Outcome()], 15.0)
    assert figures["anchored_s"] == {"median": None, "p95": None}
    assert "–" in row("stranger", figures)


def test_trials_that_were_flown_are_kept(tmp_path: Path) -> None:
    rows = tmp_path / "rows.jsonl"
    flown = Outcome(12.0, 1.0, [1000.0], [200.0], elsewhere=5, slower=[0.9])
    Kept(rows, 101).add("procedural", 3, flown)
    Kept(rows, 101).add("naip", 3, Outcome())
    again, other = Kept(rows, 101), Kept(rows, 102)
    assert again.get("procedural", 3) == flown
    assert (again.get("procedural", 4), again.get("water", 3), other.get("procedural", 3)) == (None, None, None)
    assert other.get("naip", 3) == Outcome()
    assert Kept(None, 101).get("procedural", 3) is None


def test_what_is_kept_is_shown_without_a_flight(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rows = tmp_path / "rows.jsonl"
    for number in range(2):
        Kept(rows, 101).add("procedural", number, Outcome(12.0, 14.0 + 2 * number))
    main(["--worlds", "procedural=2", "--rows", str(rows)])
    assert "| procedural | 2 | 1 | 1 | 0 | 1 |" in capsys.readouterr().out


def test_the_autopilot_tells_how_the_vehicle_turns(monkeypatch: pytest.MonkeyPatch) -> None:
    """Else its turning is taken for a pull on its compass, and ever more headings are searched."""
    nothing: Any = None
    way = Way(HOME, 0.3, 10.0, 0.05, HOME)
    flight = KidnappedFlight(way, nothing, MODEL, nothing, nothing, 3, 120.0, nothing)
    told: list[Event] = []
    monkeypatch.setattr(flight, "_send", told.append)
    pull = HeadingPull()
    for k in range(1, round(30.0 / STEP_S)):
        flight._t_s = k * STEP_S
        flight._telemetry(k)
    attitudes = [event for event in told if isinstance(event, Attitude)]
    for attitude in attitudes:
        pull.on_attitude(attitude.t_boot_ns, attitude.q_ned_frd, attitude.rate_frd_radps)
    assert len(attitudes) == 599
    assert math.degrees(pull.since_fixes_rad) < 1.0
