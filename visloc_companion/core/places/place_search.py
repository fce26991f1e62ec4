"""Finding the vehicle anywhere on the map: without a first position, or after a loss that has lasted too long.

Two kinds of questions take turns. A tile of the map (core/places/tiles.py) is searched in a frame, and the places that the answer
lists (core/places/listed_places.py) become hypotheses (core/places/hypotheses.py). Two sweeps of three over the map are quick
ones: they allow for less that compass and height may be off, and test only fixes and what is likely; the third leaves nothing
out. A hypothesis is tested by a search about it in a newer frame; while one is likely and about to be due, no tile is begun. The
claim of a fix (`probability_wrong`) was fitted on small search regions; here no single answer counts for more than the odds that
were measured for such searches, and a place is found only when so many agree, through the motion between them, that the
probability of a false agreement is below RISK.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from visloc_companion.core.covariance import largest_sigma_m
from visloc_companion.core.places import hypotheses
from visloc_companion.core.places.hypotheses import Hypothesis
from visloc_companion.core.places.listed_places import LIKELY, THOROUGH, places_of
from visloc_companion.core.places.tile_size import TileSize
from visloc_companion.core.places.tiles import FARTHEST_M, Tile, Tiles, ends_of
from visloc_companion.core.places.travel import TravelLog
from visloc_companion.core.velocity.vouching import velocity_sigma_mps
from visloc_companion.errors import Reason
from visloc_companion.geo import wgs84
from visloc_companion.types import Cov2, Fix, GeoPoint, NoFix, Odometry, Vec2

RISK = 1e-5
TILE_HEIGHTS, LEAST_RADIUS_M = 8.0, 300.0
"""Radius of the region of a tile in heights above the origin: as many footprints whatever the height, so it costs as much."""
LEAST_HEIGHT_M = LEAST_RADIUS_M / TILE_HEIGHTS
"""The ground may lie below the origin, and the vehicle above it no higher than that: a height of nothing would count every look
at one place as another agreement."""
CLIMBED = 1.5
"""A sweep begins anew where the height asks for tiles larger by this factor."""
SPACING_HEIGHTS = 0.25
"""Answers count when the vehicle has moved by so much of its height, about a quarter of what it sees."""
LISTED_HEIGHTS = 0.1
"""1-sigma of a listed place, and the least of the region in which it is tested, as a share of the height."""
VAGUE_HEIGHTS, LOST_HEIGHTS = 0.75, 0.25
"""1-sigma of the place of a hypothesis that was never seen, as a share of the height. Beyond the first a fix about it is as
likely one of another place: at 90 m it is spread over 5 ha, of which a map of 16 km2 has 314. Beyond the second it is given up
once it was looked for in vain: one in 200 is right then, while one of 18 tiles lists the right place (28 of 32 right ones, of
16)."""
SWEEPS, QUICK_SHARE = 3, 2 / 3
"""Every so many sweeps one is thorough; the others search the second of the headings and heights that the prior allows for."""
TEST_EVERY_NS = 2_000_000_000
MOST_WRONG = 0.02
"""A fix that claims to be wrong with a larger probability tells nothing. On the training landscape 157 of 168 searches about the
right place gave a better one, none of about 800 about another place that a tile had listed (two gave a worse one)."""
SURE_WRONG = 0.0005
"""A fix that claims to be wrong with no larger a probability is sure of itself: 144 of 145 about the right place on the training
landscape were, none of 108 about another one, the least of whose claims was 0.023."""
SAYS_NOTHING = (
    *(Reason.LOW_TEXTURE, Reason.BLURRED, Reason.BAD_FRAME, Reason.FROZEN, Reason.BAD_INPUT, Reason.HORIZON_IN_VIEW),
    Reason.SUPERSEDED,
)
"""Of the frame, or that nobody looked at it, not of the place; as is a worker that was lost."""
NO_ANSWER = (Reason.WORKER_TIMEOUT, Reason.WORKER_DIED)


@dataclass(frozen=True, slots=True)
class Reach:
    """Where the sweep begins, metres north and east of the origin, and how far from there it goes."""

    centre_ne_m: Vec2 = (0.0, 0.0)
    radius_m: float = FARTHEST_M


@dataclass(frozen=True, slots=True)
class Where:
    """What is asked about a frame: a place, metres north and east of the origin, and its covariance; the share of heading's and
    height's usual sigmas that is allowed for; how far north or south, east or west of the place is searched at most, metres."""

    place_ne_m: Vec2
    cov_ne_m2: Cov2
    share_of_sigmas: float = 1.0
    within_m: float | None = None


@dataclass(frozen=True, slots=True)
class Found:
    """The vehicle's place at a time, metres north and east of the origin, with its largest 1-sigma; the probability that it is
    false; how many answers agreed."""

    t_ns: int
    place_ne_m: Vec2
    sigma_m: float
    probability_wrong: float
    hits: int


@dataclass(frozen=True, slots=True)
class _Asked:
    """The question that is open: about a tile, or a hypothesis by its number."""

    request_id: int
    t_ns: int
    where: Where
    height_m: float
    sigma_v_mps: float
    searched: tuple[Tile, Tiles] | None
    number: int | None
    risk: float


def tile_radius_m(height_m: float, max_radius_m: float) -> float:
    """Radius of the region that one search covers, for a height above the origin."""
    return min(max(LEAST_RADIUS_M, TILE_HEIGHTS * height_m), max_radius_m)


def spacing_m(fix: Fix, height_m: float) -> float:
    """The way after which another fix like this one looks at other ground; `height_m`: above the origin, for a fix that does not
    say how high it is over the ground (which may lie far below where the vehicle started)."""
    return SPACING_HEIGHTS * max(LEAST_HEIGHT_M, height_m if fix.above_ground_m is None else fix.above_ground_m)


class PlaceSearch:
    """Asks and judges; the navigator carries its questions to the worker. All places are about one origin."""

    def __init__(self, max_radius_m: float) -> None:
        self._size = TileSize(max_radius_m, LEAST_RADIUS_M)
        self._travel = TravelLog()
        self._n_born = 0
        self._asked: _Asked | None = None
        self.clear()

    def clear(self) -> None:
        """Forget all places: the vehicle is found. What is asked of the worker stays asked, and its answer is thrown away."""
        self._places: tuple[Hypothesis, ...] = ()
        self._swept: tuple[Reach, Tiles] | None = None
        self._before: tuple[Reach, Tiles] | None = None
        self._tile_next = True
        self._n_swept = 0
        if self._asked is not None:
            self._asked = replace(self._asked, searched=None, number=None)

    @property
    def active(self) -> bool:
        """Whether the map is being searched."""
        return self._swept is not None

    @property
    def _thorough(self) -> bool:
        return self._n_swept % SWEEPS == SWEEPS - 1

    @property
    def places(self) -> tuple[Hypothesis, ...]:
        """The hypotheses, best first."""
        return self._places

    @property
    def seen_ne_m(self) -> Vec2 | None:
        """A place that was recognised and is likelier right than wrong, though it may take other ground to be sure of it:
        the likeliest one, metres north and east of the origin."""
        return next((h.place_ne_m for h in self._places if h.hits > 0 and h.log_odds > 0), None)

    def moving(self, t_ns: int, v_ne_mps: Vec2) -> None:
        """Take the velocity input (m/s)."""
        self._travel.velocity(t_ns, v_ne_mps)

    def moved(self, seen: Odometry) -> None:
        """Take what the camera saw of its own motion."""
        self._travel.odometry(seen)

    def next(self, request_id: int, t_ns: int, height_m: float, sigma_v_mps: float, about: Reach, risk: float = RISK) -> Where:
        """What to ask of a frame of `t_ns`, taken `height_m` above the origin; `sigma_v_mps`: 1-sigma of the velocity input. A
        place is found where it is false with a probability of at most `risk`."""
        height_m = max(height_m, LEAST_HEIGHT_M)
        self._carry(t_ns, height_m)
        due, searched = self._due(t_ns), None
        if due is None or due.log_odds < hypotheses.FIRST_LOG_ODDS:
            due = self._likely() or due
        if due is None or (self._tile_next and due.log_odds < hypotheses.FIRST_LOG_ODDS):
            tile, tiles = searched = self._next_tile(t_ns, height_m, about)
            variance = (tiles.radius_m / 3) ** 2
            share = 1.0 if self._thorough else QUICK_SHARE
            where = Where(tiles.place_ne_m(tile), ((variance, 0.0), (0.0, variance)), share, tiles.half_m)
        else:
            least = (LISTED_HEIGHTS * height_m) ** 2
            (nn, ne), (_, ee) = due.cov_ne_m2
            where = Where(due.place_ne_m, ((nn + least, ne), (ne, ee + least)))
        self._tile_next = searched is None
        number = due.number if searched is None and due is not None else None
        self._asked = _Asked(request_id, t_ns, where, height_m, sigma_v_mps, searched, number, risk)
        return where

    def is_asked(self, request_id: int) -> bool:
        """Whether an answer to this number is waited for here."""
        return self._asked is not None and self._asked.request_id == request_id

    def answered(self, answer: Fix | NoFix, origin: GeoPoint, now_ns: int) -> Found | None:
        """Take the answer to the open question; the vehicle's place now, where that is found."""
        asked, self._asked = self._asked, None
        if asked is None:
            return None
        if isinstance(answer, NoFix) and answer.reason in NO_ANSWER:
            self._spare_worker(asked, now_ns)
            return None
        if asked.searched is not None:
            self._listed(asked, *asked.searched, answer, origin)
            return None
        if asked.number is None:
            return None
        self._places = hypotheses.kept([each for h in self._places for each in self._tested(h, asked, answer, origin)])
        best = hypotheses.winner(self._places, asked.risk, swept=self._n_swept > 0)
        if best is None or best.number != asked.number or not isinstance(answer, Fix):
            return None
        now = self._travel.carried(best, now_ns)
        wrong = hypotheses.probability_wrong(best, self._places)
        return Found(now.t_ns, now.place_ne_m, largest_sigma_m(now.cov_ne_m2), wrong, now.hits)

    def _spare_worker(self, asked: _Asked, now_ns: int) -> None:
        """A tile that cost the worker its life is not asked for again at once: smaller ones are. Where it was the first of
        a larger size, the sweep of before goes on."""
        if asked.searched is not None:
            self._size.lost(asked.searched[1].radius_m, now_ns)
            self._swept, self._before = self._before, None

    def _tested(self, h: Hypothesis, asked: _Asked, answer: Fix | NoFix, origin: GeoPoint) -> tuple[Hypothesis, ...]:
        """A hypothesis after an answer. A fix where it does not lead, or about one that is anywhere by now, is a place of
        its own, as a tile's is."""
        if h.number != asked.number:
            return (h,)
        if isinstance(answer, Fix) and answer.probability_wrong <= MOST_WRONG:
            place_ne_m = wgs84.ned_from_geo(answer.place, origin)[:2]
            vague = _is_vague(h, VAGUE_HEIGHTS * asked.height_m)
            if vague or not hypotheses.leads_to(h, place_ne_m, answer.cov_ne_m2):
                return hypotheses.missed(h), self._born(asked, place_ne_m)
            sure = answer.probability_wrong <= SURE_WRONG
            spacing = spacing_m(answer, asked.height_m)
            return (hypotheses.confirmed(h, place_ne_m, answer.cov_ne_m2, spacing, sure),)
        untold = isinstance(answer, Fix) or answer.reason in SAYS_NOTHING
        return (hypotheses.untold(h) if untold else hypotheses.missed(h),)

    def _born(self, asked: _Asked, place_ne_m: Vec2) -> Hypothesis:
        self._n_born += 1
        sigma_m, sigma_v_mps = LISTED_HEIGHTS * asked.height_m, velocity_sigma_mps(asked.sigma_v_mps)
        return hypotheses.born(self._n_born, asked.t_ns, place_ne_m, sigma_m, sigma_v_mps)

    def _listed(self, asked: _Asked, tile: Tile, tiles: Tiles, answer: Fix | NoFix, origin: GeoPoint) -> None:
        """The places that the search of a tile lists become hypotheses. What is merely open was chosen for what this ground looks
        like: only other ground may count for it."""
        outside = isinstance(answer, NoFix) and answer.reason is Reason.OUTSIDE_MAP
        if isinstance(answer, NoFix) and answer.reason in SAYS_NOTHING:
            tiles.untold(tile)
        else:
            tiles.answered(tile, not outside, ends_of(answer))
            self._before = self._before if outside else None  # tiles outside of the map cost nothing
        spacing = SPACING_HEIGHTS * asked.height_m
        least = LIKELY if asked.where.share_of_sigmas < 1 else THOROUGH
        new = []
        for place in places_of(answer, origin, least):
            h = self._born(asked, place)
            new.append(h if isinstance(answer, Fix) else replace(h, counted_ne_m=place, spacing_m=spacing))
        self._places = hypotheses.kept([*self._places, *new])

    def _next_tile(self, t_ns: int, height_m: float, about: Reach) -> tuple[Tile, Tiles]:
        grows = self._size.may_grow(t_ns)
        if grows:
            self._size.grow(t_ns)
        radius_m = tile_radius_m(height_m, self._size.radius_m)
        if self._swept is None or radius_m > CLIMBED * self._swept[1].radius_m:
            self._before = self._swept if grows else None
            self._swept = about, Tiles(about.centre_ne_m, radius_m, about.radius_m)
        tile = self._swept[1].next()
        self._n_swept += tile is None
        if tile is None and self._swept[0] != about:
            self._swept = about, Tiles(about.centre_ne_m, radius_m, about.radius_m)
        tiles = self._swept[1]
        return tile or tiles.next() or (0, 0), tiles

    def _carry(self, t_ns: int, height_m: float) -> None:
        """All hypotheses to the time of a frame, which is never older than the one before. What was looked for in vain and is
        known hardly better than a tile is left to the next sweep."""
        carried = (self._travel.carried(h, t_ns) for h in self._places)
        self._places = tuple(h for h in carried if not (h.misses and _is_vague(h, LOST_HEIGHTS * height_m)))

    def _due(self, t_ns: int) -> Hypothesis | None:
        """A fix that was not tested yet, else the likeliest hypothesis that was not, or whose next test would count."""
        fixed = next((h for h in self._places if h.tested_ns is None and h.counted_ne_m is None), None)
        return fixed or next((h for h in self._places if _is_due(h, t_ns)), None)

    def _likely(self) -> Hypothesis | None:
        """The likeliest hypothesis, where it was seen, is right rather than wrong, and has moved on by half of what its next test
        waits for. Once it was seen often enough to win and has not, another place is as likely, and the search goes on."""
        best = self._places[0] if self._places else None
        if best is None or not 0 < best.hits < hypotheses.FEWEST_HITS or best.log_odds <= 0 or best.counted_ne_m is None:
            return None
        return best if math.dist(best.counted_ne_m, best.place_ne_m) >= best.spacing_m / 2 else None


def _is_vague(h: Hypothesis, sigma_m: float) -> bool:
    """Whether a place that was never seen is known no better than to so much, on the axis that is known worst."""
    return not h.hits and largest_sigma_m(h.cov_ne_m2) > sigma_m


def _is_due(h: Hypothesis, t_ns: int) -> bool:
    if h.tested_ns is None or t_ns - h.tested_ns >= TEST_EVERY_NS:
        return True
    return h.counted_ne_m is not None and math.dist(h.counted_ne_m, h.place_ne_m) >= h.spacing_m and t_ns > h.tested_ns
