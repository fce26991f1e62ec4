"""The lasting plan of the procedural landscape, as vectors in metres: east x and south y from the top-left corner.

A square is cut again and again, as land is: by main roads, minor roads, farm tracks, then field boundaries; all lines are bent
by one smooth warp. What stays between the dates is here: parcels, roads, hedges, river, lake, village.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

import cv2
import numpy as np

from visloc_companion.sim.land.landscape_noise import Waves, rng_of
from visloc_companion.types import FloatArray

MARGIN_M = 120.0


class Use(IntEnum):
    """What a parcel is."""

    ARABLE = 0
    MEADOW = 1
    FOREST = 2
    VILLAGE = 3


class Line(IntEnum):
    """What a line of the plan is, from the widest road to a mere boundary."""

    MAIN = 0
    MINOR = 1
    TRACK = 2
    BOUNDARY = 3


WIDTH_M = {Line.MAIN: 7.0, Line.MINOR: 4.5, Line.TRACK: 3.2, Line.BOUNDARY: 1.2}


@dataclass(frozen=True)
class Parcel:
    """A piece of land: closed outline, use, and the direction of its longer side (radians, from x towards y)."""

    outline_m: FloatArray
    use: Use
    along_rad: float
    area_m2: float


@dataclass(frozen=True)
class Way:
    """A line of the plan with its kind; a hedge grows along it where `hedge` is set."""

    points_m: FloatArray
    kind: Line
    hedge: bool


@dataclass(frozen=True)
class Plan:
    """Everything that lasts."""

    size_m: float
    parcels: tuple[Parcel, ...]
    ways: tuple[Way, ...]
    river_m: FloatArray
    lake_m: FloatArray
    village_m: FloatArray
    village_radius_m: float


def make_plan(seed: int, size_m: float) -> Plan:
    """The plan of a seed; the land reaches `MARGIN_M` beyond the square so that the edge is cut as the middle is."""
    rng = rng_of(seed, "plan")
    bend = _Bend(rng)
    village = np.array([0.5, 0.5]) * size_m + rng.uniform(-0.2, 0.2, 2) * size_m
    radius = min(230.0, 0.2 * size_m)
    woods = Waves.random(rng, 12, (420.0, 1300.0), 1.0)
    low, high = -MARGIN_M, size_m + MARGIN_M
    cutter = _Cutter(rng, village, radius)
    cutter.cut(np.array([[low, low], [high, low], [high, high], [low, high]]))
    parcels = tuple(_parcel(rng, outline, bend, woods, village, radius) for outline in cutter.pieces)
    ways = tuple(_way(rng, line, kind, bend) for line, kind in cutter.lines)
    lake = village + size_m * 0.30 * np.array([np.cos(a := rng.uniform(0, 2 * np.pi)), np.sin(a)])
    return Plan(size_m, parcels, ways, _river(rng, size_m, village, radius), _lake(rng, lake, size_m), village, radius)


class _Bend:
    def __init__(self, rng: np.random.Generator) -> None:
        self._x = Waves.random(rng, 6, (280.0, 900.0), 11.0)
        self._y = Waves.random(rng, 6, (280.0, 900.0), 11.0)

    def __call__(self, points_m: FloatArray) -> FloatArray:
        return points_m + np.column_stack([self._x(points_m), self._y(points_m)])


class _Cutter:
    """Cuts convex polygons until they are parcels; `lines` collects the cuts."""

    def __init__(self, rng: np.random.Generator, village_m: FloatArray, radius_m: float) -> None:
        self._rng, self._village, self._radius = rng, village_m, radius_m
        self.pieces: list[FloatArray] = []
        self.lines: list[tuple[FloatArray, Line]] = []

    def cut(self, polygon: FloatArray) -> None:
        area, kind = abs(_area(polygon)), Line.BOUNDARY
        settled = float(np.hypot(*(polygon.mean(0) - self._village))) < self._radius
        target = 6000.0 if settled else float(np.exp(self._rng.normal(np.log(15000.0), 0.5)))
        if area < target:
            self.pieces.append(polygon)
            return
        for limit, candidate in ((1_100_000.0, Line.MAIN), (360_000.0, Line.MINOR), (120_000.0, Line.TRACK)):
            if area > limit:
                kind = candidate
                break
        if settled and kind is not Line.MAIN:
            kind = Line.MINOR if area > 14_000 else Line.BOUNDARY
        strips = kind is Line.BOUNDARY and not settled and self._rng.random() < 0.35
        first, second, chord = self._halves(polygon, strips)
        if min(abs(_area(first)), abs(_area(second))) < 1500.0:
            self.pieces.append(polygon)
            return
        self.lines.append((chord, kind))
        self.cut(first)
        self.cut(second)

    def _halves(self, polygon: FloatArray, lengthwise: bool) -> tuple[FloatArray, FloatArray, FloatArray]:
        along = _long_side_rad(polygon) + (np.pi / 2 if lengthwise else 0.0) + self._rng.normal(0, 0.07)
        normal = np.array([np.cos(along), np.sin(along)])
        reach = polygon @ normal
        level = reach.min() + self._rng.uniform(0.36, 0.64) * np.ptp(reach)
        return _split(polygon, normal, float(level))


def _split(polygon: FloatArray, normal: FloatArray, level: float) -> tuple[FloatArray, FloatArray, FloatArray]:
    side = polygon @ normal - level
    low: list[FloatArray] = []
    high: list[FloatArray] = []
    chord: list[FloatArray] = []
    for i in range(len(polygon)):
        j = (i + 1) % len(polygon)
        (low if side[i] < 0 else high).append(polygon[i])
        if (side[i] < 0) != (side[j] < 0):
            crossing = polygon[i] + (polygon[j] - polygon[i]) * (side[i] / (side[i] - side[j]))
            low.append(crossing)
            high.append(crossing)
            chord.append(crossing)
    return np.array(low), np.array(high), np.array(chord)


def _area(polygon: FloatArray) -> float:
    x, y = polygon[:, 0], polygon[:, 1]
    return float(x @ np.roll(y, -1) - y @ np.roll(x, -1)) / 2


def _long_side_rad(polygon: FloatArray) -> float:
    (_, (width, height), angle) = cv2.minAreaRect(polygon.astype(np.float32))
    return float(np.radians(angle if width >= height else angle + 90.0))


def dense_line(points_m: FloatArray, step_m: float = 8.0, closed: bool = False) -> FloatArray:
    """The same polyline with points at most `step_m` apart; a closed one does not repeat its first point."""
    ends = np.roll(points_m, -1, axis=0) if closed else points_m[1:]
    parts = []
    for start, end in zip(points_m, ends, strict=False):
        n = max(1, int(np.ceil(np.hypot(*(end - start)) / step_m)))
        parts.append(start + (end - start) * (np.arange(n) / n)[:, None])
    if not closed:
        parts.append(points_m[-1:])
    return np.vstack(parts)


def _parcel(
    rng: np.random.Generator, outline: FloatArray, bend: _Bend, woods: Waves, village: FloatArray, radius: float
) -> Parcel:
    centre, area = outline.mean(0), abs(_area(outline))
    away = float(np.hypot(*(centre - village)))
    wooded = float(woods(centre[None])[0]) + rng.normal(0, 0.15)
    use = Use.MEADOW if rng.random() < 0.28 else Use.ARABLE
    if away < radius:
        use = Use.VILLAGE
    elif wooded > 0.85 and away > radius + 60:
        use = Use.FOREST
    return Parcel(bend(dense_line(outline, closed=True)), use, _long_side_rad(outline), area)


def _way(rng: np.random.Generator, chord: FloatArray, kind: Line, bend: _Bend) -> Way:
    share = {Line.MAIN: 0.15, Line.MINOR: 0.2, Line.TRACK: 0.3, Line.BOUNDARY: 0.3}[kind]
    return Way(bend(dense_line(chord)), kind, bool(rng.random() < share))


def _river(rng: np.random.Generator, size_m: float, village: FloatArray, radius: float) -> FloatArray:
    meander = Waves.random(rng, 5, (170.0, 520.0), 16.0)
    sweep = Waves.random(rng, 3, (900.0, 2200.0), 45.0)
    side = 1.0 if rng.random() < 0.5 else -1.0
    level = float(village[1]) + side * (radius + 150.0)
    x = np.arange(-MARGIN_M, size_m + MARGIN_M, 6.0)
    base = np.column_stack([x, np.full_like(x, level) + rng.uniform(-0.25, 0.25) * (x - size_m / 2)])
    return base + np.column_stack([meander(base + 999.0), meander(base) + sweep(base)])


def _lake(rng: np.random.Generator, centre: FloatArray, size_m: float) -> FloatArray:
    angle = np.linspace(0, 2 * np.pi, 90, endpoint=False)
    radius = min(65.0, 0.04 * size_m) * np.ones_like(angle)
    for order in (2, 3, 5, 7):
        radius += radius.mean() * rng.normal(0, 0.22 / order**0.5) * np.cos(order * angle + rng.uniform(0, 2 * np.pi))
    return np.asarray(centre + radius[:, None] * np.column_stack([np.cos(angle), np.sin(angle)]))
