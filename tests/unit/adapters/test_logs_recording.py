from __future__ import annotations

from pathlib import Path

import pytest

from visloc_companion.adapters.logs.recording import Losses, Recording, lacking, with_origin
from visloc_companion.geo.wgs84 import distance_m, geo_from_autopilot_ned
from visloc_companion.types import (
    FIX_3D,
    Attitude,
    AutopilotKind,
    Event,
    GeoPoint,
    Gnss,
    LinkChanged,
    LocalPose,
    OriginChanged,
    PriorPose,
    Vec3,
)

KIND = AutopilotKind.ARDUPILOT
HOME = GeoPoint(-35.208, 149.043, 585.0)
V_NED_MPS = (10.0, 0.0, 0.0)


def place(t_ms: int, p_ned_m: Vec3, origin: GeoPoint = HOME) -> Event:
    return PriorPose(t_ms * 10**6, t_ms * 10**6, geo_from_autopilot_ned(KIND, p_ned_m, origin), V_NED_MPS, -p_ned_m[2])


def local(t_ms: int, p_ned_m: Vec3) -> Event:
    return LocalPose(t_ms * 10**6, t_ms * 10**6, p_ned_m, V_NED_MPS)


def origins(*events: Event) -> list[tuple[int, GeoPoint]]:
    """Times (ms) and places of the origins that are made up."""
    timed = [(event.t_rx_ns, event) for event in events]  # type: ignore[union-attr]
    recording = with_origin(Recording(Path("a"), KIND, timed, Losses()))
    times = [t_ns for t_ns, _ in recording.events]
    assert times == sorted(times)
    return [(t_ns // 10**6, event.origin) for t_ns, event in recording.events if isinstance(event, OriginChanged)]


def test_a_local_position_counts_before_the_global_one_as_well() -> None:
    flight = [local(1_000, (20.0, -30.0, -15.0)), place(1_040, (20.4, -30.0, -15.0)), place(1_240, (22.4, -30.0, -15.0))]
    ((t_ms, origin),) = origins(*flight)
    assert t_ms == 1_040
    assert distance_m(origin, HOME) == pytest.approx(0.0, abs=0.01)
    assert origin.h_amsl_m == pytest.approx(585.0)


def test_an_origin_moves_where_two_pairs_put_it_elsewhere() -> None:
    other = GeoPoint(-35.203, 149.043, 590.0)
    flight: list[Event] = []
    for k in range(10):
        p_ned_m = (float(k), 5.0, -20.0)
        stray = k == 3
        flight += [place(100 * k, p_ned_m, other if k >= 6 or stray else HOME), local(100 * k, p_ned_m)]
    (first, moved) = origins(*flight)
    assert (first[0], moved[0]) == (0, 700)
    assert distance_m(first[1], HOME) == pytest.approx(0.0, abs=0.01)
    assert distance_m(moved[1], other) == pytest.approx(0.0, abs=0.01)


def test_what_scatters_is_one_origin() -> None:
    flight = [
        e for k in range(9) for e in (place(100 * k, (k + 6.0 * (k % 3), 0.0, 0.0)), local(100 * k, (float(k + 1), 1.0, 0.0)))
    ]
    assert len(origins(*flight)) == 1


def test_what_a_log_lacks_altogether_is_named() -> None:
    attitude = Attitude(0, 0, (1.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    assert lacking([(0, attitude)]) == ["satellite receiver", "global position"]
    assert lacking([]) == ["attitude", "satellite receiver", "global position"]


def link(t_ms: int, *, up: bool) -> Event:
    return LinkChanged(t_ms * 10**6, up=up, autopilot=KIND)


def test_after_a_restart_the_origin_of_before_stands_until_there_is_another_one() -> None:
    other = GeoPoint(-35.203, 149.043, 590.0)
    stated = OriginChanged(50 * 10**6, HOME)
    flight = [link(0, up=True), stated, link(100, up=False), link(200, up=True), OriginChanged(300 * 10**6, other)]
    assert origins(*flight, link(400, up=True)) == [(50, HOME), (200, HOME), (300, other)]
    assert origins(link(0, up=False), link(20, up=True), stated) == [(50, HOME)]
    guessed = [place(50, (20.0, -30.0, -15.0)), local(50, (20.0, -30.0, -15.0))]
    assert [t_ms for t_ms, _ in origins(link(0, up=True), *guessed, link(100, up=False), link(200, up=True))] == [50, 200]


def test_a_second_receiver_without_a_fix_hides_no_first_position() -> None:
    receivers = [Gnss(1, 1, fix_type, 9, HOME, None, None, None, receiver) for receiver, fix_type in ((0, FIX_3D), (1, 1))]
    assert [origin for _, origin in origins(*receivers, place(100, (0.0, 0.0, 0.0)))] == [HOME]
    assert origins(receivers[1], place(100, (0.0, 0.0, 0.0))) == []
