"""Of what time a height is that soundings of a whole stretch tell, and how far the navigation height walks to and from there."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from visloc_companion.types import FloatArray


class Walked(NamedTuple):
    """`age_s`: mean age of the soundings by what each adds to the height. A height that walks (random walk of 1 m/sqrt(s)) has a
    mean over the soundings which differs from its value then by a variance of `then_m2`, from its value at age 0 by `now_m2`."""

    age_s: float
    then_m2: float
    now_m2: float


def walked(weight: FloatArray, age_s: FloatArray) -> Walked:
    """Of (N,) weights and ages, seconds: integrals over time of the squared share of the soundings on the far side of it. Where
    none has any weight, all have the same. Where some weigh against the others, their mean may be of a time to come, or of one
    before the first of them: then it is of now, or of the first, the last and the first that they tell."""
    total = float(weight.sum())
    shares = weight / total if abs(total) > 0 else np.full(len(weight), 1 / len(weight))
    order = np.argsort(age_s)
    share, age = shares[order], age_s[order]
    mean = min(max(float(share @ age), 0.0), float(age[-1]))
    edges = np.concatenate([[0.0], age])
    older = 1 - np.concatenate([[0.0], np.cumsum(share)])[:-1]  # between each age and the one before, by what lies beyond
    spans = np.diff(edges)
    before = np.clip(mean - edges[:-1], 0, spans)  # of each span, the part that is nearer to now than `mean`
    then = float(np.square(older - 1) @ before + np.square(older) @ (spans - before))
    return Walked(mean, then, float(np.square(older) @ spans))
