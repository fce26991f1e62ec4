"""The Stanford diagram in a flight's report: protection level over true error, in regions, with the counts beside it."""

from __future__ import annotations

from html import escape

import numpy as np

from visloc_companion.evaluate.record import FlightRecord
from visloc_companion.evaluate.reports.report_svg import Scale, decades, figure, legend, line, rect, text, y_axis
from visloc_companion.evaluate.stanford import Judged, Region, horizontal, vertical
from visloc_companion.types import FloatArray

_WIDTH, _HEIGHT, _LEFT, _RIGHT, _TOP, _BOTTOM = 600.0, 564.0, 84.0, 560.0, 14.0, 490.0
_FLOOR_M, _LEAST_TOP_M = 0.1, 100.0
_MANY_TIMES = 1000
_BINS = 56
_DENSITY = (3, 10, 100)
"""Epochs in a cell from which on it is drawn darker."""
_NAMES = {
    Region.AVAILABLE: "available",
    Region.UNAVAILABLE: "not available",
    Region.UNAVAILABLE_MISLEADING: "not available, misleading",
    Region.MISLEADING: "misleading",
    Region.HAZARDOUS: "hazardously misleading (HMI)",
}
_LEGEND = (
    ("dotr-available", "available"),
    ("dotr-unavailable", "not available"),
    ("dotr-hazardous", "misleading; right of the alert limit hazardously so"),
)
_MEANS = {
    Region.AVAILABLE: "error ≤ level ≤ alert limit",
    Region.UNAVAILABLE: "error ≤ level, level > alert limit",
    Region.UNAVAILABLE_MISLEADING: "error > level > alert limit",
    Region.MISLEADING: "level < error ≤ alert limit",
    Region.HAZARDOUS: "level ≤ alert limit < error",
}


def stanford_section(record: FlightRecord, alert_limit_m: float) -> str:
    """Heading, both diagrams and the table of counts (HTML); empty without truth or levels."""
    judged = [(axis, one) for axis, one in (("horizontal", horizontal(record, alert_limit_m)), ("vertical", vertical(record)))]
    judged = [(axis, one) for axis, one in judged if len(one.region)]
    if not judged:
        return ""
    drawn = "".join(
        f"<div><h3>{axis.capitalize()}, alert limit {one.limit_m:g} m</h3>{_diagram(one, axis)}</div>" for axis, one in judged
    )
    return (
        "<h2>Does the protection level hold?</h2>"
        f"<p>{escape(_verdict(judged))} Every dot is one or more output ticks: what was promised over what was true. Dots below "
        "the diagonal broke the promise; right of the alert limit and below it they would have been dangerous.</p>"
        f'{legend(_LEGEND)}<div class="two">{drawn}</div>{_table(judged)}'
    )


def _verdict(judged: list[tuple[str, Judged]]) -> str:
    sentences = []
    for axis, one in judged:
        broken = int(np.sum(one.error_m > one.level_m))
        ratio = float(np.median(one.level_m)) / max(float(np.median(one.error_m)), 1e-9)
        n = len(one.region)
        kept = f"held at every tick with truth ({n})" if not broken else f"was too small at {broken} of {n} ticks with truth"
        words = f"{ratio:.1f}" if ratio < _MANY_TIMES else f"more than {_MANY_TIMES}"
        sentences.append(f"The {axis} level {kept}; its median is {words} times the median error.")
    return " ".join(sentences)


def _table(judged: list[tuple[str, Judged]]) -> str:
    heads = "".join(f'<th class="n">{axis}</th><th class="n">share</th>' for axis, _ in judged)
    rows = ""
    for region, name in _NAMES.items():
        cells = "".join(
            f'<td class="n">{one.count(region)}</td><td class="n">{100 * one.count(region) / len(one.region):.2f} %</td>'
            for _, one in judged
        )
        rows += f'<tr><td>{name}<div class="soft">{_MEANS[region]}</div></td>{cells}</tr>'
    return f'<div class="scroll"><table><thead><tr><th>ticks</th>{heads}</tr></thead><tbody>{rows}</tbody></table></div>'


def _diagram(judged: Judged, axis: str) -> str:
    top_m = 10.0 ** np.ceil(
        np.log10(max(_LEAST_TOP_M, judged.limit_m * 2, float(judged.level_m.max()), float(judged.error_m.max())))
    )
    x = Scale(_FLOOR_M, float(top_m), _LEFT, _RIGHT, log=True)
    y = Scale(_FLOOR_M, float(top_m), _BOTTOM, _TOP, log=True)
    at_x, at_y = x(judged.limit_m), y(judged.limit_m)
    parts = [
        _polygon([(_LEFT, _BOTTOM), (_LEFT, at_y), (at_x, at_y)], Region.AVAILABLE),
        _polygon([(_LEFT, at_y), (_LEFT, _TOP), (_RIGHT, _TOP), (at_x, at_y)], Region.UNAVAILABLE),
        _polygon([(at_x, at_y), (_RIGHT, _TOP), (_RIGHT, at_y)], Region.UNAVAILABLE_MISLEADING),
        _polygon([(_LEFT, _BOTTOM), (at_x, at_y), (at_x, _BOTTOM)], Region.MISLEADING),
        _polygon([(at_x, at_y), (_RIGHT, at_y), (_RIGHT, _BOTTOM), (at_x, _BOTTOM)], Region.HAZARDOUS),
        *y_axis(y, _LEFT, _RIGHT, f"{axis} protection level (m)", decades(_FLOOR_M, float(top_m))),
        *_x_decades(x, f"true {axis} error (m)"),
        line(_LEFT, _BOTTOM, _RIGHT, _TOP, "cut"),
        line(_LEFT, at_y, _RIGHT, at_y, "limit"),
        line(at_x, _TOP, at_x, _BOTTOM, "limit"),
        *_cells(judged, x, y),
        text(_LEFT + 10, at_y + 22, "available", "over", "start"),
        text(at_x - 10, at_y - 10, "not available", "over", "end"),
        text(at_x + 8, _BOTTOM - 12, "HMI", "over", "start"),
        text(at_x - 10, _BOTTOM - 12, "misleading", "over", "end"),
    ]
    words = f"Stanford diagram of the {axis} protection level: {judged.count(Region.HAZARDOUS)} hazardously misleading ticks"
    return figure(_WIDTH, _HEIGHT, parts, words, "half")


def _polygon(corners: list[tuple[float, float]], region: Region) -> str:
    points = " ".join(f"{px:.1f},{py:.1f}" for px, py in corners)
    return f'<polygon points="{points}" class="r-{region.name.lower()}"/>'


def _x_decades(x: Scale, title: str) -> list[str]:
    grid = [line(x(v), _TOP, x(v), _BOTTOM, "grid") for v in decades(x.low, x.high)]
    labels = [text(x(v), _BOTTOM + 26, f"{v:g}") for v in decades(x.low, x.high)]
    return [
        *grid,
        *labels,
        line(_LEFT, _BOTTOM, _RIGHT, _BOTTOM, "axis"),
        text((_LEFT + _RIGHT) / 2, _BOTTOM + 58, title, "title"),
    ]


def _cells(judged: Judged, x: Scale, y: Scale) -> list[str]:
    """A square for each cell of the diagram that holds epochs, in the colour of the worst of them, darker where many are."""
    side_px = (_RIGHT - _LEFT) / _BINS
    column = _bin(x.many(judged.error_m) - _LEFT, side_px)
    row = _bin(_BOTTOM - y.many(judged.level_m), side_px)
    cells: dict[tuple[int, int], tuple[int, int]] = {}
    for key_x, key_y, region in zip(column.tolist(), row.tolist(), judged.region.tolist(), strict=True):
        count, worst = cells.get((key_x, key_y), (0, 0))
        cells[key_x, key_y] = (count + 1, max(worst, region))
    parts = []
    for (key_x, key_y), (count, worst) in sorted(cells.items()):
        shade = sum(count >= limit for limit in _DENSITY)
        css = f"dotr-{Region(worst).name.lower()} d{shade}"
        left, up = _LEFT + key_x * side_px, _BOTTOM - (key_y + 1) * side_px
        parts.append(rect(left + 0.4, max(up, _TOP) + 0.4, side_px - 0.8, side_px - 0.8, css, f"{count} ticks"))
    return parts


def _bin(px: FloatArray, side_px: float) -> np.ndarray:
    return np.clip(np.floor(px / side_px), 0, None).astype(np.int64)
