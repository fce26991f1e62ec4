"""The benchmark of the vertical level: faults are flown, the level covers them, and one that believes every fix is smaller."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.height import FAR_M, KINDS, Flight, flown


@pytest.mark.parametrize("kind", KINDS)
def test_the_level_holds_and_is_more_than_blind_belief(kind: str) -> None:
    flight = Flight(kind)
    tally, blind = flown(flight, 3), flown(flight, 3, blind=True)
    figures = tally.figures(20.0)
    assert figures["misleading"] == figures["hmi"] == 0
    assert figures["epochs"] == 599
    assert np.median(blind.levels) < np.median(tally.levels)
    drifted = abs(tally.errors[-1] - tally.errors[150])
    assert (drifted > FAR_M / 2) == (kind in ("drift", "jump"))
