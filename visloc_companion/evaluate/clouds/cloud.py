"""Run a registration method over a folder of cloud cases."""

from __future__ import annotations

import math
import os
import platform
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from importlib.metadata import PackageNotFoundError, version
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

from visloc_companion import __version__
from visloc_companion.errors import ConfigError, MapError, Reason, fault_text
from visloc_companion.evaluate.batch import run_all
from visloc_companion.evaluate.case_ids import require_truth_of
from visloc_companion.evaluate.clouds.cloud_cases import BadCloudCase, CloudCase, read_cloud_cases, read_cloud_truth
from visloc_companion.evaluate.clouds.cloud_metrics import CloudResult, cloud_error, summarise
from visloc_companion.evaluate.ended_in_order import BrokenOff, done_until_broken_off
from visloc_companion.evaluate.protection import horizontal_bound_m
from visloc_companion.localise.registration.base import NotRegistered
from visloc_companion.localise.registration.claims import doubted
from visloc_companion.localise.registration.clouds import without_strays
from visloc_companion.localise.registration.registry import DEFAULT_MAX_PROBABILITY_WRONG, make_registration
from visloc_companion.localise.registration.similarity import from_origin, near_origin_m
from visloc_companion.maps.cloud import LAS_SUFFIXES, read_cloud, require_same_crs
from visloc_companion.types import FloatArray

LIBRARIES = ("numpy", "scipy", "opencv-python-headless", "small-gicp", "open3d", "open3d-cpu", "laspy", "lazrs")
ANSWER_FIELDS = ("T_reference_source", "sigma_horizontal_m", "sigma_vertical_m", "protection_level_m", "probability_wrong")
Posed = tuple[CloudCase | BadCloudCase, FloatArray | None]
"""A case and its true T_reference_source (4, 4), where that is known."""


def evaluate_cloud(
    folder: Path,
    method: str,
    jobs: int = 1,
    limit: int | None = None,
    progress: Callable[[int, int], None] | None = None,
    max_probability_wrong: float = DEFAULT_MAX_PROBABILITY_WRONG,
) -> tuple[dict[str, Any], list[CloudResult]]:
    """Register all cases of a folder; the result as it is written to JSON, and case by case.

    The method is asked for whatever it finds, and what it doubts more than `max_probability_wrong` becomes a refusal here: so the
    doubted answers are judged as well. Raises CasesError where the folder cannot be read, ConfigError for a method that there is
    not and for clouds that nothing installed can read, BrokenOff as `evaluate_image`. A case that cannot be read is a `no_fix`
    with its reason.
    """
    make_registration(method)
    cases, truth = read_cloud_cases(folder), read_cloud_truth(folder)
    require_truth_of([case.case_id for case in cases], truth, folder / "truth.json")
    cases = cases[:limit]
    _require_readers(cases)
    posed = [(case, truth.get(case.case_id)) for case in cases]
    run = partial(run_case, method=method, max_probability_wrong=max_probability_wrong)
    results = list[CloudResult]()
    answers = run_all(posed, run, run, jobs)
    why = done_until_broken_off(answers, results, lambda: progress(len(results), len(cases)) if progress else None)
    document = {
        "schema": 1,
        **({"complete": False, "asked": len(cases)} if why is not None else {}),
        "method": method,
        "max_probability_wrong": max_probability_wrong,
        "environment": environment(),
        "cases": [as_json(result) | {"id": case.given_id} for case, result in zip(cases, results, strict=why is None)],
        "summary": summarise(results),
    }
    if why is not None:
        raise BrokenOff(document, results, why)
    return document, results


def _require_readers(cases: Sequence[CloudCase | BadCloudCase]) -> None:
    """Else each such case would be a refusal, as if the method had made it. Raises ConfigError."""
    files = (file for case in cases if isinstance(case, CloudCase) for file in (case.source, case.reference))
    las = next((file for file in files if file.suffix.lower() in LAS_SUFFIXES), None)
    if las is not None and find_spec("laspy") is None:
        raise ConfigError("reading .las and .laz needs laspy", where=str(las), remedy="pip install 'visloc-companion[prep]'")


def run_case(posed: Posed, method: str, max_probability_wrong: float = DEFAULT_MAX_PROBABILITY_WRONG) -> CloudResult:
    """Register one case and judge the answer. Whatever is wrong with its files, or goes wrong over them, becomes a refusal."""
    case, T_true = posed
    known = T_true is not None
    if isinstance(case, BadCloudCase):
        return CloudResult(case.case_id, None, Reason.BAD_INPUT, case.why, has_truth=known)
    try:
        source, reference = read_cloud(case.source), read_cloud(case.reference)
        require_same_crs(source, reference)
    except MapError as why:
        return CloudResult(case.case_id, None, Reason.BAD_INPUT, str(why), has_truth=known)
    origin = near_origin_m(reference.points_m)
    clouds = source.points_m, reference.points_m
    for points in clouds:
        np.subtract(points, origin, out=points)  # in place: two more clouds of eight million points are 400 MB
    register = make_registration(method, 1.0)
    start = time.perf_counter()
    try:
        answer = register(*clouds, case.prior)
    except Exception as fault:  # one case must not cost the others their answers
        return CloudResult(case.case_id, None, Reason.BAD_INPUT, fault_text(fault), has_truth=known)
    elapsed_ms = 1000 * (time.perf_counter() - start)
    notes = (*(cloud.note for cloud in (source, reference) if cloud.note), *_strays(answer.evidence))
    placed, refusal, error = None, None, None
    if isinstance(answer, NotRegistered):
        refusal = answer
    else:
        error = None if T_true is None else cloud_error(answer, from_origin(T_true, -origin), without_strays(clouds[0]))
        placed = replace(answer, T_reference_source=from_origin(answer.T_reference_source, origin))
        if answer.probability_wrong > max_probability_wrong:
            refusal = doubted(answer)
    reason, detail = (None, "") if refusal is None else (refusal.reason, refusal.detail)
    text = "; ".join(part for part in (detail, *notes) if part)
    return CloudResult(case.case_id, placed, reason, text, elapsed_ms, answer.evidence, error, known)


def _strays(evidence: tuple[tuple[str, float], ...]) -> list[str]:
    """What the method left out of the clouds; empty where it left out nothing."""
    counted = dict(evidence)
    numbers = {what: int(counted.get(f"{what}_strays", 0)) for what in ("source", "reference")}
    return [f"{n} points far from all others are left out of the {what}" for what, n in numbers.items() if n]


def as_json(result: CloudResult) -> dict[str, Any]:
    """One case of the JSON (docs/structure.md, What comes out); what a `no_fix` does not have is null.

    `sigma_horizontal_m` is that of one axis: the root of the mean of both variances.
    """
    fix = result.fix
    numbers: dict[str, Any] = dict.fromkeys(ANSWER_FIELDS)
    if fix is not None:
        horizontal = fix.covariance_m2[:2, :2]
        values = (
            fix.T_reference_source.tolist(),
            math.sqrt(float(np.trace(horizontal)) / 2),
            math.sqrt(float(fix.covariance_m2[2, 2])),
            horizontal_bound_m(horizontal),
            float(fix.probability_wrong),
        )
        numbers = dict(zip(ANSWER_FIELDS, values, strict=True))
    status, reason = ("no_fix", str(result.reason)) if fix is None else ("fix", None)
    return {"id": result.case_id, "status": status, "reason": reason, **numbers, "elapsed_ms": result.elapsed_ms}


def environment() -> dict[str, Any]:
    """What the figures depend on beside the data; a library that is not installed is null."""
    about: dict[str, Any] = {"visloc_companion": __version__, "python": platform.python_version()}
    for name in LIBRARIES:
        try:
            about[name] = version(name)
        except PackageNotFoundError:
            about[name] = None
    return about | {"machine": platform.machine(), "cores": os.cpu_count() or 1, "provider": "cpu"}
