"""docs/dashboard.md names what there is: metrics, fields of /api/status and of the daemon's snapshot."""

from __future__ import annotations

import re
from pathlib import Path

from tests.unit.web.snapshots import SNAPSHOT, snapshot
from visloc_companion.web.heard import Heard
from visloc_companion.web.metrics import COUNTERS, GAUGES, metrics_text
from visloc_companion.web.view import Origin, view_of

PAGE = (Path(__file__).parents[3] / "docs" / "dashboard.md").read_text(encoding="utf-8")
VIEW = view_of(Heard(snapshot(), 0.0), Origin("s"), 0.0)


def test_every_metric_is_described_and_there() -> None:
    given = set(re.findall(r"^# TYPE (\w+)", metrics_text(VIEW, 0).decode(), re.MULTILINE))
    assert given >= {name for name, _, _ in GAUGES} | {f"{name}_total" for name, _, _ in COUNTERS}
    assert set(re.findall(r"`(visloc_\w+)(?:\{\w+\})?`", PAGE)) == given


def test_every_field_of_the_view_and_of_the_snapshot_is_named() -> None:
    of_programs = PAGE.split("## For programs")[1]
    view, socket = of_programs.split("`/metrics` is")[0], of_programs.split("The daemon's socket itself")[1]
    assert [name for name in VIEW if f"`{name}`" not in view and name != "stale_after_s"] == []
    assert [name for name in SNAPSHOT if f"`{name}`" not in socket and name not in ("schema", "t_ns")] == []
