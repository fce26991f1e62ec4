"""A camera that zooms in flight: the zoom is found and reckoned with, a good GNSS stays trusted, and a false one is found as soon
as ever."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest

from visloc_companion.core.camera.zoom_ramp import FOLLOWED_SHARE
from visloc_companion.errors import Reason
from visloc_companion.geo import wgs84
from visloc_companion.sim.real.oracle import answered_height
from visloc_companion.types import Fix, Injection, LocaliseRequest, NoFix, Notice, Odometry, OpenPlace

COV = ((0.01, 0.0), (0.0, 0.01))
HEIGHT_M, ORIGIN_AMSL_M, ZOOM_S = 100.0, 40.0, 30.0
RECOGNISED = 0.07
"""Natural logarithm of a scale that is off by so much that no frame is recognised."""
LEAN_M = 45.0
"""What a camera that leans by 20 degrees to the west adds to a fix for a lens that is twice as long, metres east."""
HELD_SIGMAS, ASIDE_M, SIGMA_H_M = 3.0, 6.0, 0.8
"""A height that is held further away than so many sigmas leaves no place that explains the picture: fixes are as far aside."""


def told(w: Any) -> list[str]:
    return [c.text for _, c in w.commands if isinstance(c, Notice) and c.to_operator]


def named(w: Any) -> list[float]:
    """The factors that were told."""
    return [dict(c.data)["factor"] for _, c in w.commands if isinstance(c, Notice) and "zoomed x" in c.text]


def suspected_s(w: Any) -> float:
    return float(w.notices("GNSS not trusted")[0])


@pytest.fixture
def zooming(world: Any) -> type[Any]:
    """Pictures are enlarged by `zoom`, and by ground that is `nearer`: recognised through such a lens, or from a height that
    looks alike, and off in height and motion by what is left."""

    @dataclass
    class Zooming(world):  # type: ignore[misc]
        zoom: Callable[[float], float] = lambda t: 1.0
        nearer: Callable[[float], float] = lambda t: 1.0
        tries: bool = True

        def _localise(self, request: LocaliseRequest) -> None:
            super()._localise(request)
            when, answer = self.answers.pop()
            left = self.zoom(self.t) * self.nearer(self.t) / request.zoom * self.lower(request)
            t1_s = answer.t_ns * 1e-9
            north, east = np.array(self.velocity(t1_s - self.fix_period_s / 2)) * self.fix_period_s * left
            first_ns = round((t1_s - self.fix_period_s) * 1e9)
            motion = Odometry(0, first_ns, answer.t_ns, (float(north), float(east), 0.0), COV, 0.01, 0.02)
            if (found := self.through(request, answer, request.zoom)) is not None:
                seen: Fix | NoFix = replace(found, motion=motion)
            else:
                ids = request.request_id, request.frame.frame_id, "test"
                tries = request.try_zoom is not None and self.tries
                tried = self.through(request, answer, request.try_zoom) if tries else None
                seen = NoFix(0, answer.t_ns, *ids, Reason.NO_MATCH, 5.0, motion=motion, zoomed=tried)
            self.answers.append((when, seen))

        def lower(self, request: LocaliseRequest) -> float:
            """By how much the ground looks smaller than from the height that the request says."""
            return (request.prior.place.h_amsl_m - ORIGIN_AMSL_M) / HEIGHT_M

        def through(self, request: LocaliseRequest, answer: Fix | NoFix, zoom: float) -> Fix | None:
            left = self.zoom(self.t) * self.nearer(self.t) / zoom
            if not isinstance(answer, Fix) or abs(math.log(left * self.lower(request))) > RECOGNISED:
                return None
            h_amsl_m, prior = answer.place.h_amsl_m + HEIGHT_M * (1 / left - 1), request.prior
            held = abs(h_amsl_m - prior.place.h_amsl_m) > HELD_SIGMAS * prior.sigma_h_m
            east_m = (self.zoom(self.t) / zoom - 1) * LEAN_M - (ASIDE_M if held else 0.0)
            place = wgs84.geo_from_ned((0.0, east_m, 0.0), answer.place)
            if held:
                return replace(answer, place=replace(place, h_amsl_m=prior.place.h_amsl_m), sigma_h_m=prior.sigma_h_m)
            h_amsl_m, sigma_h_m = answered_height(h_amsl_m, prior, SIGMA_H_M)
            return replace(answer, place=replace(place, h_amsl_m=h_amsl_m), sigma_h_m=sigma_h_m, per_focal_ne_m=(0.0, LEAN_M))

    return Zooming


def slow(share_per_s: float, to: float, since_s: float = ZOOM_S) -> Callable[[float], float]:
    """A zoom that goes on evenly from a time on."""
    return lambda t: min(to, 1.0 + share_per_s * max(0.0, t - since_s))


@pytest.mark.parametrize(("share_per_s", "to"), [(0.01, 1.2), (0.025, 1.25), (0.025, 1.8), (0.05, 1.8)])
def test_a_slow_zoom_is_followed_and_gnss_stays_trusted(zooming: Any, share_per_s: float, to: float) -> None:
    w = zooming(zoom=slow(share_per_s, to), jammed=lambda t: t > 65)
    w.start()
    w.fly(85.0)
    assert ZOOM_S < w.notices("camera zoomed x")[0] < ZOOM_S + 0.08 / share_per_s + 6
    assert w.notices("not trusted") == w.notices("fx_px") == []
    assert w.requests[-1][1].zoom == pytest.approx(to, rel=0.02)
    assert w.requests[-1][1].try_zoom is None
    sent = [(s, off_m) for t, s, off_m in w.statuses if t > 67]
    assert all(off_m < s.protection_level_m for s, off_m in sent)
    assert max(off_m for _, off_m in sent) < 4.0


def test_a_slow_zoom_while_nothing_but_the_camera_tells_the_place_is_in_the_level(zooming: Any) -> None:
    w = zooming(zoom=slow(0.025, 1.25), jammed=lambda t: t > 15)
    w.start()
    w.fly(60.0)
    assert all(off_m < s.protection_level_m for t, s, off_m in w.statuses if t > 17)
    assert max(off_m for t, _, off_m in w.statuses if t > 17) < 15.0


def test_a_zoom_that_goes_on_unseen_is_looked_for_where_it_would_be_by_then(zooming: Any) -> None:
    def cloud(t: float) -> bool:
        return ZOOM_S + 9 < t < ZOOM_S + 16

    w = zooming(zoom=slow(0.025, 1.7), blind=cloud)
    w.start()
    w.fly(75.0)
    tried = [(t, r.try_zoom) for t, r, _ in w.requests if r.try_zoom is not None and cloud(t)]
    assert min(abs(zoom / w.zoom(t) - 1) for t, zoom in tried[:4]) < 0.03
    assert w.requests[-1][1].zoom == pytest.approx(1.7, rel=0.02)
    assert w.notices("not trusted") == []


def test_a_false_gnss_is_found_while_a_zoom_is_followed(zooming: Any) -> None:
    def dragged(t: float) -> tuple[float, float]:
        return (0.0, 1.0 * max(0.0, t - ZOOM_S - 10))

    w = zooming(zoom=slow(0.025, 1.6), pull_m=dragged)
    plain = zooming(pull_m=dragged)
    for each in (w, plain):
        each.start()
        each.fly(70.0)
    assert suspected_s(w) <= suspected_s(plain) + 5.0


@pytest.mark.parametrize("factor", [1.5, 2.0, 1.2, 0.7])
def test_a_zoom_is_named_and_reckoned_with_and_gnss_stays_trusted(zooming: Any, factor: float) -> None:
    w = zooming(zoom=lambda t: factor if t > ZOOM_S else 1.0, jammed=lambda t: t > 60)
    w.start()
    w.fly(90.0)
    (named_s,) = w.notices("camera zoomed x")
    assert named(w)[0] == pytest.approx(factor, rel=0.03)
    assert ZOOM_S < named_s < ZOOM_S + 6
    assert w.notices("not trusted") == w.notices("fx_px") == []
    assert w.requests[-1][1].zoom == pytest.approx(factor, rel=0.015)
    aided = [(s, off_m) for t, s, off_m in w.statuses if t > 62]
    assert any(isinstance(c, Injection) for _, c in w.commands)
    assert all(off_m < s.protection_level_m for s, off_m in aided)
    assert max(off_m for _, off_m in aided) < 6.0


def test_a_zoom_while_nothing_but_the_camera_tells_the_place(zooming: Any) -> None:
    w = zooming(zoom=lambda t: 1.5 if t > ZOOM_S else 1.0, jammed=lambda t: t > 15)
    w.start()
    w.fly(70.0)
    (named_s,) = w.notices("camera zoomed x")
    assert named(w)[0] == pytest.approx(1.5, rel=0.03)
    assert named_s < ZOOM_S + 8
    assert all(off_m < s.protection_level_m for t, s, off_m in w.statuses if t > 17)
    assert max(off_m for t, _, off_m in w.statuses if t > named_s + 5) < 6.0


def test_a_fast_vehicle_is_found_where_it_is_by_the_time_of_the_answer(zooming: Any) -> None:
    """A slow computer answers after two seconds, in which the vehicle flies 50 m."""
    w = zooming(zoom=lambda t: 1.5 if t > ZOOM_S else 1.0, jammed=lambda t: t > 15, latency_s=2.0, speed_mps=25.0)
    w.start()
    w.fly(70.0)
    (named_s,) = w.notices("camera zoomed x")
    after = [off_m / s.protection_level_m for t, s, off_m in w.statuses if t > named_s]
    assert len(after) > 50
    assert max(after) < 0.6


def test_a_zoom_that_is_taken_back_is_told_and_goes_unnamed_afterwards(zooming: Any) -> None:
    w = zooming(zoom=lambda t: 1.5 if ZOOM_S < t < 50 else 1.0)
    w.start()
    w.fly(80.0)
    assert len(w.notices("camera zoomed")) == 1
    (back_s,) = w.notices("camera zoom is back to normal")
    assert 50 < back_s < 55
    assert w.requests[-1][1].zoom == 1.0
    assert w.notices("not trusted") == []


@pytest.mark.parametrize("along_mps", [0.0, -3.0])
def test_a_drag_of_gnss_while_nothing_is_recognised_is_found_as_soon_as_ever(zooming: Any, along_mps: float) -> None:
    """A drag that slows GNSS down looks as a zoom does to odometry."""

    def dragged(t: float) -> tuple[float, float]:
        d = max(0.0, t - ZOOM_S)
        return (along_mps * d, 1.0 * d)

    flights = [zooming(blind=lambda t: t > ZOOM_S - 2, pull_m=dragged, seed=seed) for seed in (1, 2, 3)]
    plain = [zooming(blind=lambda t: t > ZOOM_S - 2, pull_m=dragged, seed=seed) for seed in (1, 2, 3)]
    for w in plain:
        w.navigator._onboard.zoom.next = lambda *_: None  # tries nothing
    for w in (*flights, *plain):
        w.start()
        w.fly(70.0)
        assert w.notices("zoom") == []
    assert any(r.try_zoom is not None for _, r, _ in flights[0].requests)
    later_s = [suspected_s(a) - suspected_s(b) for a, b in zip(flights, plain, strict=True)]
    assert max(later_s) <= 1.0


def test_a_false_gnss_is_no_zoom_and_a_zoom_hides_none(zooming: Any) -> None:
    w = zooming(zoom=lambda t: 1.5 if t > ZOOM_S else 1.0, pull_m=lambda t: (0.0, max(0.0, 1.0 * (t - ZOOM_S))))
    w.start()
    w.fly(70.0)
    assert named(w) == [pytest.approx(1.5, rel=0.03)]
    assert suspected_s(w) < ZOOM_S + 20
    assert max(off_m for t, _, off_m in w.statuses if t > ZOOM_S + 25) < 6.0


def test_a_localiser_that_tries_none_answers_as_ever(zooming: Any) -> None:
    w = zooming(tries=False, blind=lambda t: 20 < t < 40)
    w.start()
    w.fly(60.0)
    assert any(r.try_zoom is not None for _, r, _ in w.requests)
    assert w.notices("zoom") == []
    assert w.requests[-1][1].zoom == 1.0


def test_ground_that_comes_nearer_little_by_little_is_no_zoom(zooming: Any) -> None:
    """Woods or a hill that the map does not show: it is in the heights of fixes, whose places are right."""
    w = zooming(nearer=slow(0.03, 1.3), jammed=lambda t: t > 50)
    w.start()
    w.fly(70.0)
    assert w.notices("zoom") == w.notices("not trusted") == []
    assert {r.try_zoom for _, r, _ in w.requests} == {None}
    assert {r.zoom for _, r, _ in w.requests} == {1.0}
    assert max(off_m for t, _, off_m in w.statuses if t > ZOOM_S) < 4.0


@pytest.fixture
def faint(zooming: type[Any]) -> type[Any]:
    """While the ground is `faint` its place is found and declined, as right with `right`, and looks through any lens fit with
    `tried_right`: so it was over a map of 5 m per pixel, 277 m up, where looks of 0.81 to 0.91 were followed by one of 0.98."""

    @dataclass
    class Faint(zooming):  # type: ignore[misc]
        faint: Callable[[float], bool] = lambda t: False
        right: float = 0.87
        tried_right: float = 0.98
        why: Reason = Reason.BLOCKS_DISAGREE

        def _localise(self, request: LocaliseRequest) -> None:
            super()._localise(request)
            when, answer = self.answers[-1]
            if not self.faint(self.t) or not isinstance(answer, Fix):
                return
            tried = None if request.try_zoom is None else replace(answer, probability_wrong=1 - self.tried_right)
            ids = request.request_id, request.frame.frame_id, "test"
            places = (OpenPlace(answer.place, answer.cov_ne_m2, math.log(self.right)),)
            declined = NoFix(0, answer.t_ns, *ids, self.why, 5.0, motion=answer.motion, open_places=places, zoomed=tried)
            self.answers[-1] = when, declined

    return Faint


@pytest.mark.parametrize(
    ("right", "why", "names"),
    [
        (0.87, Reason.BLOCKS_DISAGREE, 0),
        (0.8, Reason.AMBIGUOUS, 0),
        (0.05, Reason.NO_MATCH, 1),
        (0.999, Reason.INCONSISTENT_WITH_PRIOR, 1),
    ],
)
def test_a_lens_that_fits_hardly_better_than_the_believed_one_is_none(faint: Any, right: float, why: Reason, names: int) -> None:
    """It was named and reckoned with: odometry and heights were off by as much for the rest of a flight, which had 54 m."""
    w = faint(faint=lambda t: ZOOM_S < t < ZOOM_S + 6, right=right, why=why, jammed=lambda t: t > 15)
    w.start()
    w.fly(60.0)
    assert any(r.try_zoom is not None for _, r, _ in w.requests)
    assert len(w.notices("camera zoomed x")) == names


def test_heights_are_held_again_where_nearer_ground_has_stayed(zooming: Any) -> None:
    """They never come back to those before: until the end of a flight they were let loose, to 2.5 m here."""
    w = zooming(nearer=slow(0.03, 1.1))
    w.start()
    w.fly(75.0)
    sigmas_m = [(t, r.prior.sigma_h_m) for t, r, _ in w.requests]
    assert max(sigma_m for t, sigma_m in sigmas_m if ZOOM_S < t < ZOOM_S + 10) > 2.4
    assert max(sigma_m for t, sigma_m in sigmas_m if t > 70.0) < 1.5


def test_a_zoom_that_is_lost_sight_of_for_ten_seconds_is_told_and_followed_no_more(zooming: Any) -> None:
    """It ended behind the cloud: what lens frames are looked at through, and where the vehicle is, is known as before."""
    w = zooming(zoom=slow(0.025, 1.22), blind=lambda t: t > ZOOM_S + 8.8)
    w.start()
    w.fly(ZOOM_S + 18.0)
    ramp, tracker = w.navigator._onboard.ramp, w.navigator._tracker
    assert (ramp.following, ramp.doubting, tracker.longer_share) == (True, True, FOLLOWED_SHARE)
    w.fly(ZOOM_S + 20.5)
    assert (ramp.following, ramp.doubting, tracker.longer_share) == (False, False, 0.0)
    assert w.requests[-1][1].zoom == pytest.approx(1.22, rel=0.03)
    assert w.notices("not trusted") == []


def test_heights_that_drift_and_come_back_leave_no_lens_in_doubt(zooming: Any) -> None:
    """A wood that no map shows, of a camera that cannot tell it from a lens."""
    w = zooming(nearer=lambda t: slow(0.02, 1.06)(t) if t < 36 else 1.0)
    w.start()
    w.fly(38.0)
    ramp, tracker = w.navigator._onboard.ramp, w.navigator._tracker
    assert ramp.doubting
    assert tracker.longer_share > 0.03
    w.fly(42.0)
    assert not ramp.doubting
    assert tracker.longer_share == 0.0
    assert w.notices("zoom") == []


def test_while_a_zoom_is_followed_a_fix_of_another_question_than_the_last_tells_nothing_of_it(zooming: Any) -> None:
    """Through which lens it was looked at is not known any more."""
    w = zooming(zoom=slow(0.025, 1.8))
    w.start()
    w.fly(ZOOM_S + 9.0)
    ramp = w.navigator._onboard.ramp
    before, (_, (_, older, _), (_, last, _)) = list(ramp._ratios), (0, *w.requests[-2:])
    known_m = w.navigator._tracker.height_above_home_m
    told = w.statuses[-1][1]
    place = replace(told.place, h_amsl_m=ORIGIN_AMSL_M + known_m)
    fix = Fix(0, older.frame.t_ns, older.request_id, 1, "test", place, older.prior.q_ned_frd, COV, 0.5, 0.05, 0.001, 5.0)
    assert ramp.following
    assert ramp.on_fix(fix, known_m, None, taken=True) == []
    assert list(ramp._ratios) == before
    last_fix = replace(fix, request_id=last.request_id, t_ns=last.frame.t_ns)
    ramp.on_fix(last_fix, known_m, None, taken=True)
    assert list(ramp._ratios) != before


def test_a_zoom_that_goes_on_unseen_for_long_speaks_against_no_gnss_and_is_found_at_last(zooming: Any) -> None:
    w = zooming(zoom=slow(0.025, 1.7), blind=lambda t: 39 < t < 60)
    w.start()
    w.fly(75.0)
    assert w.notices("not trusted") == []
    assert all(off_m < s.protection_level_m for t, s, off_m in w.statuses if t > 39)
    assert max(off_m for t, _, off_m in w.statuses if t > 39) < 6.0
    assert w.requests[-1][1].zoom == pytest.approx(1.7, rel=0.02)


def test_a_zoom_that_goes_on_unseen_without_gnss_is_in_the_level(zooming: Any) -> None:
    w = zooming(zoom=lambda t: max(0.45, slow(-0.025, 2.2)(t)), blind=lambda t: t > 39, jammed=lambda t: t > 45)
    w.start()
    w.fly(65.0)
    assert all(off_m < s.protection_level_m for t, s, off_m in w.statuses if t > 39)


def test_a_drag_aside_is_found_while_nobody_sees_how_far_a_zoom_goes(zooming: Any) -> None:
    def dragged(t: float) -> tuple[float, float]:
        off_m = 1.0 * max(0.0, t - 41)
        return (-off_m * math.sin(t / 40), off_m * math.cos(t / 40))

    w = zooming(zoom=lambda t: slow(0.025, 1.7)(min(t, 39)), blind=lambda t: t > 39, pull_m=dragged)
    w.start()
    w.fly(56.0)
    assert suspected_s(w) <= 41 + 15
