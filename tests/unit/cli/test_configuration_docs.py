"""The configuration page is the one that the models make, and every key explains itself."""

from __future__ import annotations

import re
from pathlib import Path

from visloc_companion.cli.configuration_docs import render

PAGE = Path(__file__).resolve().parents[3] / "docs" / "configuration.md"


def test_page_is_current() -> None:
    assert PAGE.read_text(encoding="utf-8") == render()


def test_every_key_has_a_meaning() -> None:
    rows = [line for line in render().splitlines() if line.startswith("| `")]
    assert len(rows) > 50
    assert [row for row in rows if re.search(r"\|\s*\|$", row)] == []
