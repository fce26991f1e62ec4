"""What the documentation names is there: programs, options, files, rules, targets, settings, reasons, decisions, events."""

from __future__ import annotations

import ast
import re
import tomllib
from pathlib import Path
from typing import get_args

import pytest

from visloc_companion.config import Config, parse_config
from visloc_companion.doctor.rules.registry import RULES
from visloc_companion.errors import Reason
from visloc_companion.types import Command, Event

ROOT = Path(__file__).resolve().parents[2]
DOCS = ROOT / "docs"
PAGES = sorted([ROOT / "README.md", ROOT / "CHANGELOG.md", *DOCS.rglob("*.md"), *ROOT.glob("models/*.md")])
EVERY_PAGE = pytest.mark.parametrize("page", PAGES, ids=lambda page: page.relative_to(ROOT).as_posix())
SECTIONS = "|".join(name for name, field in Config.model_fields.items() if isinstance(field.annotation, type))
GROUPS = "|".join(sorted({rule.id.partition("-")[0] for rule in RULES}))
OF_USERS = {"visloc.toml", "demo-out/visloc.toml", "camera.toml", "gdal_edit.py"}
GONE = {("0017-accelerations-drive-the-filter.md", "core/airspeed.py"), ("0001-types-package.md", "types.py")}
"""Decisions speak of their time."""


def spans_of(page: Path) -> list[str]:
    return re.findall(
        r"`([^`\n]+)`", re.sub(r"^```.*?^```", "", page.read_text(encoding="utf-8"), flags=re.MULTILINE | re.DOTALL)
    )


def module_file(module: str) -> Path:
    path = ROOT / module.replace(".", "/")
    return path / "__main__.py" if path.is_dir() else path.with_suffix(".py")


@EVERY_PAGE
def test_programs_exist_with_these_options(page: Path) -> None:
    for module, arguments in re.findall(
        r"python -m ((?:benchmarks|visloc_companion)[\w.]*)([^`\n]*)", page.read_text(encoding="utf-8")
    ):
        assert module_file(module).is_file(), f"there is no {module}"
        source = module_file(module).read_text(encoding="utf-8")
        for option in re.findall(r"(?<!\S)--[\w-]+", arguments.partition("#")[0]):
            assert f'"{option}"' in source, f"{module} has no option {option}"


@EVERY_PAGE
def test_files_exist(page: Path) -> None:
    there = [file.relative_to(ROOT).as_posix() for room in ROOT.iterdir() if room.name[0] != "." for file in room.rglob("*.*")]
    there += [file.name for file in ROOT.iterdir()]
    for span in spans_of(page):
        for name in re.findall(r"(?<![\w/.-])[\w-]+(?:/[\w.-]+)*\.(?:py|md|toml|parm|service)\b", span):
            known = name in OF_USERS or (page.name, name) in GONE or f"/{name}" in span
            assert known or any(f"/{file}".endswith(f"/{name}") for file in there), f"there is no {name}"


@EVERY_PAGE
def test_rules_exist(page: Path) -> None:
    ids = {rule.id for rule in RULES}
    for span in spans_of(page):
        if re.fullmatch(rf"(?:{GROUPS})(?:-[a-z0-9]+)+", span):
            assert span in ids, f"the doctor has no rule {span}"


@EVERY_PAGE
def test_targets_exist(page: Path) -> None:
    targets = re.findall(r"^([a-z-]+):", (ROOT / "Makefile").read_text(encoding="utf-8"), re.MULTILINE)
    commands = re.findall(r"(?:^|`)make ([a-z-]+)(?=`|\s+#|$)", page.read_text(encoding="utf-8"), re.MULTILINE)
    assert set(commands) <= set(targets)


@EVERY_PAGE
def test_settings_are_valid(page: Path) -> None:
    for span in spans_of(page):
        if re.match(rf"(?:{SECTIONS})\.[a-z_0-9]+ = ", span):
            parse_config(tomllib.loads(span))
    for block in re.findall(r"^```toml\n(.*?)^```", page.read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL):
        data = tomllib.loads(block)
        if set(data) <= set(Config.model_fields):
            parse_config(data)


@EVERY_PAGE
def test_extras_exist(page: Path) -> None:
    extras = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["optional-dependencies"]
    named = re.findall(r"visloc-companion\[([\w,]+)\]", page.read_text(encoding="utf-8"))
    assert {extra for group in named for extra in group.split(",")} <= set(extras)


def test_every_reason_for_which_there_is_no_fix_is_explained() -> None:
    reasons = list(Reason)
    unanswered = reasons[: reasons.index(Reason.GATED)]
    section = (DOCS / "troubleshooting.md").read_text(encoding="utf-8").split("## No fixes")[1].split("\n## ")[0]
    assert [reason.value for reason in unanswered if f"`{reason}`" not in section] == []


def texts_of(source: Path) -> list[list[str]]:
    """The literal parts of each text for the operator: long enough to be found among other words."""
    texts = []
    for node in ast.walk(ast.parse(source.read_text(encoding="utf-8"))):
        parts = node.values if isinstance(node, ast.JoinedStr) else [node]
        words = [str(part.value) for part in parts if isinstance(part, ast.Constant) and isinstance(part.value, str)]
        if words and words[0].startswith("visloc: "):
            pieces = "{}".join([words[0].removeprefix("visloc: "), *words[1:]]).split("{}")
            texts.append([piece.strip() for piece in pieces if len(piece.strip()) > 6])
    return texts


def test_texts_for_the_operator_are_explained() -> None:
    pages = "\n".join(page.read_text(encoding="utf-8") for page in DOCS.glob("*.md"))
    sources = [file for room in ("core", "app", "adapters/mavlink") for file in (ROOT / "visloc_companion" / room).rglob("*.py")]
    texts = [parts for source in sources for parts in texts_of(source)]
    assert len(texts) > 30
    assert [parts for parts in texts if any(part not in pages for part in parts)] == []


def test_the_architecture_names_every_event_and_command() -> None:
    page = (DOCS / "architecture.md").read_text(encoding="utf-8")
    section = page.split("## Events and commands")[1].split("\n## ")[0]
    assert [
        kind.__name__ for kind in get_args(Event) + get_args(Command) if not re.search(rf"\b{kind.__name__}\b", section)
    ] == []


def test_the_architecture_names_the_layers_that_are_checked() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    layers = next(contract["layers"] for contract in project["tool"]["importlinter"]["contracts"] if contract["id"] == "layers")
    assert f"`{' > '.join(layers)}`" in (DOCS / "architecture.md").read_text(encoding="utf-8")


@pytest.mark.parametrize("name", ["image", "structure", "navigation"])
def test_the_benchmarks_name_what_their_pages_hold(name: str) -> None:
    page = (DOCS / "benchmarks.md").read_text(encoding="utf-8")
    headings = re.findall(r"^## (.+)$", (DOCS / "benchmarks" / f"{name}.md").read_text(encoding="utf-8"), re.MULTILINE)
    [row] = re.findall(rf"^\| \[.+\]\(benchmarks/{name}\.md\) \| (.+) \|$", page, re.MULTILINE)
    assert row.endswith(", ".join(headings))


def test_decisions_are_listed_in_order_for_a_list_counts_by_itself() -> None:
    folder = DOCS / "decisions"
    listed = re.findall(
        r"^(\d+)\. \[[^\]]+\]\((\d{4}-[\w-]+\.md)\)", (folder / "README.md").read_text(encoding="utf-8"), re.MULTILINE
    )
    assert [int(number) for number, _ in listed] == list(range(1, len(listed) + 1))
    assert [name for _, name in listed] == sorted(file.name for file in folder.glob("[0-9]*.md"))


def test_no_change_is_told_twice() -> None:
    """Two lines with an older and a newer figure of one thing stood below each other."""
    begins = [line[:100] for line in (ROOT / "CHANGELOG.md").read_text(encoding="utf-8").splitlines() if len(line) > 100]
    assert sorted(begins) == sorted(set(begins))


def test_the_readme_lists_every_page() -> None:
    listed = set(
        re.findall(r"\]\((docs/[\w-]+\.md)\)", (ROOT / "README.md").read_text(encoding="utf-8").split("## Documentation")[1])
    )
    assert listed == {f"docs/{page.name}" for page in DOCS.glob("*.md")}


def test_figures_at_a_glance_count_the_flights_of_the_scenarios() -> None:
    kept, flown = re.findall(r"^(\d+) of (\d+) flights", (DOCS / "scenarios.md").read_text(encoding="utf-8"), re.MULTILINE)[0]
    assert f"| {flown} flights of the scenarios | as each expects | {kept} of {flown} |" in (DOCS / "benchmarks.md").read_text(
        encoding="utf-8"
    )
