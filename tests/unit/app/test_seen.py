"""What the snapshot tells beside the Status."""

from __future__ import annotations

import json
import math

import pytest

from visloc_companion.app.seen import FIXES, NOTICES, Seen
from visloc_companion.errors import Reason
from visloc_companion.types import (
    Attitude,
    AutopilotKind,
    Fix,
    FrameRef,
    GeoPoint,
    Gnss,
    LinkChanged,
    Mode,
    NoFix,
    Notice,
    Severity,
    Status,
    Verdict,
)

S = 1_000_000_000
LEVEL = (1.0, 0.0, 0.0, 0.0)
COV = ((1.0, 0.0), (0.0, 1.0))
PLACE = GeoPoint(47.4, 8.55, 500.0)


def fix(t_ns: int, method: str) -> Fix:
    return Fix(t_ns + S // 5, t_ns, 1, 1, method, PLACE, LEVEL, COV, 1.0, 0.01, 0.001, 80.0)


def status(t_ns: int, age_s: float | None) -> Status:
    return Status(t_ns, Mode.AIDING, Verdict.OK, (), PLACE, (0.0, 0.0, 0.0), COV, 1.0, 5.0, age_s, True, 0)


def test_nothing_heard_is_none() -> None:
    nothing = {"autopilot", "heading_deg", "gnss", "fix", "answer", "frame_age_s"}
    found = Seen().snapshot(S)
    assert {name for name, value in found.items() if value is None} == nothing
    assert found["notices"] == []


def test_the_source_is_that_of_the_fix_that_was_taken_not_of_the_newest() -> None:
    seen = Seen()
    seen.event(fix(10 * S, "deep"))
    seen.event(fix(11 * S, "terrain"))  # rejected: the status goes on from the one before
    seen.command(12 * S, status(12 * S, 2.0))
    found = seen.snapshot(12 * S)
    assert found["fix"] == {"method": "deep", "age_s": 2.0}
    assert found["answer"]["method"] == "terrain"


def test_a_fix_that_is_not_known_any_more_has_no_source() -> None:
    seen = Seen()
    for k in range(FIXES + 1):
        seen.event(fix(k * S, "deep"))
    seen.command(20 * S, status(20 * S, 20.0))
    assert seen.snapshot(20 * S)["fix"] == {"method": None, "age_s": 20.0}


def test_the_first_receiver_is_told_with_its_age() -> None:
    seen = Seen()
    seen.event(Gnss(S, S, 3, 12, PLACE, 0.8, 1.2, None))
    seen.event(Gnss(S, S, 1, 0, GeoPoint(0.0, 0.0, 0.0), None, None, None, receiver=1))
    assert seen.snapshot(3 * S)["gnss"] == {
        "lat_deg": 47.4,
        "lon_deg": 8.55,
        "fix_type": 3,
        "n_satellites": 12,
        "h_acc_m": 0.8,
        "age_s": 2.0,
    }


def test_the_heading_is_the_noses_and_only_while_it_is_fresh() -> None:
    seen = Seen()
    west = (math.cos(-math.pi / 4), 0.0, 0.0, math.sin(-math.pi / 4))
    seen.event(Attitude(S, S, west, (0.0, 0.0, 0.0)))
    assert seen.snapshot(2 * S)["heading_deg"] == pytest.approx(270.0)
    assert seen.snapshot(4 * S)["heading_deg"] is None


def test_only_what_went_to_the_operator_is_told_newest_first_and_no_more_than_fits() -> None:
    seen = Seen()
    seen.command(S, Notice(Severity.INFO, "for the log"))
    for k in range(NOTICES + 4):
        seen.command(k * S, Notice(Severity.WARNING, f"n{k}", to_operator=True))
    told = seen.snapshot((NOTICES + 4) * S)["notices"]
    assert [row["text"] for row in told] == [f"n{k}" for k in range(NOTICES + 3, 3, -1)]
    assert told[0] == {"severity": "warning", "text": f"n{NOTICES + 3}", "age_s": 1.0}


def test_whatever_numbers_come_it_is_strict_json() -> None:
    seen, inf, nan = Seen(), math.inf, math.nan
    seen.event(LinkChanged(S, True, AutopilotKind.PX4, "1.16", 1, True))
    seen.event(Attitude(S, S, (nan, inf, 0.0, 1e300), (0.0, 0.0, 0.0)))
    seen.event(Gnss(S, S, 3, None, GeoPoint(nan, inf, 0.0), inf, None, None))
    seen.event(FrameRef(S, S, 1, 0, 640, 480, 1))
    seen.event(NoFix(S, S, 1, 1, "deep", Reason.AMBIGUOUS, nan))
    seen.command(S, status(S, inf))
    found = json.loads(json.dumps(seen.snapshot(S), allow_nan=False))
    assert found["answer"]["reason"] == "ambiguous"
    assert found["autopilot"] == {"kind": "px4", "version": "1.16", "armed": True}
    assert found["fix"] is None
