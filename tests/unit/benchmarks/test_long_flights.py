"""The figures of the flights without GNSS, and of those without fixes, from made records."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from benchmarks import long_flights, withheld


def long_flight(error_m: list[float], level_m: list[float], injected: list[bool]) -> Any:
    """An epoch a second from the last one with GNSS on."""
    record = SimpleNamespace(
        t_s=np.arange(len(error_m)) + long_flights.JAM_S - 1.0,
        injected=np.array(injected),
        error_m=np.array(error_m),
        protection_level_m=np.array(level_m),
    )
    summary = {"hmi": 0, "nees": 2.0, "n_fixes": 3, "n_no_fix": 1}
    return SimpleNamespace(record=record, summary=summary, log=SimpleNamespace(failsafe=None))


def test_time_without_a_position_is_not_within_the_goal() -> None:
    one = long_flight([9.0, 1.0, 2.0, 2.0, 4.0], [1.0, 5.0, 1.5, 5.0, 5.0], [True, False, True, True, True])
    f = long_flights.figures(one, gsd_m=0.5)
    assert f["epochs"] == 4
    assert f["within_goal"] == pytest.approx(2 / 4)
    assert f["error_m"] == pytest.approx([2.0, 3.8, 4.0])
    assert f["beyond_level"] == 1
    assert (f["fixes"], f["frames"], f["failsafe"]) == (3, 4, "none")


def test_the_goal_is_wider_over_a_coarse_map() -> None:
    one = long_flight([0.0, 4.0, 7.0, 8.0], [9.0] * 4, [True] * 4)
    assert long_flights.figures(one, gsd_m=0.5)["within_goal"] == 0.0
    f = long_flights.figures(one, gsd_m=5.0)
    assert f["goal_m"] == 7.5
    assert f["within_goal"] == pytest.approx(2 / 3)


def test_drift_counts_from_where_fixes_were_withheld() -> None:
    """10 m/s north; 3 m off before, 6 m of drift more in a minute, all of it gone two seconds after the first fix."""
    t_s = np.arange(0.0, 160.0, 0.5)
    truth = np.column_stack([10.0 * t_s, np.zeros_like(t_s), np.zeros_like(t_s)])
    drift = np.interp(t_s, [withheld.FROM_S, withheld.FROM_S + 60.0], [0.0, 6.0])
    off = np.where(t_s < withheld.FROM_S + 61.0, 3.0 + drift, 3.0)
    estimate = truth + np.column_stack([off, 0 * off, 0 * off])
    record = SimpleNamespace(
        t_s=t_s,
        truth_ned_m=truth,
        estimate_ned_m=estimate,
        error_m=off,
        protection_level_m=np.full(len(t_s), 8.0),
        cov_ne_m2=np.broadcast_to(4.0 * np.eye(2), (len(t_s), 2, 2)),
        fixes=[SimpleNamespace(t_s=50.0), SimpleNamespace(t_s=withheld.FROM_S + 61.0)],
        modes=("vision",) * len(t_s),
    )
    f = withheld.figures(SimpleNamespace(record=record), 60.0)  # type: ignore[arg-type]
    assert f["way_m"] == pytest.approx(595.0)
    assert f["end"] == pytest.approx(5.95 / 595.0)
    assert f["beyond"] == int((off[(t_s >= withheld.FROM_S) & (t_s < withheld.FROM_S + 60.0)] > 8.0).sum()) > 0
    assert f["first_fix_s"] == pytest.approx(1.0)
    assert f["sigmas"] == pytest.approx(5.95 / 2.0)
