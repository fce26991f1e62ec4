"""The plot of a training run: loss and validation error over the steps, one SVG file that any browser shows."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from visloc_companion.evaluate.reports.report_svg import Scale, circle, line, number, path, text, thinned, ticks, x_axis, y_axis
from visloc_companion.types import FloatArray

WIDTH, HEIGHT = 960.0, 560.0
_LEFT, _RIGHT = 90.0, 930.0
_LOSS_TOP, _LOSS_BOTTOM = 40.0, 240.0
_ERROR_TOP, _ERROR_BOTTOM = 310.0, 500.0
SMOOTHING = 0.1
"""Share by which each line of the log moves the smoothed loss."""
SERIES = 6
"""Colours for validation sources; further ones begin again."""
STYLE = (
    "<style>svg{background:#fff;font-family:system-ui,sans-serif}text{font-size:14px;fill:#16191d}.label{fill:#59626e}"
    ".grid{stroke:#e3e7ec}.axis{stroke:#59626e}path{fill:none;stroke-linejoin:round;stroke-width:2.2}"
    "path.raw{stroke:#9ac7ec;stroke-width:1}path.smooth{stroke:#0068b4}.base{stroke-dasharray:5 5;stroke-width:1.4}"
    ".s0{stroke:#b05a00}.s1{stroke:#00805a}.s2{stroke:#8b3a9c}.s3{stroke:#c01c28}.s4{stroke:#0068b4}.s5{stroke:#6b7480}"
    "circle{fill:none}@media (prefers-color-scheme:dark){svg{background:#14171b}text{fill:#eceff3}.label{fill:#a4aeba}"
    ".grid{stroke:#2b3138}.axis{stroke:#a4aeba}path.raw{stroke:#2c5f88}path.smooth{stroke:#5cb8ff}.s0{stroke:#ff9153}"
    ".s1{stroke:#4fd1a0}.s2{stroke:#d79be6}.s3{stroke:#ff7b7b}.s4{stroke:#5cb8ff}.s5{stroke:#98a2ae}}</style>"
)

Points = Sequence[tuple[int, float]]


def curves_svg(losses: Points, errors: Mapping[str, Points], baselines: Mapping[str, float], total_steps: int) -> str:
    """The drawing of (step, value) points. `errors` and `baselines` (plain gradient features): 0 to 1, by validation source."""
    t = Scale(0.0, max(total_steps, 1), _LEFT, _RIGHT)
    parts = [STYLE, text(_LEFT, 24, "training loss (thin: as logged, thick: smoothed)", anchor="start")]
    parts += [*_losses(t, losses), *_errors(t, errors, baselines)]
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH:g} {HEIGHT:g}" role="img" '
        f'aria-label="Training loss and validation error over the steps">{"".join(parts)}</svg>\n'
    )


def smoothed(values: FloatArray) -> FloatArray:
    """(N,) exponential moving average, unbiased at its start."""
    out = np.empty(len(values))
    total = weight = 0.0
    for k, value in enumerate(values):
        total, weight = (1 - SMOOTHING) * total + SMOOTHING * value, (1 - SMOOTHING) * weight + SMOOTHING
        out[k] = total / weight
    return out


def _losses(t: Scale, losses: Points) -> list[str]:
    at, values = _columns(losses)
    low, high = (float(values.min()), float(values.max())) if len(values) else (0.0, 1.0)
    room = max(0.1 * (high - low), 0.05)
    scale = Scale(low - room, high + room, _LOSS_BOTTOM, _LOSS_TOP)
    parts = _axes(t, scale, "loss", "")
    for drawn, css in ((values, "raw"), (smoothed(values), "smooth")):
        few_at, few = thinned(at, drawn)
        parts.append(path(t.many(few_at), scale.many(few), css))
    return parts


def _errors(t: Scale, errors: Mapping[str, Points], baselines: Mapping[str, float]) -> list[str]:
    highest = max([0.01, *baselines.values(), *(value for points in errors.values() for _, value in points)])
    scale = Scale(0.0, 100 * highest, _ERROR_BOTTOM, _ERROR_TOP)
    parts = _axes(t, scale, "wrong (%)", "steps")
    parts.append(
        text(_LEFT, _ERROR_TOP - 34, "validation: queries placed wrong (dashed: gradient features alone)", anchor="start")
    )
    x = _LEFT
    for k, (name, points) in enumerate(errors.items()):
        css = f"s{k % SERIES}"
        steps, values = _columns(points)
        x_px, y_px = t.many(steps), scale.many(100 * values)
        parts.append(path(x_px, y_px, css))
        parts += [circle(u, v, 2.5, css) for u, v in zip(x_px, y_px, strict=True)]
        if name in baselines:
            base = scale(100 * baselines[name])
            parts.append(line(_LEFT, base, _RIGHT, base, f"{css} base"))
        words = f"{name} {number(round(100 * points[-1][1], 1))} %" if points else name
        parts += [line(x, _ERROR_TOP - 15, x + 22, _ERROR_TOP - 15, css), text(x + 28, _ERROR_TOP - 10, words, anchor="start")]
        x += 60 + 8.5 * len(words)
    return parts


def _axes(t: Scale, scale: Scale, name: str, below: str) -> list[str]:
    across = x_axis(t, scale.end_px, scale.start_px, below)
    return [*across, *y_axis(scale, _LEFT, _RIGHT, name, ticks(scale.low, scale.high, 5))]


def _columns(points: Points) -> tuple[FloatArray, FloatArray]:
    table = np.array(points, dtype=np.float64).reshape(-1, 2)
    return table[:, 0], table[:, 1]
