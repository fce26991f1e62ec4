"""`visloc evaluate` that somebody ends: what was done is written and told, and marked as not all."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from tests.unit.evaluate.clouds.test_cloud_cases import folder as cloud_folder  # noqa: F401 - a fixture
from tests.unit.evaluate.test_image_cases import folder as image_folder  # noqa: F401 - a fixture
from visloc_companion.cli.evaluate import evaluate_app
from visloc_companion.evaluate.clouds import cloud
from visloc_companion.evaluate.images import image

N_DONE = 2


def broken_off_after(n: int, real: Any, why: BaseException) -> Any:
    def run(*arguments: Any) -> Iterator[Any]:
        for number, result in enumerate(real(*arguments)):
            if number == n:
                raise why
            yield result

    return run


@pytest.mark.parametrize(("why", "code"), [(KeyboardInterrupt(), 130), (SystemExit(143), 143)], ids=["Ctrl-C", "SIGTERM"])
@pytest.mark.parametrize("kind", ["image", "cloud"])
def test_what_was_done_until_then_is_written(
    kind: str, why: BaseException, code: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, request: pytest.FixtureRequest
) -> None:
    """An hour of cases was gone without a word."""
    folder = request.getfixturevalue(f"{kind}_folder")
    module, name = (image, "run_cases") if kind == "image" else (cloud, "run_all")
    monkeypatch.setattr(module, name, broken_off_after(N_DONE, getattr(module, name), why))
    out, report = tmp_path / "out.json", tmp_path / "report"
    how = ["--method", "ncc"] if kind == "image" else []
    ended = CliRunner().invoke(evaluate_app, [kind, str(folder), *how, "--json", str(out), "--report", str(report)])
    assert ended.exit_code == code
    told = json.loads(out.read_text(encoding="utf-8"))
    assert (told["complete"], len(told["cases"])) == (False, N_DONE)
    assert told["asked"] > N_DONE
    assert f"BROKEN OFF: {N_DONE} of {told['asked']} cases" in ended.stderr
    assert "n_fix" in ended.stdout or "answered" in ended.stdout
    assert (report / "report.html").exists()


@pytest.mark.parametrize("kind", ["image", "cloud"])
def test_before_the_first_case_there_is_nothing_to_write(
    kind: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, request: pytest.FixtureRequest
) -> None:
    folder = request.getfixturevalue(f"{kind}_folder")
    module, name = (image, "run_cases") if kind == "image" else (cloud, "run_all")
    monkeypatch.setattr(module, name, broken_off_after(0, getattr(module, name), SystemExit(143)))
    ended = CliRunner().invoke(evaluate_app, [kind, str(folder), "--json", str(tmp_path / "out.json")])
    assert ended.exit_code == 143
    assert not list(tmp_path.glob("out*"))
