"""What neighbouring fixes have in common, of errors drawn with a known share."""

from __future__ import annotations

import json
import math
import re
from pathlib import Path

import numpy as np
import pytest

from benchmarks.lasting import common, main, rms, smoothed

SHARE, LENGTH_M, CLAIMED = 0.4, 40.0, 1.5


def drawn(legs: int = 60, frames: int = 60) -> list[np.ndarray]:
    """Legs with a fix each 5 m: unit variance, SHARE of it correlated over LENGTH_M; they claim CLAIMED times as much."""
    rng, found = np.random.default_rng(3), []
    kept = math.exp(-5.0 / LENGTH_M)
    for leg in range(legs):
        lasting = [rng.standard_normal(2)]
        for _ in range(frames - 1):
            lasting.append(kept * lasting[-1] + math.sqrt(1 - kept**2) * rng.standard_normal(2))
        error = math.sqrt(SHARE) * np.array(lasting) + math.sqrt(1 - SHARE) * rng.standard_normal((frames, 2))
        about = np.column_stack([np.full(frames, leg), 5.0 * np.arange(frames)])
        found.append(np.column_stack([about, 2.0 * error, np.full((frames, 2), 4.0 * CLAIMED)]))
    return found


def test_the_share_in_common_is_found_at_each_distance() -> None:
    for apart_m, share, n in common(drawn()):
        true = 1.0 if apart_m == 0 else SHARE * math.exp(-apart_m / LENGTH_M)
        assert share == pytest.approx(true / CLAIMED, abs=0.05)
        assert n > 1000


def test_a_mean_of_neighbours_keeps_what_they_have_in_common() -> None:
    off_m, mean = smoothed(drawn())
    rms2 = float((mean**2).mean())
    apart = np.abs(np.subtract.outer(np.arange(5), np.arange(5)))
    true = float(np.where(apart == 0, 1.0, SHARE * np.exp(-5.0 * apart / LENGTH_M)).mean()) / CLAIMED
    assert rms2 == pytest.approx(true, rel=0.06)
    assert rms(off_m) ** 2 == pytest.approx(4.0 * CLAIMED * rms2)


def test_what_was_flown_before_is_counted_again(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "fixes.json"
    file.write_text(json.dumps({"7": np.concatenate(drawn(3)).tolist()}), encoding="utf-8")
    main(["--no-flights", "--fixes", str(file)])
    lines = capsys.readouterr().out.splitlines()
    assert re.fullmatch(r"worlds 7: 180 fixes, error per axis [12]\.\d\d m rms, over sigma 0\.\d\d", lines[0])
    assert lines[4].startswith("| 0 | ")
