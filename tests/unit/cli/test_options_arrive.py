"""Options that are but passed on: what the function that does the work is given."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from visloc_companion.adapters.mavlink import operator_call
from visloc_companion.cli.main import app
from visloc_companion.doctor import examine
from visloc_companion.evaluate.clouds import cloud
from visloc_companion.evaluate.images import image, map_sigma


class Asked(Exception):
    """Ends a command where its work would begin."""


def given(monkeypatch: pytest.MonkeyPatch, module: object, name: str, *command: str) -> tuple[tuple[Any, ...], dict[str, Any]]:
    """The arguments that a command gives to a function."""
    calls: list[tuple[tuple[Any, ...], dict[str, Any]]] = []

    def note(*arguments: Any, **named: Any) -> None:
        calls.append((arguments, named))
        raise Asked

    monkeypatch.setattr(module, name, note)
    ran = CliRunner().invoke(app, list(command))
    assert isinstance(ran.exception, Asked), ran.output
    return calls[0]


def test_the_doctor_waits_and_measures_as_long_as_it_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    (wishes,), _ = given(
        monkeypatch, examine, "examine", "doctor", "--link", "udpin:127.0.0.1:0", "--wait", "90", "--seconds", "20"
    )
    assert (wishes.wait_s, wishes.seconds) == (90.0, 20.0)


def test_a_daemon_of_another_component_is_called_by_that(monkeypatch: pytest.MonkeyPatch) -> None:
    place = "47.0,8.0"
    arguments, _ = given(
        monkeypatch, operator_call, "say_here", "here", place, "--link", "udpin:127.0.0.1:0", "--component", "198"
    )
    assert arguments[3].component_id == 198


def test_cases_of_images_know_of_the_maps_error(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    (tmp_path / "cases.csv").write_text("id\n", encoding="utf-8")
    options = ("--map-sigma-m", "0.4,0.8", "--map-sigma-h-m", "2.5", "--provider", "cuda", "--provider", "cpu")
    _, named = given(monkeypatch, image, "evaluate_image", "evaluate", "image", str(tmp_path), *options)
    assert named["map_sigma"] == map_sigma.stated("0.4,0.8", 2.5)
    assert named["map_sigma"] != map_sigma.stated(None, None)
    assert named["network"].providers == ("cuda", "cpu")


def test_only_the_first_cases_of_clouds_are_judged(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    (tmp_path / "cases.json").write_text("[]", encoding="utf-8")
    options = ("--limit", "3", "--jobs", "2", "--method", "gicp")
    (folder, method, jobs, limit, _), _ = given(
        monkeypatch, cloud, "evaluate_cloud", "evaluate", "cloud", str(tmp_path), *options
    )
    assert (folder, method, jobs, limit) == (tmp_path, "gicp", 2, 3)
