"""Whether the truth of image cases can be theirs: on which side of the earth it lies of the priors."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from visloc_companion.errors import CasesError
from visloc_companion.evaluate.cases import BadCase, Case, Truth
from visloc_companion.evaluate.right_place import FAR_M, SWAPPED_M, Area, least_distance_m
from visloc_companion.types import GeoPoint

EXCHANGED = "latitude and longitude are exchanged", "write them in their own columns"
ELSEWHERE = "it is the truth of another place", "check signs (south and west are negative), degrees and ids"


class _Far(NamedTuple):
    case_id: str
    off_m: float
    what: str
    remedy: str


def far_truths(cases: Sequence[Case | BadCase], truth: Mapping[str, Truth], path: Path) -> list[str]:
    """A sentence on the truths that no search about their priors reaches, while others lie near theirs: it may be the prior that
    is elsewhere, and only the summary rests on a truth.

    Cases without a right answer may have theirs elsewhere. Raises CasesError where all are out of reach: right fixes would count
    as wrong and accepted.
    """
    told = [
        (case, truth[case.case_id])
        for case in cases
        if isinstance(case, Case) and case.case_id in truth and truth[case.case_id].solvable
    ]
    far = [one for case, true in told if (one := _far(case.case_id, case.prior.place, true)) is not None]
    if not far:
        return []
    first = far[0]
    where = f"{path}, id {first.case_id}"
    what = f"{first.what}: it lies {first.off_m / 1000:.0f} km from its prior"
    if len(far) == len(told):
        raise CasesError(what, where=where, remedy=first.remedy)
    more = f" ({len(far) - 1} more do so)" if len(far) > 1 else ""
    return [f"{where}: {what}{more}; a fix near the prior counts as wrong; remedy: {first.remedy}, and look at the prior"]


def _far(case_id: str, prior: GeoPoint, true: Truth) -> _Far | None:
    """None where a search about the prior may reach the truth."""
    about = Area("its prior", prior.lat_deg, prior.lon_deg, prior.lat_deg, prior.lon_deg)
    place = np.array([[true.lat_deg, true.lon_deg]])
    off_m = least_distance_m(about, place)
    if off_m > SWAPPED_M and least_distance_m(about, place[:, ::-1]) <= SWAPPED_M:
        return _Far(case_id, off_m, *EXCHANGED)
    return _Far(case_id, off_m, *ELSEWHERE) if off_m > FAR_M else None
