"""Between pixels: where a peak of a score is highest."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

LEAST_CURVATURE = 1e-9


def peak_offset(score: NDArray[np.floating[Any]], row: int, col: int) -> tuple[float, float]:
    """How far right and down of a maximum (at most half a pixel) parabolas through it and its neighbours are highest; zero along
    an axis at whose end it lies, or that is level."""
    right, down = (_offset(line, at) for line, at in ((score[row], col), (score[:, col], row)))
    return right, down


def _offset(line: NDArray[np.floating[Any]], at: int) -> float:
    if not 0 < at < len(line) - 1:
        return 0.0
    before, here, after = (float(s) for s in line[at - 1 : at + 2])
    curvature = before - 2 * here + after
    return max(-0.5, min(0.5, 0.5 * (before - after) / curvature)) if curvature < -LEAST_CURVATURE else 0.0
