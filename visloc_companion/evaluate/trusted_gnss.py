"""Where the receiver lay of the truth while GNSS counted as OK: far off, one of the two is not of this flight."""

from __future__ import annotations

import numpy as np

from visloc_companion.evaluate.record import FlightRecord
from visloc_companion.types import Verdict

_FAR_M = 100.0
"""More than receivers err by that claim a fix, less than grids of another datum and shifted maps lie apart."""


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
