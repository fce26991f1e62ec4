from __future__ import annotations

import math

import pytest

from visloc_companion.core.places.tiles import Tiles


def sweep(tiles: Tiles, half_m: float, most: int = 5000) -> list[tuple[float, float]]:
    """The middles of one sweep's tiles over a square map of `half_m` about the origin."""
    asked = []
    while (tile := tiles.next()) is not None:
        north, east = tiles.place_ne_m(tile)
        asked.append((north, east))
        tiles.answered(tile, max(abs(north), abs(east)) <= half_m + tiles.radius_m)
        assert len(asked) < most
    return asked


def test_the_whole_map_is_covered_and_its_edge_ends_the_sweep() -> None:
    tiles = Tiles((300.0, -400.0), 900.0)
    asked = sweep(tiles, 2000.0)
    assert asked[0] == (300.0, -400.0)
    for north in range(-2000, 2001, 250):
        for east in range(-2000, 2001, 250):
            assert min(math.dist((north, east), middle) for middle in asked) <= 900.0
    assert len(asked) <= 49
    assert max(math.hypot(*middle) for middle in asked) < 7000.0


def test_the_next_sweep_leaves_out_what_is_no_map() -> None:
    tiles = Tiles((0.0, 0.0), 900.0)
    first, second, third, fourth = (sweep(tiles, 2000.0) for _ in range(4))
    assert len(second) < len(first)
    assert len(fourth) <= len(third) < len(first) + 20
    assert all(max(abs(n), abs(e)) <= 2900.0 for n, e in (*second, *fourth))
    assert set(second) == set(fourth)


def test_a_second_piece_of_the_map_is_found_by_third_sweeps() -> None:
    """Each asks about eight tiles of what lies behind the edge, after the map; what was found is part of every sweep then."""
    tiles, pieces = Tiles((0.0, 0.0), 900.0), ((0, 0), (0, 1), (0, 2), (3, 3), (3, 4))
    asked: list[list[tuple[int, int]]] = []
    for _ in range(16):
        asked.append([])
        while (tile := tiles.next()) is not None:
            asked[-1].append(tile)
            tiles.answered(tile, tile in pieces)
    beyond = [[tile for tile in each if tile not in pieces] for each in asked[1:]]
    assert len(asked[1]) < len(asked[0]) < 30
    found = next(k for k, each in enumerate(asked) if (3, 3) in each)
    assert found % 3 == 2
    assert [len(each) for each in beyond[: found - 1]] == [0, *[8, 0, 0] * ((found - 2) // 3)]
    assert all((3, 3) in each for each in asked[found:])
    assert (3, 4) in asked[found + 1]


def test_the_map_comes_before_what_may_lie_beyond_it() -> None:
    """A vehicle that the first two sweeps did not find waits for no tile that is likely no map."""
    tiles = Tiles((300.0, -400.0), 960.0)
    first, _, third = (swept(tiles, 2000.0) for _ in range(3))
    on_map = len(first)
    assert [inside for inside, _ in third] == [True] * on_map + [False] * 8


def test_a_loss_bounds_the_sweep() -> None:
    tiles = Tiles((0.0, 0.0), 500.0, reach_m=1200.0)
    assert max(math.hypot(*middle) for middle in sweep(tiles, 1e6)) <= math.sqrt(2) * (1200.0 + 2 * math.sqrt(3.0) * 500.0)


def test_far_from_the_map_it_is_looked_for_within_reason() -> None:
    tiles = Tiles((0.0, 0.0), 2000.0)
    asked = sweep(tiles, -1e6)
    assert max(math.hypot(*middle) for middle in asked) == pytest.approx(20_000.0 * math.sqrt(2), rel=0.4)
    assert tiles.next() is None


def test_a_tile_of_which_nothing_is_told_comes_again_once_a_sweep() -> None:
    tiles = Tiles((0.0, 0.0), 900.0)
    for _ in range(2):
        asked = []
        while (tile := tiles.next()) is not None:
            asked.append(tile)
            if max(map(abs, tile)) == 1:
                tiles.untold(tile)
            else:
                tiles.answered(tile, tile == (0, 0))
        ring = asked[1:17]
        assert len(set(ring)) == 8
        assert ring[:8] == ring[8:]
        assert all(asked.count(tile) == 1 for tile in asked[17:])


def swept(tiles: Tiles, half_m: float) -> list[tuple[bool, tuple[int, int]]]:
    """A sweep over a square map of `half_m` about the origin, of which the answers tell at which sides of a tile it ends: whether
    each tile was on the map, and which it was."""
    asked = []
    while (tile := tiles.next()) is not None:
        north, east = tiles.place_ne_m(tile)
        on_map = max(abs(north), abs(east)) < half_m + tiles.half_m
        reach = {(1, 0): north, (-1, 0): -north, (0, 1): east, (0, -1): -east}
        ends = frozenset(side for side, off_m in reach.items() if off_m + tiles.half_m > half_m)
        tiles.answered(tile, on_map, ends if on_map else None)
        asked.append((on_map, tile))
    return asked


@pytest.mark.parametrize("centre", [(0.0, 0.0), (300.0, -400.0), (-490.0, 450.0), (1500.0, 1900.0)])
def test_where_the_map_is_told_to_end_nothing_is_asked_before_the_third_sweep(centre: tuple[float, float]) -> None:
    tiles = Tiles(centre, 960.0)
    first, second, third, fourth = (swept(tiles, 2000.0) for _ in range(4))
    on_map = {tile for inside, tile in third if inside}
    assert [inside for inside, _ in first] == [True] * len(on_map)
    assert {tile for _, tile in first} == {tile for _, tile in second} == {tile for _, tile in fourth} == on_map
    assert any(not inside for inside, _ in third)


def test_tiles_cover_the_map_without_overlap() -> None:
    tiles = Tiles((300.0, -400.0), 960.0)
    middles = [tiles.place_ne_m(tile) for _, tile in swept(tiles, 2000.0)]
    for north in range(-2000, 2001, 125):
        for east in range(-2000, 2001, 125):
            assert sum(max(abs(north - n), abs(east - e)) < tiles.half_m for n, e in middles) == 1


def test_a_corner_of_a_turned_map_is_asked_about_from_beside_it() -> None:
    """The map goes on north of (0, 1) and then east of (1, 1), not east of (0, 1)."""
    told = {(0, 0): {(-1, 0), (0, -1), (1, 0)}, (0, 1): {(-1, 0), (0, 1)}, (1, 1): {(1, 0)}, (1, 2): {(1, 0), (-1, 0), (0, 1)}}
    tiles, asked = Tiles((0.0, 0.0), 960.0), []
    while (tile := tiles.next()) is not None:
        asked.append(tile)
        tiles.answered(tile, tile in told, frozenset(told.get(tile, ())))
    assert set(asked) == {*told, (0, 2)}, "the last one from (1, 1), across a corner"
