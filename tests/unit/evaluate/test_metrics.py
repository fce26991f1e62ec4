from __future__ import annotations

import csv
import json
from dataclasses import replace
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from visloc_companion.app.journal import Entry
from visloc_companion.evaluate.metrics import (
    alarms_s,
    availability,
    count_hmi,
    count_misleading,
    detected_at_s,
    error_figures,
    false_alarms,
    flight_summary,
    injection_figures,
    judged_epochs,
    latency_figures,
    mean_nees,
    write_epochs,
)
from visloc_companion.evaluate.record import FlightRecord, Track, from_entries
from visloc_companion.types import GeoPoint, Injection, Mode, Status, Verdict

KEYS = {
    "schema", "duration_s", "n_frames", "n_fixes", "n_no_fix", "reasons", "error_horizontal_m", "availability", "hmi",
    "misleading", "nees", "gnss", "injected", "latency_ms", "epochs", "integrity",
}  # fmt: skip


def made(
    error_m: list[float], level_m: list[float], verdicts: list[str] | None = None, sigma_m: float = 1.0, modes: str = "aiding"
) -> FlightRecord:
    """Ticks at 1 Hz with these errors (north, NaN: no truth) and protection levels (NaN: none)."""
    n = len(error_m)
    estimate = np.zeros((n, 3))
    truth = np.column_stack([-np.array(error_m), np.zeros(n), np.zeros(n)])
    return replace(
        from_entries([]),
        t_s=np.arange(n, dtype=float),
        estimate_ned_m=estimate,
        truth_ned_m=truth,
        cov_ne_m2=np.tile(np.eye(2) * sigma_m**2, (n, 1, 1)),
        sigma_m=np.full(n, sigma_m),
        protection_level_m=np.array(level_m),
        modes=(modes,) * n,
        verdicts=tuple(verdicts or ["ok"] * n),
        reasons=((),) * n,
        injected=np.zeros(n, dtype=bool),
    )


def test_the_summary_has_exactly_the_agreed_fields(synthetic: ModuleType) -> None:
    summary = flight_summary(synthetic.make_record(), epochs="epochs.csv")
    assert set(summary) == KEYS
    assert set(summary["error_horizontal_m"]) == {"mean", "median", "p95", "max"}
    assert set(summary["gnss"]) == {"detected_at_s", "false_alarms"}
    assert set(summary["injected"]) == {"n", "rate_hz", "gap_max_ms"}
    assert set(summary["latency_ms"]) == {"p50", "p95", "p99"}
    assert summary["integrity"]["horizontal"]["hazardous"] == summary["hmi"]
    assert summary["integrity"]["vertical"]["epochs"] == summary["integrity"]["horizontal"]["epochs"]
    json.dumps(summary, allow_nan=False)
    assert summary["reasons"]["ambiguous"] + summary["reasons"]["no_match"] == summary["n_no_fix"]


@pytest.mark.parametrize("entries", [0, 1])
def test_undefined_figures_are_null(entries: int, synthetic: ModuleType) -> None:
    status = Status(0, Mode.WAITING, Verdict.DENIED, ("no_data",), None, (0, 0, 0), ((0, 0), (0, 0)), 0, None, None, False, 0)
    summary = flight_summary(from_entries([Entry(0, None, status)] * entries))
    json.dumps(summary, allow_nan=False)
    assert summary["error_horizontal_m"] == {"mean": None, "median": None, "p95": None, "max": None}
    assert summary["hmi"] is summary["misleading"] is summary["nees"] is summary["gnss"]["false_alarms"] is None
    assert summary["availability"] == (0.0 if entries else None)
    assert summary["injected"] == {"n": 0, "rate_hz": None, "gap_max_ms": None}


def test_errors_are_those_of_epochs_with_truth() -> None:
    record = made([1.0, 2.0, 3.0, 10.0, np.nan], [20.0] * 5)
    assert error_figures(record) == {"mean": 4.0, "median": 2.5, "p95": 8.95, "max": 10.0}
    assert error_figures(record, np.array([True, True, False, False, True]))["max"] == 2.0


def test_hmi_needs_a_protection_level_that_does_not_warn() -> None:
    record = made([30.0, 30.0, 30.0, 5.0, np.nan], [10.0, 40.0, np.nan, 4.0, 1.0])
    assert count_hmi(record, 25.0) == 1
    assert count_misleading(record) == 2
    assert availability(record, 25.0) == pytest.approx(0.6)


def test_nees_is_two_for_an_honest_claim_and_more_for_a_bold_one() -> None:
    rng = np.random.default_rng(3)
    honest = made([0.0] * 4000, [9.0] * 4000)
    honest = replace(honest, truth_ned_m=np.column_stack([rng.normal(0, 1, (4000, 2)), np.zeros(4000)]))
    assert mean_nees(honest) == pytest.approx(2.0, abs=0.1)
    assert mean_nees(replace(honest, cov_ne_m2=honest.cov_ne_m2 / 9)) == pytest.approx(18.0, abs=1)
    assert mean_nees(replace(honest, cov_ne_m2=honest.cov_ne_m2 * 0)) is None


def test_alarms_count_from_trust() -> None:
    record = made([0.0] * 8, [9.0] * 8, ["denied", "ok", "suspect", "denied", "ok", "ok", "suspect", "ok"])
    assert alarms_s(record) == [2.0, 6.0]
    assert detected_at_s(record) == 2.0
    assert detected_at_s(record, [(5.0, 9.0)]) == 6.0
    assert detected_at_s(record, [(7.0, 9.0)]) is None
    assert false_alarms(record, [(5.0, 9.0)]) == 1
    assert false_alarms(record, []) == 2
    assert false_alarms(record) is None


def test_gnss_that_was_never_trusted_was_detected_at_once() -> None:
    assert detected_at_s(made([0.0] * 3, [9.0] * 3, ["denied"] * 3)) == 0.0
    assert detected_at_s(made([0.0] * 3, [9.0] * 3)) is None


def test_an_alarm_is_false_where_the_receiver_was_right() -> None:
    t_s = np.arange(10.0)
    truth = Track(t_s, np.zeros((10, 3)))
    record = replace(made([0.0] * 10, [9.0] * 10, ["ok", "suspect"] * 5), truth=truth)
    dragged = np.where(t_s >= 5, 40.0, 0.0)
    gnss = Track(t_s, np.column_stack([dragged, np.zeros((10, 2))]))
    assert false_alarms(replace(record, gnss=gnss)) == 2


def test_an_alarm_that_nobody_can_judge_makes_no_clean_record() -> None:
    t_s = np.arange(10.0)
    known = t_s < 4
    truth = Track(t_s[known], np.zeros((4, 3)))
    record = replace(made([0.0] * 10, [9.0] * 10, ["ok"] * 6 + ["suspect"] * 4), truth=truth, gnss=Track(t_s, np.zeros((10, 3))))
    assert false_alarms(record) is None, "the truth ends before the alarm"
    assert false_alarms(replace(record, truth=Track(t_s, np.zeros((10, 3))), gnss=Track(t_s[:0], np.zeros((0, 3))))) == 0


@pytest.mark.parametrize(("off_m", "n_s", "expected"), [(0.0, 30, 1), (40.0, 30, 0), (0.0, 5, 0)])
def test_a_healthy_receiver_that_is_never_trusted_is_a_false_alarm(off_m: float, n_s: int, expected: int) -> None:
    t_s = np.arange(float(n_s))
    off = np.column_stack([np.full(n_s, off_m), np.zeros((n_s, 2))])
    record = made([0.0] * n_s, [9.0] * n_s, ["denied"] * n_s)
    assert false_alarms(replace(record, truth=Track(t_s, np.zeros((n_s, 3))), gnss=Track(t_s, off))) == expected
    assert false_alarms(record, []) == (n_s > 10)
    assert false_alarms(record, [(0.0, 60.0)]) == 0


def test_only_epochs_with_truth_and_level_are_judged() -> None:
    record = made([30.0, 1.0, np.nan, 1.0], [10.0, 40.0, 9.0, np.nan])
    assert judged_epochs(record) == 2
    assert judged_epochs(made([np.nan], [9.0])) == 0


def test_a_pause_in_shadow_is_no_gap_but_one_in_lost_is() -> None:
    times = [0.0, 0.1, 0.2, 5.0, 5.1, 5.4]
    for mode, gap in (("shadow", 300.0), ("lost", 4800.0)):
        record = replace(made([0.0] * 6, [9.0] * 6), injection_t_s=np.array(times))
        record = replace(record, modes=("aiding", mode, mode, mode, mode, "aiding"))
        assert injection_figures(record)["gap_max_ms"] == pytest.approx(gap)
    assert injection_figures(record)["n"] == 6


def test_the_rate_is_that_while_injecting(synthetic: ModuleType) -> None:
    place = GeoPoint(47, 8, 500)
    injection = Injection(0, (0, 0, 0), place, (1, 0, 0, 0), ((1, 0), (0, 1)), 1, 0.1, 0)
    record = from_entries([Entry(round(k * 5e7), None, injection) for k in range(21)])
    assert injection_figures(record) == {"n": 21, "rate_hz": 20.0, "gap_max_ms": 50.0}


def test_latency_from_exposure_or_of_the_computation(synthetic: ModuleType) -> None:
    record = synthetic.make_record(60.0)
    arrival, computation = latency_figures(record), latency_figures(record, "computation")
    assert arrival["p50"] == pytest.approx(computation["p50"] + 20, abs=0.1)
    assert arrival["p50"] < arrival["p95"] < arrival["p99"]


def test_epochs_are_written_with_empty_fields_for_the_unknown(synthetic: ModuleType, tmp_path: Path) -> None:
    record = synthetic.make_record(20.0)
    write_epochs(record, tmp_path / "epochs.csv")
    rows = list(csv.DictReader((tmp_path / "epochs.csv").read_text(encoding="utf-8").splitlines()))
    assert len(rows) == len(record.t_s)
    assert rows[0]["estimate_n_m"] == rows[0]["error_m"] == ""
    assert rows[0]["mode"] == "waiting"
    assert float(rows[100]["error_m"]) == pytest.approx(record.error_m[100], abs=1e-3)
    assert float(rows[100]["truth_n_m"]) == pytest.approx(record.truth_ned_m[100, 0], abs=1e-3)
