"""Questions about the ground below the track in flight: when they are asked, and what the filter makes of the answers."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from tests.unit.core.conftest import BOOT_OFFSET_NS, HEIGHT_M, ns, place_of
from tests.unit.core.flown import started
from visloc_companion.core.settings import CoreSettings
from visloc_companion.core.terrain.terrain_aiding import FAR_SIGMA_M, METHOD, SHORTEST_M
from visloc_companion.errors import Reason
from visloc_companion.types import (
    Attitude,
    Command,
    Event,
    Fix,
    NoFix,
    OperatorFix,
    Range,
    TerrainRequest,
    WorkerState,
)

World = Any
SPEED_MPS, COV = 40.0, ((25.0, 0.0), (0.0, 25.0))
WAITS = "a fix of the terrain from far off waits for a second one"


@pytest.fixture
def sounding(world: Any) -> type[Any]:
    """A vehicle at 40 m/s without a camera and a rangefinder that reads its height over flat ground; a worker that knows where
    it is."""

    class Sounding(world):  # type: ignore[misc]
        answers_terrain, lively = True, True

        def send(self, event: Event) -> list[Command]:
            commands: list[Command] = super().send(event)
            for command in commands:
                if isinstance(command, TerrainRequest) and self.lively:
                    self.answers.append((self.t + 0.5, self.terrain(command)))
            return commands

        def terrain(self, asked: TerrainRequest) -> Fix | NoFix:
            told = asked.t_ns, asked.request_id, 0, METHOD
            if not self.answers_terrain:
                return NoFix(0, *told, Reason.LOW_TEXTURE, 1.0)
            return Fix(0, *told, place_of(self.p), asked.prior.q_ned_frd, COV, 1.0, 0.05, 0.001, 1.0)

        def _telemetry(self, t: float, gnss: np.ndarray, jammed: bool) -> None:
            super()._telemetry(t, gnss, jammed)
            self.send(Range(ns(t), ns(t) - BOOT_OFFSET_NS + ns(1000), HEIGHT_M, True))

    return Sounding


def flown(sounding: type[Any], **faults: Any) -> World:
    settings = CoreSettings(terrain=True, structure=False, has_camera=False)
    return started(sounding, settings=settings, speed_mps=SPEED_MPS, camera=lambda t: False, **faults)


def asked(w: World) -> list[tuple[float, TerrainRequest]]:
    return [(t, c) for t, c in w.commands if isinstance(c, TerrainRequest)]


def test_a_stretch_that_is_long_enough_is_asked_about_at_the_vehicles_attitude(sounding: type[Any]) -> None:
    w = flown(sounding, jammed=lambda t: t > 20).fly(60)
    lost = flown(sounding, jammed=lambda t: t > 10).fly(17)
    (first_s, first), *_ = asked(w)
    assert 0 < first_s - SHORTEST_M / SPEED_MPS < 6
    assert first.prior.q_ned_frd == (1.0, 0.0, 0.0, 0.0), "of the vehicle, wherever the camera looks"
    assert asked(lost)[0][1].sigma_drift_mps2 > first.sigma_drift_mps2, "no GNSS holds the velocity"
    status, off_m = w.status_at(59)
    assert status.age_of_fix_s < 25
    assert off_m < 15.0


def test_a_fix_of_the_terrain_tells_by_how_much_the_velocity_was_off(sounding: type[Any]) -> None:
    """Nothing else is told it before GNSS is lost; the autopilot's velocity is off by 2 m/s from there."""
    w = flown(sounding, jammed=lambda t: t > 10, false_velocity_mps=lambda t: (2.0 * (t > 12), 0.0)).fly(31)
    learned_north_mps, _ = w.navigator._terrain._learned.error_at(ns(asked(w)[-1][0]))
    assert learned_north_mps == pytest.approx(2.0, abs=0.6)


def test_nothing_is_asked_without_a_place_and_a_first_answer_from_far_off_waits(sounding: type[Any]) -> None:
    w = flown(sounding, jammed=lambda t: True).fly(30)
    assert not asked(w)
    w.send(OperatorFix(ns(w.t), place_of(w.p), 4 * FAR_SIGMA_M))
    w.fly(90)
    times = [t for t, _ in asked(w)]
    assert w.notices(WAITS) == pytest.approx([times[0] + 0.5], abs=0.06)
    before, after = w.status_at(times[1] - 0.1)[0], w.status_at(times[1] + 1.0)[0]
    assert max(before.cov_ne_m2[0][0], before.cov_ne_m2[1][1]) > FAR_SIGMA_M**2
    assert max(after.cov_ne_m2[0][0], after.cov_ne_m2[1][1]) < 20.0**2
    assert w.status_at(times[1] + 1.0)[1] < 20.0


def test_a_worker_that_ended_is_asked_again(sounding: type[Any]) -> None:
    w = flown(sounding, jammed=lambda t: t > 10)
    w.lively = False
    w.fly(30)
    (_, lost), *more = asked(w)
    assert not more, "one question at a time"
    w.lively = True
    w.send(WorkerState(ns(w.t), up=False, restarts=1))
    assert len(asked(w)) == 1
    w.send(WorkerState(ns(w.t), up=True, restarts=1))
    assert [c.request_id for _, c in asked(w)] == [lost.request_id, lost.request_id + 1]


def test_a_step_of_the_autopilots_clock_begins_the_stretch_anew(sounding: type[Any]) -> None:
    """What was measured before it lies nobody knows how far behind."""
    w = flown(sounding).fly(14)
    assert not asked(w)
    w.send(Attitude(ns(w.t), ns(1.0), (1.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0)))
    stepped_s = w.t
    w.fly(stepped_s + SHORTEST_M / SPEED_MPS - 1.0)
    assert not asked(w)
    w.fly(stepped_s + SHORTEST_M / SPEED_MPS + 4.0)
    (request,) = [c for _, c in asked(w)]
    assert request.soundings[0][0] < w.t - stepped_s
