"""The height above the take-off of a vehicle whose home is moved in flight."""

from __future__ import annotations

from dataclasses import replace

import pytest

from tests.unit.core.conftest import World
from visloc_companion.core.heights.takeoff_height import GLIDES_NS, RestartedAloft, TakeoffHeight
from visloc_companion.core.navigator import Navigator
from visloc_companion.types import (
    AutopilotKind,
    Command,
    Event,
    Fix,
    FoundOnVision,
    GeoPoint,
    Injection,
    LinkChanged,
    Mode,
    OriginChanged,
    PriorPose,
)

S = 1_000_000_000
ORIGIN = GeoPoint(59.3, 18.1, 40.0)
FIELD_AMSL_M = 40.0


def said(t_s: float, above_home_m: float, home_amsl_m: float = FIELD_AMSL_M, climb_mps: float = 0.0) -> PriorPose:
    place = GeoPoint(59.3, 18.1, home_amsl_m + above_home_m)
    return PriorPose(round(t_s * S), round(t_s * S), place, (5.0, 0.0, -climb_mps), above_home_m)


def flying() -> TakeoffHeight:
    """100 m up, ten seconds after it was first heard."""
    heights = TakeoffHeight()
    for t_s in range(11):
        assert heights.above_m(said(t_s, 100.0), disarmed=False) == 100.0
    return heights


def test_a_home_that_is_set_to_where_the_vehicle_flies_leaves_it_as_high_as_it_was() -> None:
    heights = flying()
    assert heights.above_m(said(10.1, 0.0, FIELD_AMSL_M + 100), disarmed=False) == pytest.approx(100.0)
    assert heights.above_m(said(10.2, -20.0, FIELD_AMSL_M + 100), disarmed=False) == pytest.approx(80.0)
    assert heights.above_m(said(10.3, 80.0, FIELD_AMSL_M), disarmed=False) == pytest.approx(80.0), "and back"


def test_also_of_a_vehicle_that_climbs_while_the_link_is_away() -> None:
    heights = flying()
    heights.above_m(said(10.1, 100.0, climb_mps=5.0), disarmed=False)
    assert heights.above_m(said(14.1, 20.0, FIELD_AMSL_M + 100), disarmed=False) == pytest.approx(120.0)


def test_a_height_above_the_sea_that_is_corrected_moves_no_home() -> None:
    heights = flying()
    assert heights.above_m(said(10.1, 100.0, FIELD_AMSL_M + 30), disarmed=False) == 100.0
    assert heights.above_m(said(10.2, 130.0, FIELD_AMSL_M + 30), disarmed=False) == 130.0, (
        "nor does a height that jumps as a whole"
    )


def test_a_home_that_is_set_by_arming_is_the_ground() -> None:
    heights = TakeoffHeight()
    heights.above_m(said(0.0, 30.0), disarmed=True)
    assert heights.above_m(said(0.1, 30.0), disarmed=False) == 30.0
    assert heights.above_m(said(0.2, 0.0, FIELD_AMSL_M + 30), disarmed=False) == 0.0


def test_what_was_moved_is_forgotten_on_the_ground() -> None:
    heights = flying()
    heights.above_m(said(10.1, 0.0, FIELD_AMSL_M + 100), disarmed=False)
    heights.above_m(said(60.0, -100.0, FIELD_AMSL_M + 100), disarmed=False)
    assert heights.above_m(said(61.0, -100.0, FIELD_AMSL_M + 100), disarmed=True) == -100.0


def test_the_first_home_of_an_autopilot_that_had_none_is_not_one_that_was_moved() -> None:
    heights = TakeoffHeight()
    for t_s in range(7):
        heights.above_m(said(t_s, 500.0, 0.0), disarmed=False)
    assert heights.above_m(said(7.1, 100.0, 400.0), disarmed=False) == 100.0


class SetHome(World):
    """At 30 s home is set to where the vehicle is, 100 m up. From 50 s on it hovers."""

    def velocity(self, t_s: float) -> tuple[float, float]:
        return super().velocity(t_s) if t_s < 50 else (0.0, 0.0)

    def send(self, event: Event) -> list[Command]:
        if isinstance(event, PriorPose) and self.t > 30:
            event = replace(event, h_rel_m=event.h_rel_m - 100.0)
        elif isinstance(event, Fix):
            event = replace(event, above_ground_m=100.0)
        return super().send(event)

    def restart(self) -> None:
        """Another daemon finds it flying on vision."""
        self.navigator, self.answers = Navigator(self.settings), []
        self.send(LinkChanged(0, up=True, autopilot=AutopilotKind.ARDUPILOT, system_id=1, armed=True))
        self.send(FoundOnVision(0))
        self.send(OriginChanged(0, ORIGIN))


def test_a_vehicle_that_nothing_was_recognised_from_for_a_while_is_looked_for_again() -> None:
    """It counted as on the ground as soon as no fix said for 30 s how far that lies below: no frame was asked about any more."""
    w = SetHome(jammed=lambda t: t > 20, blind=lambda t: 35 < t < 68)
    w.start()
    w.send(LinkChanged(0, up=True, autopilot=AutopilotKind.ARDUPILOT, system_id=1, armed=True))
    w.fly(80.0)
    assert len([t for t, _, _ in w.requests if 66 < t < 80]) > 20
    assert w.status_at(79.9)[0].mode is Mode.AIDING


def test_a_daemon_that_is_restarted_after_that_does_not_take_the_vehicle_for_landed() -> None:
    """What moves is looked for; a fix shows the ground far below, and then so is what hovers, also when that was long ago."""
    w = SetHome(jammed=lambda t: t > 20, blind=lambda t: 52 < t < 88)
    w.start()
    w.send(LinkChanged(0, up=True, autopilot=AutopilotKind.ARDUPILOT, system_id=1, armed=True))
    w.fly(40.0)
    w.restart()
    w.fly(95.0)
    assert w.first(Injection, since_s=40.0) < 43.0
    assert len([t for t, _, _ in w.requests if 86 < t < 95]) > 10
    assert w.status_at(94.9)[0].mode is Mode.AIDING


def test_whose_autopilot_restarts_in_flight_flies_on_until_a_fix_shows_the_ground() -> None:
    aloft = RestartedAloft()
    assert not aloft.flies(0, disarmed=False, ground_seen=False)
    aloft.restarted(flew=True)
    assert aloft.flies(S, disarmed=False, ground_seen=False)
    aloft.restarted(flew=False)  # again, while it counts from where it was
    assert aloft.flies(2 * S, disarmed=False, ground_seen=False)
    assert aloft.flies(2 * S + GLIDES_NS, disarmed=False, ground_seen=False), "something drives it"
    assert not aloft.flies(600 * S, disarmed=False, ground_seen=True)
    assert not aloft.flies(601 * S, disarmed=False, ground_seen=False)


def test_what_nothing_drives_is_down_after_a_while_and_what_stood_does_not_fly() -> None:
    flew, stood = RestartedAloft(), RestartedAloft()
    flew.restarted(flew=True)
    stood.restarted(flew=False)
    assert flew.flies(S, disarmed=True, ground_seen=False)
    assert flew.flies(GLIDES_NS, disarmed=True, ground_seen=False)
    assert not flew.flies(S + GLIDES_NS, disarmed=True, ground_seen=False)
    assert not stood.flies(S, disarmed=True, ground_seen=False)


def test_a_height_over_ground_that_is_known_before_the_autopilots_word_is_the_height() -> None:
    heights = TakeoffHeight()
    assert heights.found_m(80.0) == 80.0
    assert heights.above_m(said(0.0, 5.0), disarmed=False) == 5.0
    assert heights.found_m(80.0) == 80.0
    assert heights.above_m(said(1.0, 6.0), disarmed=False) == 81.0
