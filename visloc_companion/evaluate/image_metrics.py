"""Figures of merit of an image evaluation. Only this module knows the truth."""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from visloc_companion.errors import Reason
from visloc_companion.evaluate.cases import Truth
from visloc_companion.geo.se3 import euler_from_quat, wrap_pi
from visloc_companion.geo.wgs84 import ned_from_geo
from visloc_companion.types import Fix, FloatArray, GeoPoint

WRONG_PX = 5.0


@dataclass(frozen=True, slots=True)
class CaseResult:
    """What came out of one case: a fix, or why there is none. `map_gsd_m` is 0 where the map could not be read."""

    case_id: str
    fix: Fix | None
    reason: Reason | None
    detail: str = ""
    elapsed_ms: float = 0.0
    evidence: dict[str, float] = field(default_factory=dict)
    map_gsd_m: float = 0.0


@dataclass(frozen=True, slots=True)
class CaseError:
    """Errors of one fix: metres north and east, height (also per cent of that above ground), heading, and over the sigmas."""

    north_m: float
    east_m: float
    gsd_m: float
    h_m: float
    h_percent: float
    yaw_deg: float
    sigmas: tuple[float, float, float]
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


def case_error(result: CaseResult, truth: Truth) -> CaseError | None:
    """Errors of a case, None where there is no fix."""
    fix = result.fix
    if fix is None:
        return None
    north, east, _ = ned_from_geo(fix.place, GeoPoint(truth.lat_deg, truth.lon_deg, truth.h_m))
    up = fix.place.h_amsl_m - truth.h_m
    yaw = wrap_pi(euler_from_quat(fix.q_ned_frd)[2] - math.radians(truth.yaw_deg))
    sigmas = tuple(math.sqrt(max(v, 1e-12)) for v in (fix.cov_ne_m2[0][0], fix.cov_ne_m2[1][1]))
    return CaseError(
        north,
        east,
        truth.gsd_m or result.map_gsd_m or 1.0,
        up,
        100 * up / (result.evidence.get("agl_m") or truth.h_m or 1.0),
        math.degrees(yaw),
        (north / sigmas[0], east / sigmas[1], up / max(fix.sigma_h_m, 1e-6)),
        truth.solvable,
    )


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
    px = np.array([e.horizontal_px for e in errors if e.solvable])
    metres = np.array([e.horizontal_m for e in errors if e.solvable])
    sigmas = np.array([e.sigmas for e in right]).reshape(-1, 3)
    return {
        "n_with_truth": len(judged),
        "n_solvable": solvable,
        "within_5px_share": _share(int((px < WRONG_PX).sum()), solvable),
        "within_2px_share": _share(int((px < 2.0).sum()), solvable),
        "wrong_and_accepted": sum(e.wrong for e in errors),
        "error_m": _spread(metres),
        "error_px": _spread(px),
        "rms_error_over_sigma": {axis: _rms(sigmas[:, k]) for k, axis in enumerate(("north", "east", "height"))},
        "altitude_error_m": _spread(np.array([abs(e.h_m) for e in right])),
        "altitude_error_percent": _spread(np.array([abs(e.h_percent) for e in right])),
        "heading_error_deg": _spread(np.array([abs(e.yaw_deg) for e in right])),
    }


def _share(part: int, whole: int) -> float | None:
    return part / whole if whole else None


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
