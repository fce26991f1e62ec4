"""Figures of merit of an image evaluation. Only this module knows the truth."""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from visloc_companion.errors import Reason
from visloc_companion.evaluate.cases import Truth
from visloc_companion.evaluate.protection import CHI2_95
from visloc_companion.evaluate.reliability import reliability
from visloc_companion.geo.se3 import R_from_quat, euler_from_quat, quat_from_euler, wrap_pi
from visloc_companion.geo.wgs84 import ned_from_geo
from visloc_companion.types import Fix, FloatArray, GeoPoint

WRONG_PX = 5.0
"""A fix that is off by as much is wrong; ..."""
FAR_PX = 10.0
"""... by more than this it is far off: what must not be accepted."""


@dataclass(frozen=True, slots=True)
class CaseResult:
    """What came out of one case: a fix, or why there is none. `map_gsd_m` is 0 where the map could not be read, `frame_px` (width
    and height) None where the frame could not be."""

    case_id: str
    fix: Fix | None
    reason: Reason | None
    detail: str = ""
    elapsed_ms: float = 0.0
    evidence: dict[str, float] = field(default_factory=dict)
    map_gsd_m: float = 0.0
    frame_px: tuple[int, int] | None = None


@dataclass(frozen=True, slots=True)
class CaseError:
    """Errors of one fix: metres north and east, height (also per cent of that above ground), heading, tilt (angle between the
    camera's true and found vertical axes), over the sigmas, and `chi2` of the horizontal error under the claimed covariance.

    Those of height and angles are NaN where the truth does not know them.
    """

    north_m: float
    east_m: float
    gsd_m: float
    h_m: float
    h_percent: float
    yaw_deg: float
    tilt_deg: float
    sigmas: tuple[float, float, float]
    chi2: float
    solvable: bool

    @property
    def horizontal_m(self) -> float:
        """Distance, metres."""
        return math.hypot(self.north_m, self.east_m)

    @property
    def horizontal_px(self) -> float:
        """Distance, map pixels."""
        return self.horizontal_m / self.gsd_m

    @property
    def wrong(self) -> bool:
        """Whether the fix is another place."""
        return not self.solvable or self.horizontal_px >= WRONG_PX

    @property
    def far(self) -> bool:
        """Whether the fix is far off."""
        return not self.solvable or self.horizontal_px > FAR_PX


def case_error(result: CaseResult, truth: Truth) -> CaseError | None:
    """Errors of a case, None where there is no fix."""
    fix = result.fix
    if fix is None:
        return None
    north, east, _ = ned_from_geo(fix.place, GeoPoint(truth.lat_deg, truth.lon_deg, fix.place.h_amsl_m))
    up = fix.place.h_amsl_m - truth.h_m
    yaw = wrap_pi(euler_from_quat(fix.q_ned_frd)[2] - math.radians(truth.yaw_deg))
    sigmas = tuple(math.sqrt(max(v, 1e-12)) for v in (fix.cov_ne_m2[0][0], fix.cov_ne_m2[1][1]))
    off, covariance = np.array([north, east]), np.array(fix.cov_ne_m2) + 1e-12 * np.eye(2)
    return CaseError(
        north_m=north,
        east_m=east,
        gsd_m=truth.gsd_m or result.map_gsd_m or 1.0,
        h_m=up,
        h_percent=100 * up / (result.evidence.get("agl_m") or truth.h_m or 1.0),
        yaw_deg=math.degrees(yaw),
        tilt_deg=tilt_between_deg(fix, truth),
        sigmas=(north / sigmas[0], east / sigmas[1], up / max(fix.sigma_h_m, 1e-6)),
        chi2=float(off @ np.linalg.solve(covariance, off)),
        solvable=truth.solvable,
    )


def tilt_between_deg(fix: Fix, truth: Truth) -> float:
    """Angle between where the body's down axis points by the fix and by the truth, both turned to north: without the heading.

    NaN where the truth does not know it.
    """
    if math.isnan(truth.roll_deg) or math.isnan(truth.pitch_deg):
        return math.nan
    down = []
    for roll, pitch in (euler_from_quat(fix.q_ned_frd)[:2], (math.radians(truth.roll_deg), math.radians(truth.pitch_deg))):
        down.append(R_from_quat(quat_from_euler(roll, pitch, 0.0))[:, 2])
    return math.degrees(math.acos(float(np.clip(down[0] @ down[1], -1, 1))))


def accepted(results: list[CaseResult], max_probability_wrong: float) -> list[CaseResult]:
    """The same results with a stricter limit: fixes that claim a larger probability of being wrong become refusals."""
    return [
        replace(r, fix=None, reason=Reason.NO_MATCH)
        if r.fix is not None and r.fix.probability_wrong > max_probability_wrong
        else r
        for r in results
    ]


def claims(judged: list[tuple[CaseResult, Truth]]) -> tuple[FloatArray, NDArray[np.bool_]]:
    """Claimed probability of being wrong (N,) of every fix, and whether it is (N,)."""
    pairs = [(r.fix.probability_wrong, e.wrong) for r, t in judged if r.fix is not None and (e := case_error(r, t)) is not None]
    return np.array([p for p, _ in pairs], dtype=np.float64), np.array([w for _, w in pairs], dtype=np.bool_)


def summarise(results: list[CaseResult], truth: dict[str, Truth]) -> dict[str, Any]:
    """Counts, times and, where truths are known, errors. Finite numbers only; a figure without data is null."""
    fixes = [r for r in results if r.fix is not None]
    elapsed = np.array([r.elapsed_ms for r in results if r.elapsed_ms > 0])
    map_side = np.array([r.evidence["map_ms"] for r in results if "map_ms" in r.evidence])
    summary: dict[str, Any] = {
        "n": len(results),
        "n_fix": len(fixes),
        "fix_share": _share(len(fixes), len(results)),
        "reasons": dict(sorted(Counter(str(r.reason) for r in results if r.reason is not None).items())),
        "elapsed_ms": _spread(elapsed),
        "map_side_ms": _spread(map_side),
    }
    judged = [(r, truth[r.case_id]) for r in results if r.case_id in truth]
    if judged:
        summary |= _against_truth(judged)
    return summary


def _against_truth(judged: list[tuple[CaseResult, Truth]]) -> dict[str, Any]:
    errors = [e for e in (case_error(r, t) for r, t in judged) if e is not None]
    solvable = sum(t.solvable for _, t in judged)
    right = [e for e in errors if not e.wrong]
    near = [e for e in errors if not e.far]
    px = np.array([e.horizontal_px for e in errors if e.solvable])
    metres = np.array([e.horizontal_m for e in errors if e.solvable])
    return {
        "n_with_truth": len(judged),
        "n_solvable": solvable,
        "within_5px_share": _share(int((px < WRONG_PX).sum()), solvable),
        "within_2px_share": _share(int((px < 2.0).sum()), solvable),
        "within_15px_share": _share(int((px < 15.0).sum()), solvable),
        "wrong_and_accepted": sum(e.wrong for e in errors),
        "far_and_accepted": sum(e.far for e in errors),
        "accepted_of_solvable_share": _share(sum(e.solvable for e in errors), solvable),
        "refused_of_unsolvable_share": _share(
            len(judged) - solvable - sum(not e.solvable for e in errors), len(judged) - solvable
        ),
        "error_m": _spread(metres),
        "error_px": _spread(px),
        "rms_error_over_sigma": {
            axis: _rms(_known([e.sigmas[k] for e in near])) for k, axis in enumerate(("north", "east", "height"))
        },
        "inside_95_ellipse_share": _share(sum(e.chi2 <= CHI2_95 for e in near), len(near)),
        "altitude_error_m": _spread(_known([abs(e.h_m) for e in right])),
        "altitude_error_percent": _spread(_known([abs(e.h_percent) for e in right])),
        "heading_error_deg": _spread(_known([abs(e.yaw_deg) for e in right])),
        "tilt_error_deg": _spread(_known([e.tilt_deg for e in right])),
        "reliability": reliability(*claims(judged)),
    }


def _share(part: int, whole: int) -> float | None:
    return part / whole if whole else None


def _known(values: list[float]) -> FloatArray:
    """Those of the values that the truth was known for."""
    return np.array([value for value in values if not math.isnan(value)])


def _rms(values: FloatArray) -> float | None:
    return float(np.sqrt(np.mean(values**2))) if values.size else None


def _spread(values: FloatArray) -> dict[str, float] | None:
    if not values.size:
        return None
    return {
        "mean": float(values.mean()),
        "median": float(np.median(values)),
        "p95": float(np.percentile(values, 95)),
        "max": float(values.max()),
    }
