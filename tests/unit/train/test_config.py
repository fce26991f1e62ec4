from __future__ import annotations

import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from visloc_companion.errors import ConfigError
from visloc_companion.train.config import TrainingConfig, load_training_config, parse_training_config
from visloc_companion.train.config_sources import DatesSource, LandscapeSource, PairsSource, share_images

SHIPPED = Path(__file__).resolve().parents[3] / "models" / "features.toml"
SHAPES = {"kind": "shapes", "name": "shapes"}
LEAST: dict[str, Any] = {"sources": [SHAPES], "validation": {"sources": [SHAPES]}}


def problem_of(**changes: Any) -> str:
    with pytest.raises(ConfigError) as caught:
        parse_training_config({**LEAST, **changes}, where="own.toml")
    assert caught.value.where == "own.toml"
    return caught.value.what


def test_the_shipped_configuration_is_valid_and_trains_on_no_held_out_row() -> None:
    config = load_training_config(SHIPPED)
    every = [*config.sources, *config.validation.sources]
    assert all(source.last_row <= 400 for source in every if isinstance(source, DatesSource))
    assert {source.folder for source in every if isinstance(source, DatesSource | PairsSource)} <= {"naip", "bitemporal"}
    trained, checked = (
        {seed for source in sources if isinstance(source, LandscapeSource) for seed in source.seeds}
        for sources in (config.sources, config.validation.sources)
    )
    assert not trained & checked


DATES: dict[str, Any] = {"kind": "dates", "name": "d", "folder": "d"}
PAIRS: dict[str, Any] = {"kind": "pairs", "name": "p", "folder": "p"}
LANDSCAPE: dict[str, Any] = {"kind": "landscape", "name": "l", "seeds": [1, 2]}


@pytest.mark.parametrize(
    ("trained", "checked", "shared"),
    [
        (DATES | {"last_row": 400}, DATES | {"first_row": 400}, False),
        (DATES | {"last_row": 400}, DATES | {"first_row": 399}, True),
        (DATES, DATES | {"folder": "e"}, False),
        (DATES, DATES | {"folder": "./d/"}, True),
        (PAIRS | {"folder": "p/"}, PAIRS, True),
        (PAIRS | {"pairs": ["x"]}, PAIRS | {"pairs": ["y", "z"]}, False),
        (PAIRS | {"pairs": ["x"]}, PAIRS | {"pairs": ["y", "x"]}, True),
        (PAIRS, PAIRS | {"pairs": ["y"]}, True),
        (LANDSCAPE, LANDSCAPE | {"seeds": [3]}, False),
        (LANDSCAPE, LANDSCAPE | {"seeds": [2, 3], "size_m": 300}, True),
        (LANDSCAPE, DATES, False),
        (SHAPES, SHAPES, False),
    ],
)
def test_sources_that_share_images_are_told(trained: dict[str, Any], checked: dict[str, Any], shared: bool) -> None:
    config = parse_training_config({"sources": [trained], "validation": {"sources": [checked]}}, where="own.toml")
    assert share_images(config.validation.sources[0], config.sources[0]) is shared


def test_the_shipped_configuration_states_every_default_that_matters() -> None:
    data = tomllib.loads(SHIPPED.read_text(encoding="utf-8"))
    for section in ("network", "pairs", "schedule"):
        assert data[section].keys() == TrainingConfig.model_fields[section].default.model_dump().keys()


def test_plain_data_comes_back_as_the_same_configuration(tiny: Callable[..., TrainingConfig]) -> None:
    config = tiny(seed=7)
    assert parse_training_config(config.plain(), "checkpoint") == config


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({"seeed": 1}, "seeed: unknown key, did you mean 'seed'?"),
        ({"network": {"full_widht": 8}}, "network.full_widht: unknown key, did you mean 'full_width'?"),
        ({"sources": [{**SHAPES, "shares": 1.0}]}, "sources.0.shapes.shares: unknown key, did you mean 'share'?"),
        ({"sources": [{"kind": "landscap", "name": "x"}]}, "'landscape'"),
        ({"sources": [{"name": "x"}]}, "sources.0: Unable to extract tag"),
        ({"sources": [{"kind": "dates", "name": "x"}]}, "sources.0.dates.folder: is missing"),
        ({"sources": [SHAPES, SHAPES]}, "two have the same name"),
        ({"sources": [{**SHAPES, "scales": [2.0, 1.0]}]}, "scales: the first must not exceed"),
        ({"pairs": {"windows_px": [50]}}, "multiple of 4"),
        ({"pairs": {"reference_px": 64, "windows_px": [60]}}, "8 px smaller"),
        ({"schedule": {"check_every": 75}}, "multiple of log_every"),
        ({"schedule": {"batch": 1}}, "schedule.batch"),
        ({"seed": 1.5}, "seed: "),
    ],
)
def test_what_is_wrong_is_named(changes: dict[str, Any], expected: str) -> None:
    assert expected in problem_of(**changes)


def test_a_list_is_not_called_too_short_for_an_item_that_is_wrong() -> None:
    assert "at least 1 item" not in problem_of(sources=[{"kind": "shapes"}])
    assert "at least 1 item" in problem_of(sources=[])


@pytest.mark.parametrize("content", [None, b"\xff\xfe", b"seed = ", b"seed = 1"])
def test_files_that_are_no_configuration(tmp_path: Path, content: bytes | None) -> None:
    path = tmp_path / "own.toml"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(ConfigError, match=r"own\.toml.*remedy"):
        load_training_config(path)
