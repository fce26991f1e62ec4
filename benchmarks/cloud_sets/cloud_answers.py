"""What a registration method answers to a case, and how far off it is."""

from __future__ import annotations

import time
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from benchmarks.cloud_sets.cloud_cases import CloudCase
from visloc_companion.evaluate.protection import CHI2_95
from visloc_companion.localise.registration.base import Registered, RegistrationMethod
from visloc_companion.localise.registration.clouds import density_per_m2

Array = NDArray[np.float64]
WRONG_M, FAR_M = 5.0, 10.0


@dataclass(frozen=True, slots=True, eq=False)
class CloudAnswer:
    """`probability_wrong` 1 and errors infinite where there is no answer; `error_m` (3,) of the source's mean point.

    `covered`: share of the source whose right place is on the reference.
    """

    case: str
    cloud: str
    cover: str
    scenario: str
    level: str
    covered: float
    reason: str
    probability_wrong: float
    mtre_m: float
    error_m: Array
    covariance_m2: Array
    evidence: dict[str, float]
    cpu_s: float

    @property
    def horizontal_m(self) -> float:
        """Horizontal distance of the source's mean point from where it belongs."""
        return float(np.hypot(self.error_m[0], self.error_m[1]))

    @property
    def wrong(self) -> bool:
        """Off by more than 5 m horizontally, as `probability_wrong` means it."""
        return self.horizontal_m > WRONG_M

    @property
    def inside(self) -> bool:
        """Whether the horizontal error is within the claimed 95 % ellipse."""
        off_m, claimed_m2 = self.error_m[:2], self.covariance_m2[:2, :2]
        return float(off_m @ np.linalg.solve(claimed_m2, off_m)) <= CHI2_95


def answers(method: RegistrationMethod, cases: Iterable[CloudCase]) -> list[CloudAnswer]:
    """Of all cases, in order."""
    return [answer_of(method, case) for case in cases]


def answer_of(method: RegistrationMethod, case: CloudCase) -> CloudAnswer:
    """The answer to one case and its errors; CPU time of this process."""
    begun = time.process_time()
    found = method(case.source_m, case.reference_m, case.prior)
    spent = time.process_time() - begun
    labels = (case.name, case.cloud, case.cover, case.scenario, case.level, covered(case))
    if not isinstance(found, Registered):
        nowhere = np.full(3, np.inf)
        return CloudAnswer(*labels, str(found.reason), 1.0, np.inf, nowhere, np.eye(3), dict(found.evidence), spent)
    off = _moved(found.T_reference_source, case.source_m) - _moved(case.T_true, case.source_m)
    mtre = float(np.linalg.norm(off, axis=1).mean())
    return CloudAnswer(*labels, "", found.probability_wrong, mtre, off.mean(0), found.covariance_m2, dict(found.evidence), spent)


def covered(case: CloudCase) -> float:
    """Share of the source's points that the truth puts on cells that hold points of the reference; 0 where there is no truth.

    Cells are so large that four points of the reference are expected in each: stray returns off water cover few.
    """
    if case.T_true is None:
        return 0.0
    source, reference = _moved(case.T_true, case.source_m), case.reference_m
    side = 2 / np.sqrt(density_per_m2(reference))
    low, high = source[:, :2].min(0) - side, source[:, :2].max(0) + side
    near = reference[((reference[:, :2] >= low) & (reference[:, :2] <= high)).all(1)]
    cells = (np.floor(p[:, :2] / side).astype(np.int64) @ np.array([1 << 32, 1]) for p in (source, near))
    return float(np.isin(*cells).mean())


def _moved(T: Array | None, points_m: Array) -> Array:
    if T is None:
        return np.full(points_m.shape, np.inf)
    return np.asarray(points_m @ T[:3, :3].T + T[:3, 3], dtype=np.float64)
