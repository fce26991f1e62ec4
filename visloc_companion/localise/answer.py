"""Fix and NoFix from local results."""

from __future__ import annotations

import math
import time
from dataclasses import replace

import numpy as np

from visloc_companion.errors import Reason
from visloc_companion.geo.camera import R_FRD_CAM
from visloc_companion.geo.se3 import quat_from_R
from visloc_companion.localise.ortho_rectify import CameraPose
from visloc_companion.localise.plan import SearchPlan, above_ground_m
from visloc_companion.protocols import ReferenceMap
from visloc_companion.types import Fix, FloatArray, GeoPoint, LocaliseRequest, NoFix


class Stopwatch:
    """Time of the whole localisation, and of the part that only prepares the map."""

    def __init__(self) -> None:
        self._start_s = time.perf_counter()
        self._map_s = 0.0
        self._map_start_s = 0.0

    def __enter__(self) -> Stopwatch:
        """Start of work on the map's side."""
        self._map_start_s = time.perf_counter()
        return self

    def __exit__(self, *_: object) -> None:
        """End of work on the map's side."""
        self._map_s += time.perf_counter() - self._map_start_s

    def add_map_ms(self, ms: float) -> None:
        """Count what another one's watch told of the map's side."""
        self._map_s += 1e-3 * ms

    @property
    def elapsed_ms(self) -> float:
        """Milliseconds since construction, all included."""
        return 1e3 * (time.perf_counter() - self._start_s)

    @property
    def map_ms(self) -> float:
        """Milliseconds spent on the map's side: reading the window and computing its features."""
        return 1e3 * self._map_s


def no_fix(
    request: LocaliseRequest, method: str, watch: Stopwatch, why: tuple[Reason, str], evidence: dict[str, float] | None = None
) -> NoFix:
    """A typed refusal, with how long it took."""
    return replace(refused(request, method, *why, watch.elapsed_ms), evidence=_evidence(evidence, watch))


def refused(request: LocaliseRequest, method: str, reason: Reason, detail: str, elapsed_ms: float = 0.0) -> NoFix:
    """A typed refusal."""
    frame = request.frame
    return NoFix(frame.t_rx_ns, frame.t_ns, request.request_id, frame.frame_id, method, reason, elapsed_ms, detail)


def fix(
    request: LocaliseRequest,
    method: str,
    watch: Stopwatch,
    plan: SearchPlan,
    ref: ReferenceMap,
    pose: CameraPose,
    covariance: FloatArray,
    probability_wrong: float,
    map_sigma_m: float,
    evidence: dict[str, float],
) -> Fix:
    """A fix from a pose in the plan's frame and its covariance (6, 6) of north, east, up, rotation about n, e, d."""
    lat, lon = ref.to_geo(*plan.frame.to_map(pose.p_ned_m[:2]))
    cov = covariance[:2, :2] + np.eye(2) * map_sigma_m**2
    with watch:
        over_ground_m = above_ground_m(plan, pose, ref)
    frame = request.frame
    return Fix(
        t_rx_ns=frame.t_rx_ns,
        t_ns=frame.t_ns,
        request_id=request.request_id,
        frame_id=frame.frame_id,
        method=method,
        place=GeoPoint(float(lat), float(lon), -float(pose.p_ned_m[2])),
        q_ned_frd=quat_from_R(pose.R_ned_cam @ R_FRD_CAM.T),
        cov_ne_m2=((float(cov[0, 0]), float(cov[0, 1])), (float(cov[0, 1]), float(cov[1, 1]))),
        sigma_h_m=math.sqrt(float(covariance[2, 2])),
        sigma_yaw_rad=math.sqrt(float(covariance[5, 5])),
        probability_wrong=probability_wrong,
        elapsed_ms=watch.elapsed_ms,
        evidence=_evidence(evidence, watch),
        above_ground_m=over_ground_m,
        footprint_m=math.sqrt(plan.area_m2),
    )


def _evidence(values: dict[str, float] | None, watch: Stopwatch) -> tuple[tuple[str, float], ...]:
    return tuple((k, float(v)) for k, v in {**(values or {}), "map_ms": watch.map_ms}.items() if math.isfinite(v))
