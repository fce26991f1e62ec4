"""The plot of a training run: loss and validation error over the steps, one SVG file that any browser shows."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from visloc_companion.evaluate.report_svg import Scale, circle, number, path, text, thinned, ticks, x_axis, y_axis
from visloc_companion.types import FloatArray

WIDTH, HEIGHT = 960.0, 560.0
_LEFT, _RIGHT = 90.0, 930.0
_LOSS_TOP, _LOSS_BOTTOM = 40.0, 250.0
_ERROR_TOP, _ERROR_BOTTOM = 310.0, 500.0
SMOOTHING = 0.02
"""Share by which each step moves the smoothed loss."""
STYLE = (
    "<style>svg{background:#fff;font-family:system-ui,sans-serif}text{font-size:14px;fill:#16191d}.label{fill:#59626e}"
    ".grid{stroke:#e3e7ec}.axis{stroke:#59626e}.raw,.smooth,.error{fill:none;stroke-linejoin:round}"
    ".raw{stroke:#9ac7ec;stroke-width:1}.smooth{stroke:#0068b4;stroke-width:2.2}.error{stroke:#b05a00;stroke-width:2.2}"
    ".dot{fill:#b05a00}"
    "@media (prefers-color-scheme:dark){svg{background:#14171b}text{fill:#eceff3}.label{fill:#a4aeba}.grid{stroke:#2b3138}"
    ".axis{stroke:#a4aeba}.raw{stroke:#2c5f88}.smooth{stroke:#5cb8ff}.error{stroke:#ff9153}.dot{fill:#ff9153}}</style>"
)


def curves_svg(
    steps: Sequence[int], losses: Sequence[float], validated: Sequence[tuple[int, float]], total_steps: int, error_name: str
) -> str:
    """The drawing. `losses` at `steps`; `validated` is (step, error) pairs; `error_name` says what the error is, with its unit."""
    t = Scale(0.0, max(total_steps, 1), _LEFT, _RIGHT)
    parts = [STYLE, text(_LEFT, 24, "training loss (thin: as measured, thick: smoothed)", anchor="start")]
    parts += _panel(t, np.array(losses, dtype=np.float64), _LOSS_TOP, _LOSS_BOTTOM, "loss", "")
    if losses:
        at, scale = np.array(steps, dtype=np.float64), _scale(np.array(losses), _LOSS_TOP, _LOSS_BOTTOM)
        for values, css in ((np.array(losses, dtype=np.float64), "raw"), (smoothed(losses), "smooth")):
            few_t, few = thinned(at, values)
            parts.append(path(t.many(few_t), scale.many(few), css))
    errors = np.array([error for _, error in validated], dtype=np.float64)
    parts.append(text(_LEFT, _ERROR_TOP - 16, f"validation: {error_name}", anchor="start"))
    parts += _panel(t, errors, _ERROR_TOP, _ERROR_BOTTOM, "error", "steps")
    if validated:
        scale = _scale(errors, _ERROR_TOP, _ERROR_BOTTOM)
        x_px, y_px = t.many(np.array([step for step, _ in validated], dtype=np.float64)), scale.many(errors)
        parts.append(path(x_px, y_px, "error"))
        parts += [circle(x, y, 3, "dot") for x, y in zip(x_px, y_px, strict=True)]
        parts.append(text(_RIGHT, _ERROR_TOP - 16, f"last {number(round(errors[-1], 4))}", anchor="end"))
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH:g} {HEIGHT:g}" role="img" '
        f'aria-label="Training loss and validation error over the steps">{"".join(parts)}</svg>\n'
    )


def smoothed(losses: Sequence[float]) -> FloatArray:
    """(N,) exponential moving average, unbiased at its start."""
    out = np.empty(len(losses))
    total = weight = 0.0
    for k, loss in enumerate(losses):
        total, weight = (1 - SMOOTHING) * total + SMOOTHING * loss, (1 - SMOOTHING) * weight + SMOOTHING
        out[k] = total / weight
    return out


def _panel(t: Scale, values: FloatArray, top: float, bottom: float, name: str, below: str) -> list[str]:
    scale = _scale(values, top, bottom)
    return [*x_axis(t, top, bottom, below), *y_axis(scale, _LEFT, _RIGHT, name, ticks(scale.low, scale.high, 5))]


def _scale(values: FloatArray, top: float, bottom: float) -> Scale:
    """From zero, or from the lowest value where that is negative, to the highest."""
    if not len(values):
        return Scale(0.0, 1.0, bottom, top)
    low, high = min(0.0, float(values.min())), float(values.max())
    return Scale(low, high if high > low and math.isfinite(high) else low + 1.0, bottom, top)
