"""Which of the estimators of an ArduPilot log flew, and logs without any."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.unit.adapters.test_logs_dataflash import MODERN, formats, message, write
from visloc_companion.adapters.logs.open import open_log
from visloc_companion.types import EstimatorStatus, LocalPose, PriorPose

ESTIMATORS = {
    "ATT": MODERN["ATT"],
    "PARM": (20, "QNf", "TimeUS,Name,Value"),
    "NKF1": (21, "Qffffff", "TimeUS,VN,VE,VD,PN,PE,PD"),
    "NKF4": (22, "QcccI", "TimeUS,SV,SP,SH,SS"),
    "XKF1": MODERN["XKF1"],
    "XKF4": (23, "QBcccIb", "TimeUS,C,SV,SP,SH,SS,PI"),
}


def two_estimators(*, primary: int) -> bytes:
    parts = [message(ESTIMATORS, "ATT", 1_000_000, 0, 0, 0)]
    for k in range(4):
        us = 1_000_000 + 100_000 * k
        parts += [
            message(ESTIMATORS, "NKF1", us, *[2.0] * 6),
            message(ESTIMATORS, "NKF4", us, 0, 200, 0, 0x33F),
            *(message(ESTIMATORS, "XKF1", us, core, *[10.0 + core] * 6) for core in (0, 1)),
            *(message(ESTIMATORS, "XKF4", us, core, 0, 10 + core, 0, 0x33F, primary if k else 0) for core in (0, 1)),
        ]
    return b"".join(parts)


@pytest.mark.parametrize(("in_use", "norths_m"), [(2, [2.0] * 4), (3, [10.0, 10.0, 11.0, 11.0])])
def test_the_estimator_that_flies_and_its_primary_core(tmp_path: Path, in_use: int, norths_m: list[float]) -> None:
    chosen = message(ESTIMATORS, "PARM", 900_000, b"AHRS_EKF_TYPE", float(in_use))
    data = formats(ESTIMATORS) + chosen + message(ESTIMATORS, "PARM", 900_000, b"AHRS_GPS_USE", 1.0) + two_estimators(primary=1)
    events = [event for _, event in open_log(write(tmp_path / "a.bin", data)).events]
    assert [event.p_ned_m[0] for event in events if isinstance(event, LocalPose)] == norths_m
    ratios = [event.position_ratio for event in events if isinstance(event, EstimatorStatus)]
    assert ratios == pytest.approx([2.0] * 4 if in_use == 2 else [0.10, 0.11, 0.11, 0.11])


def test_the_second_core_of_before_4_1_has_messages_of_its_own(tmp_path: Path) -> None:
    """That fly where it is the primary one: of the first then nothing is to be believed."""
    table = {
        "ATT": MODERN["ATT"],
        **{name: (30 + k, "Qffffff", "TimeUS,VN,VE,VD,PN,PE,PD") for k, name in enumerate(("NKF1", "NKF6"))},
        **{name: (40 + k, "QcccIb", "TimeUS,SV,SP,SH,SS,PI") for k, name in enumerate(("NKF4", "NKF9"))},
    }
    parts = [formats(table), message(table, "ATT", 1_000_000, 0, 0, 0)]
    for k in range(4):
        us, primary = 1_000_000 + 100_000 * k, int(k >= 1)
        parts += [message(table, name, us, *[value] * 6) for name, value in (("NKF1", 10.0), ("NKF6", 11.0))]
        parts += [message(table, name, us, 0, value, 0, 0x33F, primary) for name, value in (("NKF4", 10), ("NKF9", 11))]
    events = [event for _, event in open_log(write(tmp_path / "a.bin", b"".join(parts))).events]
    assert [event.p_ned_m[0] for event in events if isinstance(event, LocalPose)] == [10.0, 10.0, 11.0, 11.0]
    ratios = [event.position_ratio for event in events if isinstance(event, EstimatorStatus)]
    assert ratios == pytest.approx([0.10, 0.11, 0.11, 0.11])


def test_positions_of_a_log_without_an_ekf_have_the_velocity_between_them(tmp_path: Path) -> None:
    """On DCM, or with an AHRS of its own, a vehicle logs POS alone."""
    parts = [formats(MODERN), message(MODERN, "ATT", 1_000_000, 0, 0, 0)]
    for k in range(7):
        us = 1_000_000 + 100_000 * k + 3_000_000 * (k >= 4)
        parts.append(message(MODERN, "POS", us, 474_000_000 + 90 * k, 85_500_000, 540.0 + 0.2 * k, 40.0, 40.0))
    placed = [e for _, e in open_log(write(tmp_path / "a.bin", b"".join(parts))).events if isinstance(e, PriorPose)]
    assert [e.t_boot_ns // 10**8 for e in placed] == [11, 12, 13, 46], "the first has none, nor those about a gap"
    for pose in placed:
        assert pose.v_ned_mps == pytest.approx((10.0, 0.0, -2.0), abs=0.02)
