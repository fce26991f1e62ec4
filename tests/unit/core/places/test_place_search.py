"""The search of the whole map: questions, and a worker that knows the truth."""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import pytest

from visloc_companion.core.places import hypotheses
from visloc_companion.core.places.place_search import SURE_WRONG, Found, PlaceSearch, Reach, Where, tile_radius_m
from visloc_companion.errors import Reason
from visloc_companion.geo import wgs84
from visloc_companion.types import Fix, GeoPoint, NoFix, OpenPlace, Vec2

S = 1_000_000_000
ORIGIN = GeoPoint(59.3, 18.1, 40.0)
HEIGHT_M, SPEED_MPS = 120.0, 10.0
COV = ((1.0, 0.0), (0.0, 1.0))


@dataclass
class Worker:
    """A map of 4 x 4 km; the vehicle flies north from `start`. `doubles`: places that look the same, offsets from the truth."""

    start: Vec2 = (-900.0, 700.0)
    doubles: tuple[Vec2, ...] = ((0.0, 0.0),)
    half_m: float = 2000.0
    claim: float = 0.001
    ridge_m: tuple[float, float] | None = None
    above_ground_m: float | None = None
    ends_m: float | None = None
    """How far from the origin its answers tell that the map ends; None: they do not tell."""
    seen_from_s: float = 0.0
    asked: list[Where] = field(default_factory=list)

    def truth(self, t_s: float) -> Vec2:
        return self.start[0] + SPEED_MPS * t_s, self.start[1]

    def answer(self, request_id: int, t_s: float, where: Where) -> Fix | NoFix:
        self.asked.append(where)
        (north, east), sigma_m = where.place_ne_m, math.sqrt(where.cov_ne_m2[0][0])
        told = request_id, 1, "test"
        if max(abs(north), abs(east)) > self.half_m + 3 * sigma_m:
            return NoFix(0, round(t_s * S), *told, Reason.OUTSIDE_MAP, 1.0)
        if self.ridge_m is not None and self.ridge_m[0] < math.hypot(north, east) < self.ridge_m[1]:
            return NoFix(0, round(t_s * S), *told, Reason.TOO_LOW, 1.0)
        at = self.truth(t_s)
        seen = [p for d in self.doubles if math.dist(p := (at[0] + d[0], at[1] + d[1]), where.place_ne_m) <= 3 * sigma_m]
        seen = seen if t_s >= self.seen_from_s else []
        if len(seen) == 1 and sigma_m < 100:
            place = wgs84.geo_from_ned((*seen[0], -HEIGHT_M), ORIGIN)
            level, above_m = (1.0, 0.0, 0.0, 0.0), self.above_ground_m
            return Fix(0, round(t_s * S), *told, place, level, COV, 1.0, 0.1, self.claim, 1.0, above_ground_m=above_m)
        listed = [*seen, (north + 55.0, east - 80.0)]  # and one that is nothing
        answer = left_open(request_id, t_s, [(place, 1 / len(listed)) for place in listed])
        if self.ends_m is None or where.within_m is None:
            return answer
        sides_m = {"map_north": north, "map_south": -north, "map_east": east, "map_west": -east}
        told_m = self.ends_m - where.within_m
        return replace(answer, evidence=tuple((side, float(off_m <= told_m)) for side, off_m in sides_m.items()))


def left_open(request_id: int, t_s: float, places: Sequence[tuple[Vec2, float]]) -> NoFix:
    """An answer that leaves places open: metres north and east of the origin, and the probability of each."""
    there = [(wgs84.geo_from_ned((*place, -HEIGHT_M), ORIGIN), probability) for place, probability in places]
    listed = tuple(OpenPlace(place, COV, math.log(probability)) for place, probability in there)
    told = request_id, 1, "test"
    return NoFix(0, round(t_s * S), *told, Reason.AMBIGUOUS, 1.0, open_places=listed, footprint_m=120.0)


def searched(
    worker: Worker, seconds: float, about: Reach | None = None, period_s: float = 0.5, v_ne_mps: Vec2 = (SPEED_MPS + 1.0, 0.5)
) -> tuple[Found | None, float]:
    """What is found, and when."""
    search = PlaceSearch(2000.0)
    for k in range(1, round(seconds / period_s)):
        t_s = k * period_s
        search.moving(round(t_s * S), v_ne_mps)
        where = search.next(k, round(t_s * S), HEIGHT_M, 3.0, about or Reach())
        assert search.is_asked(k)
        found = search.answered(worker.answer(k, t_s, where), ORIGIN, round((t_s + 0.3) * S))
        if found is not None:
            return found, t_s + 0.3
    return None, seconds


def test_a_vehicle_anywhere_on_the_map_is_found() -> None:
    worker = Worker()
    found, t_s = searched(worker, 60.0)
    assert found is not None
    assert t_s < 30.0
    assert math.dist(found.place_ne_m, worker.truth(t_s)) < 3.0
    assert found.probability_wrong <= 1e-5
    assert found.hits >= hypotheses.FEWEST_HITS
    assert found.sigma_m < 5.0


def test_fewer_sure_answers_find_a_place_once_the_whole_map_was_searched() -> None:
    """A quarter of the height, 3 s, sooner, and as unlikely to be false; an answer that is less sure is one of four."""
    found, t_s = searched(sure := Worker(claim=SURE_WRONG, seen_from_s=40.0), 90.0)
    doubtful, later_s = searched(Worker(claim=1.1 * SURE_WRONG, seen_from_s=40.0), 90.0)
    assert found is not None
    assert doubtful is not None
    assert (found.hits, doubtful.hits) == (hypotheses.FEWEST_SURE_HITS, hypotheses.FEWEST_HITS)
    assert math.dist(found.place_ne_m, sure.truth(t_s)) < 3.0
    assert max(found.probability_wrong, doubtful.probability_wrong) <= 1e-5
    assert 2.0 < later_s - t_s < 5.0


def test_before_the_whole_map_was_searched_sure_answers_do_not_suffice() -> None:
    found = searched(Worker(claim=SURE_WRONG), 60.0)[0]
    assert found is not None
    assert found.hits == hypotheses.FEWEST_HITS


def test_an_autopilot_that_knows_of_no_motion_is_no_obstacle() -> None:
    worker = Worker()
    found, t_s = searched(worker, 60.0, v_ne_mps=(0.0, 0.0))
    assert found is not None
    assert math.dist(found.place_ne_m, worker.truth(t_s)) < 5.0


def test_a_map_without_the_vehicle_has_no_answer() -> None:
    assert searched(Worker(start=(9000.0, 0.0)), 120.0)[0] is None


def test_a_place_that_repeats_itself_has_no_answer() -> None:
    assert searched(Worker(doubles=((0.0, 0.0), (0.0, 600.0))), 120.0)[0] is None


def test_agreement_is_about_other_ground_also_where_the_ground_lies_far_below_the_start() -> None:
    """From a summit: 120 m above it, 600 m above the valley, a quarter of which is 150 m and takes 15 s."""
    near = searched(Worker(), 60.0)[1]
    found, t_s = searched(worker := Worker(above_ground_m=5 * HEIGHT_M), 120.0)
    assert found is not None
    assert math.dist(found.place_ne_m, worker.truth(t_s)) < 3.0
    assert near < 30.0 < (hypotheses.FEWEST_HITS - 1) * 0.25 * 5 * HEIGHT_M / SPEED_MPS < t_s


def test_mountains_all_around_the_start_are_not_the_edge_of_the_map() -> None:
    """Tiles of 960 m about a valley: the first ring about the middle one lies higher than the vehicle, which is beyond."""
    worker = Worker(start=(3000.0, 300.0), half_m=4500.0, ridge_m=(500.0, 2950.0))
    found, t_s = searched(worker, 130.0)
    assert found is not None
    assert math.dist(found.place_ne_m, worker.truth(t_s)) < 5.0


@pytest.mark.parametrize("places", [((0.0, 0.0), (0.0, 600.0)), ((0.0, 500.0), (0.0, -500.0)), ((0.0, 0.0), (1200.0, -1200.0))])
def test_a_place_that_repeats_itself_has_no_answer_however_sure(places: tuple[Vec2, ...]) -> None:
    assert searched(Worker(doubles=places, claim=1e-6), 120.0)[0] is None


def test_doubtful_fixes_find_nothing() -> None:
    assert searched(Worker(claim=0.03), 60.0)[0] is None


def test_after_a_loss_the_search_begins_where_the_vehicle_was_believed_to_be() -> None:
    worker = Worker()
    found, t_s = searched(worker, 60.0, Reach((-800.0, 600.0), 1500.0))
    assert worker.asked[0].place_ne_m == (-800.0, 600.0)
    assert found is not None
    assert t_s < 15.0
    far = Worker(start=(1800.0, 1800.0))
    searched(far, 60.0, Reach((-1900.0, -1900.0), 300.0))
    assert max(math.dist(w.place_ne_m, (-1900.0, -1900.0)) for w in far.asked) < 4000.0


def test_a_climb_asks_for_larger_tiles() -> None:
    search, radius_m = PlaceSearch(2000.0), []
    for k, height_m in enumerate((20.0, 25.0, 120.0, 500.0)):
        where = search.next(k, k * S, height_m, 3.0, Reach())
        search.answered(NoFix(0, k * S, k, 1, "test", Reason.NO_MATCH, 1.0), ORIGIN, k * S)
        radius_m.append(3 * math.sqrt(where.cov_ne_m2[0][0]))
    assert radius_m == pytest.approx([300.0, 300.0, 960.0, 2000.0])
    assert tile_radius_m(1e4, 1500.0) == 1500.0


def test_a_worker_that_is_too_slow_is_asked_for_smaller_tiles() -> None:
    search, radius_m = PlaceSearch(2000.0), []
    for k in range(4):
        where = search.next(k, k * S, HEIGHT_M, 3.0, Reach())
        search.answered(NoFix(0, k * S, k, 1, "test", Reason.WORKER_TIMEOUT, 1.0), ORIGIN, k * S)
        radius_m.append(3 * math.sqrt(where.cov_ne_m2[0][0]))
    assert radius_m == pytest.approx([960.0, 480.0, 300.0, 300.0])


def test_a_worker_that_is_lost_over_a_place_that_was_listed_is_asked_for_no_smaller_tiles() -> None:
    """The test of a place is a search of a small region: no tile was too large."""
    search = PlaceSearch(2000.0)
    search.next(1, S, HEIGHT_M, 3.0, Reach())
    search.answered(left_open(1, 1.0, [((100.0, 0.0), 0.9)]), ORIGIN, S)
    test = search.next(2, 2 * S, HEIGHT_M, 3.0, Reach())
    assert not asked_tile(test)
    search.answered(NoFix(0, 2 * S, 2, 1, "test", Reason.WORKER_TIMEOUT, 1.0), ORIGIN, 2 * S)
    asked = []
    for k in range(3, 7):
        asked.append(search.next(k, k * S, HEIGHT_M, 3.0, Reach()))
        search.answered(NoFix(0, k * S, k, 1, "test", Reason.NO_MATCH, 1.0), ORIGIN, k * S)
    assert {round(3 * math.sqrt(where.cov_ne_m2[0][0])) for where in asked if asked_tile(where)} == {960}


def test_tiles_are_as_large_as_before_some_time_after_a_worker_was_lost() -> None:
    """Somebody ended it (the kernel's OOM killer): the tiles stayed halved to the end of the flight, four for one."""
    asked_at, _ = tiles_asked(300, killed={1})
    assert asked_at[0] == pytest.approx(960.0)
    assert set(np.round(list(asked_at.values())[2:58])) == {480.0}
    assert {round(radius_m) for k, radius_m in asked_at.items() if k > 65} == {960}


def test_a_size_that_costs_the_worker_each_time_is_tried_ever_more_seldom() -> None:
    """And what was swept with smaller tiles meanwhile is not swept again."""
    asked_at, where = tiles_asked(2600, too_large_m=900.0)
    tried = [k for k, radius_m in asked_at.items() if radius_m > 900.0]
    gaps = np.diff(tried)
    assert tried[0] == 0 and list(np.round(gaps / 60)) == [1, 2, 4, 8, 16]
    small = [place for k, place in where.items() if tried[1] - 30 < k < tried[1] + 30 and asked_at[k] < 900.0]
    assert len(set(small)) == len(small), "the sweep goes on where it was"


def tiles_asked(
    seconds: int, killed: Collection[int] = (), too_large_m: float = math.inf
) -> tuple[dict[int, float], dict[int, Vec2]]:
    """Radius and middle of the tile that each frame was asked about; `killed`: frames whose worker is ended from outside."""
    search, radius_m, place = PlaceSearch(2000.0), {}, {}
    for k in range(seconds):
        where = search.next(k, k * S, HEIGHT_M, 3.0, Reach())
        radius_m[k], place[k] = 3 * math.sqrt(where.cov_ne_m2[0][0]), where.place_ne_m
        lost = k in killed or radius_m[k] > too_large_m
        reason = Reason.WORKER_DIED if lost else Reason.NO_MATCH
        search.answered(NoFix(0, k * S, k, 1, "test", reason, 1.0), ORIGIN, k * S)
    return radius_m, place


def test_answers_that_are_thrown_away() -> None:
    search, worker = PlaceSearch(2000.0), Worker(start=(0.0, 0.0))
    assert search.answered(NoFix(0, 0, 1, 1, "test", Reason.NO_MATCH, 1.0), ORIGIN, 0) is None
    where = search.next(1, S, HEIGHT_M, 3.0, Reach())
    search.answered(NoFix(0, S, 1, 1, "test", Reason.WORKER_TIMEOUT, 1.0), ORIGIN, S)
    assert not search.places
    where = search.next(2, 2 * S, HEIGHT_M, 3.0, Reach())
    search.clear()
    assert search.is_asked(2)
    assert search.answered(worker.answer(2, 2.0, where), ORIGIN, 2 * S) is None
    assert not search.places


def test_a_frame_that_shows_nothing_speaks_against_no_place() -> None:
    search, worker = PlaceSearch(2000.0), Worker(start=(0.0, 0.0))
    search.answered(worker.answer(1, 1.0, search.next(1, S, HEIGHT_M, 3.0, Reach())), ORIGIN, S)
    before = [h.log_odds for h in search.places]
    search.next(2, 2 * S, HEIGHT_M, 3.0, Reach())
    search.answered(NoFix(0, 2 * S, 2, 1, "test", Reason.LOW_TEXTURE, 1.0), ORIGIN, 2 * S)
    assert [h.log_odds for h in search.places] == before
    search.next(3, 3 * S, HEIGHT_M, 3.0, Reach())
    search.answered(NoFix(0, 3 * S, 3, 1, "test", Reason.NO_MATCH, 1.0), ORIGIN, 3 * S)
    assert sorted(h.log_odds for h in search.places)[0] < before[0]


def test_a_question_that_nobody_looked_at_speaks_against_no_place() -> None:
    search, worker = PlaceSearch(2000.0), Worker(start=(0.0, 0.0))
    search.answered(worker.answer(1, 1.0, search.next(1, S, HEIGHT_M, 3.0, Reach())), ORIGIN, S)
    before = [(h.log_odds, h.misses) for h in search.places]
    assert before
    search.next(2, 2 * S, HEIGHT_M, 3.0, Reach())
    search.answered(NoFix(0, 2 * S, 2, 1, "test", Reason.SUPERSEDED, 0.0), ORIGIN, 2 * S)
    assert [(h.log_odds, h.misses) for h in search.places] == before


@pytest.mark.parametrize("why", [Reason.HORIZON_IN_VIEW, Reason.SUPERSEDED])
def test_a_tile_whose_frame_showed_nothing_is_asked_about_again_in_the_same_sweep(why: Reason) -> None:
    """In a bank the camera sees the horizon while the tile that has the vehicle in it has its turn."""

    class Banked(Worker):
        def answer(self, request_id: int, t_s: float, where: Where) -> Fix | NoFix:
            told = super().answer(request_id, t_s, where)
            about = sum(math.dist(each.place_ne_m, where.place_ne_m) < 1.0 for each in self.asked)
            has_it = math.dist(self.truth(t_s), where.place_ne_m) <= 3 * math.sqrt(where.cov_ne_m2[0][0])
            return (
                NoFix(0, round(t_s * S), request_id, 1, "test", why, 1.0) if has_it and about == 1 and asked_tile(where) else told
            )

    found, t_s = searched(Banked(), 120.0)
    assert found is not None
    assert t_s < 30.0


def asked_tile(where: Where) -> bool:
    return 3 * math.sqrt(where.cov_ne_m2[0][0]) > 900.0


def tile_answer(request_id: int, *probabilities: float) -> NoFix:
    """A tile that shows nothing for certain: open places 200 m apart."""
    return left_open(request_id, float(request_id), [((200.0 * k, 0.0), p) for k, p in enumerate(probabilities, 1)])


@pytest.mark.parametrize(("share", "listed"), [(2 / 3, [(200.0, 0.0)]), (1.0, [(200.0, 0.0), (400.0, 0.0)])])
def test_quick_sweeps_test_what_is_likely_and_thorough_ones_all(share: float, listed: list[Vec2]) -> None:
    search = PlaceSearch(2000.0)
    for k in range(1, 200):
        where = search.next(k, k * S, HEIGHT_M, 3.0, Reach((0.0, 0.0), 100.0))
        if asked_tile(where) and where.share_of_sigmas == pytest.approx(share):
            break
        search.answered(tile_answer(k), ORIGIN, k * S)
    assert not search.places
    search.answered(tile_answer(k, 0.5, 0.2, 0.05), ORIGIN, k * S)
    assert [h.place_ne_m for h in search.places] == [pytest.approx(place, abs=1e-3) for place in listed]


def test_two_sweeps_of_three_are_quick() -> None:
    search, shares = PlaceSearch(2000.0), []
    for k in range(1, 200):
        where = search.next(k, k * S, HEIGHT_M, 3.0, Reach((0.0, 0.0), 100.0))
        if where.place_ne_m == (0.0, 0.0):
            shares.append(where.share_of_sigmas)
        search.answered(tile_answer(k), ORIGIN, k * S)
    assert shares[:6] == pytest.approx([2 / 3, 2 / 3, 1.0, 2 / 3, 2 / 3, 1.0])


def test_tests_allow_for_all_headings_and_heights() -> None:
    search = PlaceSearch(2000.0)
    assert search.next(1, S, HEIGHT_M, 3.0, Reach()).share_of_sigmas < 1
    search.answered(tile_answer(1, 0.9), ORIGIN, S)
    where = search.next(2, 2 * S, HEIGHT_M, 3.0, Reach())
    assert not asked_tile(where)
    assert where.share_of_sigmas == 1.0


@pytest.mark.parametrize(("fixed", "moved_m", "hits"), [(True, 10.0, 1), (False, 10.0, 0), (False, 35.0, 1)])
def test_an_open_place_is_seen_only_on_other_ground(fixed: bool, moved_m: float, hits: int) -> None:
    search, worker = PlaceSearch(2000.0), Worker(start=(200.0, 0.0))
    search.moving(0, (SPEED_MPS, 0.0))
    search.next(1, 0, HEIGHT_M, 3.0, Reach())
    near = Where((200.0, 0.0), ((900.0, 0.0), (0.0, 900.0)))
    search.answered(worker.answer(1, 0.0, near) if fixed else tile_answer(1, 0.9), ORIGIN, 0)
    t_s = moved_m / SPEED_MPS
    where = search.next(2, round(t_s * S), HEIGHT_M, 3.0, Reach())
    assert not asked_tile(where)
    search.answered(worker.answer(2, t_s, where), ORIGIN, round(t_s * S))
    assert [h.hits for h in search.places] == [hits]


def test_no_tile_is_begun_while_a_likely_place_is_about_to_be_due() -> None:
    worker, search, after_hit = Worker(start=(0.0, 0.0)), PlaceSearch(2000.0), []
    search.next(1, S, HEIGHT_M, 3.0, Reach())
    search.answered(tile_answer(1, 0.9), ORIGIN, S)
    (place,) = (h.place_ne_m for h in search.places)
    worker.start = place[0] - SPEED_MPS, place[1]
    for k in range(2, 200):
        t_s = 1.0 + 0.1 * k
        search.moving(round(t_s * S), (SPEED_MPS, 0.0))
        where = search.next(k, round(t_s * S), HEIGHT_M, 3.0, Reach())
        best = search.places[0]
        if 0 < best.hits < hypotheses.FEWEST_HITS and best.counted_ne_m is not None:
            moved_m = math.dist(best.counted_ne_m, best.place_ne_m)
            after_hit.append((moved_m, asked_tile(where)))
        if search.answered(worker.answer(k, t_s, where), ORIGIN, round((t_s + 0.05) * S)) is not None:
            break
    assert any(tile for moved_m, tile in after_hit if moved_m < 14.0)
    assert not any(tile for moved_m, tile in after_hit if moved_m > 16.0)


@pytest.mark.parametrize("height_m", [20.0, 0.0, -50.0])
def test_looks_at_one_place_are_one_agreement_below_the_origin_too(height_m: float) -> None:
    search, place = PlaceSearch(2000.0), wgs84.geo_from_ned((100.0, 50.0, -height_m), ORIGIN)
    for k in range(1, 60):
        t_ns = k * S // 2
        search.moving(t_ns, (0.0, 0.0))
        search.next(k, t_ns, height_m, 0.5, Reach())
        answer = Fix(t_ns, t_ns, k, k, "test", place, (1.0, 0.0, 0.0, 0.0), COV, 1.0, 0.1, 0.001, 1.0)
        assert search.answered(answer, ORIGIN, t_ns) is None


def test_no_more_of_the_map_is_searched_than_the_square_of_a_tile() -> None:
    """Each part of it once a sweep: a search costs what the square about its region does."""
    worker = Worker(start=(9000.0, 0.0))
    searched(worker, 14.0)
    tiles = [w for w in worker.asked if w.within_m is not None]
    sides_m = [2.0 * (w.within_m or 0.0) for w in tiles]
    assert len(tiles) > 9
    assert len({w.place_ne_m for w in tiles}) == len(tiles)
    assert sides_m == pytest.approx([math.sqrt(2.0) * 960.0] * len(tiles))
    for k, w in enumerate(tiles):
        apart = [max(abs(a - b) for a, b in zip(w.place_ne_m, o.place_ne_m, strict=True)) for o in tiles[:k]]
        assert not apart or min(apart) == pytest.approx(sides_m[0])
    tests = [w for w in worker.asked if w.within_m is None]
    assert tests
    assert max(math.sqrt(w.cov_ne_m2[0][0]) for w in tests) < 100.0


def test_tiles_where_the_map_is_told_to_end_are_not_asked_about() -> None:
    worker = Worker(start=(9000.0, 0.0), ends_m=2000.0)
    searched(worker, 40.0)
    outside = [w for w in worker.asked[:40] if max(map(abs, w.place_ne_m)) > 2000.0 + (w.within_m or 0.0)]
    assert not outside
    assert len({w.place_ne_m for w in worker.asked[:40] if w.within_m is not None}) == 9
