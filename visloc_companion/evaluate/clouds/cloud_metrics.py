"""Figures of merit of a cloud evaluation. Only this module knows the truth.

MTRE is the mean distance of the source's points under the found and under the true transform (Sabel et al. 2022); the errors
east, north and up are those of the source's middle, whose covariance the method claims.
"""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from visloc_companion.errors import Reason
from visloc_companion.evaluate.protection import CHI2_95
from visloc_companion.evaluate.reliability import reliability
from visloc_companion.localise.registration.base import Registered
from visloc_companion.localise.registration.clouds import middle_m
from visloc_companion.types import FloatArray

WRONG_M = 5.0
"""An answer that is off by more, horizontally, is wrong: what `probability_wrong` is the probability of; ..."""
FAR_M = 10.0
"""... by more than this (MTRE) it is far off: what must not be accepted."""
AXES = ("east", "north", "up")
_NUMBERING = re.compile(r"(_[A-Z])?_?\d*$")


@dataclass(frozen=True, slots=True, eq=False)
class CloudError3d:
    """Errors of one answer: MTRE, the source's middle east, north, up (3,), metres and over the sigmas, heading and scale."""

    mtre_m: float
    off_m: FloatArray
    sigmas: FloatArray
    chi2: float
    yaw_deg: float
    scale: float

    @property
    def horizontal_m(self) -> float:
        """Distance of the source's middle, metres."""
        return math.hypot(self.off_m[0], self.off_m[1])

    @property
    def wrong(self) -> bool:
        """Whether the answer is another place."""
        return self.horizontal_m > WRONG_M

    @property
    def far(self) -> bool:
        """Whether the answer is far off."""
        return self.mtre_m > FAR_M


@dataclass(frozen=True, slots=True, eq=False)
class CloudResult:
    """What came out of one case: the method's answer (None where it declined), the reason why it is refused (None where it is a
    fix), and its errors where both answer and truth are known."""

    case_id: str
    answer: Registered | None
    reason: Reason | None
    detail: str = ""
    elapsed_ms: float = 0.0
    evidence: tuple[tuple[str, float], ...] = ()
    error: CloudError3d | None = None
    has_truth: bool = False

    @property
    def fix(self) -> Registered | None:
        """The answer where it is accepted."""
        return self.answer if self.reason is None else None


def cloud_error(answer: Registered, T_true: FloatArray, source_m: FloatArray) -> CloudError3d:
    """Errors of an answer for the source's points (N, 3); (4, 4) `T_true` is T_reference_source."""
    apart = answer.T_reference_source - T_true
    mtre_m = float(np.linalg.norm(source_m @ apart[:3, :3].T + apart[:3, 3], axis=1).mean())
    off_m = apart[:3, :3] @ middle_m(source_m) + apart[:3, 3]
    covariance = answer.covariance_m2 + 1e-12 * np.eye(3)
    turn = answer.T_reference_source[:3, :3] @ T_true[:3, :3].T
    return CloudError3d(
        mtre_m=mtre_m,
        off_m=off_m,
        sigmas=off_m / np.sqrt(np.diag(covariance)),
        chi2=float(off_m[:2] @ np.linalg.solve(covariance[:2, :2], off_m[:2])),
        yaw_deg=math.degrees(math.atan2(turn[1, 0] - turn[0, 1], turn[0, 0] + turn[1, 1])),
        scale=float(np.cbrt(np.linalg.det(answer.T_reference_source[:3, :3]) / np.linalg.det(T_true[:3, :3]))) - 1,
    )


def place_of(case_id: str) -> str:
    """The cloud that a case was cut from: its id without scenario and number (`delft_ahn3_A_04`: `delft_ahn3`)."""
    return _NUMBERING.sub("", case_id) or case_id


def by_place(results: Sequence[CloudResult]) -> dict[str, list[CloudResult]]:
    """Results by the cloud they were cut from, in order of appearance."""
    groups: dict[str, list[CloudResult]] = {}
    for result in results:
        groups.setdefault(place_of(result.case_id), []).append(result)
    return groups


def summarise(results: Sequence[CloudResult]) -> dict[str, Any]:
    """Counts, times and, where truths are known, errors, in all and by place. Finite numbers only; without data null."""
    elapsed = np.array([r.elapsed_ms for r in results if r.elapsed_ms > 0])
    summary: dict[str, Any] = {
        "n": len(results),
        "n_fix": sum(r.fix is not None for r in results),
        "fix_share": _share(sum(r.fix is not None for r in results), len(results)),
        "reasons": dict(sorted(Counter(str(r.reason) for r in results if r.reason is not None).items())),
        "elapsed_ms": spread(elapsed),
    }
    if any(r.has_truth for r in results):
        judged = [r for r in results if r.has_truth]
        summary |= against_truth(judged)
        summary |= _claims(judged)
        summary["by_place"] = {name: against_truth(group) for name, group in by_place(judged).items()}
    return summary


def against_truth(judged: Sequence[CloudResult]) -> dict[str, Any]:
    """How far the fixes are off, and under `answers` the same for all answers, refused ones as well.

    Shares `within` are those of all cases: what has no answer is not within.
    """
    fixes = [r.error for r in judged if r.fix is not None and r.error is not None]
    answers = [r.error for r in judged if r.error is not None]
    return {
        "n_with_truth": len(judged),
        **_distances(fixes, len(judged)),
        "within_5m_of_fixes_share": _share(sum(e.mtre_m < WRONG_M for e in fixes), len(fixes)),
        "wrong_and_accepted": sum(e.wrong for e in fixes),
        "far_and_accepted": sum(e.far for e in fixes),
        "answers": _distances(answers, len(judged)),
    }


def _distances(errors: Sequence[CloudError3d], n_cases: int) -> dict[str, Any]:
    mtre = np.array([e.mtre_m for e in errors])
    horizontal = np.array([e.horizontal_m for e in errors])
    return {
        "n_answered": len(errors),
        "mtre_m": spread(mtre),
        "horizontal_m": spread(horizontal),
        "up_m": spread(np.array([abs(e.off_m[2]) for e in errors])),
        "within_5m_share": _share(int((mtre < 5.0).sum()), n_cases),
        "within_1m_share": _share(int((mtre < 1.0).sum()), n_cases),
        "within_5m_horizontal_share": _share(int((horizontal < 5.0).sum()), n_cases),
        "within_1m_horizontal_share": _share(int((horizontal < 1.0).sum()), n_cases),
    }


def _claims(judged: Sequence[CloudResult]) -> dict[str, Any]:
    """Whether covariance (of the fixes that are not far off) and probability (of all answers, accepted or not) are true."""
    errors = [r.error for r in judged if r.fix is not None and r.error is not None]
    near = [e for e in errors if not e.far]
    sigmas = np.array([e.sigmas for e in near]).reshape(-1, 3)
    answers = [(r.answer.probability_wrong, r.error) for r in judged if r.answer is not None and r.error is not None]
    p = np.array([claim for claim, _ in answers], dtype=np.float64)
    far = np.array([e.far for _, e in answers], dtype=np.bool_)
    wrong = np.array([e.wrong for _, e in answers], dtype=np.bool_)
    return {
        "rms_error_over_sigma": {axis: _rms(sigmas[:, k]) for k, axis in enumerate(AXES)},
        "inside_95_ellipse_share": _share(sum(e.chi2 <= CHI2_95 for e in near), len(near)),
        "heading_error_deg": spread(np.array([abs(e.yaw_deg) for e in near])),
        "scale_error_percent": spread(np.array([100 * abs(e.scale) for e in near])),
        "reliability": reliability(p, wrong),
        "separation_of_far": reliability(p, far)["separation"],
    }


def spread(values: FloatArray) -> dict[str, float] | None:
    """Mean, median, 95 % and maximum; None without values."""
    if not values.size:
        return None
    names = ("mean", "median", "p95", "max")
    figures = (values.mean(), np.median(values), np.percentile(values, 95), values.max())
    return {name: float(value) for name, value in zip(names, figures, strict=True)}


def _share(part: int, whole: int) -> float | None:
    return part / whole if whole else None


def _rms(values: FloatArray) -> float | None:
    return float(np.sqrt(np.mean(values**2))) if values.size else None
