"""The page's view of a snapshot: the words and numbers it shows, and that nothing in a snapshot breaks it."""

from __future__ import annotations

import json
import math
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.unit.web.snapshots import SNAPSHOT, snapshot
from visloc_companion.core.satellites import gnss_words
from visloc_companion.core.terrain import terrain_aiding
from visloc_companion.doctor.rules import system
from visloc_companion.errors import Reason
from visloc_companion.localise.structure import localiser as structure
from visloc_companion.types import Mode, Verdict
from visloc_companion.web import condition, words
from visloc_companion.web.heard import STALE_S, Heard
from visloc_companion.web.history import History
from visloc_companion.web.metrics import metrics_text
from visloc_companion.web.view import Origin, view_of

LIVE = Origin("/run/visloc/status.sock")


def view(given: dict[str, Any] | None, age_s: float = 0.1, problem: str = "") -> dict[str, Any]:
    return view_of(Heard(given, 100.0, problem), LIVE, 100.0 + age_s)


def test_a_flight_in_which_gnss_is_spoofed() -> None:
    shown = view(snapshot())
    assert (shown["state"], shown["says"]) == ("live", "")
    assert shown["mode"]["label"] == "AIDING"
    assert shown["gnss"]["label"] == "not trusted"
    assert shown["gnss"]["says"] == ["the camera sees the vehicle elsewhere", "the receiver reports spoofing"]
    assert shown["gnss"]["off_m"] == pytest.approx(100.0, abs=0.3)
    assert shown["integrity"]["protection_level_m"] == 12.0
    assert shown["integrity"]["says"] == "within the alert limits"
    assert shown["fix"]["source"] == "camera against map (deep)"
    assert shown["fix"]["answer"]["says"] == "no fix: several places look alike"
    assert shown["injection"]["says"] == "sending positions to the autopilot"
    assert [(row["part"], row["ok"]) for row in shown["health"]] == [
        ("link", True),
        ("camera", True),
        ("worker", True),
        ("disk", True),
    ]
    assert shown["notices"][0]["text"] == "visloc: GNSS not trusted, camera says elsewhere"


def test_positions_that_are_kept_back_are_not_shown_as_sent() -> None:
    why = "too far outside the map"
    of_the_link = {"injections": {"sent": 300, "dropped": 0, "withheld": why}}
    shown = view(snapshot() | of_the_link)["injection"]
    assert shown == {"now": False, "says": f"positions are NOT SENT: {why}", "withheld": why, "sent": 300, "dropped": 0}
    idle = view(snapshot(injected=False) | of_the_link)["injection"]
    assert (idle["now"], idle["says"], idle["withheld"]) == (False, "not sending", ""), "of before: none are to be sent now"


def test_a_line_that_is_too_slow_is_shown() -> None:
    row = view(snapshot() | {"line": {"left_out": 12, "slow": False}})["health"][0]
    assert (row["part"], row["ok"]) == ("link", True), "a few at a start"
    shown = view(snapshot() | {"line": {"left_out": 321, "slow": True}})
    assert shown["line"] == {"left_out": 321, "slow": True}
    row = shown["health"][0]
    assert (row["part"], row["ok"]) == ("link", False)
    assert row["says"] == "the line is too slow, 321 messages were left out; ArduPilot 4.6.2, armed"
    assert view({"status": snapshot()["status"]})["line"] == {"left_out": None, "slow": None}, "of a recording nobody knows"


def test_the_ellipse_points_along_the_larger_sigma() -> None:
    """Sigmas of 2 m north and 1 m east: 95 % within 2.448 of each, the major axis north."""
    position = view(snapshot())["position"]
    assert position["radius_95_m"] == pytest.approx(2 * 2.4477, abs=1e-3)
    assert position["ellipse_95"]["semi_minor_m"] == pytest.approx(2.4477, abs=1e-3)
    assert position["ellipse_95"]["azimuth_deg"] == pytest.approx(0.0)
    east = view(snapshot(cov_ne_m2=[[1.0, 0.0], [0.0, 4.0]]))["position"]["ellipse_95"]
    assert east["azimuth_deg"] == pytest.approx(90.0)
    between = view(snapshot(cov_ne_m2=[[2.0, 1.0], [1.0, 2.0]]))["position"]["ellipse_95"]
    assert between["azimuth_deg"] == pytest.approx(45.0)


def test_without_an_attitude_the_course_is_shown_and_named_so() -> None:
    given = snapshot() | {"heading_deg": None}
    position = view(given)["position"]
    assert position["direction_is"] == "course"
    assert position["direction_deg"] == pytest.approx(math.degrees(math.atan2(6.0, 8.0)))
    assert view(given | {"status": given["status"] | {"v_ned_mps": [0.1, 0.1, 0.0]}})["position"]["direction_deg"] is None


def test_an_old_answer_is_not_current_and_its_ages_grow() -> None:
    shown = view(snapshot(), age_s=12.0, problem="No daemon answers at /run/visloc/status.sock: it has ended.")
    assert shown["state"] == "stale"
    assert shown["says"].startswith("No daemon answers at /run/visloc/status.sock: it has ended. Last heard 12 s ago")
    assert shown["fix"]["age_s"] == pytest.approx(12.8)
    assert shown["notices"][0]["age_s"] == pytest.approx(24.0)
    assert shown["gnss"]["lat_deg"] is None, "where GNSS was 12 s ago is not where it is"


def test_a_navigator_that_stands_still_is_not_current() -> None:
    given = snapshot()
    given["t_ns"] += 5_000_000_000
    shown = view(given)
    assert shown["state"] == "stale"
    assert "stood still for 5.0 s" in shown["says"]


def test_a_daemon_that_was_never_heard_is_named() -> None:
    shown = view(None, problem="No daemon answers at /run/visloc/status.sock: there is no such socket.")
    assert shown["state"] == "absent"
    assert "/run/visloc/status.sock" in shown["says"]
    assert shown["position"] is None
    assert shown["injection"]["now"] is None
    assert {row["says"] for row in shown["health"]} == {"not known"}


def test_a_daemon_that_has_just_started_has_stated_nothing() -> None:
    shown = view(snapshot() | {"status": None})
    assert shown["state"] == "stale"
    assert "stated nothing yet" in shown["says"]


def test_what_is_wrong_with_the_parts_is_said() -> None:
    given = snapshot() | {
        "link_up": False,
        "frame_age_s": 31.0,
        "worker": {"up": False, "restarts": 3, "given_up": True},
        "journal": {"dropped": 0, "problem": "journal stopped: No space left on device"},
        "late": ["tick"],
    }
    rows = {row["part"]: row for row in view(given)["health"]}
    assert {name: row["ok"] for name, row in rows.items()} == dict.fromkeys(("link", "camera", "worker", "disk", "tick"), False)
    assert rows["disk"]["says"] == "journal stopped: No space left on device"
    assert rows["camera"]["says"] == "last frame 31 s ago"


LOAD = {
    "uptime_s": 60.0,
    "cores": [0.5, 0.25],
    "temperature_c": 61.4,
    "ram_used_bytes": 1_200_000_000,
    "ram_total_bytes": 4_000_000_000,
    "storage_used_bytes": 20_000_000_000,
    "storage_total_bytes": 32_300_000_000,
}


@pytest.mark.parametrize(
    ("load", "computer", "disk"),
    [
        ({}, (True, "38 % of 2 cores, 1.2 of 4.0 GB memory, 61 °C"), (True, "journal is written, 12.3 GB free")),
        ({"temperature_c": 91.0}, (False, "38 % of 2 cores, 1.2 of 4.0 GB memory, 91 °C"), (True, None)),
        ({"storage_used_bytes": 32_000_000_000}, (True, None), (False, "journal is written, 0.3 GB free")),
        ({"temperature_c": None, "cores": [], "ram_used_bytes": None}, (None, "not known"), (True, None)),
    ],
)
def test_the_computer_is_told(
    load: dict[str, Any], computer: tuple[bool | None, str | None], disk: tuple[bool, str | None]
) -> None:
    rows = {row["part"]: row for row in view(snapshot() | {"computer": LOAD | load})["health"]}
    for name, (ok, says) in (("computer", computer), ("disk", disk)):
        assert rows[name]["ok"] is ok
        assert says is None or rows[name]["says"] == says


def test_the_page_finds_a_computer_hot_and_full_where_the_doctor_does() -> None:
    assert condition.HOT_C == system.HOT_C
    assert condition.SPARE_BYTES == system.SPARE_DISK_MB * 1e6


def test_a_part_that_hangs_is_not_healthy_whatever_else_is_known_of_it() -> None:
    rows = {row["part"]: row for row in view(snapshot() | {"late": ["worker"]})["health"]}
    assert rows["worker"]["ok"] is False
    assert rows["worker"]["says"].startswith("hangs")


def test_an_alert_is_said() -> None:
    shown = view(snapshot(protection_level_m=90.0, available=False, alert=True))
    assert shown["integrity"]["says"].startswith("ALERT")
    assert shown["integrity"]["available"] is False


def test_before_gnss_was_ever_heard_it_is_waited_for_and_not_lost() -> None:
    assert view(snapshot(verdict="denied", reasons=["no_data"]))["gnss"]["label"] == "waiting"
    assert view(snapshot(verdict="denied", reasons=["silence"]))["gnss"]["label"] == "lost"


def test_a_receiver_without_a_fix_has_no_place_on_the_map() -> None:
    given = snapshot()
    given["gnss"]["fix_type"] = 1
    assert view(given)["gnss"]["lat_deg"] is None
    assert view(given)["gnss"]["fix"] == "no fix"


def test_every_mode_verdict_and_reason_has_its_words() -> None:
    assert set(words.MODES) == {mode.value for mode in Mode}
    assert set(words.VERDICTS) == {verdict.value for verdict in Verdict}
    assert set(words.GNSS_REASONS) == set(gnss_words.WORDS)
    reasons = list(Reason)
    assert set(words.NO_FIX) == {reason.value for reason in reasons[: reasons.index(Reason.GATED)]}
    assert set(words.SOURCES) == {terrain_aiding.METHOD, structure.METHOD}


@pytest.mark.parametrize(
    ("seconds", "said"),
    [(0.04, "0.0 s"), (9.94, "9.9 s"), (9.96, "10 s"), (59.4, "59 s"), (185, "3 min 05 s"), (7800, "2 h 10 min")],
)
def test_spans_are_short(seconds: float, said: str) -> None:
    assert words.span(seconds) == said


ANY = st.recursive(
    st.none() | st.booleans() | st.integers(-(10**400), 10**400) | st.floats() | st.text(max_size=5) | st.just({"float": "inf"}),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=4), inner, max_size=3),
    max_leaves=6,
)


def paths(value: object, at: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    items = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    return [at] * bool(at) + [path for key, inner in items for path in paths(inner, (*at, key))]


def with_changed(path: tuple[Any, ...], value: object) -> dict[str, Any]:
    changed = snapshot()
    inner: Any = changed
    for key in path[:-1]:
        inner = inner[key]
    inner[path[-1]] = value
    return changed


@given(changes=st.tuples(st.sampled_from(paths(SNAPSHOT)), ANY))
def test_no_value_anywhere_in_a_snapshot_breaks_the_view(changes: tuple[tuple[Any, ...], object]) -> None:
    shown = view(with_changed(*changes))
    json.dumps(shown, allow_nan=False)
    History().take(shown)
    metrics_text(shown, 0)
    assert shown["mode"]["label"]


@pytest.mark.parametrize(
    "value",
    [
        None,
        True,
        math.inf,
        -math.inf,
        math.nan,
        10**400,
        -1,
        1e308,
        "text",
        "",
        [],
        {},
        [None, None],
        [[1.0, math.inf], [1.0, 1.0]],
    ],
    ids=repr,
)
def test_no_value_stands_for_another_and_none_breaks_the_view(value: object) -> None:
    for path in paths(SNAPSHOT):
        shown = view(with_changed(path, value))
        json.dumps(shown, allow_nan=False)
        metrics_text(shown, 0)


@given(given=st.dictionaries(st.sampled_from(list(SNAPSHOT)), ANY))
def test_no_snapshot_whatever_breaks_the_view(given: dict[str, Any]) -> None:
    shown = view(given)
    json.dumps(shown, allow_nan=False)
    metrics_text(shown, 0)


@given(age_s=st.floats(0.0, 1e6))
def test_nothing_older_than_the_limit_is_ever_live(age_s: float) -> None:
    assert (view(snapshot(), age_s)["state"] == "live") == ((100.0 + age_s) - 100.0 <= STALE_S)
