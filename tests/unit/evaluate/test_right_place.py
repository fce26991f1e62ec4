"""What cannot be the truth of a flight is told before it is flown."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from visloc_companion.adapters.logs.recording import Losses, Recording
from visloc_companion.adapters.logs.truth import TruthRow
from visloc_companion.errors import LogError
from visloc_companion.evaluate.right_place import Area, area_about, check_places, flown_places, least_distance_m
from visloc_companion.maps.pack import PackMap
from visloc_companion.types import AutopilotKind, GeoPoint, Gnss, PriorPose

MAP = Area("the map", 36.0, -80.1, 36.1, -80.0)
BESIDE_180 = Area("the map", -18.0, 179.9, -17.9, -179.9)
TRUTH_FILE = Path("flight/truth.csv")


@dataclass
class _Pack:
    """A pack as far as its box goes."""

    area: Area

    @property
    def manifest(self) -> Any:
        return SimpleNamespace(bounds=self.area)


def pack(area: Area = MAP) -> PackMap:
    return cast("PackMap", _Pack(area))


def recording(lat_deg: float, lon_deg: float) -> Recording:
    place = GeoPoint(lat_deg, lon_deg, 0.0)
    prior, fix = PriorPose(1, 1, place, (0.0, 0.0, 0.0), 0.0), Gnss(2, 2, 3, 9, place, None, None, None)
    lost = replace(fix, place=GeoPoint(0.0, 0.0, 0.0))
    return Recording(Path("a.tlog"), AutopilotKind.ARDUPILOT, [(1, prior), (2, fix), (3, lost)], Losses())


def truth(lat_deg: float, lon_deg: float) -> list[TruthRow]:
    return [TruthRow(k, GeoPoint(lat_deg + 1e-5 * k, lon_deg, 100.0)) for k in range(5)]


@pytest.mark.parametrize(
    ("area", "place", "metres"),
    [
        (MAP, (36.05, -80.05), 0.0),
        (MAP, (37.1, -80.05), 111_195.0),
        (MAP, (36.05, -79.0), 111_195.0 * math.cos(math.radians(36.05))),
        (MAP, (-36.05, -80.05), 72.05 * 111_195.0),
        (BESIDE_180, (-17.95, 179.95), 0.0),
        (BESIDE_180, (-17.95, -179.8), 0.1 * 111_195.0 * math.cos(math.radians(17.95))),
    ],
)
def test_how_far_a_place_lies_from_a_box(area: Area, place: tuple[float, float], metres: float) -> None:
    assert least_distance_m(area, np.array([place, place, (100.0, -80.0)])) == pytest.approx(metres, rel=1e-2, abs=1.0)


def test_a_box_leaves_out_what_leaps_and_crosses_180_degrees() -> None:
    places = np.array([(-17.9, 179.9), (-17.95, -179.9), *[(-17.92, 180.0)] * 40, (50.0, 8.0)])
    area = area_about("the log", places)
    assert area is not None and area_about("the log", places[:0]) is None
    assert least_distance_m(area, places[2:3]) == 0.0
    assert least_distance_m(area, places[:1]) < 20_000.0
    assert least_distance_m(area, places[-1:]) > 5e6


def test_places_of_a_receiver_without_a_fix_count_for_nothing() -> None:
    flown = recording(36.05, -80.05)
    flown.events.append((4, Gnss(4, 4, 1, 0, GeoPoint(10.0, 10.0, 0.0), None, None, None)))
    assert flown_places(flown.events).tolist() == [[36.05, -80.05]] * 2


@pytest.mark.parametrize("reference", [pack(), None])
def test_what_lies_where_it_should_is_not_spoken_of(reference: PackMap | None) -> None:
    assert check_places(recording(36.05, -80.05), truth(36.2, -80.05), TRUTH_FILE, reference) == []
    assert check_places(recording(36.05, -80.05), [], TRUTH_FILE, reference) == []


@pytest.mark.parametrize(
    ("reference", "lat_deg", "lon_deg", "told"),
    [
        (pack(), -80.05, 36.05, r"lie \d+ km from the map, the other way round 0 km"),
        (None, -80.05, 36.05, r"lie \d+ km from the log's positions, the other way round 0 km"),
    ],
)
def test_exchanged_columns_are_told_as_such(reference: PackMap | None, lat_deg: float, lon_deg: float, told: str) -> None:
    with pytest.raises(LogError, match=rf"truth\.csv: latitude and longitude are exchanged: its places {told}; remedy: "):
        check_places(recording(36.05, -80.05), truth(lat_deg, lon_deg), TRUTH_FILE, reference)


def test_near_the_diagonal_exchanged_columns_are_told_too() -> None:
    """45.3 and 45.0 degrees: 41 km apart, which nothing else would show."""
    area = Area("the map", 45.29, 44.99, 45.31, 45.01)
    with pytest.raises(LogError, match="exchanged"):
        check_places(recording(45.3, 45.0), truth(45.0, 45.3), TRUTH_FILE, pack(area))


def test_an_exchanged_log_is_named() -> None:
    with pytest.raises(LogError, match=r"a\.tlog: latitude and longitude are exchanged"):
        check_places(recording(-80.05, 36.05), [], TRUTH_FILE, pack())


def test_a_truth_of_another_place_is_refused_beside_a_map() -> None:
    """A sign that is missing, say."""
    with pytest.raises(LogError, match=r"truth\.csv: none of its places lies near the map: .* \d{4,5} km off; remedy"):
        check_places(recording(36.05, -80.05), truth(36.05, 80.05), TRUTH_FILE, pack())


def test_a_receiver_that_was_false_all_the_time_is_told_and_replayed() -> None:
    """Spoofing may put the whole log elsewhere, where the truth is not."""
    (note,) = check_places(recording(33.8, 35.5), truth(36.05, -80.05), TRUTH_FILE, pack())
    assert note.startswith("All positions of the log lie ") and "from the map" in note
    (note,) = check_places(recording(33.8, 35.5), truth(36.05, -80.05), TRUTH_FILE, None)
    assert note.startswith("All places of the truth lie ") and "from the log's positions" in note
