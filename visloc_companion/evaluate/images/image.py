"""Run a localiser over a folder of image cases."""

from __future__ import annotations

import math
import os
import platform
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import lru_cache, partial
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from visloc_companion import __version__
from visloc_companion.adapters.camera.calibration import with_mask
from visloc_companion.adapters.camera.mask import decode_mask
from visloc_companion.errors import ConfigError, MapError, OutsideMap, Reason, fault_text
from visloc_companion.evaluate.batch import run_all
from visloc_companion.evaluate.case_ids import require_truth_of
from visloc_companion.evaluate.cases import BadCase, Case, read_cases, read_frame, read_truth
from visloc_companion.evaluate.ended_in_order import BrokenOff, done_until_broken_off
from visloc_companion.evaluate.images.case_map import map_near, open_case_map
from visloc_companion.evaluate.images.case_places import far_truths
from visloc_companion.evaluate.images.frame_sizes import mixed_sizes
from visloc_companion.evaluate.images.image_metrics import CaseResult, summarise
from visloc_companion.evaluate.images.map_sigma import MapSigma, with_map_sigma
from visloc_companion.evaluate.images.search_reach import MOST_POSITIONS, search_reach_m
from visloc_companion.evaluate.protection import horizontal_bound_m
from visloc_companion.geo.pinhole_view import why_folded
from visloc_companion.geo.se3 import euler_from_quat
from visloc_companion.localise.features.onnx import NetworkFeatures
from visloc_companion.localise.registry import make_localiser, open_features_for
from visloc_companion.localise.runtime import NetworkChoice, default_threads
from visloc_companion.localise.settings import Looks
from visloc_companion.protocols import ReferenceMap
from visloc_companion.types import CameraModel, Fix, FrameRef, Image, LocaliseRequest

POSE_FIELDS = (
    *("lat_deg", "lon_deg", "h_m", "roll_deg", "pitch_deg", "yaw_deg"),
    *("cov_ne_m2", "sigma_h_m", "protection_level_m", "probability_wrong"),
)
MAPS_AT_HAND = 6
NETWORKS_AT_HAND = 2
SHIPPED = NetworkChoice()
UNSTATED = MapSigma()
MAX_PROBABILITY_WRONG = 0.05
"""Fixes with a larger calibrated probability of being wrong become refusals."""
CASES_AT_ONCE = 4
"""Handed to a process."""
UNREADABLE = "is missing, cut off or no image; remedy: name a whole PNG or JPEG"


def evaluate_image(
    folder: Path,
    method: str,
    jobs: int = 1,
    limit: int | None = None,
    progress: Callable[[int, int], None] | None = None,
    max_probability_wrong: float = MAX_PROBABILITY_WRONG,
    network: NetworkChoice = SHIPPED,
    map_sigma: MapSigma = UNSTATED,
) -> tuple[dict[str, Any], list[CaseResult]]:
    """Localise all cases of a folder; the result as it is written to JSON, with `warnings` where there are any, and case by case.

    Raises CasesError where the folder cannot be read, ConfigError for an unknown method, ModelError for a network that cannot be
    used, BrokenOff with what was done where Ctrl-C or `ended_in_order` ends it. A case that cannot be read is a `no_fix` with its
    reason.
    """
    cases, truth = read_cases(folder), read_truth(folder)
    require_truth_of([case.case_id for case in cases], truth, folder / "truth.csv")
    far = far_truths(cases, truth, folder / "truth.csv")
    cases = cases[:limit]
    about = environment(_features(method, network))  # first: what stands against the network is said before an hour of cases
    results = list[CaseResult]()
    answers = run_cases(cases, method, jobs, max_probability_wrong, network, map_sigma)
    why = done_until_broken_off(answers, results, lambda: progress(len(results), len(cases)) if progress else None)
    document = {
        "schema": 1,
        **({"complete": False, "asked": len(cases)} if why is not None else {}),
        "method": method,
        "environment": about,
        "cases": [as_json(result) for result in results],
        "summary": summarise(results, truth),
    }
    if warnings := [*far, *mixed_sizes(cases[: len(results)], results)]:
        document["warnings"] = warnings
    if why is not None:
        raise BrokenOff(document, results, why)
    return document, results


def run_cases(
    cases: list[Case | BadCase],
    method: str,
    jobs: int,
    max_probability_wrong: float = MAX_PROBABILITY_WRONG,
    network: NetworkChoice = SHIPPED,
    map_sigma: MapSigma = UNSTATED,
    looks: Looks = Looks.BOTH,
) -> Iterator[CaseResult]:
    """Results in the order of the cases; of several processes (as `run_all`) each gives the network one thread."""
    run = partial(run_case, method=method, max_probability_wrong=max_probability_wrong, map_sigma=map_sigma, looks=looks)
    here, there = (partial(run, network=each) for each in (network, replace(network, threads=1)))
    return run_all(cases, here, there, jobs, CASES_AT_ONCE)


def run_case(
    case: Case | BadCase,
    method: str,
    max_probability_wrong: float = MAX_PROBABILITY_WRONG,
    network: NetworkChoice = SHIPPED,
    map_sigma: MapSigma = UNSTATED,
    looks: Looks = Looks.BOTH,
) -> CaseResult:
    """Localise one case. Whatever is wrong with its files, or goes wrong over them, becomes a `no_fix`; a network is opened once
    for a process.

    What is claimed includes the map's own error.
    """
    if isinstance(case, BadCase):
        return CaseResult(case.case_id, None, Reason.BAD_INPUT, case.why)
    pixels = read_frame(case.frame)
    if pixels is None:
        return CaseResult(case.case_id, None, Reason.BAD_FRAME, f"{case.frame}: {UNREADABLE}")
    try:
        model = _camera_model(case, pixels)
        reference = map_near(_open_map(case.ortho, case.dsm), case.prior.place)
        reach_m = search_reach_m(case.prior.place, reference)
    except Exception as fault:  # one case must not cost the others their answers
        return _without_answer(case, fault)
    localiser = make_localiser(
        method,
        model,
        features=_features(method, network),
        max_probability_wrong=max_probability_wrong,
        max_search_radius_m=reach_m,
        most_positions=MOST_POSITIONS,
        threads=network.threads or default_threads(),
        looks=looks,
    )
    channels, frame_px = 1 if pixels.ndim == 2 else 3, (model.width_px, model.height_px)
    frame = FrameRef(0, 0, 0, 0, *frame_px, channels)
    try:
        answer = localiser.localise(LocaliseRequest(0, frame, case.prior, 1), pixels, reference)
    except Exception as fault:  # as above
        return _without_answer(case, fault)
    evidence = _above_ground(case, reference) | dict(answer.evidence)
    elapsed_ms = answer.elapsed_ms - evidence.get("map_ms", 0.0)
    if isinstance(answer, Fix):
        fix = with_map_sigma(answer, map_sigma)
        return CaseResult(case.case_id, fix, None, "", elapsed_ms, evidence, reference.gsd_m, frame_px)
    return CaseResult(case.case_id, None, answer.reason, answer.detail, elapsed_ms, evidence, reference.gsd_m, frame_px)


def _above_ground(case: Case, reference: ReferenceMap) -> dict[str, float]:
    """How high the prior lies over the map's surface, `agl_m`, for methods that do not say; empty off the map and below it."""
    place = case.prior.place
    try:
        agl_m = place.h_amsl_m - reference.height_amsl_m(*reference.to_map(place.lat_deg, place.lon_deg))
    except OutsideMap:
        return {}
    return {"agl_m": agl_m} if agl_m > 0 else {}


def _without_answer(case: Case, fault: Exception) -> CaseResult:
    reason = Reason.OUTSIDE_MAP if isinstance(fault, OutsideMap) else Reason.BAD_INPUT
    return CaseResult(case.case_id, None, reason, str(fault) if isinstance(fault, MapError | ConfigError) else fault_text(fault))


def _camera_model(case: Case, pixels: Image) -> CameraModel:
    """The camera of a case and its frame, with the mask that the case names. Raises ConfigError for a frame of another size than
    the case states, for a rational or fisheye lens that folds within the picture (a Brown-Conrady one is looked at as it is), and
    for a mask that is missing or none of the frame."""
    model = case.camera.model(pixels)
    if case.camera.size_px not in (None, (model.width_px, model.height_px)):
        what = f"{model.width_px} x {model.height_px} px, calibrated for {case.camera.size_px[0]} x {case.camera.size_px[1]}"
        raise ConfigError(what, where=f"frame = {case.frame}", remedy="give the frame as it was taken, or its own calibration")
    if model.distortion_model != "brown_conrady" and (why := why_folded(model)):
        raise ConfigError(why, where="distortion")
    if case.mask is None:
        return model
    where = f"mask = {case.mask}"
    try:
        content = case.mask.read_bytes()
    except OSError as why_not:
        remedy = "name a picture that is there, or leave the column empty"
        raise ConfigError(f"cannot be read: {why_not.strerror}", where=where, remedy=remedy) from why_not
    return with_mask(model, decode_mask(content, model.width_px, model.height_px, where), where)


def as_json(result: CaseResult) -> dict[str, Any]:
    """One case of the JSON (docs/replay.md, Image cases); what a `no_fix` does not have is null.

    The protection level is provisional, from one vote alone; the covariance includes the map's own.
    """
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
            "protection_level_m": horizontal_bound_m(np.array(fix.cov_ne_m2)),
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


_open_map = lru_cache(maxsize=MAPS_AT_HAND)(open_case_map)
