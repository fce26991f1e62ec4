from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from visloc_companion.cli.main import app
from visloc_companion.cli.train import duration

TINY = """
threads = 1
[network]
full_width = 4
half_width = 4
dilations = [1]
descriptors = 2
[pairs]
reference_px = 48
windows_px = [24]
[schedule]
steps = 2
batch = 2
log_every = 1
check_every = 1
[[sources]]
kind = "shapes"
name = "shapes"
[validation]
batch = 2
windows_px = [24]
[[validation.sources]]
kind = "shapes"
name = "shapes"
"""


def test_a_run_tells_how_it_goes_and_what_comes_next(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("torch", reason="PyTorch is not installed: make install-train")
    from visloc_companion.train import run

    (tmp_path / "own.toml").write_text(TINY, encoding="utf-8")
    words = ["train", "features", "--config", str(tmp_path / "own.toml"), "--out", str(tmp_path / "run")]
    learn, steps = run.training_loss, []

    def broken_off(*given: Any) -> Any:
        steps.append(given)
        if len(steps) == 2:
            raise KeyboardInterrupt
        return learn(*given)

    with monkeypatch.context() as patch:
        patch.setattr(run, "training_loss", broken_off)
        stopped = CliRunner().invoke(app, words)
    assert stopped.exit_code == 130
    assert "the same command goes on" in stopped.stderr
    done = CliRunner().invoke(app, words)
    assert done.exit_code == 0, done.stderr
    assert "step 2 of 2: loss" in done.stderr
    assert "placed wrong: shapes" in done.stderr
    assert "visloc train export --checkpoint" in done.stdout


@pytest.mark.parametrize("name", ["a/b", "", "_a", "-", "ä", "a\n"])
def test_a_name_that_is_none_is_told_at_once(tmp_path: Path, name: str) -> None:
    pytest.importorskip("torch", reason="PyTorch is not installed: make install-train")
    words = ["train", "export", "--checkpoint", "checkpoint.pt", f"--name={name}", "--out", str(tmp_path)]
    assert f"{name!r} is no name" in str(CliRunner().invoke(app, words).exception)


@pytest.mark.parametrize(("seconds", "words"), [(12.3, "12 s"), (90, "0 h 02 min"), (7320, "2 h 02 min")])
def test_durations(seconds: float, words: str) -> None:
    assert duration(seconds) == words
