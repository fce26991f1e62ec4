"""Every option of every command stands on a page: one that users would have to find by --help alone is as good as not there."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from tests.unit.test_docs import COMMANDS, DOCS, ROOT, command_and_arguments, commands_of, text_of

PAGES = sorted([ROOT / "README.md", *DOCS.glob("*.md"), *DOCS.glob("benchmarks/*.md")])
"""Those that say how things are used: neither decisions, which speak of their time, nor the list of changes."""
OF_ALL = {"--help", "-h"}


def options(command: Any, path: str) -> Iterator[tuple[str, tuple[str, ...]]]:
    """Each command's path and the names of one of its options."""
    for param in command.params:
        if param.param_type_name == "option" and not OF_ALL & set(param.opts):
            yield path, tuple(param.opts)
    for name, below in getattr(command, "commands", {}).items():
        yield from options(below, f"{path} {name}")


def used(page: Path) -> set[tuple[str, str]]:
    """Which options of which commands a page uses in a command, or names beside one in a code span of their own."""
    found, paths = set(), set()
    for words in commands_of(page):
        _, rest, path = command_and_arguments(words)
        paths.add(path)
        found |= {(path, word) for word in rest if word.startswith("-")}
    prose = re.sub(r"^```.*?^```", "", text_of(page), flags=re.MULTILINE | re.DOTALL)
    alone = {option for span in re.findall(r"`(-[^`\n]*)`", prose) for option in re.findall(r"(?<!\S)--?[a-z][\w-]*", span)}
    return found | {(path, option) for path in paths for option in alone}


USED = {pair for page in PAGES for pair in used(page)}


@pytest.mark.parametrize(("path", "names"), list(options(COMMANDS, "visloc")), ids=str)
def test_every_option_stands_on_a_page(path: str, names: tuple[str, ...]) -> None:
    if path == "visloc":
        assert any(f"`visloc {name}`" in text_of(page) for page in PAGES for name in names)
    else:
        assert any((path, name) in USED for name in names), f"{path} {names[0]} stands on no page"
