"""The map of a flight: true, estimated and GNSS-reported tracks with a scale bar, over the ortho where there is one."""

from __future__ import annotations

import base64
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from visloc_companion.evaluate.record import MAX_TRUTH_GAP_S, FlightRecord, Track
from visloc_companion.evaluate.reports.report_svg import (
    Scale,
    circle,
    figure,
    legend,
    line,
    nice_step,
    number,
    path,
    rect,
    text,
    thinned_track,
)
from visloc_companion.geo.wgs84 import ned_from_geo
from visloc_companion.types import FloatArray, GeoPoint

WIDTH, HEIGHT = 600.0, 560.0
_MARGIN_SHARE, _LEAST_SPAN_M = 0.08, 40.0
_GNSS_WIDENS, _ALL_BUT = 4.0, 0.9
_SPARSE = 3.0
"""Of a track that is sampled more seldom than truth is interpolated, a gap is so many times its usual spacing."""


Moment = tuple[float, str]
"""Seconds since the start, and what is said before them."""


@dataclass(frozen=True, slots=True)
class MapImage:
    """A picture (JPEG bytes) of the ground and the places of its outer corners, of (width, height) pixels."""

    jpeg: bytes
    size_px: tuple[int, int]
    north_west: GeoPoint
    north_east: GeoPoint
    south_west: GeoPoint


@dataclass(frozen=True, slots=True)
class View:
    """The window of ground that a map shows: centre (north, east) and side in metres along the drawing's width."""

    north_m: float
    east_m: float
    width_m: float

    def scales(self) -> tuple[Scale, Scale]:
        """East to x and north to y (up)."""
        half_e, half_n = self.width_m / 2, self.width_m / 2 * HEIGHT / WIDTH
        east = Scale(self.east_m - half_e, self.east_m + half_e, 0, WIDTH)
        return east, Scale(self.north_m - half_n, self.north_m + half_n, HEIGHT, 0)


def view_of(tracks: Sequence[FloatArray]) -> View:
    """The window that holds all of these (N, 2+) north, east positions with a margin."""
    points = np.concatenate([track[:, :2] for track in tracks] or [np.zeros((0, 2))])
    points = points[np.isfinite(points).all(axis=1)]
    if not len(points):
        points = np.zeros((1, 2))
    low, high = points.min(axis=0), points.max(axis=0)
    width = max(high[1] - low[1], (high[0] - low[0]) * WIDTH / HEIGHT, _LEAST_SPAN_M) * (1 + 2 * _MARGIN_SHARE)
    return View(float(low[0] + high[0]) / 2, float(low[1] + high[1]) / 2, float(width))


def flight_view(record: FlightRecord, baseline: FlightRecord | None = None) -> View:
    """The window of a flight, with a baseline about the same origin if it has one: of all its tracks, but of the receiver's only
    where that leaves the flight large enough to be seen. Spoofers put receivers on other continents."""
    own = [record.truth.p_ned_m, record.estimate_ned_m, *([baseline.truth.p_ned_m] if baseline is not None else [])]
    near, whole = view_of(own), view_of([*own, record.gnss.p_ned_m])
    known = any(np.isfinite(track[:, :2]).all(axis=1).any() for track in own)
    return near if known and whole.width_m > _GNSS_WIDENS * near.width_m else whole


def flight_map(
    record: FlightRecord, view: View, label: str, image: MapImage | None, *, own: str = "truth", lost: Moment | None = None
) -> str:
    """The drawing (SVG) of one flight in a window. `own` is the class of the true track; `lost` marks a moment on it."""
    east, north = view.scales()
    parts = [
        f'<clipPath id="clip-{own}"><rect width="{WIDTH:g}" height="{HEIGHT:g}"/></clipPath>',
        f'<g clip-path="url(#clip-{own})">',
    ]
    parts += [_photo(image, record.origin, east, north)] if image else _grid(view, east, north)
    parts += [*_scale_bar(view), *_north_arrow()]
    for track, css in ((record.gnss, "gnss"), (record.truth, own), (Track(record.t_s, record.estimate_ned_m), "estimate")):
        parts += _line(track, css, east, north, halo=image is not None)
    parts += _markers(_flown(record), east, north, lost)
    parts += ["</g>", rect(0.5, 0.5, WIDTH - 1, HEIGHT - 1, "frame")]
    return figure(WIDTH, HEIGHT, parts, label, "map")


def map_legend(record: FlightRecord, view: View, own: str, own_words: str) -> str:
    """What the lines of `flight_map` are; only those that are there."""
    items = [(own, own_words)] if len(record.truth.t_s) else []
    items += [("estimate", "our estimate")] if np.isfinite(record.estimate_ned_m).any() else []
    off_m = _off_the_map_m(record.gnss, view)
    left = f", up to {off_m / 1000:,.1f} km off this map" if off_m > 0 else ""
    items += [("gnss", f"position that GNSS reported{left}")] if len(record.gnss.t_s) else []
    ends = [("dotstart", "start"), ("dotend", "end")] if len(_flown(record).t_s) else []
    return legend([*items, *ends])


def _flown(record: FlightRecord) -> Track:
    """The true track, or what is nearest to it of what lasts longer: truth may be of a part of the flight."""
    known = np.isfinite(record.estimate_ned_m[:, 0])
    estimate = Track(record.t_s[known], record.estimate_ned_m[known])
    tracks = [track for track in (record.truth, estimate, record.gnss) if len(track.t_s)]
    lasts_s = [float(track.t_s[-1] - track.t_s[0]) for track in tracks]
    most_s = max(lasts_s, default=0.0)
    return next((track for track, s in zip(tracks, lasts_s, strict=True) if s >= _ALL_BUT * most_s), record.truth)


def _line(track: Track, css: str, east: Scale, north: Scale, *, halo: bool) -> list[str]:
    p = _drawn_ned_m(track)
    inside = (p[:, 1] >= east.low) & (p[:, 1] <= east.high) & (p[:, 0] >= north.low) & (p[:, 0] <= north.high)
    beside = np.append(inside[1:], False) | np.insert(inside[:-1], 0, False)  # leads over the edge, where the clip cuts it
    x = (p[:, 1] - east.low) * WIDTH / (east.high - east.low)
    y = (north.high - p[:, 0]) * HEIGHT / (north.high - north.low)
    x[~(inside | beside)] = np.nan
    drawn = path(x, y, css)
    return [path(x, y, "halo"), drawn] if halo and drawn else [drawn]


def _off_the_map_m(track: Track, view: View) -> float:
    """How far beyond the window's edges a track leads, metres; 0 within."""
    off_n = np.abs(track.p_ned_m[:, 0] - view.north_m) - view.width_m / 2 * HEIGHT / WIDTH
    off_e = np.abs(track.p_ned_m[:, 1] - view.east_m) - view.width_m / 2
    return float(np.max(np.hypot(np.maximum(off_n, 0), np.maximum(off_e, 0)), initial=0.0))


def _drawn_ned_m(track: Track) -> FloatArray:
    """(M, 3) at most about MAX_POINTS positions of a track that keep its reach, with NaN where nothing is known in between: a
    line would tell of a way that nobody has seen."""
    if not len(track.p_ned_m):
        return track.p_ned_m
    steps_s = np.diff(track.t_s, prepend=track.t_s[0])
    apart_s = max(MAX_TRUTH_GAP_S, _SPARSE * float(np.median(steps_s[1:]))) if len(steps_s) > 1 else MAX_TRUTH_GAP_S
    broken = np.asarray((steps_s > apart_s) | np.isnan(track.p_ned_m[:, 0]))
    kept = thinned_track(track.p_ned_m, broken)
    breaks = np.cumsum(broken)[kept]
    return np.asarray(np.insert(track.p_ned_m[kept], np.flatnonzero(np.diff(breaks)) + 1, np.nan, axis=0))


def _markers(track: Track, east: Scale, north: Scale, lost: Moment | None) -> list[str]:
    if not len(track.t_s):
        return []
    first, last = track.p_ned_m[0], track.p_ned_m[-1]
    parts = [circle(east(first[1]), north(first[0]), 7, "dotstart"), circle(east(last[1]), north(last[0]), 7, "dotend")]
    if lost is None:
        return parts
    at_s, says = lost
    x, y = _pixel(track, at_s, east, north)
    if not np.isfinite([x, y]).all():
        return parts
    left = x > WIDTH * 0.6
    words = text(x + (-12 if left else 12), y - 10, f"{says} {number(round(at_s))} s", "over", "end" if left else "start")
    return [*parts, circle(x, y, 5, "dotgnss"), words]


def _pixel(track: Track, t_s: float, east: Scale, north: Scale) -> tuple[float, float]:
    at = track.at(np.array([t_s]))[0]
    return float(east.many(at[1:2])[0]), float(north.many(at[:1])[0])


def _grid(view: View, east: Scale, north: Scale) -> list[str]:
    step = nice_step(view.width_m, 6)
    parts: list[str] = []
    for k in range(int(np.ceil(east.low / step)), int(np.floor(east.high / step)) + 1):
        parts.append(line(east(k * step), 0, east(k * step), HEIGHT, "grid"))
    for k in range(int(np.ceil(north.low / step)), int(np.floor(north.high / step)) + 1):
        parts.append(line(0, north(k * step), WIDTH, north(k * step), "grid"))
    return parts


def _photo(image: MapImage, origin: GeoPoint, east: Scale, north: Scale) -> str:
    corners = [ned_from_geo(place, origin) for place in (image.north_west, image.north_east, image.south_west)]
    per_m_x, per_m_y = WIDTH / (east.high - east.low), HEIGHT / (north.high - north.low)
    (x0, y0), (x1, y1), (x2, y2) = (((e - east.low) * per_m_x, (north.high - n) * per_m_y) for n, e, _ in corners)
    width, height = image.size_px
    matrix = ((x1 - x0) / width, (y1 - y0) / width, (x2 - x0) / height, (y2 - y0) / height, x0, y0)
    data = base64.b64encode(image.jpeg).decode("ascii")
    numbers = " ".join(f"{value:.6g}" for value in matrix)
    return (
        f'<image class="photo" width="{width}" height="{height}" transform="matrix({numbers})" '
        f'preserveAspectRatio="none" href="data:image/jpeg;base64,{data}"/>'
    )


def _scale_bar(view: View) -> list[str]:
    length_m = nice_step(view.width_m, 5)
    length_px = length_m / view.width_m * WIDTH
    x, y = 18.0, HEIGHT - 20.0
    bar = [
        line(x, y, x + length_px, y, "axis"),
        line(x, y - 6, x, y + 6, "axis"),
        line(x + length_px, y - 6, x + length_px, y + 6, "axis"),
    ]
    plate = rect(x - 10, y - 30, max(length_px, 70) + 20, 42, "plate")
    return [plate, *bar, text(x, y - 10, f"{number(length_m)} m", "title", "start")]


def _north_arrow() -> list[str]:
    x = WIDTH - 30.0
    return [
        rect(x - 20, 10, 40, 58, "plate"),
        f'<path class="s-on" d="M{x} 16 l9 26 l-9 -7 l-9 7 z"/>',
        text(x, 62, "N", "title"),
    ]
