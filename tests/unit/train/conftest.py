"""A training that takes a second: invented shapes, a network of a few hundred weights."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import pytest

from visloc_companion.train.config import TrainingConfig, parse_training_config


class Quiet:
    """A watcher that keeps what it was told, and breaks the run off where it is asked to."""

    def __init__(self, break_at: int | None = None) -> None:
        self.steps: list[int] = []
        self.validations: list[int] = []
        self._break_at = break_at

    def preparing(self, what: str) -> None:
        assert what

    def stepped(self, step: int, steps: int, loss: float, seconds_per_step: float) -> None:
        self.steps.append(step)
        if step == self._break_at:
            raise KeyboardInterrupt

    def validated(self, step: int, wrong: Mapping[str, float], gradient_wrong: Mapping[str, float]) -> None:
        assert wrong.keys() == gradient_wrong.keys()
        self.validations.append(step)


@pytest.fixture(scope="session")
def watcher() -> type[Quiet]:
    """Call it for a watcher."""
    return Quiet


@pytest.fixture(scope="session")
def tiny() -> Callable[..., TrainingConfig]:
    """`tiny(section={...})`: the configuration with some keys replaced."""

    def make(**changes: Any) -> TrainingConfig:
        shapes = {"kind": "shapes", "name": "shapes", "scales": [0.7, 1.4]}
        data: dict[str, Any] = {
            "seed": 5,
            "threads": 1,
            "split": "nothing held out",
            "network": {"full_width": 4, "half_width": 4, "dilations": [1, 2], "descriptors": 2},
            "pairs": {"reference_px": 48, "windows_px": [24, 32]},
            "schedule": {"steps": 4, "batch": 2, "warm_up_steps": 2, "log_every": 1, "check_every": 2},
            "validation": {"batch": 2, "windows_px": [32], "sources": [shapes]},
            "sources": [shapes],
        }
        for key, value in changes.items():
            data[key] = {**data[key], **value} if isinstance(value, dict) else value
        return parse_training_config(data, "test")

    return make
