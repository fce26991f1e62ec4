"""The simulated flights of the GNSS monitor, and what is counted of them."""

from __future__ import annotations

import json
import math
import xml.etree.ElementTree as ET
from itertools import pairwise

import numpy as np
import pytest

from visloc_companion.core.settings import GnssSettings
from visloc_companion.sim import faults
from visloc_companion.sim.faults import FaultSchedule


def test_flights_are_as_they_are_described(load):
    flights = load("gnss_runs.gnss_flights")
    moments = [
        m for seed in range(8) for m in flights.Flight(seed, FaultSchedule(), 300.0, flights.World(outage_every_s=1e9)).moments()
    ]
    fixes = [m for m in moments if m.difference_ne_m is not None]
    assert 0.9 < len(fixes) / (8 * 300) < 0.99
    spread = math.sqrt(np.mean([math.hypot(*m.difference_ne_m) ** 2 for m in fixes]) / 2)
    assert 2.0 < spread < 4.5  # 2 m of fixes, 1 to 2 m of GNSS, 1 m of the map, a few wrong fixes
    apart = [m.gnss_moved_ne_m[0] - m.odometry_moved_ne_m[0] for m in moments if m.gnss_moved_ne_m is not None]
    assert 0.3 < np.std(apart) < 0.8
    assert all(m.has_fix and m.false_m == 0.0 for m in moments)
    again = next(iter(flights.Flight(3, FaultSchedule(), 1.0, flights.World()).moments()))
    assert again == next(iter(flights.Flight(3, FaultSchedule(), 1.0, flights.World()).moments()))


def test_outages_and_lost_fixes_leave_nothing_to_compare(load):
    flights = load("gnss_runs.gnss_flights")
    world = flights.World(outage_every_s=5.0, outage_s=50.0)
    jammed = list(flights.Flight(1, faults.jam(0.0), 30.0, world).moments())
    assert all(m.difference_ne_m is None and m.gnss_moved_ne_m is None and not m.has_fix for m in jammed)
    rare = [m for m in flights.Flight(1, FaultSchedule(), 200.0, world).moments() if m.difference_ne_m is not None]
    assert len(rare) < 100


def test_a_fix_tells_what_it_looked_at_and_how_far_it_lay_from_where_fixes_had_the_vehicle(load):
    flights = load("gnss_runs.gnss_flights")
    world = flights.World(outage_every_s=1e9, odometry=False)
    moments = list(flights.Flight(2, FaultSchedule(), 300.0, world).moments())
    assert all((m.ground is None) == (m.difference_ne_m is None) for m in moments)
    grounds = [m.ground for m in moments if m.ground is not None]
    assert all(ground.claimed == flights.WRONG_SHARE and 14.0 < ground.spacing_m < 75.0 for ground in grounds)
    speeds = [math.dist(a.at_ne_m, b.at_ne_m) for a, b in pairwise(grounds)]
    assert 5.0 < np.median(speeds) < 21.0
    assert grounds[0].off_ne_m is None
    sigmas = [math.hypot(*ground.off_ne_m) / math.sqrt(ground.off_var_m2) for ground in grounds[1:]]
    assert 0.7 < np.median(sigmas) / math.sqrt(2 * math.log(2)) < 1.4  # claims are up to a quarter off
    dragged = list(flights.Flight(2, faults.slow_drag(100.0, 1.0, 0.3), 300.0, world).moments())
    late = [m.ground for m in dragged if m.ground is not None and m.t_s > 160.0]
    assert np.mean([math.hypot(*ground.off_ne_m) for ground in late]) < 5.0, "the filter learns that the velocity is false"


def test_fixes_that_claim_too_little_are_believed_less_as_the_daemon_does(load, monkeypatch):
    flights, roc = load("gnss_runs.gnss_flights"), load("gnss_roc")
    mean_over = {}
    for claim in (1.0, 0.2):
        world = flights.World(claim=(claim, claim), lasting_share=(0.0, 0.0), outage_every_s=1e9)
        moments = list(flights.Flight(4, FaultSchedule(), 60.0, world).moments())
        mean_over[claim] = np.mean([m.over for m in moments if m.difference_ne_m is not None][-10:])
    assert mean_over[0.2] > 1.7 > 1.3 > mean_over[1.0] >= 1.0
    shown = []
    monkeypatch.setattr(roc.GnssMonitor, "on_vision", lambda self, *seen: shown.append((seen[2][0][0], seen[6])))
    list(roc.watch(flights.Flight(4, FaultSchedule(), 60.0, world), GnssSettings()))
    fixes = [m for m in moments if m.difference_ne_m is not None]
    assert shown == [(m.over * m.claimed_var_m2, m.over) for m in fixes]


def test_a_filter_on_fixes_refuses_starts_anew_and_gives_way_to_gnss(load):
    held = load("gnss_runs.gnss_held").Held()

    def take(north_m):
        held.carry((0.0, 0.0), 0.1, 1.0)
        return held.take((north_m, 0.0), 4.0, 0.1, 100.0, 0.01)

    assert take(0.0)[0].off_ne_m is None
    ground, taken = take(1.0)
    assert ground.off_ne_m == (1.0, 0.0) and taken and 4.0 < ground.off_var_m2 < 9.0
    assert [take(40.0)[1] for _ in range(5)] == [False] * 4 + [True]
    assert abs(take(40.0)[0].off_ne_m[0]) < 0.1
    held.carry((0.0, 0.0), 0.1, 6.0)
    assert take(40.0)[0].off_ne_m is None


def test_wrong_matches_that_are_of_the_ground_last(load):
    flights = load("gnss_runs.gnss_flights")
    world = flights.World(lasting_wrong=True, wrong_share=0.05, wrong_m=(5.0, 6.0), speed_mps=(2.0, 2.0), outage_every_s=1e9)
    right = flights.World(lasting_wrong=True, wrong_share=0.0, speed_mps=(2.0, 2.0), outage_every_s=1e9)
    pair = [list(flights.Flight(3, FaultSchedule(), 600.0, w).moments()) for w in (world, right)]
    off = {
        m.t_s: round(math.dist(m.difference_ne_m, other.difference_ne_m), 3)
        for m, other in zip(*pair, strict=True)
        if m.difference_ne_m is not None and other.difference_ne_m is not None
    }
    wrong = [t_s for t_s, by_m in off.items() if by_m > 0.1]
    assert all(5.0 <= off[t_s] <= 6.0 for t_s in wrong)
    again = [off.get(t_s + 1.0) == off[t_s] for t_s in wrong if t_s + 1.0 in off]
    assert len(wrong) > 10
    assert np.mean(again) > 0.8
    assert all(m.ground is None or m.ground.claimed == 0.05 for m in pair[0])


def test_alarms_close_together_are_one(load):
    series = np.zeros(500)
    series[[10, 11, 40, 200]] = 11.0
    assert load("gnss_roc").alarms(series, 10.0) == 2
    assert load("gnss_roc").alarms(series, 12.0) == 0


def test_every_class_of_attack_is_drawn_and_begins_after_the_quiet_time(load):
    module = load("gnss_runs.gnss_attacks")
    drawn = list(module.attacks(0.02))
    assert len({a.name for a in drawn}) == 15
    assert all(a.begins_s >= module.QUIET_S and a.faults.gnss_start_s == a.begins_s for a in drawn)
    assert sum(1 for _ in module.attacks(1.0)) == 1600


def test_a_judged_drag_and_a_judged_jam(load):
    roc, attacks, flights = load("gnss_roc"), load("gnss_runs.gnss_attacks"), load("gnss_runs.gnss_flights")
    drag = roc.judged(attacks.Attack("drag", faults.slow_drag(60.0, 2.0, 1.0), 60.0, ends=False), 5, flights.World())
    assert 2.0 < drag["pulled_m"] < 25.0
    assert drag["out_s"] == pytest.approx(drag["pulled_m"] / 2, abs=0.3)
    jam = roc.judged(attacks.Attack("jam", faults.jam(60.0, 80.0), 60.0), 5, flights.World(odometry=False))
    assert (jam["pulled_m"], jam["followed"], jam["before"]) == (0.0, False, 0)
    assert jam["healed_s"] >= 20.0
    row = roc.summary([drag, jam])
    assert (row["n"], row["declared"], row["healed"], row["healed_s"][0]) == (2, 2, 1, round(jam["healed_s"], 1))


def test_the_whole_benchmark_on_a_handful_of_flights(load, tmp_path, monkeypatch, capsys):
    roc = load("gnss_roc")
    monkeypatch.setattr(roc, "CLEAN_S", 90.0)
    monkeypatch.setattr(roc, "ATTACK_S", 65.0)
    assert roc.main([str(tmp_path), "--scale", "0.001"]) == 0
    result = json.loads((tmp_path / "gnss_roc.json").read_text())
    assert set(result) == {"vision", "vision and odometry", "seconds"}
    rates = [r["alarms_per_h"] for r in result["vision"]["curve"]]
    assert rates == sorted(rates, reverse=True)
    assert ET.parse(tmp_path / "gnss_roc.svg").getroot().tag.endswith("svg")
    assert "| drag 1 m/s |" in capsys.readouterr().out
