"""Answers kept in a file for each part of a long collection, so that a run goes on where another has stopped."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.cloud_sets.cloud_answers import CloudAnswer


def kept(folder: Path, part: str, collected: Callable[[], Iterable[CloudAnswer]]) -> list[CloudAnswer]:
    """The answers of a part: those of its file, or collected and written there."""
    file = folder / f"{part}.json"
    if file.exists():
        return [_read(one) for one in json.loads(file.read_text(encoding="utf-8"))]
    answers = list(collected())
    folder.mkdir(parents=True, exist_ok=True)
    file.write_text(json.dumps([asdict(a) for a in answers], default=np.ndarray.tolist, indent=0) + "\n", encoding="utf-8")
    return answers


def _read(one: dict[str, Any]) -> CloudAnswer:
    arrays = {name: np.array(one[name], dtype=np.float64) for name in ("error_m", "covariance_m2")}
    return CloudAnswer(**{**one, **arrays})
