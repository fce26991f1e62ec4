"""Trees and buildings of the procedural landscape: where they stand, how large they are, and on which of the dates."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from visloc_companion.sim.land.landscape_grid import inside
from visloc_companion.sim.land.landscape_noise import Waves, rng_of
from visloc_companion.sim.land.landscape_plan import WIDTH_M, Line, Parcel, Plan, Use, Way, dense_line
from visloc_companion.types import FloatArray


@dataclass(frozen=True)
class Trees:
    """Crowns, one row each: place (m), radius and height at the map's date, growth per year, conifer or not, tone (0..1).

    `stand` numbers the forest parcel (-1 outside forests); `at_map` and `at_flight` tell on which dates the tree stands.
    """

    xy_m: FloatArray
    radius_m: FloatArray
    height_m: FloatArray
    conifer: NDArray[np.bool_]
    tone: FloatArray
    at_map: NDArray[np.bool_]
    at_flight: NDArray[np.bool_]


@dataclass(frozen=True)
class Building:
    """A house or barn with a gabled roof; `along_rad` is the ridge's direction. `at_map` is false for what was built since."""

    center_m: FloatArray
    length_m: float
    width_m: float
    along_rad: float
    eave_m: float
    ridge_m: float
    tone: float
    at_map: bool


def felled_parcels(seed: int, plan: Plan) -> frozenset[int]:
    """Numbers of the forest parcels that are cut between the dates."""
    rng = rng_of(seed, "felling")
    return frozenset(i for i, p in enumerate(plan.parcels) if p.use is Use.FOREST and rng.random() < 0.09)


def plant_trees(seed: int, plan: Plan) -> Trees:
    """All trees: forests, hedges, avenues, the river's banks, gardens and single ones in meadows."""
    rng = rng_of(seed, "trees")
    felled = felled_parcels(seed, plan)
    parts: list[Trees] = []
    conifers = Waves.random(rng, 8, (300.0, 900.0), 0.6)
    for number, parcel in enumerate(plan.parcels):
        if parcel.use is Use.FOREST:
            parts.append(_forest(rng, parcel, conifers, number in felled))
        elif parcel.use is Use.VILLAGE:
            parts.append(_scattered(rng, parcel, 260.0, (1.6, 3.6), (4.0, 10.0)))
        elif parcel.use is Use.MEADOW:
            parts.append(
                _orchard(rng, parcel) if rng.random() < 0.04 else _scattered(rng, parcel, 9000.0, (2.5, 6.0), (8.0, 18.0))
            )
    parts += [_along(rng, way) if way.hedge else _shrubs(rng, way) for way in plan.ways]
    parts.append(_banks(rng, plan.river_m, 13.0))
    parts.append(_banks(rng, np.vstack([plan.lake_m, plan.lake_m[:1]]), 7.0))
    return Trees(*(np.concatenate([getattr(part, name) for part in parts]) for name in Trees.__dataclass_fields__))


def _trees(
    rng: np.random.Generator,
    xy_m: FloatArray,
    radius: FloatArray,
    height: FloatArray,
    conifer: NDArray[np.bool_],
    gone: float = 0.05,
) -> Trees:
    n = len(xy_m)
    fate = rng.random(n)
    return Trees(xy_m, radius, height, conifer, rng.random(n), fate > 0.03, (fate < 0.03) | (fate > 0.03 + gone))


def _forest(rng: np.random.Generator, parcel: Parcel, conifers: Waves, felled: bool) -> Trees:
    age = rng.uniform(0.35, 1.0)
    share = float(np.clip(0.60 + 0.9 * conifers(parcel.outline_m.mean(0)[None])[0], 0.04, 0.96))
    spacing = 3.2 + 3.4 * age
    low, high = parcel.outline_m.min(0), parcel.outline_m.max(0)
    grid = np.stack(np.meshgrid(np.arange(low[0], high[0], spacing), np.arange(low[1], high[1], spacing)), -1).reshape(-1, 2)
    xy = grid + rng.uniform(-0.42, 0.42, grid.shape) * spacing
    xy = xy[inside(xy, parcel.outline_m)]
    conifer = rng.random(len(xy)) < share
    size = rng.lognormal(0.0, 0.2, len(xy))
    radius = spacing * np.where(conifer, 0.50, 0.62) * size
    height = (9.0 + 17.0 * age) * np.where(conifer, 1.08, 0.95) * size**0.6
    return _trees(rng, xy, radius, height, conifer, gone=0.97 if felled else 0.04)


def _scattered(
    rng: np.random.Generator, parcel: Parcel, m2_each: float, radius: tuple[float, float], height: tuple[float, float]
) -> Trees:
    low, high = parcel.outline_m.min(0), parcel.outline_m.max(0)
    xy = rng.uniform(low, high, (rng.poisson(np.prod(high - low) / m2_each), 2))
    xy = xy[inside(xy, parcel.outline_m)]
    size = rng.random(len(xy))
    return _trees(
        rng, xy, radius[0] + size * (radius[1] - radius[0]), height[0] + size * (height[1] - height[0]), rng.random(len(xy)) < 0.2
    )


def _orchard(rng: np.random.Generator, parcel: Parcel) -> Trees:
    centre, c, s = parcel.outline_m.mean(0), np.cos(parcel.along_rad), np.sin(parcel.along_rad)
    reach = np.hypot(*(parcel.outline_m - centre).T).max()
    at = np.arange(-reach, reach, 9.0)
    grid = np.stack(np.meshgrid(at, at), -1).reshape(-1, 2) @ np.array([[c, s], [-s, c]]) + centre
    xy = grid[inside(grid, parcel.outline_m)] + 0.0
    xy = (xy + rng.normal(0, 0.9, xy.shape))[rng.random(len(xy)) < 0.85]
    size = rng.uniform(0.5, 1.4, len(xy))
    return _trees(rng, xy, 2.4 * size, 5.0 * size, np.zeros(len(xy), bool), gone=0.1)


def _beside(points_m: FloatArray, step_m: float, offset_m: float) -> tuple[FloatArray, FloatArray]:
    line = dense_line(points_m, 2.0)
    walked = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(line, axis=0).T))])
    at = np.arange(step_m / 2, walked[-1], step_m)
    xy = np.column_stack([np.interp(at, walked, line[:, 0]), np.interp(at, walked, line[:, 1])])
    tangent = np.gradient(xy, axis=0) if len(xy) > 1 else np.tile(line[-1] - line[0], (len(xy), 1))
    tangent /= np.maximum(np.hypot(*tangent.T), 1e-9)[:, None]
    normal = np.column_stack([-tangent[:, 1], tangent[:, 0]])
    return xy + normal * offset_m, np.arctan2(tangent[:, 1], tangent[:, 0])


def _along(rng: np.random.Generator, way: Way) -> Trees:
    if way.kind in {Line.MAIN, Line.MINOR}:
        sides = [_beside(way.points_m, 14.0, side * (WIDTH_M[way.kind] / 2 + 4.5))[0] for side in (-1, 1)]
        xy = np.vstack(sides)
        xy = xy[rng.random(len(xy)) < 0.85] if len(xy) else xy
        size = rng.uniform(0.75, 1.2, len(xy))
        return _trees(rng, xy + rng.normal(0, 0.3, xy.shape), 3.8 * size, 12.0 * size, np.zeros(len(xy), bool))
    xy, _ = _beside(way.points_m, 2.6, WIDTH_M[way.kind] / 2 + 2.0)
    stretch = np.sin(np.arange(len(xy)) * 0.045 + rng.uniform(0, 6.3)) > -0.75
    xy = xy[stretch] + rng.normal(0, 0.6, (int(stretch.sum()), 2))
    tall = rng.random(len(xy)) < 0.08
    size = rng.uniform(0.7, 1.3, len(xy))
    return _trees(rng, xy, np.where(tall, 4.6, 2.1) * size, np.where(tall, 13.0, 4.5) * size, rng.random(len(xy)) < 0.04)


def _shrubs(rng: np.random.Generator, way: Way) -> Trees:
    """Single shrubs and small trees along a way without a hedge."""
    xy, _ = _beside(way.points_m, 11.0, WIDTH_M[way.kind] / 2 + 1.6)
    xy = xy[rng.random(len(xy)) < 0.3]
    xy = xy + rng.normal(0, 0.8, xy.shape)
    size = rng.uniform(0.5, 1.4, len(xy))
    return _trees(rng, xy, 1.7 * size, 3.2 * size, np.zeros(len(xy), bool))


def _banks(rng: np.random.Generator, line_m: FloatArray, offset_m: float) -> Trees:
    xy = np.vstack([_beside(line_m, 5.5, side * offset_m)[0] for side in (-1, 1)])
    xy = xy[rng.random(len(xy)) < 0.6]
    xy = xy + rng.normal(0, 1.6, xy.shape)
    size = rng.uniform(0.6, 1.3, len(xy))
    return _trees(rng, xy, 3.2 * size, 10.0 * size, np.zeros(len(xy), bool))


def place_buildings(seed: int, plan: Plan) -> tuple[Building, ...]:
    """Houses along the village's roads, and farmsteads along the others; about one in eight is built between the dates."""
    rng = rng_of(seed, "buildings")
    houses: list[Building] = []
    for way in plan.ways:
        if way.kind is Line.BOUNDARY:
            continue
        for side in (-1, 1):
            offset = WIDTH_M[way.kind] / 2 + 11.0
            for xy, along in zip(*_beside(way.points_m, 21.0, side * offset), strict=True):
                away = float(np.hypot(*(xy - plan.village_m)))
                if away < plan.village_radius_m and rng.random() < 0.8:
                    _settle(houses, _house(rng, xy, along))
                elif plan.village_radius_m + 150 < away and rng.random() < 0.006 and _dry(plan, xy):
                    _farm(rng, houses, xy, along)
    return tuple(houses)


def _dry(plan: Plan, xy: FloatArray) -> bool:
    return bool(np.hypot(*(plan.river_m - xy).T).min() > 60 and np.hypot(*(plan.lake_m - xy).T).min() > 50)


def _house(rng: np.random.Generator, xy: FloatArray, along: float) -> Building:
    turn = np.pi / 2 if rng.random() < 0.4 else 0.0
    length, width = rng.uniform(9, 15), rng.uniform(7.5, 10)
    eave = rng.uniform(3.2, 6.0)
    return Building(
        xy + rng.normal(0, 1.2, 2), length, width, along + turn + rng.normal(0, 0.05), eave, eave + 0.42 * width,
        rng.random(), bool(rng.random() > 0.12),
    )  # fmt: skip


def _farm(rng: np.random.Generator, houses: list[Building], xy: FloatArray, along: float) -> None:
    for k, (dx, dy) in enumerate(((0.0, 0.0), (34.0, 6.0), (8.0, 38.0))):
        c, s = np.cos(along), np.sin(along)
        centre = xy + np.array([c * dx - s * dy, s * dx + c * dy])
        length, width = (14.0, 10.0) if k == 0 else (rng.uniform(24, 46), rng.uniform(12, 18))
        turn = np.pi / 2 if k == 2 else 0.0
        eave = rng.uniform(4, 6)
        built = bool(k < 2 or rng.random() < 0.5)
        _settle(houses, Building(centre, length, width, along + turn, eave, eave + 0.3 * width, rng.random(), built))


def _settle(houses: list[Building], house: Building) -> None:
    reach = house.length_m
    if all(np.hypot(*(h.center_m - house.center_m)) > 0.62 * (h.length_m + reach) * 0.9 for h in houses):
        houses.append(house)
