"""Numbers on the command line: none that is no number, none without end."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest
from typer.main import get_command
from typer.testing import CliRunner

from visloc_companion.cli.main import app
from visloc_companion.errors import ConfigError

CHECKED_BY_THEIR_COMMAND = {("run", "--sigma"), ("here", "--sigma"), ("map build", "--ground-height-m")}
CHECKED_WITH_THE_HEIGHTS = {("map build", "--geoid-undulation-m")}
"""prepare/surface.py, once it is known whether the heights are ellipsoidal."""


def commands(one: Any, path: tuple[str, ...] = ()) -> Iterator[tuple[str, Any]]:
    for name, sub in getattr(one, "commands", {}).items():
        yield from commands(sub, (*path, name))
    if not hasattr(one, "commands"):
        yield " ".join(path), one


COMMANDS = dict(commands(get_command(app)))
NUMBERS = {
    (path, param.opts[0]): param
    for path, command in COMMANDS.items()
    for param in command.params
    if "float" in str(param.type_descriptor.annotation)
}
"""The options that take a float."""
BOUNDED = sorted(key for key, param in NUMBERS.items() if param.min is not None and param.max is not None)


def required(path: str) -> list[str]:
    """What a command cannot do without: files that are not there."""
    words: list[str] = []
    for param in COMMANDS[path].params:
        if param.required:
            words += [*([] if param.param_type_name == "argument" else [param.opts[0]]), "/nowhere"]
    return words


def test_every_number_has_a_least_and_a_greatest_value() -> None:
    assert len(BOUNDED) >= 9
    assert NUMBERS.keys() - BOUNDED == CHECKED_BY_THEIR_COMMAND | CHECKED_WITH_THE_HEIGHTS


@pytest.mark.parametrize("key", BOUNDED, ids=" ".join)
def test_what_is_no_finite_number_is_refused_by_the_options_name(key: tuple[str, str]) -> None:
    path, option = key
    for value in ("nan", "inf", "-inf", "1e400"):
        result = CliRunner().invoke(app, [*path.split(), *required(path), option, value])
        assert result.exit_code == 2
        assert f"Invalid value for '{option}'" in result.output


@pytest.mark.parametrize("value", ["nan", "inf", "-inf"])
@pytest.mark.parametrize(
    "words",
    [
        ("here", "47,8", "--link", "udpout:127.0.0.1:9", "--sigma"),
        ("map", "build", "--ortho", "/nowhere", "--out", "/nowhere", "--ground-height-m"),
    ],
    ids=lambda words: words[-1],
)
def test_commands_that_look_at_a_number_themselves_name_it(words: tuple[str, ...], value: str) -> None:
    result = CliRunner().invoke(app, [*words, value])
    assert isinstance(result.exception, ConfigError)
    assert words[-1] in str(result.exception) and "remedy" in str(result.exception)
