from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from visloc_companion.errors import Reason
from visloc_companion.evaluate.cases import Truth
from visloc_companion.evaluate.images.image_metrics import CaseResult, accepted, case_error, claims, summarise
from visloc_companion.geo.se3 import quat_from_euler
from visloc_companion.geo.wgs84 import geo_from_ned
from visloc_companion.types import Fix, GeoPoint

PLACE = GeoPoint(47.0, 9.0, 100.0)
TRUTH = Truth(47.0, 9.0, 100.0, 30.0, 0.5, True, roll_deg=1.0, pitch_deg=-2.0)


def result(north_m=0.0, east_m=0.0, up_m=0.0, sigma_m=1.0, p=0.01, tilt_deg=0.0, name="a") -> CaseResult:
    attitude = quat_from_euler(math.radians(1.0), math.radians(-2.0 + tilt_deg), math.radians(30.0))
    covariance = ((sigma_m**2, 0.0), (0.0, sigma_m**2))
    place = geo_from_ned((north_m, east_m, -up_m), PLACE)
    fix = Fix(0, 0, 0, 0, "gradient", place, attitude, covariance, 1.0, 0.01, p, 1.0)
    return CaseResult(name, fix, None, elapsed_ms=5.0, evidence={"agl_m": 100.0})


def drawn(sigma_m: float, claimed_m: float, n: int = 600) -> tuple[list[CaseResult], dict[str, Truth]]:
    """Results whose errors have one sigma and whose claims have another."""
    rng = np.random.default_rng(3)
    results = [result(*rng.normal(0, sigma_m, 2), up_m=rng.normal(), sigma_m=claimed_m, name=str(k)) for k in range(n)]
    return results, {r.case_id: TRUTH for r in results}


def test_errors_are_told_apart():
    error = case_error(result(3.0, 4.0, up_m=2.0, sigma_m=2.0, tilt_deg=1.5), TRUTH)
    assert error is not None
    assert error.horizontal_m == pytest.approx(5.0, abs=1e-3)
    assert error.horizontal_px == pytest.approx(10.0, abs=1e-2)
    assert error.h_percent == pytest.approx(2.0, abs=1e-3)
    assert error.tilt_deg == pytest.approx(1.5, abs=1e-3)
    assert error.yaw_deg == pytest.approx(0.0, abs=1e-6)
    assert error.chi2 == pytest.approx(25 / 4, rel=1e-3)


def test_the_ellipse_uses_the_correlation():
    r = result(1.0, 1.0)
    assert r.fix is not None
    along = replace(r, fix=replace(r.fix, cov_ne_m2=((1.0, 0.9), (0.9, 1.0))))
    across = replace(r, fix=replace(r.fix, cov_ne_m2=((1.0, -0.9), (-0.9, 1.0))))
    chi2 = [e.chi2 for e in (case_error(along, TRUTH), case_error(across, TRUTH)) if e]
    assert chi2 == pytest.approx([2 / 1.9, 20.0], rel=1e-3)


def test_true_claims_hold_95_percent_and_bold_ones_do_not():
    honest, truth = drawn(1.0, 1.0)
    assert summarise(honest, truth)["inside_95_ellipse_share"] == pytest.approx(0.95, abs=0.03)
    assert summarise(honest, truth)["rms_error_over_sigma"]["north"] == pytest.approx(1.0, abs=0.1)
    bold, truth = drawn(1.0, 0.5)
    assert summarise(bold, truth)["inside_95_ellipse_share"] < 0.92
    assert summarise(bold, truth)["rms_error_over_sigma"]["east"] > 1.3


def test_wrong_and_far_differ():
    between = result(3.0)  # 6 px
    summary = summarise([between, result(9.0, name="b")], {"a": TRUTH, "b": TRUTH})
    assert (summary["wrong_and_accepted"], summary["far_and_accepted"]) == (2, 1)


def test_a_stricter_limit_turns_fixes_into_refusals():
    sure, doubtful = result(p=0.01), result(p=0.4, name="b")
    taken = accepted([sure, doubtful], 0.05)
    assert taken[0] is sure
    assert (taken[1].fix, taken[1].reason) == (None, Reason.NO_MATCH)


def test_refusals_of_what_has_no_answer_are_counted():
    nowhere = replace(TRUTH, solvable=False)
    refused = CaseResult("b", None, Reason.NO_MATCH)
    summary = summarise([result(), refused, result(name="c")], {"a": TRUTH, "b": nowhere, "c": nowhere})
    assert summary["refused_of_unsolvable_share"] == 0.5
    assert summary["accepted_of_solvable_share"] == 1.0
    assert summary["far_and_accepted"] == 1


def test_claims_leave_out_refusals():
    p, wrong = claims([(result(p=0.02), TRUTH), (CaseResult("b", None, Reason.NO_MATCH), TRUTH), (result(50.0, p=0.6), TRUTH)])
    assert p.tolist() == [0.02, 0.6]
    assert wrong.tolist() == [False, True]
