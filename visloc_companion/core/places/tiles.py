"""The order in which the map is searched for a vehicle that may be anywhere: tiles about where it may rather be, outwards.

A tile is the square in the circle of three sigmas of its prior, and no more than that is searched: a search costs what the square
about its region does, and squares meet without overlap (over 4 x 4 km hexagons in circles, of which fewer cover a plane, cost 1.5
times as much). How far the map reaches nobody tells the core beforehand. An answer may tell at which sides of a tile it goes on;
a ring of tiles that lie all outside of it, after one that did not, is its end. Later sweeps leave out what was found outside, and
every third one ends with some of what lies behind it, for a map may be in pieces.
"""

from __future__ import annotations

import math
from collections.abc import Iterable

from visloc_companion.types import MAP_SIDES, Fix, NoFix, Vec2

FARTHEST_M = 20_000.0
"""No tile's middle is further off."""
PIECES_EVERY, BEYOND = 3, 8
"""Tiles that lie behind others which are outside the map, or at sides of theirs where the map ends, are asked about at the end of
every third sweep, so many of them, the nearest first: maps are seldom in pieces, and each question takes a frame."""
Tile = tuple[int, int]
Side = tuple[int, int]
"""Of a tile: by how many rows and columns the one at that side lies further on."""


class Tiles:
    """Tiles in circles of `radius_m` about a centre (metres north, east), one after the other; `reach_m` bounds their middles."""

    def __init__(self, centre_ne_m: Vec2, radius_m: float, reach_m: float = FARTHEST_M) -> None:
        self._centre_ne_m, self.radius_m, self._reach_m = centre_ne_m, radius_m, min(reach_m, FARTHEST_M)
        self._inside: set[Tile] = set()
        self._outside: set[Tile] = set()
        self._left_out: set[Tile] = set()
        self._ends: dict[Tile, frozenset[Side]] = {}
        self._n_swept = 0
        self._begin()

    def _begin(self) -> None:
        self._ring, self._todo = 0, [(0, 0)]
        self._inside_ring, self._met_map, self._beyond = False, False, False
        self._again: set[Tile] = set()

    @property
    def row_m(self) -> float:
        """Distance between rows of tiles, and between columns."""
        return 2 * self.half_m

    @property
    def half_m(self) -> float:
        """How far a tile reaches to either side of its middle."""
        return self.radius_m / math.sqrt(2.0)

    def place_ne_m(self, tile: Tile) -> Vec2:
        """A tile's middle: tile (i, j) lies in row i, column j."""
        row, column = tile
        return self._centre_ne_m[0] + row * self.row_m, self._centre_ne_m[1] + column * self.row_m

    def next(self) -> Tile | None:
        """The next tile of the sweep; None at its end, after which the next sweep begins."""
        while True:
            while self._todo:
                tile = self._todo.pop(0)
                if tile not in self._outside and not self._leaves_out(tile):
                    return tile
            if self._beyond:
                self._n_swept += 1
                self._begin()
                return None
            over = self._met_map and not self._inside_ring and all(max(map(abs, tile)) < self._ring for tile in self._inside)
            self._met_map |= self._inside_ring
            self._ring, self._inside_ring = self._ring + 1, False
            if over or (self._ring - 1) * self.row_m > self._reach_m:
                self._beyond, self._todo = True, self._pieces()
            else:
                self._todo = self._nearest_first(_ring(self._ring))

    def answered(self, tile: Tile, on_map: bool, ends: frozenset[Side] | None = None) -> None:
        """Whether a tile that was asked about lies on the map, and at which sides of it there is none, where that is known."""
        if on_map:
            self._inside_ring = True
            self._inside.add(tile)
            if ends is not None:
                self._ends[tile] = ends
        else:
            self._outside.add(tile)

    def untold(self, tile: Tile) -> None:
        """The frame that was to tell of a tile shows nothing: another one is asked at the end of the ring, once a sweep."""
        if tile in self._again:
            self.answered(tile, on_map=True)
            return
        self._again.add(tile)
        self._todo.append(tile)

    def _leaves_out(self, tile: Tile) -> bool:
        """Whether a tile is kept for the end of some sweep."""
        if self._beyond or not self._behind_the_edge(tile):
            self._left_out.discard(tile)
            return False
        self._left_out.add(tile)
        return True

    def _pieces(self) -> list[Tile]:
        """What is asked about at the end of a sweep, though it lies behind the map's edge."""
        return self._nearest_first(self._left_out)[:BEYOND] if self._n_swept % PIECES_EVERY == PIECES_EVERY - 1 else []

    def _behind_the_edge(self, tile: Tile) -> bool:
        """Whether all that leads to a tile from the ring before lies outside, and nothing is known of it."""
        if tile in self._inside or not self._met_map:
            return False
        before = [t for t in _ring(self._ring - 1) if max(abs(t[0] - tile[0]), abs(t[1] - tile[1])) <= 1]
        beside = [t for t in ((tile[0] - row, tile[1] - column) for row, column in MAP_SIDES.values()) if t in self._ends]
        return not any(self._leads(t, tile) for t in (*before, *beside))

    def _leads(self, known: Tile, tile: Tile) -> bool:
        """Whether the map may go on from a tile that was asked about to one that touches it."""
        if known in self._outside or known in self._left_out:
            return False
        north, east = tile[0] - known[0], tile[1] - known[1]
        ends = self._ends.get(known, frozenset())
        return (north, 0) not in ends and (0, east) not in ends

    def _nearest_first(self, tiles: Iterable[Tile]) -> list[Tile]:
        return sorted(tiles, key=lambda tile: (self._distance_m(tile), tile))

    def _distance_m(self, tile: Tile) -> float:
        return math.dist(self.place_ne_m(tile), self._centre_ne_m)


def ends_of(answer: Fix | NoFix) -> frozenset[Side] | None:
    """At which sides of the square that was searched there is no map; None where the answer does not tell."""
    told = dict(answer.evidence)
    if any(name not in told for name in MAP_SIDES):
        return None
    return frozenset(side for name, side in MAP_SIDES.items() if told[name] == 0.0)


def _ring(n: int) -> list[Tile]:
    """The tiles of a square ring of rows and columns."""
    span = range(-n, n + 1)
    return [(i, j) for i in span for j in span if max(abs(i), abs(j)) == n]
