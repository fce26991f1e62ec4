"""A flipped bit in a log without checksums puts one position far away; spoofing, which leaps and stays, is kept as it is."""

from __future__ import annotations

import struct
from pathlib import Path

import pytest

from tests.unit.adapters.test_logs_dataflash import MODERN, message, modern_flight
from tests.unit.adapters.test_logs_ulog import flight as px4_flight
from tests.unit.adapters.test_logs_ulog import packed
from visloc_companion.adapters.logs.lone_leaps import lone_leaps, without_lone_leaps
from visloc_companion.adapters.logs.open import open_log
from visloc_companion.adapters.logs.recording import Losses
from visloc_companion.types import Event, GeoPoint, Gnss, LocalPose, PriorPose

HERTZ_10_NS = 100_000_000
FAR_M = 20_000.0


def track(places_m: list[float], step_ns: int = HERTZ_10_NS) -> list[tuple[int, int, float]]:
    return [(k, k * step_ns, place_m) for k, place_m in enumerate(places_m)]


def found(places_m: list[float], step_ns: int = HERTZ_10_NS) -> list[int]:
    return [leap.number for leap in lone_leaps(track(places_m, step_ns), lambda a, b: abs(a - b))]


def test_what_leaps_away_for_one_record_and_back_is_found() -> None:
    assert found([0.0, 1.0, FAR_M, 3.0, 4.0, -FAR_M, 6.0, 7.0]) == [2, 5]
    (leap,) = lone_leaps(track([0.0, 1.0, FAR_M, 3.0, 4.0]), lambda a, b: abs(a - b))
    assert (leap.t_ns, leap.off_m) == (2 * HERTZ_10_NS, FAR_M - 3.0)


@pytest.mark.parametrize(
    "places_m",
    [
        [0.0, 1.0, FAR_M, FAR_M + 1, FAR_M + 2],  # it leaps and stays
        [0.0, 1.0, FAR_M, FAR_M + 1, 4.0, 5.0],  # comes back after two
        [0.0, 1.0, FAR_M, 3 * FAR_M, 3 * FAR_M],  # leaps twice, and on
        [0.0, 1.0, FAR_M, 0.5 * FAR_M, 0.0],  # comes back to another place
        [0.0, 1.0, 9_000.0, 3.0, 4.0],  # is not so far
        [FAR_M, 1.0, 2.0, FAR_M],  # first and last have a neighbour on one side alone
        [],
    ],
)
def test_what_may_have_been_is_not(places_m: list[float]) -> None:
    assert found(places_m) == []


def test_what_is_not_too_fast_is_not() -> None:
    assert found([0.0, 1.0, FAR_M, 3.0], 19 * 1_000_000_000) == [2]
    assert found([0.0, 1.0, FAR_M, 3.0], 21 * 1_000_000_000) == []


def of(kind: type, recording_events: list[tuple[int, Event]]) -> list[Event]:
    return [event for _, event in recording_events if isinstance(event, kind)]


def flipped(data: bytes, record: bytes, value: int, bit: int) -> bytes:
    """A log with one bit of a value (int32) in one of its records flipped."""
    at = data.index(record) + record.index(struct.pack("<i", value))
    damaged = bytearray(data)
    damaged[at + bit // 8] ^= 1 << bit % 8
    return bytes(damaged)


def test_a_flipped_bit_of_the_autopilots_position_is_left_out_counted_and_told(tmp_path: Path) -> None:
    pos = message(MODERN, "POS", 1_700_000, 474_000_630, 85_500_000, 540.0, 40.0, 40.0)
    path = tmp_path / "a.bin"
    path.write_bytes(flipped(modern_flight(), pos, 474_000_630, 20))
    recording = open_log(path)
    assert len(of(PriorPose, recording.events)) == 19
    assert all(abs(e.place.lat_deg - 47.4) < 1e-3 for e in of(PriorPose, recording.events) if isinstance(e, PriorPose))
    assert (recording.losses.leaping_positions, recording.losses.dropped_messages) == (1, 0)
    (note,) = recording.notes
    assert note.startswith("Of a.bin, positions of the autopilot that leap away for one record and back were left out as damaged")
    assert note.endswith(": 1, the first at 1.700 s of the boot clock, 12 km off.")


def test_a_receivers_is_told_and_taken_as_it_is(tmp_path: Path) -> None:
    """Who judges a receiver must see what it said."""
    gps = message(MODERN, "GPS", 1_700_000, 0, 3, 3_600_700, 2200, 15, 80, 474_000_630, 85_500_000, 54_000, 10.0, 90.0, -0.1, 0.0)
    path = tmp_path / "a.bin"
    path.write_bytes(flipped(modern_flight(), gps, 474_000_630, 20))
    recording = open_log(path)
    assert len(of(Gnss, recording.events)) == 20 and recording.losses.leaping_positions == 0
    (note,) = recording.notes
    assert note.startswith(
        "Of a.bin, positions of the receiver that leap away for one record and back were taken as they are: 1,"
    )


def test_spoofing_that_drags_all_along_stays_as_it_is(tmp_path: Path) -> None:
    """From the tenth record on receiver and autopilot are 111 km away."""
    whole = modern_flight()
    for k in range(10, 20):
        lat = 474_000_000 + k * 90
        whole = whole.replace(struct.pack("<i", lat), struct.pack("<i", lat + 10_000_000))
    path = tmp_path / "a.bin"
    path.write_bytes(whole)
    recording = open_log(path)
    assert (len(of(PriorPose, recording.events)), len(of(Gnss, recording.events)), recording.notes) == (20, 20, ())


def test_px4s_local_and_global_positions_are_looked_at(tmp_path: Path) -> None:
    data = px4_flight()
    damaged = data.replace(
        packed("vehicle_local_position", 21_000_000, 47.4, 8.55, 488.0, 10.0, 2.0, -30.0, 10.0, 0.5, 0.0, *(True,) * 5),
        packed("vehicle_local_position", 21_000_000, 47.4, 8.55, 488.0, 1e6, 2.0, -30.0, 10.0, 0.5, 0.0, *(True,) * 5),
    ).replace(
        packed("vehicle_global_position", 21_500_000, 47.4 + 15 * 1e-5, 8.55, 518.0),
        packed("vehicle_global_position", 21_500_000, 49.4, 8.55, 518.0),
    )
    assert damaged != data
    (tmp_path / "a.ulg").write_bytes(damaged)
    recording = open_log(tmp_path / "a.ulg")
    assert recording.losses.leaping_positions == 2
    assert max(e.p_ned_m[0] for e in of(LocalPose, recording.events) if isinstance(e, LocalPose)) < 100.0
    assert len(of(PriorPose, recording.events)) == 29
    assert recording.notes[0].endswith(": 2, the first at 21.000 s of the boot clock, 1000 km off.")


def test_a_receiver_without_a_fix_leaps_as_it_likes() -> None:
    def fix(k: int, fix_type: int, lat_deg: float) -> tuple[int, Event]:
        t_ns = k * HERTZ_10_NS
        return t_ns, Gnss(t_ns, t_ns, fix_type, 9, GeoPoint(lat_deg, 8.0, 0.0), None, None, None)

    events = [fix(0, 3, 47.0), fix(1, 3, 47.0), fix(2, 1, 0.0), fix(3, 3, 47.0), fix(4, 3, 47.0)]
    assert without_lone_leaps(Path("a.bin"), events, Losses()) == (events, ())
