"""Parameter files: only what must change, in the format of each autopilot's ground station."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from tests.unit.doctor.conftest import good_facts
from tests.unit.doctor.parameter_files import read_parameters
from visloc_companion.doctor.parameter_file import changes, diff, render
from visloc_companion.doctor.rules.registry import RULES
from visloc_companion.types import AutopilotKind

AP, PX4 = AutopilotKind.ARDUPILOT, AutopilotKind.PX4


def changed(kind: AutopilotKind, **wrong: float) -> dict[str, float]:
    facts = good_facts(kind)
    return changes(RULES, replace(facts, parameters={**facts.parameters, **wrong}))


@pytest.mark.parametrize("kind", [AP, PX4])
def test_nothing_changes_where_nothing_is_wrong(kind: AutopilotKind) -> None:
    assert changed(kind) == {}


def test_only_what_is_wrong_changes() -> None:
    assert changed(AP, VISO_TYPE=2.0, EK3_SRC2_YAW=6.0) == {"VISO_TYPE": 1.0, "EK3_SRC2_YAW": 1.0}


@pytest.mark.parametrize("mask", range(16))
def test_rules_that_share_a_mask_agree_on_one_value(mask: int) -> None:
    assert changed(PX4, EKF2_EV_CTRL=float(mask)) == ({} if mask == 1 else {"EKF2_EV_CTRL": 1.0})


def test_makers_defaults_become_the_recommended_file() -> None:
    """From what a new autopilot has to what the documentation tells to load."""
    new = {"VISO_TYPE": 0.0, "VISO_POS_M_NSE": 0.2, "ARMING_CHECK": 1.0, "EK3_SRC2_POSXY": 0.0, "EK3_SRC2_YAW": 0.0}
    wanted = {"VISO_TYPE": 1.0, "VISO_POS_M_NSE": 0.5, "ARMING_CHECK": 786430.0, "EK3_SRC2_POSXY": 6.0, "EK3_SRC2_YAW": 1.0}
    assert changed(AP, **new) == wanted
    new = {"EKF2_EV_CTRL": 0.0, "EKF2_HGT_REF": 1.0, "EKF2_TAU_POS": 0.25, "EKF2_TAU_VEL": 0.25}
    wanted = {"EKF2_EV_CTRL": 1.0, "EKF2_HGT_REF": 0.0, "EKF2_TAU_POS": 0.1, "EKF2_TAU_VEL": 0.1}
    assert changed(PX4, **new) == wanted


def test_a_difference_shows_old_and_new() -> None:
    assert diff({"A": 1.0, "LONG": 0.25}, {"A": 2.0, "LONG": 5e6, "NEW": 0.5}) == [
        "A     1 -> 2",
        "LONG  0.25 -> 5000000",
        "NEW   - -> 0.5",
    ]


@pytest.mark.parametrize("kind", [AP, PX4])
def test_what_is_written_is_read_back(kind: AutopilotKind, tmp_path: Path) -> None:
    new = {"EKF2_EV_CTRL": 1.0, "EKF2_EVP_NOISE": 0.1, "EKF2_NOAID_TOUT": 5e6}
    path = tmp_path / "fix.param"
    path.write_text(render(kind, new, 3, {"EKF2_EV_CTRL": 6, "EKF2_EVP_NOISE": 9}), encoding="utf-8")
    assert read_parameters(path) == new
    lines = [line for line in path.read_text(encoding="utf-8").splitlines() if not line.startswith("#")]
    assert lines[0] == ("3\t1\tEKF2_EV_CTRL\t1\t6" if kind is PX4 else "EKF2_EV_CTRL,1")
