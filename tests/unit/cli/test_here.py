"""`visloc here`: what goes to the vehicle, and what a person reads."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from visloc_companion.adapters.mavlink import operator_call
from visloc_companion.adapters.mavlink.signing_key import read_key, write_key
from visloc_companion.cli.main import app
from visloc_companion.errors import ConfigError

PLACE = "47.0123,8.4567"
TAKEN = "visloc: position taken, looking there"


def call(
    monkeypatch: pytest.MonkeyPatch, answer: str, *options: str, place: str = PLACE
) -> tuple[int, str, list[tuple[Any, ...]]]:
    asked: list[tuple[Any, ...]] = []

    async def say_here(*arguments: Any) -> str:
        asked.append(arguments)
        return answer

    monkeypatch.setattr(operator_call, "say_here", say_here)
    ran = CliRunner().invoke(app, ["here", place, "--link", "udpin:127.0.0.1:14550", *options], catch_exceptions=False)
    return ran.exit_code, ran.output, asked


@pytest.mark.parametrize(
    ("answer", "shown", "code"),
    [
        (TAKEN, f"{TAKEN}\n", 0),
        ("visloc: position refused, far from the fixes", "visloc: position refused, far from the fixes\n", 4),
    ],
)
def test_the_daemons_answer_is_shown(monkeypatch: pytest.MonkeyPatch, answer: str, shown: str, code: int) -> None:
    exit_code, output, ((url, place, sigma_m, caller, *_),) = call(monkeypatch, answer, "--sigma", "20", "--system", "252")
    assert (exit_code, output) == (code, shown)
    assert (url, place.lat_deg, place.lon_deg, sigma_m) == ("udpin:127.0.0.1:14550", 47.0123, 8.4567, 20.0)
    assert (caller.system_id, caller.component_id, caller.signing) == (252, 197, None)


@pytest.mark.parametrize("place", ["-33.4567,-70.6543", "-0.5,36.8"])
def test_places_south_of_the_equator_are_no_options(monkeypatch: pytest.MonkeyPatch, place: str) -> None:
    exit_code, _, ((_, said, *_),) = call(monkeypatch, TAKEN, place=place)
    assert (exit_code, f"{said.lat_deg},{said.lon_deg}") == (0, place)


def test_a_place_that_is_none_is_named_as_it_was_given(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(ConfigError, match=r"LAT,LON: '97,8' is no place to fly; remedy: write LAT,LON in degrees") as refused:
        call(monkeypatch, TAKEN, place="97,8")
    assert "--at" not in str(refused.value)


def test_a_mistyped_option_is_still_refused() -> None:
    ran = CliRunner().invoke(app, ["here", PLACE, "--link", "udpin:127.0.0.1:0", "--sgima", "20"])
    assert ran.exit_code == 2
    assert "--sgima" in ran.output


def test_a_key_signs_it(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    write_key(tmp_path / "key")
    _, _, ((*_, caller, _opener),) = call(monkeypatch, TAKEN, "--key", str(tmp_path / "key"))
    assert caller.signing.key == read_key(tmp_path / "key")
    assert caller.signing.stamp_at_zero > 0


def test_what_is_no_place_is_said_before_anything_is_sent() -> None:
    with pytest.raises(ConfigError, match="no latitude and longitude"):
        CliRunner().invoke(app, ["here", "north", "--link", "udpin:127.0.0.1:0"], catch_exceptions=False)
