"""What levels are made of, term by term, and drawn flights beside a GNSS."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from tests.unit.core.filter.test_by_gnss import Flight


def test_the_terms_of_a_level_add_up_to_it(load):
    terms_of, flight = load("flown.level_terms"), Flight().run(20, gnss_east=0.0)
    stated_m = flight.level_m()
    with terms_of.noted(2.5) as found:
        assert flight.level_m() == stated_m
        assert flight.filter.protection_level_m(round(20.4e9), 0.01) > stated_m
    assert flight.level_m() == stated_m
    assert len(found) == 2
    terms = found[0]
    assert terms.level_m == stated_m == pytest.approx(sum(terms[1:]))
    assert terms_of.of_levels(found, [found[1].level_m]) == found[1:]
    assert terms.own_m > terms.map_m > 0
    assert terms.doubts_m == terms.age_m == 0
    assert terms.gnss_m < -1.0
    assert terms.wrong_fixes_m > 0
    assert found[1].age_m > 0


def test_the_terms_are_those_of_the_filter_where_no_gnss_tells(load):
    with load("flown.level_terms").noted(1.0) as found:
        Flight().run(20).level_m()
    assert found[0].gnss_m == 0
    assert found[0].doubts_m > 0, "the map is doubted beyond what is configured"


def test_a_flight_has_turned_from_its_first_turn_on(load):
    ahead = np.column_stack([np.arange(0.0, 100.0), np.zeros(100)])
    aside = np.column_stack([np.full(50, 99.0), np.arange(1.0, 51.0)])
    truth = np.column_stack([np.concatenate([ahead, aside]), np.zeros(150)])
    turned = load("level_parts").turned(SimpleNamespace(truth_ned_m=truth))
    assert 100 <= int(turned.argmax()) <= 105
    assert turned[-1]


def test_phases_are_counted_apart(load):
    parts = load("level_parts")
    t_s = np.arange(0.0, 10.0)
    flight = parts.Levels(
        "jam, copter",
        t_s,
        np.where(t_s < 5, 20.0, 30.0),
        np.tile([15.0, 3.0, 0.0, 1.0, -1.0, 2.0], (10, 1)),
        np.full(10, 3.0),
        np.where(t_s < 5, 0, 2),
        np.column_stack([t_s, np.where(t_s < 5, 8.0, 9.0)]),
        np.zeros((0, 2)),
    )
    first, second, all_of_it = parts.rows(flight)
    assert first[1:5] == ["GNSS trusted", "0 to 4", "100.0 %", "100.0 %"]
    assert second[1:6] == ["without", "5 to 9", "0.0 %", "0.0 %", "30.0"]
    assert first[-4:] == ["3.0, 3.0", "0.15", "8.00", "–"]
    assert all_of_it[1:4] == ["all", "0 to 9", "50.0 %"]
    assert parts.by_fixes_m(flight)[0] == pytest.approx(20.0 * 19.0 / 18.0)
    assert [row[1] for row in parts.moments(flight, 5.0)] == ["GNSS trusted", "without"]


def test_drawn_flights_stay_within_a_level_that_believes_gnss(load, capsys):
    beside = load("beside_gnss")
    beside.main(["--flights", "4", "--seconds", "50"])
    rows = [[cell.strip() for cell in line.split("|")[1:-1]] for line in capsys.readouterr().out.splitlines()[2:]]
    assert [row[0] for row in rows] == ["0 to 10", "10 to 20", "20 to 30", "30 to 40", "40 to 50"]
    assert {row[8] for row in rows} == {"0 of 40"}
    assert all(float(row[11]) < 2.5 for row in rows), "what GNSS holds claims what it errs by"


def test_a_camera_that_is_mounted_true_is_shown_to_be(load):
    beside = load("beside_gnss")
    flight = beside.flown(beside.Drawn(10.0, 0.0, 100.0, 30.0, 40.0, 0.0, 0.016, 0.0), 7)
    assert np.median(flight[10:, 3]) < 0.9 * np.median(flight[10:, 2])
    assert (flight[:, 1] < flight[:, 3]).all()
