"""Whether a claimed probability of being wrong is true: reliability diagram, expected calibration error, separation.

A claim is a pair (p, wrong): what was claimed for one answer, and whether it was wrong. Calibrated means that of the answers with
p near 0.2 a fifth are wrong (Murphy & Winkler 1977); the expected calibration error is the mean distance from that, weighted by
how many answers fall into each bin (Naeini et al. 2015).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from visloc_companion.evaluate.reports.report_svg import Scale, circle, figure, line, rect, text, ticks, x_axis, y_axis
from visloc_companion.types import FloatArray

BINS = 10
MAX_CALIBRATION_ERROR = 0.03
MAX_EXCESS_SIGMAS = 3.0
"""More wrong answers than claimed, by so many standard deviations of chance, is over-confidence and no accident."""


@dataclass(frozen=True, slots=True)
class Bin:
    """Answers whose claims lie in [low, high): how many, their mean claim, the share of them that is wrong."""

    low: float
    high: float
    n: int
    claimed: float
    wrong: float

    @property
    def sigma(self) -> float:
        """Standard deviation of the share of wrong ones if the claim is true."""
        return math.sqrt(max(self.claimed * (1 - self.claimed), 1e-12) / self.n)


def bins_of(p: FloatArray, wrong: NDArray[np.bool_], count: int = BINS) -> list[Bin]:
    """The occupied ones of `count` equally wide bins. `p` (N,) within 0..1, `wrong` (N,)."""
    index = np.minimum((p * count).astype(int), count - 1)
    return [
        Bin(k / count, (k + 1) / count, int(here.sum()), float(p[here].mean()), float(wrong[here].mean()))
        for k in range(count)
        if (here := index == k).any()
    ]


def expected_calibration_error(p: FloatArray, wrong: NDArray[np.bool_], count: int = BINS) -> float | None:
    """Mean distance of claim and truth over the bins, weighted by their answers; None without answers."""
    if not len(p):
        return None
    return sum(b.n * abs(b.claimed - b.wrong) for b in bins_of(p, wrong, count)) / len(p)


def excess_sigmas(p: FloatArray, wrong: NDArray[np.bool_]) -> float:
    """Wrong answers beyond the claimed number, in standard deviations of chance: > 0 over-confident, < 0 too timid."""
    return float((wrong - p).sum() / math.sqrt(max(float((p * (1 - p)).sum()), 1e-9))) if len(p) else 0.0


def separation(p: FloatArray, wrong: NDArray[np.bool_]) -> float | None:
    """Area under the receiver operating curve: the chance that a wrong answer claims a larger p than a right one.

    Ties count half (Mann & Whitney 1947). None where there are only right or only wrong answers.
    """
    n_wrong, n_right = int(wrong.sum()), int((~wrong).sum())
    if not n_wrong or not n_right:
        return None
    values, inverse, counts = np.unique(p, return_inverse=True, return_counts=True)
    ranks = (np.cumsum(counts) - (counts - 1) / 2)[inverse.reshape(-1)] if len(values) else np.zeros(0)
    return float((ranks[wrong].sum() - n_wrong * (n_wrong + 1) / 2) / (n_wrong * n_right))


def reliability(p: FloatArray, wrong: NDArray[np.bool_]) -> dict[str, Any]:
    """All figures of a set of claims; `honest` is whether neither the calibration error nor the excess is out of bounds."""
    error, excess = expected_calibration_error(p, wrong), excess_sigmas(p, wrong)
    return {
        "n": len(p),
        "n_wrong": int(wrong.sum()),
        "claimed_wrong": float(p.sum()),
        "expected_calibration_error": error,
        "excess_sigmas": excess,
        "separation": separation(p, wrong),
        "honest": error is not None and error <= MAX_CALIBRATION_ERROR and excess <= MAX_EXCESS_SIGMAS,
    }


def reliability_diagram(p: FloatArray, wrong: NDArray[np.bool_]) -> str:
    """SVG: the share of wrong answers over the claim by bin, with what chance allows, and below how many answers each bin has."""
    width, left, right, top, bottom, foot = 640.0, 76.0, 620.0, 16.0, 380.0, 500.0
    x, y = Scale(0, 1, left, right), Scale(0, 1, bottom, top)
    parts = x_axis(x, top, bottom, "claimed probability of being wrong", 10)
    parts += [*y_axis(y, left, right, "share that is wrong", ticks(0, 1, 5)), line(x(0), y(0), x(1), y(1), "limit")]
    found = bins_of(p, wrong)
    for b in found:
        low, high = max(0.0, b.claimed - 2 * b.sigma), min(1.0, b.claimed + 2 * b.sigma)
        parts.append(line(x(b.claimed), y(low), x(b.claimed), y(high), "level"))
        parts.append(circle(x(b.claimed), y(b.wrong), 5.5, "mark"))
    parts += _counts(found, x, foot)
    return figure(width, foot + 30, parts, "Reliability diagram: share of wrong answers over the claimed probability", "half")


def _counts(found: Sequence[Bin], x: Scale, base: float) -> list[str]:
    most = max((b.n for b in found), default=1)
    parts = []
    for b in found:
        height = max(1.5, 46 * math.log1p(b.n) / math.log1p(most))
        parts.append(rect(x(b.low) + 2, base - height, x(b.high) - x(b.low) - 4, height, "bar", f"{b.n} answers"))
        parts.append(text((x(b.low) + x(b.high)) / 2, base + 18, str(b.n)))
    return parts
