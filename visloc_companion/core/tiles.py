"""The order in which the map is searched for a vehicle that may be anywhere: tiles about where it may rather be, outwards.

A search region is a circle, a tile the hexagon in it: so fewest circles cover a plane (Kershner 1939). How far the map reaches
nobody tells the core; a ring of tiles that lie all outside the map, after one that did not, is its end. Later sweeps leave out
what was found outside.
"""

from __future__ import annotations

import math

from visloc_companion.types import Vec2

FARTHEST_M = 20_000.0
"""No tile's middle is further off."""
IN_ONE_PIECE = 2
"""The first sweeps, so many, ask about no tile that lies behind others which are outside the map: maps are seldom in pieces, and
each question takes a frame."""
Tile = tuple[int, int]


class Tiles:
    """Tiles of circles of `radius_m` about a centre (metres north, east), one after the other; `reach_m` bounds their middles."""

    def __init__(self, centre_ne_m: Vec2, radius_m: float, reach_m: float = FARTHEST_M) -> None:
        self._centre_ne_m, self.radius_m, self._reach_m = centre_ne_m, radius_m, min(reach_m, FARTHEST_M)
        self._outside: set[Tile] = set()
        self._left_out: set[Tile] = set()
        self._n_swept = 0
        self._begin()

    def _begin(self) -> None:
        self._ring, self._todo = 0, [(0, 0)]
        self._inside_ring, self._met_map = False, False
        self._again: set[Tile] = set()

    @property
    def row_m(self) -> float:
        """Distance between rows of tiles."""
        return 1.5 * self.radius_m

    def place_ne_m(self, tile: Tile) -> Vec2:
        """A tile's middle: tile (i, j) lies in row i, every other row half a tile further east."""
        row, column = tile
        east = math.sqrt(3.0) * self.radius_m * (column + 0.5 * (row % 2))
        return self._centre_ne_m[0] + row * self.row_m, self._centre_ne_m[1] + east

    def next(self) -> Tile | None:
        """The next tile of the sweep; None at its end, after which the next sweep begins."""
        while True:
            if self._todo:
                tile = self._todo.pop(0)
                if self._behind_the_edge(tile):
                    self._left_out.add(tile)
                elif tile not in self._outside:
                    return tile
                continue
            over = self._met_map and not self._inside_ring
            self._met_map |= self._inside_ring
            self._ring, self._inside_ring = self._ring + 1, False
            if over or (self._ring - 1) * self.row_m > self._reach_m:
                self._n_swept += 1
                self._begin()
                return None
            self._todo = sorted(_ring(self._ring), key=lambda tile: (self._distance_m(tile), tile))

    def answered(self, tile: Tile, on_map: bool) -> None:
        """Whether a tile that was asked about lies on the map."""
        if on_map:
            self._inside_ring = True
        else:
            self._outside.add(tile)

    def untold(self, tile: Tile) -> None:
        """The frame that was to tell of a tile shows nothing: another one is asked at the end of the ring, once a sweep."""
        if tile in self._again:
            self.answered(tile, on_map=True)
            return
        self._again.add(tile)
        self._todo.append(tile)

    def _behind_the_edge(self, tile: Tile) -> bool:
        """Whether all that leads to a tile from the ring before lies outside, in a sweep that asks about no such tile."""
        if self._n_swept >= IN_ONE_PIECE or not self._met_map:
            return False
        inner = _ring(self._ring - 1)
        before = [t for t in inner if max(abs(t[0] - tile[0]), abs(t[1] - tile[1])) <= 1]
        return all(t in self._outside or t in self._left_out for t in before)

    def _distance_m(self, tile: Tile) -> float:
        return math.dist(self.place_ne_m(tile), self._centre_ne_m)


def _ring(n: int) -> list[Tile]:
    """The tiles of a square ring of rows and columns."""
    span = range(-n, n + 1)
    return [(i, j) for i in span for j in span if max(abs(i), abs(j)) == n]
