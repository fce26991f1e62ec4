"""The daemon's cameras read their tables by the rules of replays."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.unit.adapters.cut_video import write_cut_video, write_dropping_video
from tests.unit.adapters.test_camera_sources import MODEL, JumpingClock, folder_of, picture, write_png, write_video
from visloc_companion.adapters.camera.files import FilesCamera
from visloc_companion.adapters.camera.table import times_of_video
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


def test_a_row_for_each_frame_of_a_video_that_was_cut_is_one_for_each_that_is_shown(tmp_path: Path) -> None:
    """Its file states those before the cut, too: with a row for each of them, all frames were taken for earlier ones."""
    write_cut_video(tmp_path / "v.mp4", 20, hidden=5)
    (tmp_path / "v.csv").write_text("t_us\n" + "".join(f"{100_000 * k}\n" for k in range(20)))
    with pytest.raises(CameraError, match=r"has 20 rows, v\.mp4 15 frames"):
        times_of_video(tmp_path / "v.csv", tmp_path / "v.mp4")
    (tmp_path / "v.csv").write_text("t_us\n" + "".join(f"{100_000 * k}\n" for k in range(5, 20)))
    assert times_of_video(tmp_path / "v.csv", tmp_path / "v.mp4") == tuple(100_000 * k for k in range(5, 20))


def test_a_row_for_a_frame_that_was_dropped_is_refused(tmp_path: Path) -> None:
    """The file states it; behind it each frame was taken for the one before."""
    write_dropping_video(tmp_path / "v.avi", 20, dropped=7)
    (tmp_path / "v.csv").write_text("t_us\n" + "".join(f"{100_000 * k}\n" for k in range(20)))
    with pytest.raises(CameraError, match=r"has 20 rows, v\.avi 19 frames"):
        times_of_video(tmp_path / "v.csv", tmp_path / "v.avi")
