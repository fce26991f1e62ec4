"""Starts without GNSS, and relocalisation after a long loss: the navigator finds its place on the map."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from tests.unit.core.flown import blinkered
from visloc_companion.core.settings import CoreSettings, InjectionSettings, NavigatorSettings
from visloc_companion.errors import Reason
from visloc_companion.geo import wgs84
from visloc_companion.types import (
    Attitude,
    Event,
    GeoPoint,
    Gnss,
    Injection,
    LocaliseRequest,
    Mode,
    NoFix,
    OperatorFix,
    OriginChanged,
    PriorPose,
    Tick,
    Vote,
    WorkerState,
)

World = Any
ORIGIN = GeoPoint(59.3, 18.1, 40.0)
INJECTION = InjectionSettings(switch_source=True)


def test_a_daemon_that_starts_while_gnss_is_lost_finds_its_place_and_injects(world: type[World]) -> None:
    w = blinkered(world)
    w.p = w.ekf_p = np.array([-700.0, 1100.0])
    w.ekf_p = np.array([4000.0, 0.0])  # what the autopilot says of its place is of no use
    w.fly(60)
    (found_s,) = w.notices("position found on the map")
    (begun_s,) = w.notices("searching the map, keep moving")
    assert begun_s < found_s
    assert found_s < 30
    assert w.first(Injection) >= found_s
    assert w.status_at(58)[0].mode is Mode.AIDING
    assert max(error for t, _, error in w.statuses if t > found_s + 1) < 8
    assert all(request.vote is Vote.IMAGE for t, request, _ in w.requests if t < found_s)
    first, test = (
        next(r.prior for _, r, _ in w.requests if (r.prior.cov_ne_m2[0][0] > 150**2) == tile) for tile in (True, False)
    )
    assert math.degrees(first.sigma_yaw_rad) == pytest.approx(10 / 3)
    assert first.sigma_h_m < test.sigma_h_m
    assert test.sigma_yaw_rad == math.radians(5.0)


def test_nothing_is_searched_for_while_gnss_is_trusted_or_where_it_is_not_wished(world: type[World]) -> None:
    healthy = blinkered(world, jammed=lambda t: False).fly(20)
    assert max(request.prior.cov_ne_m2[0][0] for _, request, _ in healthy.requests) < 30**2
    off = CoreSettings(injection=INJECTION, navigator=NavigatorSettings(start_anywhere=False))
    assert not blinkered(world, off).fly(20).requests
    assert not healthy.notices("searching the map")


def test_a_daemon_that_waited_for_its_autopilot_gives_gnss_its_time(world: type[World]) -> None:
    w = world(settings=CoreSettings(injection=INJECTION))
    for k in range(1, 200):
        w.k = k
        w.send(Tick(round(w.t * 1e9)))
    w.start()
    w.fly(w.t + 10)
    assert w.requests
    assert max(request.prior.cov_ne_m2[0][0] for _, request, _ in w.requests) < 30**2


def test_the_operators_position_ends_the_search(world: type[World]) -> None:
    w = blinkered(world).fly(8)
    assert w.requests
    w.send(OperatorFix(0, wgs84.geo_from_ned((float(w.p[0]), float(w.p[1]), 0.0), ORIGIN), 20.0))
    w.fly(40)
    assert not w.notices("position found on the map")
    assert max(math.sqrt(r.prior.cov_ne_m2[0][0]) for t, r, _ in w.requests if t > 10) < 40
    assert w.status_at(38)[1] < 8


def test_a_word_that_leaves_much_open_is_where_the_search_begins_anew(world: type[World]) -> None:
    """Wider than a tile: a sweep of the whole map that was under way is not finished first."""
    w = blinkered(world, blind=lambda t: True).fly(40)
    said = wgs84.geo_from_ned((9000.0, 1500.0, 0.0), ORIGIN)
    w.send(OperatorFix(0, said, 350.0))
    w.fly(50)
    asked_m = [wgs84.distance_m(r.prior.place, said) for t, r, _ in w.requests if t > 40]
    assert len(asked_m) >= 15
    assert asked_m[0] < 50
    assert max(asked_m) < 4000, "two rings of tiles about it"


def test_an_origin_that_changes_its_height_does_not_begin_the_search_anew(world: type[World]) -> None:
    asked = []
    for raised_m in (0.0, 0.04):
        w = blinkered(world).fly(6)
        w.send(OriginChanged(0, replace(ORIGIN, h_amsl_m=ORIGIN.h_amsl_m + raised_m)))
        w.fly(12)
        asked.append([(r.prior.place.lat_deg, r.prior.place.lon_deg) for _, r, _ in w.requests])
    assert len(asked[0]) > 8
    assert asked[0] == asked[1]


def test_an_origin_that_moves_begins_the_search_anew(world: type[World]) -> None:
    w = blinkered(world).fly(6)
    w.send(OriginChanged(0, wgs84.geo_from_ned((300.0, 0.0, 0.0), ORIGIN)))
    w.fly(12)
    assert wgs84.distance_m(w.requests[-1][1].prior.place, ORIGIN) < 4000


def test_after_a_long_loss_it_is_found_again_with_a_new_reset_counter(world: type[World]) -> None:
    """Blind for long enough that the search of one region is too small; the velocity that carries the state is off by 4 m/s."""
    settings = CoreSettings(injection=INJECTION, navigator=NavigatorSettings(velocity_sigma_aiding_mps=4.0))
    w = blinkered(
        world,
        settings,
        jammed=lambda t: t > 20,
        blind=lambda t: 20 < t < 200,
        false_velocity_mps=lambda t: (4.0, 0.0) if t > 20 else (0.0, 0.0),
        speed_mps=5.0,
    )
    w.fly(199)
    status, error = w.status_at(198)
    assert status.mode is Mode.LOST
    before = status.reset_counter
    w.fly(300)
    found = w.notices("position found on the map")
    assert found, (status.cov_ne_m2, error)
    status, error = w.status_at(298)
    assert status.reset_counter != before
    assert status.mode is Mode.AIDING
    assert error < 15


def test_a_worker_that_dies_once_over_a_tile_makes_tiles_smaller_once(world: type[World]) -> None:
    """The frame that waits is asked of a worker that is dead, before that is told: its refusal is no other death."""
    w = blinkered(world)
    while not w.requests:
        w.step()
    w.answers.clear()
    w.fly(w.t + 3.0)
    ((_, first, _),) = w.requests
    told = first.frame.t_ns, first.request_id, first.frame.frame_id, "test"
    refused = [c for c in w.send(NoFix(0, *told, Reason.WORKER_TIMEOUT, 0.0)) if isinstance(c, LocaliseRequest)]
    w.send(WorkerState(0, up=False, restarts=1))
    for each in refused:
        told = each.frame.t_ns, each.request_id, each.frame.frame_id, "test"
        w.send(NoFix(0, *told, Reason.WORKER_DIED, 0.0, "there is no worker"))
    w.fly(w.t + 1.0)
    (again,) = [c for c in w.send(WorkerState(0, up=True, restarts=1)) if isinstance(c, LocaliseRequest)]
    assert again.prior.cov_ne_m2[0][0] == pytest.approx(first.prior.cov_ne_m2[0][0] / 4)


def test_a_place_that_is_found_before_a_restarted_autopilot_tells_a_velocity_starts_no_filter(world: type[World]) -> None:
    """Its first attitude comes with the answer, its first velocity after it. GNSS is given its time again, then it is found."""
    first = blinkered(world)
    while not first.notices("position found on the map"):
        first.step()
    found_s = first.t

    class Restarts(world):  # type: ignore[misc]
        def send(self, event: Event) -> Any:
            if self.t >= found_s and isinstance(event, Attitude | PriorPose | Gnss):
                event = replace(event, t_boot_ns=event.t_boot_ns - 900_000_000_000)
            return super().send(event)

    w = blinkered(Restarts).fly(found_s + 1.0)
    assert w.notices("autopilot clock stepped") == [found_s]
    assert not w.notices("position found on the map")
    assert w.status_at(w.t)[0].place is None
    w.fly(found_s + 20.0)
    assert len(w.notices("position found on the map")) == 1
    assert w.status_at(w.t)[1] < 8.0
