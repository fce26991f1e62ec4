"""Answers that leave several places open: from the worker's answer to the filter, and what the operator is told."""

from __future__ import annotations

import math
from typing import Any

from visloc_companion.app.serialise import from_json, to_json
from visloc_companion.core.settings import CoreSettings, InjectionSettings
from visloc_companion.errors import Reason
from visloc_companion.geo import wgs84
from visloc_companion.types import Fix, GeoPoint, LocaliseRequest, Mode, NoFix, OpenPlace, Status

World = Any
ORIGIN = GeoPoint(59.3, 18.1, 40.0)
FOOTPRINT_M, JAMMED_S = 60.0, 20.0
BESIDE = ((70.0, 0.0), (0.0, -65.0), (-60.0, 60.0))


def over_look_alikes(world: type[World], pick: Any, seed: int = 1) -> World:
    """After GNSS is lost every frame shows the right place and others; `pick(k)` says which of BESIDE the k-th one shows."""

    class LookAlike(world):  # type: ignore[misc]
        n_open = 0

        def _localise(self, request: LocaliseRequest) -> None:
            super()._localise(request)
            when, fix = self.answers[-1]
            if self.t < JAMMED_S or not isinstance(fix, Fix) or math.sqrt(request.prior.cov_ne_m2[0][0]) < 6.0:
                return
            shown = [(0.0, 0.0), *(BESIDE[k] for k in pick(self.n_open // 12))]
            self.n_open += 1
            places = tuple(
                OpenPlace(wgs84.geo_from_ned((n, e, 0.0), fix.place), fix.cov_ne_m2, math.log(0.98 / len(shown)))
                for n, e in shown
            )
            about = (0, fix.t_ns, fix.request_id, fix.frame_id, "test", Reason.AMBIGUOUS, 5.0)
            answer = NoFix(*about, open_places=places, footprint_m=FOOTPRINT_M)
            assert from_json(to_json(answer)) == answer
            self.answers[-1] = (when, answer)

    settings = CoreSettings(injection=InjectionSettings(switch_source=True), structure=False)
    w = LookAlike(settings=settings, jammed=lambda t: t > JAMMED_S, blind=lambda t: JAMMED_S - 1 < t < 50, seed=seed)
    w.start()
    return w


def test_the_place_that_all_frames_share_becomes_a_fix(world: type[World]) -> None:
    w = over_look_alikes(world, lambda k: ([0, 1], [1, 2], [0], [2], [1])[k % 5], seed=2).fly(100)
    (found_s,) = w.notices("one of the open places is left")
    assert w.notices("places are open")
    assert 50 < found_s < 90
    assert max(status.open_places for _, status, _ in w.statuses) >= 3
    assert w.status_at(99)[0].open_places == 0
    assert w.status_at(99)[0].mode is Mode.AIDING
    assert max(error for t, _, error in w.statuses if t > found_s + 2) < 12


def test_ground_that_repeats_itself_gives_no_fix(world: type[World]) -> None:
    w = over_look_alikes(world, lambda k: [0, 1, 2]).fly(110)
    assert w.n_open > 40
    assert not w.notices("one of the open places is left")
    assert w.status_at(109)[0].age_of_fix_s > 55


def test_older_journals_can_be_read() -> None:
    old = (
        '{"type":"NoFix","t_rx_ns":1,"t_ns":1,"request_id":1,"frame_id":1,"method":"deep","reason":"ambiguous","elapsed_ms":5.0}'
    )
    answer = from_json(old)
    assert isinstance(answer, NoFix)
    assert (answer.open_places, answer.footprint_m) == ((), None)
    nothing = '"cov_ne_m2":[[0.0,0.0],[0.0,0.0]],"sigma_d_m":0.0,"protection_level_m":null,"age_of_fix_s":null'
    status = from_json(
        '{"type":"Status","t_ns":1,"mode":"lost","verdict":"ok","reasons":[],"place":null,"v_ned_mps":[0.0,0.0,0.0],'
        f'{nothing},"injected":false,"reset_counter":0}}'
    )
    assert isinstance(status, Status)
    assert status.open_places == 0
