from __future__ import annotations

from types import ModuleType

import numpy as np
import pytest

from visloc_companion.app.journal import Entry
from visloc_companion.evaluate.record import Track, from_entries, rebased
from visloc_companion.geo.wgs84 import geo_from_ned
from visloc_companion.types import Gnss


def test_a_record_holds_what_was_flown(synthetic: ModuleType) -> None:
    record = synthetic.make_record(160.0)
    assert record.duration_s == pytest.approx(160.0, abs=0.3)
    assert len(record.t_s) == 1600
    assert record.t_s[5] == pytest.approx(0.5)
    assert np.isnan(record.estimate_ned_m[:40]).all()
    assert np.isfinite(record.estimate_ned_m[41:]).all()
    assert record.truth_ned_m[205, :2] == pytest.approx(synthetic.true_ned(20.5)[:2], abs=1e-3)
    assert record.error_m[100] == pytest.approx(np.hypot(*(record.estimate_ned_m - record.truth_ned_m)[100, :2]))
    assert record.sigma_m[60] == pytest.approx(np.sqrt(0.81 + 0.1), abs=1e-6)
    assert record.protection_level_m[60] == pytest.approx(4.05)
    assert record.n_frames == record.n_requests == len(record.fixes) + len(record.refusals)
    assert record.changes(record.verdicts) == [(0.0, "ok"), (85.0, "suspect"), (120.0, "denied")]
    assert record.while_verdict("denied").sum() == 400
    assert len(record.injection_t_s) == record.injected.sum() == 750


def test_fixes_carry_their_times(synthetic: ModuleType) -> None:
    fix = synthetic.make_record(20.0).fixes[0]
    assert fix.latency_ms == pytest.approx(fix.elapsed_ms + 20)
    assert fix.sigma_m == pytest.approx(1.0)
    assert fix.p_ned_m[:2] == pytest.approx(synthetic.true_ned(fix.t_s)[:2], abs=4)


def test_a_receiver_without_fix_draws_no_track(synthetic: ModuleType) -> None:
    far = geo_from_ned((9e3, 0.0, 0.0), synthetic.HOME)
    events = [
        Gnss(0, 0, kind, 9, place, None, None, None, receiver)
        for kind, place, receiver in ((3, synthetic.HOME, 0), (1, far, 0), (3, far, 1))
    ]
    record = from_entries([Entry(k * 10**9, event, None) for k, event in enumerate(events)])
    assert record.gnss.p_ned_m.shape == (1, 3)
    assert record.gnss.p_ned_m[0] == pytest.approx([0, 0, 0])


def test_nothing_recorded_gives_an_empty_record() -> None:
    record = from_entries([])
    assert record.duration_s == 0
    assert record.error_m.shape == (0,)
    assert record.while_verdict("ok").shape == (0,)
    assert record.changes(record.modes) == []


def test_truth_is_interpolated_but_not_over_gaps() -> None:
    track = Track(np.array([0.0, 1.0, 9.0, 10.0]), np.array([[0.0, 0, 0], [2, 0, 0], [20, 0, 0], [22, 0, 0]]))
    at = track.at(np.array([-0.5, 0.25, 1.0, 5.0, 9.5, 10.5]))[:, 0]
    assert at == pytest.approx([np.nan, 0.5, 2.0, np.nan, 21.0, np.nan], nan_ok=True)


def test_a_flight_moves_to_another_origin_as_a_whole(synthetic: ModuleType) -> None:
    record = synthetic.make_record(20.0)
    moved = rebased(record, geo_from_ned((100.0, -50.0, 0.0), record.origin))
    shift = np.array([-100.0, 50.0])
    assert moved.truth.p_ned_m[:, :2] == pytest.approx(record.truth.p_ned_m[:, :2] + shift, abs=0.02)
    assert moved.error_m == pytest.approx(record.error_m, nan_ok=True)
    assert moved.fixes[3].p_ned_m[:2] == pytest.approx(np.array(record.fixes[3].p_ned_m[:2]) + shift, abs=0.02)
