"""The pages are in step with the rules: the table, every id that is named, and what finds each symptom."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from visloc_companion.doctor.page import update
from visloc_companion.doctor.rules.registry import RULES

DOCS = Path(__file__).resolve().parents[3] / "docs"
NAMED = r"`((?:ap|px4|link|camera|map|model|system|config|firmware)-[a-z0-9-]+)`"


def text_of(name: str) -> str:
    return (DOCS / name).read_text(encoding="utf-8")


def test_the_table_is_current() -> None:
    page = text_of("doctor.md")
    assert page == update(page), "python -m visloc_companion.doctor.page docs/doctor.md"


def test_a_page_without_a_place_for_the_table_is_refused() -> None:
    with pytest.raises(ValueError, match="lacks"):
        update("# nothing")


@pytest.mark.parametrize("name", ["doctor.md", "ardupilot.md", "px4.md", "troubleshooting.md"])
def test_rules_that_are_named_exist(name: str) -> None:
    named = set(re.findall(NAMED, text_of(name)))
    assert named
    assert named <= {rule.id for rule in RULES}


def test_the_symptoms_name_rules() -> None:
    """Each section about positions or the link says which rule finds it."""
    sections = re.split(r"^## ", text_of("troubleshooting.md"), flags=re.MULTILINE)[1:]
    about = {section.splitlines()[0]: section for section in sections}
    for title in (
        "Positions are sent but not fused",
        "Positions come late",
        "The vehicle jumps when vision begins",
        "The source does not switch",
        "It does not arm",
        "No origin",
        "Messages do not arrive",
    ):
        assert re.search(NAMED, about[title]), title
