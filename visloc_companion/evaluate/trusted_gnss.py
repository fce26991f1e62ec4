"""What a replay's verdicts of GNSS rest on: where the receiver lay of the truth while it counted as OK (far off, one of the two
is not of this flight), and how often a log tells of it."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from visloc_companion.config import LEAST_REPORTS
from visloc_companion.evaluate.record import FlightRecord
from visloc_companion.types import Event, Gnss, Verdict

_FAR_M = 100.0
"""More than receivers err by that claim a fix, less than grids of another datum and shifted maps lie apart."""

_OFTEN = 0.1
"""Share of the gaps between reports."""


def far_from_truth_noted(record: FlightRecord) -> list[str]:
    """A sentence where the first receiver lay far from the truth, horizontally, at half or more of the epochs at which GNSS
    counted as OK; none where either is unknown."""
    trusted_s = record.t_s[record.while_verdict(Verdict.OK)]
    apart_m = np.hypot(*(record.gnss.at(trusted_s) - record.truth.at(trusted_s))[:, :2].T)
    known_m = apart_m[np.isfinite(apart_m)]
    if not len(known_m) or (median_m := float(np.median(known_m))) <= _FAR_M:
        return []
    return [
        f"WARNING: while GNSS counted as OK, the receiver lay {median_m:.0f} m from the truth (median): either GNSS was false "
        "and nothing contradicted it, or the truth is of another flight, datum or time base, and errors and HMI mean nothing."
    ]


def rare_reports_noted(events: Sequence[tuple[int, Event]], silence_s: float) -> list[str]:
    """A sentence where a log tells of the first receiver so rarely that it counts as silent again and again; none where it was
    silent a few times. `events` with their times of arrival (ns), `silence_s` is gnss.silence_s."""
    at_ns = [event.t_rx_ns for _, event in events if isinstance(event, Gnss) and event.receiver == 0]
    gaps_s = np.diff(np.array(at_ns, dtype=np.float64) * 1e-9)
    if not len(gaps_s) or np.mean(gaps_s > silence_s) < _OFTEN:
        return []
    apart_s = float(np.median(gaps_s))
    enough_s = math.ceil((LEAST_REPORTS + 1) * apart_s)
    return [
        f"WARNING: the log tells of GNSS every {apart_s:.1f} s (median), and {silence_s:g} s without a word are a lost GNSS "
        f"(gnss.silence_s): the verdicts are those of a slow log. Replay it with gnss.silence_s = {enough_s} in --config."
    ]
