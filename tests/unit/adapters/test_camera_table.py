"""The daemon's cameras read their tables by the rules of replays."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.unit.adapters.test_camera_sources import MODEL, JumpingClock, folder_of, picture, write_png, write_video
from visloc_companion.adapters.camera.files import FilesCamera
from visloc_companion.adapters.camera.video import VideoCamera
from visloc_companion.errors import CameraError


@pytest.mark.parametrize(
    ("table", "told"),
    [
        ("t_us\n1\n2\n", r"frames\.csv: has 2 rows, flight\.avi 3 frames; remedy: write a row for each frame"),
        ("t_us\n1\n3\n2\n", r"frames\.csv, row 3, column t_us: goes back; remedy"),
        ("t_us\n1\ninf\n2\n", r"frames\.csv, row 2, column t_us: has no whole number of microseconds; remedy"),
        ("t_us\n1\n60_000_000\n90000000\n", r"frames\.csv, row 2, column t_us: has no whole number of microseconds; remedy"),
        ("t_us,t_us\n1,1\n2,2\n3,3\n", r"frames\.csv: has column t_us more than once; remedy"),
        ("t_us,file\n1,a.png\n2,b.png\n3,c.png\n", r"frames\.csv: lists a\.png beside flight\.avi; remedy"),
    ],
)
def test_a_table_that_is_not_of_the_video_is_refused_as_replays_do(tmp_path: Path, table: str, told: str) -> None:
    write_video(tmp_path / "flight.avi", 3)
    write_png(tmp_path / "a.png", picture(1))
    (tmp_path / "frames.csv").write_text(table, encoding="utf-8")
    with pytest.raises(CameraError, match=told):
        VideoCamera(tmp_path / "flight.avi", MODEL, JumpingClock())


def test_a_time_base_that_is_unknown_is_named(tmp_path: Path) -> None:
    folder = folder_of(tmp_path, ["a.png"], "0, a.png\n")
    (folder / "camera.toml").write_text('time_base = "autopilot-boot"\n', encoding="utf-8")
    with pytest.raises(CameraError, match=r"camera\.toml: time_base: 'autopilot-boot' is unknown; remedy: use one of"):
        FilesCamera(folder, MODEL, JumpingClock())
