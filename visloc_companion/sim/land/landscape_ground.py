"""The bare ground of the procedural landscape at one date: crops with rows and wheel tracks, roads, water."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from visloc_companion.sim.land.landscape_grid import Grid
from visloc_companion.sim.land.landscape_noise import Raster, fractal_noise, rng_of, smooth_noise
from visloc_companion.sim.land.landscape_plan import WIDTH_M, Line, Plan, Use
from visloc_companion.sim.land.season import Cover, Rgb, Season
from visloc_companion.types import Image

BAND_ROWS = 400
NEVER_M = 1e9


@dataclass(frozen=True)
class Lasting:
    """Layers that both dates share: parcel numbers, metres to the nearest boundary, and opacities of lines and water."""

    parcel: NDArray[np.int32]
    edge_m: Raster
    lines: dict[Line, NDArray[np.uint8]]
    verge: NDArray[np.uint8]
    water: NDArray[np.uint8]
    shore: NDArray[np.uint8]
    blocked: NDArray[np.uint8]
    """Where no tree stands: ways with their clearance, and water."""


def lasting_layers(grid: Grid, plan: Plan) -> Lasting:
    """Draw the plan."""
    parcel = np.zeros((grid.size_px, grid.size_px), np.int32)
    for number, piece in enumerate(plan.parcels):
        grid.fill(parcel, piece.outline_m, number)
    lines = {kind: grid.blank() for kind in Line}
    verge, water, shore, boundary, clear = (grid.blank() for _ in range(5))
    for way in plan.ways:
        grid.draw(lines[way.kind], way.points_m, WIDTH_M[way.kind])
        grid.draw(verge, way.points_m, WIDTH_M[way.kind] + (1.6 if way.kind is Line.BOUNDARY else 4.0))
        if way.kind is not Line.BOUNDARY:
            grid.draw(clear, way.points_m, WIDTH_M[way.kind] + 2.6)
        grid.draw(boundary, way.points_m, max(1.0, grid.gsd_m))
    grid.draw(shore, plan.river_m, 25.0)
    grid.draw(water, plan.river_m, 15.0)
    lake = grid.blank()
    grid.fill(lake, plan.lake_m, 255)
    for layer in (*lines.values(), verge):
        layer[lake > 0] = 0
    for layer, width in ((shore, 9.0), (water, 0.0)):
        cv2.fillPoly(layer, [grid.fixed(plan.lake_m)], 255, cv2.LINE_AA, 4)
        if width:
            grid.draw(layer, plan.lake_m, width, closed=True)
    far = np.where(boundary > 0, 0, 255).astype(np.uint8)
    edge_m = cv2.distanceTransform(far, cv2.DIST_L2, 3) * np.float32(grid.gsd_m)
    return Lasting(parcel, np.asarray(edge_m, dtype=np.float32), lines, verge, water, shore, np.maximum(clear, water))


@dataclass(frozen=True)
class FieldTable:
    """How each parcel is divided and painted: arrays by parcel, and by strip (from `first[parcel]` on)."""

    cos: Raster
    sin: Raster
    start_m: Raster
    width_m: Raster
    strips: NDArray[np.int32]
    first: NDArray[np.int32]
    color: Raster
    row_k_radpm: Raster
    row_strength: Raster
    tramline_m: Raster
    tramline_strength: Raster
    mottle: Raster
    soil: Raster
    grain: Raster
    headland_m: Raster
    height_m: Raster


def field_table(seed: int, plan: Plan, season: Season, felled: frozenset[int]) -> FieldTable:
    """Crops of one date. Strips and row directions are drawn anew for each date; most parcels keep their direction."""
    rng = rng_of(seed, f"fields {season.years}")
    parcels: list[tuple[float, float, float, float, int, int]] = []
    covers: list[tuple[Rgb, Cover, float, float]] = []
    for number, parcel in enumerate(plan.parcels):
        along = parcel.along_rad + (np.pi / 2 if rng.random() < 0.18 else 0.0) + rng.normal(0, 0.02)
        across = parcel.outline_m @ np.array([-np.sin(along), np.cos(along)])
        most = max(1, min(4, int(np.ptp(across) // 35)))
        strips = int(rng.integers(1, most + 1)) if parcel.use is Use.ARABLE and rng.random() < 0.6 else 1
        parcels.append((np.cos(along), np.sin(along), across.min(), np.ptp(across) / strips, strips, len(covers)))
        for _ in range(strips):
            cover = _cover(rng, parcel.use, season, number in felled)
            tone = rng.normal(1.0, 0.06) + rng.normal(0, 0.02, 3)
            r, g, b = (float(c * t) for c, t in zip(cover.color, tone, strict=True))
            headland_m = rng.uniform(10, 16) if parcel.use is Use.ARABLE else 0.0
            inverted = rng.uniform(0.6, 1.3) * (-1.0 if rng.random() < season.soil_inverted else 1.0)
            covers.append(((r, g, b), cover, headland_m, inverted))
    columns = list(zip(*parcels, strict=True))
    f = [np.array(column, np.float32) for column in columns[:4]]
    i = [np.array(column, np.int32) for column in columns[4:]]

    def of(name: str) -> Raster:
        return np.array([getattr(cover, name) for _, cover, _, _ in covers], np.float32)

    row, tram = of("row_m"), of("tramline_m")
    headland = np.array([metres for _, _, metres, _ in covers], np.float32)
    sense = np.array([sign for _, _, _, sign in covers], np.float32)
    return FieldTable(
        f[0], f[1], f[2], f[3], i[0], i[1],
        np.array([color for color, _, _, _ in covers], np.float32),
        np.where(row > 0, 2 * np.pi / np.where(row > 0, row, 1), 0).astype(np.float32), of("row_strength"),
        np.where(tram > 0, tram, NEVER_M).astype(np.float32), of("tramline_strength"),
        of("mottle"), of("soil") * sense, of("grain"), headland, of("height_m"),
    )  # fmt: skip


def _cover(rng: np.random.Generator, use: Use, season: Season, felled: bool) -> Cover:
    if use is Use.FOREST:
        return season.clearing if felled and season.years > 0 else season.forest_floor
    if use is Use.VILLAGE:
        return season.garden
    choices = season.crops if use is Use.ARABLE else season.meadows
    return choices[int(rng.integers(len(choices)))]


def paint_ground(seed: int, grid: Grid, plan: Plan, lasting: Lasting, table: FieldTable, season: Season) -> tuple[Image, Raster]:
    """Albedo (H, W, 3) and crop height (H, W) of the ground."""
    size, gsd = grid.size_px, grid.gsd_m
    wobble = smooth_noise(rng_of(seed, f"wobble {season.years}"), size, 45 / gsd) * np.float32(0.7)
    soil = _soil(seed, size, gsd)
    mottle = fractal_noise(rng_of(seed, f"mottle {season.years}"), size, 14 / gsd, 4, 0.7)
    grain_rng = rng_of(seed, f"grain {season.years}")
    albedo = np.empty((size, size, 3), np.uint8)
    crop = np.empty((size, size), np.float32)
    x = ((np.arange(size, dtype=np.float32) + 0.5) * np.float32(gsd))[None]
    for top in range(0, size, BAND_ROWS):
        band = slice(top, min(top + BAND_ROWS, size))
        y = ((np.arange(band.start, band.stop, dtype=np.float32) + 0.5) * np.float32(gsd))[:, None]
        parcel, edge = lasting.parcel[band], lasting.edge_m[band]
        across = y * table.cos[parcel] - x * table.sin[parcel] + wobble[band]
        index = ((across - table.start_m[parcel]) / table.width_m[parcel]).astype(np.int32)
        strip = table.first[parcel] + np.clip(index, 0, table.strips[parcel] - 1)
        headland = edge < table.headland_m[strip]
        row_at = np.where(headland, edge, across)
        value = 1 + table.row_strength[strip] * np.sin(row_at * table.row_k_radpm[strip])
        in_tram = np.mod(row_at, table.tramline_m[strip])
        wheels = np.maximum(_bump(in_tram - 1.2), _bump(in_tram - 3.1))
        value -= table.tramline_strength[strip] * wheels
        value += table.mottle[strip] * mottle[band] + table.soil[strip] * soil[band]
        value += table.grain[strip] * grain_rng.standard_normal(value.shape, dtype=np.float32)
        albedo[band] = np.clip(table.color[strip] * value[:, :, None], 0, 255)
        crop[band] = table.height_m[strip] * np.where(edge > 1.5, 1, 0)
    _overlay(seed, grid, plan, albedo, lasting, season, crop)
    return albedo, crop


def _soil(seed: int, size_px: int, gsd_m: float) -> Raster:
    """What the soil shows through every crop: patches of clay and sand, and old channels as winding bands."""
    patches = fractal_noise(rng_of(seed, "soil"), size_px, 60 / gsd_m, 7, 0.8)
    for number, cell_m in enumerate((75.0, 48.0)):
        bend = smooth_noise(rng_of(seed, f"channels {number}"), size_px, cell_m / gsd_m)
        patches += np.float32(1.6) * cv2.exp(-((bend * np.float32(9.0 * 60 / cell_m)) ** 2))
    return np.clip(patches, -1.9, 2.2)


def _bump(offset_m: Raster) -> Raster:
    return np.asarray(np.clip(1 - np.abs(offset_m) / np.float32(0.6), 0, 1), dtype=np.float32)


def _overlay(seed: int, grid: Grid, plan: Plan, albedo: Image, lasting: Lasting, season: Season, crop: Raster) -> None:
    rng = rng_of(seed, f"roads {season.years}")
    _blend(rng, albedo, lasting.verge, season.verge, 0.10)
    _blend(rng, albedo, lasting.shore, season.shore, 0.12)
    _blend(rng, albedo, lasting.water, season.water, 0.03)
    _blend(rng, albedo, lasting.lines[Line.TRACK], season.track, 0.07)
    middle = grid.blank()
    for way in plan.ways:
        if way.kind is Line.TRACK:
            grid.draw(middle, way.points_m, 0.9)
    _blend(rng, albedo, middle, season.verge, 0.08)
    for kind, tone in ((Line.MINOR, 1.06), (Line.MAIN, 0.96)):
        _blend(rng, albedo, lasting.lines[kind], tuple(c * tone for c in season.asphalt), 0.035)
    for layer in (lasting.verge, lasting.water, lasting.shore):
        crop[layer > 60] = 0


def _blend(rng: np.random.Generator, albedo: Image, opacity: NDArray[np.uint8], color: tuple[float, ...], grain: float) -> None:
    at = np.flatnonzero(opacity)
    flat = albedo.reshape(-1, 3)
    share = (opacity.ravel()[at].astype(np.float32) / 255)[:, None]
    value = 1 + np.float32(grain) * rng.standard_normal((len(at), 1), dtype=np.float32)
    flat[at] = np.clip(flat[at] * (1 - share) + np.array(color, np.float32) * value * share, 0, 255)
