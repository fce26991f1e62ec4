"""Methods are listed; an unknown method and a missing folder are named with the remedy."""

from pathlib import Path

import pytest

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
