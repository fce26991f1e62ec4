"""A truth that lies elsewhere than the receiver while GNSS counts as OK is told of, and a log that seldom tells of GNSS."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.unit.evaluate.synthetic_flight import make_record
from visloc_companion.evaluate.record import FlightRecord, Track
from visloc_companion.evaluate.trusted_gnss import far_from_truth_noted, rare_reports_noted
from visloc_companion.types import GeoPoint, Gnss


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


def reports(every_s: float, n: int = 100, receiver: int = 0) -> list[tuple[int, Gnss]]:
    at_ns = [round(k * every_s * 1e9) for k in range(n)]
    return [(t, Gnss(t, t, 3, 12, GeoPoint(47.0, 8.0, 400.0), 1.0, 1.5, None, receiver=receiver)) for t in at_ns]


def test_a_log_in_which_receivers_speak_seldom_is_told_of_with_what_to_write() -> None:
    """A real log with a report every 2.7 s was replayed as 900 s of a lost GNSS, and nothing said that it was the log."""
    (note,) = rare_reports_noted(reports(2.7), 2.0)
    assert "every 2.7 s (median)" in note
    assert "gnss.silence_s = 9 in --config" in note
    assert rare_reports_noted(reports(2.7), 9.0) == []


def test_a_receiver_that_falls_silent_now_and_then_is_not_a_log_that_is_slow() -> None:
    often = reports(0.2)
    assert rare_reports_noted(often[:40] + often[80:], 2.0) == []
    assert rare_reports_noted([], 2.0) == rare_reports_noted(often[:1], 2.0) == []
    assert rare_reports_noted(reports(2.7, receiver=1), 2.0) == [], "the second receiver is not judged"
