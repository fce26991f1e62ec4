"""A truth that lies elsewhere than the receiver while GNSS counts as OK is told of."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.unit.evaluate.synthetic_flight import make_record
from visloc_companion.evaluate.record import FlightRecord, Track
from visloc_companion.evaluate.trusted_gnss import far_from_truth_noted


def moved(record: FlightRecord, north_m: float, from_s: float = 0.0) -> FlightRecord:
    """The flight with its truth moved from a time on."""
    shift = np.where(record.truth.t_s[:, None] >= from_s, (north_m, 0.0, 0.0), 0.0)
    return replace(record, truth=Track(record.truth.t_s, record.truth.p_ned_m + shift))


@pytest.mark.parametrize("north_m", [11_000.0, -400.0])
def test_a_truth_of_elsewhere_is_told_with_how_far_it_is(north_m: float) -> None:
    (note,) = far_from_truth_noted(moved(make_record(), north_m))
    assert f"the receiver lay {abs(north_m):.0f} m from the truth (median)" in note


def test_a_receiver_that_is_right_for_most_of_the_time_is_not_spoken_of() -> None:
    """The flight's own is dragged by 37 m while it counts as OK; from 60 of these 85 s on it may be anywhere."""
    record = make_record()
    assert far_from_truth_noted(record) == []
    assert far_from_truth_noted(moved(record, 11_000.0, from_s=60.0)) == []
    assert len(far_from_truth_noted(moved(record, 11_000.0, from_s=30.0))) == 1


def test_nothing_is_said_where_truth_receiver_or_trust_is_not_there() -> None:
    record, no_track = moved(make_record(), 11_000.0), Track(np.zeros(0), np.zeros((0, 3)))
    assert far_from_truth_noted(replace(record, truth=no_track)) == []
    assert far_from_truth_noted(replace(record, gnss=no_track)) == []
    assert far_from_truth_noted(replace(record, verdicts=("denied",) * len(record.verdicts))) == []
