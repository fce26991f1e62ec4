"""The height above home where the global position of an autopilot ends, as PX4's does without aiding."""

from __future__ import annotations

from typing import Any

import pytest

from tests.unit.core.conftest import World
from visloc_companion.core.heights.home_height import ENDED_NS, HomeHeight
from visloc_companion.geo import wgs84
from visloc_companion.types import AutopilotKind, Command, Event, GeoPoint, LinkChanged, LocalPose, Mode, PriorPose

ORIGIN = GeoPoint(59.3, 18.1, 40.0)
S = 1_000_000_000


def test_the_autopilots_word_counts_while_it_comes() -> None:
    home = HomeHeight()
    assert home.by_local(0, -20.0, disarmed=False) is None, "where home is nobody has said"
    home.told(S // 10, 5.0)
    assert home.by_local(S, -40.0, disarmed=False) is None


def test_the_local_position_carries_it_on_and_a_restart_ends_that() -> None:
    home = HomeHeight()
    home.by_local(0, -20.0, disarmed=False)
    home.told(S // 10, 5.0)
    later_ns = S // 10 + ENDED_NS + 1
    assert home.by_local(later_ns, -60.0, disarmed=False) == pytest.approx(45.0)
    home.forget()
    assert home.by_local(later_ns + S, 0.0, disarmed=False) is None


def test_positions_of_different_moments_tell_nothing_of_home() -> None:
    home = HomeHeight()
    home.by_local(0, -20.0, disarmed=False)
    home.told(S, 30.0)
    assert home.by_local(4 * S, -60.0, disarmed=False) is None


def test_a_disarmed_vehicle_without_a_global_position_stands_on_its_home() -> None:
    home = HomeHeight()
    assert home.by_local(0, -3.0, disarmed=True) == 0.0
    assert home.by_local(S, -33.0, disarmed=False) == 30.0


class GlobalEnds(World):
    """Both positions; the global one ends at 28 s, when the vehicle hovers 5 m up. Then it climbs."""

    def send(self, event: Event) -> list[Command]:
        if not isinstance(event, PriorPose):
            return super().send(event)
        height_m = event.h_rel_m
        p_ned_m: Any = (float(self.ekf_p[0]), float(self.ekf_p[1]), -height_m)
        told = super().send(LocalPose(event.t_rx_ns, event.t_boot_ns, p_ned_m, event.v_ned_mps))
        place = wgs84.geo_from_ned(p_ned_m, ORIGIN)
        whole = PriorPose(event.t_rx_ns, event.t_boot_ns, place, event.v_ned_mps, height_m)
        return told if self.t > 28 else [*told, *super().send(whole)]


def test_a_vehicle_that_climbs_after_its_global_position_ended_is_looked_for() -> None:
    """It counted as 5 m high for good: at 100 m no frame was asked about, and nobody was told."""
    w = GlobalEnds(jammed=lambda t: t > 20, height_m=lambda t: 5.0 if t < 30 else min(100.0, 5 + 10 * (t - 30)))
    w.start()
    w.send(LinkChanged(0, up=True, autopilot=AutopilotKind.PX4, system_id=1, armed=True))
    w.fly(45.0)
    assert not [t for t, _, _ in w.requests if t < 30], "too low"
    assert len([t for t, _, _ in w.requests if 32 < t < 45]) > 20
    assert w.status_at(44.9)[0].mode is Mode.AIDING
