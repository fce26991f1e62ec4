"""A full disk leaves the result of before, not half of a new one."""

from __future__ import annotations

import os
from pathlib import Path
from types import ModuleType

import pytest

from visloc_companion.evaluate.clouds import cloud_report
from visloc_companion.evaluate.clouds.cloud_metrics import summarise as summarise_clouds
from visloc_companion.evaluate.images.image_metrics import summarise
from visloc_companion.evaluate.images.image_report import write_image_report
from visloc_companion.evaluate.metrics import write_epochs
from visloc_companion.evaluate.report import write_flight_report


def refuse(descriptor: int) -> None:
    """As fsync does where blocks that were only promised are not there."""
    raise OSError(28, f"No space left on device ({descriptor})")


@pytest.mark.parametrize("kind", ["flight", "epochs", "images", "clouds"])
def test_an_old_result_stays_where_the_new_one_cannot_be_written(
    synthetic: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, kind: str
) -> None:
    record = synthetic.make_record(20.0)
    monkeypatch.setattr(cloud_report, "read_cloud_cases", lambda folder: [])

    def write() -> None:
        if kind == "flight":
            write_flight_report(record, tmp_path / "report.html", title="a flight")
        elif kind == "epochs":
            write_epochs(record, tmp_path / "epochs.csv")
        elif kind == "images":
            write_image_report(tmp_path, {"method": "gradient", "summary": summarise([], {})}, [], {})
        else:
            cloud_report.write_cloud_report(tmp_path, {"method": "gicp", "summary": summarise_clouds([])}, [], tmp_path)

    write()
    names = sorted(path.name for path in tmp_path.iterdir())
    for name in names:
        (tmp_path / name).write_text("old")
    monkeypatch.setattr(os, "fsync", refuse)
    with pytest.raises(OSError, match="No space"):
        write()
    assert sorted(path.name for path in tmp_path.iterdir()) == names
    assert {path.read_text() for path in tmp_path.iterdir()} == {"old"}
