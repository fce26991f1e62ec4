"""Small pieces of SVG: scales, ticks, axes, paths. Colours and sizes are classes of report_style.py."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from heapq import heapify, heappop, heappush
from html import escape
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from visloc_companion.types import FloatArray

MAX_POINTS = 1600


@dataclass(frozen=True, slots=True)
class Scale:
    """From values to pixels of the drawing; `log` spaces decades evenly (values below `low` are drawn at `low`)."""

    low: float
    high: float
    start_px: float
    end_px: float
    log: bool = False

    def __call__(self, value: float) -> float:
        """The pixel of one value."""
        return float(self.many(np.array([value]))[0])

    def many(self, values: FloatArray) -> FloatArray:
        """(N,) pixels of values; NaN stays NaN."""
        low, high = (math.log10(self.low), math.log10(self.high)) if self.log else (self.low, self.high)
        inside = np.clip(values, self.low, self.high)
        share = ((np.log10(inside) if self.log else inside) - low) / max(high - low, 1e-12)
        return np.asarray(self.start_px + share * (self.end_px - self.start_px), dtype=np.float64)


def nice_step(span: float, count: int) -> float:
    """A step of 1, 2 or 5 times a power of ten that divides a span into about so many parts."""
    raw = max(span, 1e-9) / max(count, 1)
    power = 10.0 ** math.floor(math.log10(raw))
    return next(step * power for step in (1.0, 2.0, 5.0, 10.0) if step * power >= raw * 0.999)


def ticks(low: float, high: float, count: int) -> list[float]:
    """Round values between two."""
    step = nice_step(high - low, count)
    first = math.ceil(low / step - 1e-9)
    return [k * step for k in range(first, math.floor(high / step + 1e-9) + 1)]


def decades(low: float, high: float) -> list[float]:
    """Powers of ten between two positive values, both included."""
    return [10.0**k for k in range(math.ceil(math.log10(low) - 1e-9), math.floor(math.log10(high) + 1e-9) + 1)]


def number(value: float) -> str:
    """A number for a label, without needless digits and without a negative zero."""
    return f"{value + 0.0:.10g}" if abs(value) >= 1e-9 else "0"


def path(x_px: FloatArray, y_px: FloatArray, css: str) -> str:
    """A polyline that is broken where a coordinate is NaN; empty where nothing is left."""
    known = np.isfinite(x_px) & np.isfinite(y_px)
    parts: list[str] = []
    pen_down = False
    for x, y, here in zip(x_px, y_px, known, strict=True):
        if here:
            parts.append(f"{'L' if pen_down else 'M'}{x:.1f} {y:.1f}")
        pen_down = bool(here)
    return f'<path class="{css}" d="{"".join(parts)}"/>' if parts else ""


def thinned(t: FloatArray, values: FloatArray) -> tuple[FloatArray, FloatArray]:
    """At most about MAX_POINTS samples that keep every peak: the least and the greatest of each bin, in order."""
    if len(t) <= MAX_POINTS:
        return t, values
    kept: list[int] = []
    for part in np.array_split(np.arange(len(t)), MAX_POINTS // 2):
        here = values[part]
        if np.isnan(here).any():
            kept.append(int(part[int(np.argmax(np.isnan(here)))]))
        if np.isfinite(here).any():
            kept += [int(part[int(np.nanargmin(here))]), int(part[int(np.nanargmax(here))])]
    order = sorted(set(kept))
    return t[order], values[order]


def thinned_track(p_ned_m: FloatArray, broken: NDArray[np.bool_] | None = None) -> NDArray[np.int64]:
    """Which of (N, 2+) positions to draw, at most about MAX_POINTS, in order.

    The first and the last, those beside gaps (NaN, or `broken` (N,): no line leads to it), those furthest to each side of the
    compass, then always the one furthest from the line drawn so far (Douglas and Peucker 1973): all corners, before noise.
    """
    if len(p_ned_m) <= MAX_POINTS:
        return np.arange(len(p_ned_m))
    finite = np.isfinite(p_ned_m[:, :2]).all(axis=1)
    known = np.flatnonzero(finite)
    kept = {0, len(p_ned_m) - 1}
    if not len(known):
        return np.array(sorted(kept))
    xy = np.asarray(p_ned_m[known, :2], dtype=np.float64)
    gaps = np.cumsum(~finite if broken is None else ~finite | broken)[known]
    after = np.flatnonzero(np.diff(gaps)) + 1
    beside = np.concatenate([after - 1, after]) if len(after) < MAX_POINTS // 4 else after[:0]
    ends = {0, len(known) - 1, *(int(k) for k in (*xy.argmin(axis=0), *xy.argmax(axis=0), *beside))}
    order = sorted(ends)
    open_parts = [_furthest(xy, a, b) for a, b in pairwise(order)]
    heapify(open_parts)
    while open_parts and len(ends) < MAX_POINTS:
        _, a, middle, b = heappop(open_parts)
        if middle <= a:
            continue
        ends.add(middle)
        heappush(open_parts, _furthest(xy, a, middle))
        heappush(open_parts, _furthest(xy, middle, b))
    return np.array(sorted(kept | set(known[sorted(ends)].tolist())))


def _furthest(xy: FloatArray, a: int, b: int) -> tuple[float, int, int, int]:
    """Minus the distance of the position between two that is furthest from the line between them, and the three; `a` twice where
    nothing lies between."""
    if b - a < 2:
        return 0.0, a, a, b
    way, there = xy[b] - xy[a], xy[a + 1 : b] - xy[a]
    along = np.clip(there @ way / max(float(way @ way), 1e-12), 0.0, 1.0)
    off = np.hypot(*(there - along[:, None] * way).T)
    k = int(off.argmax())
    return -float(off[k]), a, a + 1 + k, b


def text(x: float, y: float, words: str, css: str = "label", anchor: str = "middle", extra: str = "") -> str:
    """One line of text."""
    return f'<text x="{x:.1f}" y="{y:.1f}" class="{css}" text-anchor="{anchor}"{extra}>{escape(words)}</text>'


def line(x1: float, y1: float, x2: float, y2: float, css: str) -> str:
    """A straight line."""
    return f'<line x1="{x1:.1f}" y1="{y1:.1f}" x2="{x2:.1f}" y2="{y2:.1f}" class="{css}"/>'


def rect(x: float, y: float, width: float, height: float, css: str, title: str = "") -> str:
    """A rectangle, with a tooltip where a title is given."""
    inner = f"<title>{escape(title)}</title>" if title else ""
    return f'<rect x="{x:.1f}" y="{y:.1f}" width="{max(width, 0):.1f}" height="{max(height, 0):.1f}" class="{css}">{inner}</rect>'


def circle(x: float, y: float, radius: float, css: str) -> str:
    """A disc."""
    return f'<circle cx="{x:.1f}" cy="{y:.1f}" r="{radius:g}" class="{css}"/>'


def figure(width: float, height: float, parts: Sequence[str], label: str, css: str = "") -> str:
    """A whole drawing that scales with its container. `label` is what a screen reader says."""
    return (
        f'<svg viewBox="0 0 {width:g} {height:g}" class="{css}" role="img" aria-label="{escape(label, quote=True)}">'
        f"{''.join(parts)}</svg>"
    )


def x_axis(scale: Scale, y_top: float, y_bottom: float, title: str, count: int = 10) -> list[str]:
    """Grid lines, tick labels and title of a horizontal axis at `y_bottom`."""
    parts: list[str] = []
    for value in ticks(scale.low, scale.high, count):
        parts += [line(scale(value), y_top, scale(value), y_bottom, "grid"), text(scale(value), y_bottom + 18, number(value))]
    middle = (scale.start_px + scale.end_px) / 2
    return [*parts, line(scale.start_px, y_bottom, scale.end_px, y_bottom, "axis"), text(middle, y_bottom + 38, title, "title")]


def y_axis(scale: Scale, x_left: float, x_right: float, title: str, values: Sequence[float]) -> list[str]:
    """Grid lines, tick labels and (turned) title of a vertical axis at `x_left`."""
    parts: list[str] = []
    for value in values:
        at = scale(value)
        parts += [line(x_left, at, x_right, at, "grid"), text(x_left - 8, at + 4.5, number(value), anchor="end")]
    middle = (scale.start_px + scale.end_px) / 2
    turned = text(0, 0, title, "title", extra=f' transform="translate({x_left - 52:.1f} {middle:.1f}) rotate(-90)"')
    return [*parts, line(x_left, scale.start_px, x_left, scale.end_px, "axis"), turned]


def legend(items: Sequence[tuple[str, str]]) -> str:
    """A legend as HTML that wraps: (class of the stroke or dot, words)."""
    keys = []
    for css, words in items:
        if css.startswith("dot"):
            sample = circle(14, 7, 4, css)
        elif css.startswith("band"):
            sample = rect(2, 1, 24, 12, css)
        else:
            sample = line(1, 7, 27, 7, css)
        keys.append(f'<li><svg viewBox="0 0 28 14" class="key" aria-hidden="true">{sample}</svg>{escape(words)}</li>')
    return f'<ul class="legend">{"".join(keys)}</ul>'
