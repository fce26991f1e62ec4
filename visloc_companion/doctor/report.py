"""What the doctor prints: a table for people, JSON for programs."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from typing import Any

from rich import box
from rich.table import Table
from rich.text import Text

from visloc_companion.doctor.examine import Report
from visloc_companion.doctor.finding import Judged, Level
from visloc_companion.types import AutopilotKind

SCHEMA = 1
NARROW = 72
"""Columns below which the answers are listed."""
STYLES = {Level.RED: "bold red", Level.AMBER: "yellow", Level.GREEN: "green", Level.SKIPPED: "dim"}


def as_json(report: Report) -> dict[str, Any]:
    """The result in the fixed form; every rule is in it, also those that were skipped."""
    return {
        "schema": SCHEMA,
        "autopilot": str(report.facts.autopilot),
        "version": report.facts.version,
        "rules": [
            {"id": a.rule.id, "level": str(a.level), "read": a.read, "why": a.rule.why, "remedy": a.remedy} for a in report.judged
        ],
    }


def table(report: Report, everything: bool) -> Table:
    """Worst first. Rules of the other autopilot are left out; skipped ones, too, unless `everything` is wished."""
    rows = Table(box=box.SIMPLE_HEAD, show_lines=False, pad_edge=False)
    for title in ("", "rule", "read", "remedy"):
        rows.add_column(title, overflow="fold")
    for answer in _shown(report, everything):
        more = "\n".join(_advice(answer))
        rows.add_row(Text(str(answer.level), style=STYLES[answer.level]), Text(answer.rule.id), Text(answer.read), Text(more))
    return rows


def listed(report: Report, everything: bool) -> Iterator[Text]:
    """The same for narrow terminals, in which a table's columns would break every word."""
    for answer in _shown(report, everything):
        yield Text.assemble((str(answer.level), STYLES[answer.level]), f" {answer.rule.id}: {answer.read}")
        for words in _advice(answer):
            yield Text(f"- {words}")


def _shown(report: Report, everything: bool) -> Iterator[Judged]:
    for answer in report.judged:
        if answer.level is not Level.SKIPPED or (everything and not _of_another(answer, report)):
            yield answer


def _advice(answer: Judged) -> list[str]:
    """The remedy, and of what is bad why it matters."""
    why = [answer.rule.why] if answer.level in (Level.RED, Level.AMBER) else []
    return [words for words in (answer.remedy, *why) if words]


def summary(report: Report) -> str:
    """One line: how many of each level."""
    counts = Counter(answer.level for answer in report.judged if not _of_another(answer, report))
    of = " ".join(part for part in (str(report.facts.autopilot), report.facts.version) if part)
    if report.facts.autopilot is AutopilotKind.UNKNOWN:
        of = "no autopilot" if report.facts.link is None else "neither ArduPilot nor PX4"
    numbers = ", ".join(f"{counts[level]} {level}" for level in (Level.RED, Level.AMBER, Level.GREEN, Level.SKIPPED))
    return f"{of}: {numbers}"


def is_red(report: Report) -> bool:
    """Whether a rule is red: then nothing should fly."""
    return any(answer.level is Level.RED for answer in report.judged)


def _of_another(answer: Judged, report: Report) -> bool:
    return answer.rule.only is not None and answer.rule.only is not report.facts.autopilot
