"""The regions of the Stanford diagram, their counts, and the section of a report that shows them."""

from __future__ import annotations

import re
from dataclasses import replace
from types import ModuleType

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from visloc_companion.evaluate.record import from_entries
from visloc_companion.evaluate.reports.report_stanford import stanford_section
from visloc_companion.evaluate.stanford import DEFAULT_VERTICAL_LIMIT_M, Region, horizontal, regions, vertical


@pytest.mark.parametrize(
    ("error_m", "level_m", "region"),
    [
        (5.0, 10.0, Region.AVAILABLE),
        (10.0, 10.0, Region.AVAILABLE),
        (5.0, 30.0, Region.UNAVAILABLE),
        (28.0, 30.0, Region.UNAVAILABLE),
        (40.0, 30.0, Region.UNAVAILABLE_MISLEADING),
        (12.0, 10.0, Region.MISLEADING),
        (26.0, 10.0, Region.HAZARDOUS),
        (26.0, 25.0, Region.HAZARDOUS),
    ],
)
def test_regions(error_m: float, level_m: float, region: Region) -> None:
    assert regions(np.array([error_m]), np.array([level_m]), np.array([25.0])).tolist() == [region]


@given(st.lists(st.tuples(st.floats(0, 200), st.floats(0, 200), st.floats(1, 100)), min_size=1, max_size=50))
def test_every_epoch_is_in_one_region_that_its_numbers_say(epochs: list[tuple[float, float, float]]) -> None:
    error, level, limit = np.array(epochs).T
    found = regions(error, level, limit)
    assert np.array_equal(found == Region.HAZARDOUS, (error > limit) & (level <= limit))
    broken = np.isin(found, [Region.MISLEADING, Region.HAZARDOUS, Region.UNAVAILABLE_MISLEADING])
    assert np.array_equal(broken, error > level)
    assert np.array_equal(np.isin(found, [Region.UNAVAILABLE, Region.UNAVAILABLE_MISLEADING]), level > limit)


def test_a_flight_is_counted_where_truth_and_level_are_known(synthetic: ModuleType) -> None:
    record = synthetic.make_record()
    judged = horizontal(record, 25.0)
    known = np.isfinite(record.error_m) & np.isfinite(record.protection_level_m)
    assert len(judged.region) == known.sum()
    summary = judged.summary()
    assert summary is not None
    assert sum(summary[region.name.lower()] for region in Region) == summary["epochs"]
    assert summary["alert_limit_m"] == 25.0
    tighter = horizontal(record, 3.0).summary()
    assert tighter is not None
    assert tighter["available"] == 0


def test_vertical_levels_are_held_against_the_limits_of_their_phase(synthetic: ModuleType) -> None:
    record = synthetic.make_record()
    limits = np.where(record.t_s > 150, 2.0, 50.0)
    judged = vertical(replace(record, vertical_alert_limit_m=limits))
    assert judged.limit_m == 50.0
    assert 0 < judged.count(Region.UNAVAILABLE) < judged.count(Region.AVAILABLE)
    unknown = vertical(replace(record, vertical_alert_limit_m=np.full(len(record.t_s), np.nan)))
    assert unknown.limit_m == DEFAULT_VERTICAL_LIMIT_M


def test_without_truth_there_is_nothing_to_judge(synthetic: ModuleType) -> None:
    record = from_entries(synthetic.make_entries(20.0))
    assert horizontal(record, 25.0).summary() is None
    assert stanford_section(record, 25.0) == ""
    assert stanford_section(from_entries([]), 25.0) == ""


def test_the_section_says_what_held_and_what_did_not(synthetic: ModuleType) -> None:
    record = synthetic.make_record()
    section = stanford_section(replace(record, protection_level_m=np.full(len(record.t_s), 40.0)), 25.0)
    n_judged = int(np.isfinite(record.error_m).sum())
    assert f"The horizontal level held at every tick with truth ({n_judged})" in section
    assert section.count('role="img"') == 2
    low = stanford_section(replace(record, protection_level_m=np.full(len(record.t_s), 0.01)), 0.02)
    n = int(np.isfinite(record.error_m).sum())
    assert f"was too small at {n} of {n} ticks" in low
    assert re.search(rf'hazardously misleading \(HMI\).*?<td class="n">{n}</td>', low)


def test_a_flight_recorded_before_vertical_levels_shows_the_horizontal_one(synthetic: ModuleType) -> None:
    record = synthetic.make_record()
    section = stanford_section(replace(record, vertical_protection_level_m=np.full(len(record.t_s), np.nan)), 25.0)
    assert section.count('role="img"') == 1
    assert "Vertical" not in section
