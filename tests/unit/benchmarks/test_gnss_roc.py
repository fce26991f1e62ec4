"""The simulated flights of the GNSS monitor, and what is counted of them."""

from __future__ import annotations

import importlib
import json
import math
import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np
import pytest

from visloc_companion.sim import faults
from visloc_companion.sim.faults import FaultSchedule

ROOT = Path(__file__).resolve().parents[3]


@pytest.fixture
def load(monkeypatch):
    monkeypatch.syspath_prepend(str(ROOT))
    return lambda name: importlib.import_module(f"benchmarks.{name}")


def test_flights_are_as_they_are_described(load):
    flights = load("gnss_flights")
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
    flights = load("gnss_flights")
    world = flights.World(outage_every_s=5.0, outage_s=50.0)
    jammed = list(flights.Flight(1, faults.jam(0.0), 30.0, world).moments())
    assert all(m.difference_ne_m is None and m.gnss_moved_ne_m is None and not m.has_fix for m in jammed)
    rare = [m for m in flights.Flight(1, FaultSchedule(), 200.0, world).moments() if m.difference_ne_m is not None]
    assert len(rare) < 100


def test_alarms_close_together_are_one(load):
    series = np.zeros(500)
    series[[10, 11, 40, 200]] = 11.0
    assert load("gnss_roc").alarms(series, 10.0) == 2
    assert load("gnss_roc").alarms(series, 12.0) == 0


def test_every_class_of_attack_is_drawn_and_begins_after_the_quiet_time(load):
    module = load("gnss_attacks")
    drawn = list(module.attacks(0.02))
    assert len({a.name for a in drawn}) == 15
    assert all(a.begins_s >= module.QUIET_S and a.faults.gnss_start_s == a.begins_s for a in drawn)
    assert sum(1 for _ in module.attacks(1.0)) == 1600


def test_a_judged_drag_and_a_judged_jam(load):
    roc, attacks, flights = load("gnss_roc"), load("gnss_attacks"), load("gnss_flights")
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
