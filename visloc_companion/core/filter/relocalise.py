"""When rejected fixes agree with each other, the filter is what is wrong: from which of them it starts again, and how fast.

Candidates are carried along by the velocity input, so that those of one truth coincide. Two kinds of agreement: the last n all
coincide pairwise; or, when the velocity input itself is false (a spoofed GNSS drags it), the last n + 2 lie on a line in time,
whose slope is the velocity's error. Fixes that stand still while the velocity input moves are no such line: that is what a
frozen camera looks like.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from visloc_companion.core.settings import NavigatorSettings
from visloc_companion.types import Cov2, FloatArray, Vec2

SPAN_S = 30.0
MEMORY = 12
MAX_VELOCITY_ERROR_MPS = 40.0
MIN_LINE_SPAN_S = 1.0
STANDING_MPS = 2.0
"""What is seen to move no faster stands, or comes from a frozen camera."""
LINE_SIGMA_MPS = 2.0


@dataclass(frozen=True, slots=True)
class Candidate:
    """A rejected fix of a method: `anchor_ne_m` is its position minus the travel by the velocity input until then."""

    t_ns: int
    p_ne_m: Vec2
    anchor_ne_m: Vec2
    cov_ne_m2: Cov2
    method: str = ""


@dataclass(frozen=True, slots=True)
class Restart:
    """Start again from the last candidate, with this error of the velocity input (input minus truth) and its 1-sigma."""

    velocity_error_ne_mps: Vec2
    sigma_mps: float


def remembered(rejected: tuple[Candidate, ...], new: Candidate) -> tuple[Candidate, ...]:
    """The candidates with a new one, without what is too old."""
    return (*(c for c in rejected if new.t_ns - c.t_ns <= SPAN_S * 1e9), new)[-MEMORY:]


def restart(rejected: tuple[Candidate, ...], sigma_v_mps: float, settings: NavigatorSettings) -> Restart | None:
    """Whether the last candidates agree, and how."""
    n = settings.relocalise_after_rejections
    sigma_v = max(sigma_v_mps, settings.velocity_sigma_aiding_mps)
    last = rejected[-n:]
    if len(last) == n and all(coincide(a, b, sigma_v, settings.gate_sigma) for a, b in combinations(last, 2)):
        return Restart((0.0, 0.0), 0.0)
    line = rejected[-(n + 2) :]
    return _on_a_line(line, settings.gate_sigma) if len(line) == n + 2 and not standing(line) else None


def standing(rejected: Sequence[Candidate]) -> bool:
    """Whether the fixes stand still while the velocity input does not."""
    first, last = rejected[0], rejected[-1]
    reach_m = STANDING_MPS * (last.t_ns - first.t_ns) * 1e-9
    noise_m = 2 * math.sqrt(last.cov_ne_m2[0][0] + last.cov_ne_m2[1][1])
    return math.dist(first.p_ne_m, last.p_ne_m) <= reach_m + noise_m and math.dist(first.anchor_ne_m, last.anchor_ne_m) > reach_m


def coincide(a: Candidate, b: Candidate, sigma_v_mps: float, gate_sigma: float) -> bool:
    """Whether two name one place, as far as the velocity input, of this 1-sigma, can have carried them apart."""
    growth = (sigma_v_mps * (b.t_ns - a.t_ns) * 1e-9) ** 2
    S = np.array(a.cov_ne_m2) + np.array(b.cov_ne_m2) + growth * np.eye(2)
    d = np.array(b.anchor_ne_m) - np.array(a.anchor_ne_m)
    return float(d @ np.linalg.solve(S, d)) <= gate_sigma**2


def _on_a_line(line: Sequence[Candidate], gate_sigma: float) -> Restart | None:
    """Least squares of anchor = a + w t; every candidate must lie within the gate about it."""
    t = np.array([(c.t_ns - line[-1].t_ns) * 1e-9 for c in line])
    if -float(t[0]) < MIN_LINE_SPAN_S:
        return None
    design: FloatArray = np.column_stack([np.ones(len(t)), t])
    anchors = np.array([c.anchor_ne_m for c in line])
    fitted = np.linalg.lstsq(design, anchors, rcond=None)[0]
    residuals = anchors - design @ fitted
    nis = [float(r @ np.linalg.solve(np.array(c.cov_ne_m2), r)) for r, c in zip(residuals, line, strict=True)]
    slope = (float(fitted[1, 0]), float(fitted[1, 1]))
    if max(nis) > gate_sigma**2 or math.hypot(*slope) > MAX_VELOCITY_ERROR_MPS:
        return None
    return Restart((-slope[0], -slope[1]), LINE_SIGMA_MPS)
