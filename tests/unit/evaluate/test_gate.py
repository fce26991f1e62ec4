from __future__ import annotations

import pytest

from visloc_companion.errors import ConfigError
from visloc_companion.evaluate.gate import check_gate, parse_gate

SUMMARY = {
    "hmi": 0,
    "nees": None,
    "availability": 0.97,
    "error_horizontal_m": {"p95": 11.9, "max": 30.0},
    "injected": {"gap_max_ms": 180.0},
}


def test_conditions_are_read_and_checked() -> None:
    checks = check_gate("hmi=0, p95_m<=12 ,max_m < 25,availability>=0.97,injected.gap_max_ms!=180", SUMMARY)
    assert [(check.name, check.value, check.passed) for check in checks] == [
        ("hmi", 0, True),
        ("p95_m", 11.9, True),
        ("max_m", 30.0, False),
        ("availability", 0.97, True),
        ("injected.gap_max_ms", 180.0, False),
    ]
    assert checks[1].limit == "<= 12"


@pytest.mark.parametrize("gate", ["nees<3", "misleading=0", "median_m>0", "median_m<=1e9"])
def test_an_undefined_figure_fails(gate: str) -> None:
    (check,) = check_gate(gate, SUMMARY)
    assert not check.passed
    assert check.value is None


def test_an_empty_gate_has_no_conditions() -> None:
    assert parse_gate("") == parse_gate("  ") == []


@pytest.mark.parametrize("text", [",", " , ", "hmi=0,", ",hmi=0", "hmi=0,,p95_m<=12"])
def test_a_comma_without_a_condition_is_refused(text: str) -> None:
    """What a script left empty would pass unseen."""
    with pytest.raises(ConfigError, match=r"--gate: has a comma without a condition beside it; remedy"):
        parse_gate(text)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("hmi", "'hmi' is no condition"),
        ("hmi=0;p95_m<3", "is no condition"),
        ("p95<=12m", "is no condition"),
        ("p95_m<=1.2.3", "is no number"),
        ("p95_m<=1e400", "is beyond any number"),
        ("max_m>=-1e400", "is beyond any number"),
        ("p95m<=12", "did you mean 'p95_m'"),
        ("colour=1", "valid are duration_s"),
    ],
)
def test_bad_text_is_a_clear_error(text: str, words: str) -> None:
    with pytest.raises(ConfigError, match="--gate") as caught:
        parse_gate(text)
    assert words in str(caught.value)
