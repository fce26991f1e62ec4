"""Methods are listed; an unknown method and a missing folder are named with the remedy."""

from pathlib import Path

import pytest
from typer.testing import CliRunner

from visloc_companion.cli.evaluate import evaluate_app
from visloc_companion.cli.evaluate_choice import chosen_cases
from visloc_companion.errors import ConfigError

METHODS = ("near", "far")
EXAMPLE = "visloc evaluate image FOLDER (with cases.csv)"


def test_the_folder_that_is_named_is_taken(capsys: pytest.CaptureFixture[str]) -> None:
    assert chosen_cases(Path("cases"), "far", METHODS, False, EXAMPLE) == Path("cases")
    assert capsys.readouterr().out == ""


def test_methods_are_listed_whatever_else_is_asked(capsys: pytest.CaptureFixture[str]) -> None:
    assert chosen_cases(None, "psychic", METHODS, True, EXAMPLE) is None
    assert capsys.readouterr().out == "near\nfar\n"


@pytest.mark.parametrize(
    ("cases", "method", "words"),
    [
        (Path("cases"), "psychic", "--method: unknown method 'psychic'; remedy: use one of near, far"),
        (None, "near", f"CASES: no folder named; remedy: {EXAMPLE}"),
    ],
)
def test_what_is_missing_is_said_with_the_remedy(cases: Path | None, method: str, words: str) -> None:
    with pytest.raises(ConfigError) as refused:
        chosen_cases(cases, method, METHODS, False, EXAMPLE)
    assert str(refused.value) == words


@pytest.mark.parametrize("option", ["--model", "--provider"])
def test_a_network_is_chosen_for_methods_that_have_one(option: str, tmp_path: Path) -> None:
    """A folder that there is not, and a provider that cannot be used, went by without a word."""
    ended = CliRunner().invoke(evaluate_app, ["image", str(tmp_path), "--method", "gradient", option, "cuda"])
    assert isinstance(ended.exception, ConfigError)
    assert str(ended.exception).startswith(f"{option}: means nothing with --method gradient")
