from __future__ import annotations

import subprocess
import sys

import pytest
from typer.testing import CliRunner

from visloc_companion.cli.main import app
from visloc_companion.errors import ConfigError
from visloc_companion.train import extra


@pytest.mark.parametrize(
    "words",
    [
        ["features", "--config", "own.toml", "--out", "run"],
        ["export", "--checkpoint", "checkpoint.pt", "--name", "own", "--out", "models/own"],
    ],
)
def test_without_the_extra_the_command_says_what_to_install(monkeypatch: pytest.MonkeyPatch, words: list[str]) -> None:
    monkeypatch.setattr(extra, "find_spec", lambda name: None if name == "torch" else object())
    result = CliRunner().invoke(app, ["train", *words])
    assert isinstance(result.exception, ConfigError)
    assert result.exception.what == "needs torch"
    assert "visloc-companion[train]" in result.exception.remedy


def test_help_loads_nothing_heavy() -> None:
    heavy = {"torch", "onnx", "onnxscript", "onnxruntime", "cv2", "numpy", "rasterio"}
    code = f"import sys, visloc_companion.cli.main; print(sorted({heavy!r} & sys.modules.keys()))"
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.strip() == "[]"
