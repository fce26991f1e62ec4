"""Run a localiser over a folder of image cases."""

from __future__ import annotations

import math
import os
import platform
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from dataclasses import replace
from functools import lru_cache
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from visloc_companion import __version__
from visloc_companion.errors import MapError, OutsideMap, Reason
from visloc_companion.evaluate.cases import BadCase, Case, read_cases, read_frame, read_truth
from visloc_companion.evaluate.image_metrics import CaseResult, summarise
from visloc_companion.geo.se3 import euler_from_quat
from visloc_companion.localise.features.onnx import NetworkFeatures
from visloc_companion.localise.registry import make_localiser, open_features_for
from visloc_companion.localise.runtime import NetworkChoice, default_threads
from visloc_companion.maps.raster import RasterMap
from visloc_companion.types import Fix, FrameRef, LocaliseRequest

POSE_FIELDS = (
    *("lat_deg", "lon_deg", "h_m", "roll_deg", "pitch_deg", "yaw_deg"),
    *("cov_ne_m2", "sigma_h_m", "protection_level_m", "probability_wrong"),
)
MAPS_AT_HAND = 6
NETWORKS_AT_HAND = 2
SHIPPED = NetworkChoice()
MAX_PROBABILITY_WRONG = 0.05
"""Fixes with a larger calibrated probability of being wrong become refusals."""
RAYLEIGH_1E5 = math.sqrt(-2 * math.log(1e-5))
"""4.80: radius, in sigmas of a circular Gaussian, that an error exceeds once in 100,000."""


def evaluate_image(
    folder: Path,
    method: str,
    jobs: int = 1,
    limit: int | None = None,
    progress: Callable[[int, int], None] | None = None,
    max_probability_wrong: float = MAX_PROBABILITY_WRONG,
    network: NetworkChoice = SHIPPED,
) -> tuple[dict[str, Any], list[CaseResult]]:
    """Localise all cases of a folder; the result as it is written to JSON, and case by case.

    Raises CasesError where the folder cannot be read, ConfigError for an unknown method, ModelError for a network that cannot be
    used. A case that cannot be read is a `no_fix` with its reason.
    """
    cases = read_cases(folder)[:limit]
    truth = read_truth(folder)
    about = environment(_features(method, network))  # first: what stands against the network is said before an hour of cases
    results = []
    for result in run_cases(cases, method, jobs, max_probability_wrong, network):
        results.append(result)
        if progress:
            progress(len(results), len(cases))
    document = {
        "schema": 1,
        "method": method,
        "environment": about,
        "cases": [as_json(result) for result in results],
        "summary": summarise(results, truth),
    }
    return document, results


def run_cases(
    cases: list[Case | BadCase],
    method: str,
    jobs: int,
    max_probability_wrong: float = MAX_PROBABILITY_WRONG,
    network: NetworkChoice = SHIPPED,
) -> Iterator[CaseResult]:
    """Results in the order of the cases, by so many processes; where one of them is killed, this process does the rest."""
    if jobs <= 1:
        cv2.setNumThreads(1)
        yield from (run_case(case, method, max_probability_wrong, network) for case in cases)
        return
    done = 0
    try:
        with ProcessPoolExecutor(jobs, mp_context=get_context("spawn"), initializer=cv2.setNumThreads, initargs=(1,)) as pool:
            alone = replace(network, threads=1)
            same = ([each] * len(cases) for each in (method, max_probability_wrong, alone))
            for result in pool.map(run_case, cases, *same, chunksize=4):
                done += 1
                yield result
    except BrokenProcessPool:
        yield from run_cases(cases[done:], method, 1, max_probability_wrong, network)


def run_case(
    case: Case | BadCase,
    method: str,
    max_probability_wrong: float = MAX_PROBABILITY_WRONG,
    network: NetworkChoice = SHIPPED,
) -> CaseResult:
    """Localise one case. Whatever is wrong with its files becomes a `no_fix`; a network is opened once for a process."""
    if isinstance(case, BadCase):
        return CaseResult(case.case_id, None, Reason.BAD_INPUT, case.why)
    pixels = read_frame(case.frame)
    if pixels is None:
        return CaseResult(case.case_id, None, Reason.BAD_FRAME, f"{case.frame}: not a readable image")
    model = case.camera.model(pixels)
    localiser = make_localiser(
        method,
        model,
        features=_features(method, network),
        max_probability_wrong=max_probability_wrong,
        threads=network.threads or default_threads(),
    )
    channels = 1 if pixels.ndim == 2 else 3
    frame = FrameRef(0, 0, 0, 0, model.width_px, model.height_px, channels)
    try:
        reference = _open_map(case.ortho, case.dsm)
        answer = localiser.localise(LocaliseRequest(0, frame, case.prior, 1), pixels, reference)
    except OutsideMap as why:
        return CaseResult(case.case_id, None, Reason.OUTSIDE_MAP, str(why))
    except MapError as why:
        return CaseResult(case.case_id, None, Reason.BAD_INPUT, str(why))
    evidence = dict(answer.evidence)
    elapsed_ms = answer.elapsed_ms - evidence.get("map_ms", 0.0)
    if isinstance(answer, Fix):
        return CaseResult(case.case_id, answer, None, "", elapsed_ms, evidence, reference.gsd_m)
    return CaseResult(case.case_id, None, answer.reason, answer.detail, elapsed_ms, evidence, reference.gsd_m)


def protection_level_m(fix: Fix) -> float:
    """Provisional bound of the horizontal error at a risk of 1e-5, from one vote alone.

    4.80 times the largest sigma of the claimed covariance (the map's own included): right if the match is right and its error
    Gaussian. It says nothing of wrong matches; `probability_wrong` does.
    """
    return RAYLEIGH_1E5 * math.sqrt(float(np.linalg.eigvalsh(np.array(fix.cov_ne_m2))[-1]))


def as_json(result: CaseResult) -> dict[str, Any]:
    """One case as evaluation.md section 3.1 wants it; what a `no_fix` does not have is null."""
    fix = result.fix
    if fix is None:
        numbers: dict[str, Any] = dict.fromkeys(POSE_FIELDS)
        reason = str(result.reason)
    else:
        reason = None
        roll, pitch, yaw = (math.degrees(a) for a in euler_from_quat(fix.q_ned_frd))
        numbers = {
            "lat_deg": fix.place.lat_deg,
            "lon_deg": fix.place.lon_deg,
            "h_m": fix.place.h_amsl_m,
            "roll_deg": roll,
            "pitch_deg": pitch,
            "yaw_deg": yaw % 360,
            "cov_ne_m2": [list(row) for row in fix.cov_ne_m2],
            "sigma_h_m": fix.sigma_h_m,
            "protection_level_m": protection_level_m(fix),
            "probability_wrong": fix.probability_wrong,
        }
    status = "no_fix" if fix is None else "fix"
    return {"id": result.case_id, "status": status, "reason": reason, **numbers, "elapsed_ms": result.elapsed_ms}


def environment(features: NetworkFeatures | None = None) -> dict[str, Any]:
    """What the figures depend on beside the data; the provider is what the network's session really got."""
    return {
        "visloc_companion": __version__,
        "python": platform.python_version(),
        "numpy": np.__version__,
        "opencv": cv2.__version__,
        "machine": platform.machine(),
        "cores": os.cpu_count() or 1,
        "provider": features.session.provider if features else "cpu",
        "network": features.session.about if features else None,
    }


@lru_cache(maxsize=NETWORKS_AT_HAND)
def _features(method: str, network: NetworkChoice) -> NetworkFeatures | None:
    return open_features_for(method, network)


@lru_cache(maxsize=MAPS_AT_HAND)
def _open_map(ortho: Path, dsm: Path | None) -> RasterMap:
    return RasterMap.open(ortho, dsm)
