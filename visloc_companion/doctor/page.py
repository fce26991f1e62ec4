"""Writes the table of rules into docs/doctor.md: `python -m visloc_companion.doctor.page docs/doctor.md`."""

from __future__ import annotations

import sys
from pathlib import Path

from visloc_companion.doctor.finding import Rule
from visloc_companion.doctor.rules.registry import RULES, THEMES

BEGIN, END = "<!-- rules: begin -->", "<!-- rules: end -->"


def render() -> str:
    """The tables of all rules as Markdown."""
    parts = [f"{len(RULES)} rules.", ""]
    for theme, rules in THEMES.items():
        parts += [f"### {theme}", "", "| rule | looks at | why it matters | remedy |", "|---|---|---|---|", *map(_row, rules), ""]
    return "\n".join(parts).strip()


def _row(rule: Rule) -> str:
    looks, why, remedy = (text.replace("|", "\\|") for text in (rule.reads, rule.why, rule.remedy))
    return f"| `{rule.id}` | {looks} | {why} | {remedy} |"


def update(page: str) -> str:
    """A page with its tables made anew. Raises ValueError where it has no place for them."""
    before, found, rest = page.partition(BEGIN)
    _, ended, after = rest.partition(END)
    if not found or not ended:
        raise ValueError(f"the page lacks {BEGIN} or {END}")
    return f"{before}{BEGIN}\n\n{render()}\n\n{END}{after}"


if __name__ == "__main__":
    path = Path(sys.argv[1])
    path.write_text(update(path.read_text(encoding="utf-8")), encoding="utf-8")
