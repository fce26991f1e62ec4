"""Whether the truth of image cases can be theirs: on which side of the earth it lies of the priors."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from visloc_companion.errors import CasesError
from visloc_companion.evaluate.cases import BadCase, Case, Truth
from visloc_companion.evaluate.right_place import FAR_M, SWAPPED_M, Area, least_distance_m


def require_truth_near(cases: Sequence[Case | BadCase], truth: Mapping[str, Truth], path: Path) -> None:
    """Raises CasesError for a truth that no search about its prior reaches: right fixes would count as wrong and accepted.

    Cases without a right answer may have theirs elsewhere.
    """
    for case in cases:
        told = truth.get(case.case_id)
        if isinstance(case, BadCase) or told is None or not told.solvable:
            continue
        prior = case.prior.place
        about = Area("its prior", prior.lat_deg, prior.lon_deg, prior.lat_deg, prior.lon_deg)
        place = np.array([[told.lat_deg, told.lon_deg]])
        off_m = least_distance_m(about, place)
        if off_m > SWAPPED_M and least_distance_m(about, place[:, ::-1]) <= SWAPPED_M:
            what, remedy = "latitude and longitude are exchanged", "write them in their own columns"
        elif off_m > FAR_M:
            what, remedy = "it is the truth of another place", "check signs (south and west are negative), degrees and ids"
        else:
            continue
        raise CasesError(
            f"{what}: it lies {off_m / 1000:.0f} km from its prior", where=f"{path}, id {case.case_id}", remedy=remedy
        )
