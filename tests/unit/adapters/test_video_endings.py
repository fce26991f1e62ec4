"""What is taken for a video by its name, and whose times are taken for those of its frames."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from tests.unit.adapters.test_camera_sources import MODEL, JumpingClock
from tests.unit.adapters.test_logs_folder import LENS, telemetry
from visloc_companion.adapters.camera import video_stamps
from visloc_companion.adapters.camera.video import VideoCamera
from visloc_companion.adapters.logs.folder import open_folder
from visloc_companion.errors import CameraError, LogError
from visloc_companion.prepare.lens.pictures import listed, pictures_of

DOCS = Path(__file__).resolve().parents[3] / "docs"


def write(path: Path, codec: str, rate_hz: float = 25.0, n: int = 5) -> None:
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*codec), rate_hz, (64, 48))
    if not writer.isOpened():
        pytest.skip(f"this OpenCV writes no {codec} into {path.suffix}")
    for k in range(n):
        writer.write(np.full((48, 64, 3), 40 * k, np.uint8))
    writer.release()


@pytest.fixture
def flight(tmp_path: Path) -> Path:
    telemetry(tmp_path)
    (tmp_path / "camera.toml").write_text(LENS + "video_start_us = 60000000\n")
    return tmp_path


@pytest.mark.parametrize(
    ("name", "codec"),
    [("video.mpg", "MPG1"), ("video.mpeg", "MPG2"), ("Video.MP4", "mp4v"), ("video.ts", "MPG2"), ("video.wmv", "WMV2")],
)
def test_a_video_of_any_common_ending_is_read(flight: Path, name: str, codec: str) -> None:
    write(flight / name, codec)
    frames = open_folder(flight).frames
    assert frames is not None
    assert frames.t_us == tuple(60_000_000 + 40_000 * k for k in range(5))
    last = frames.pixels(4)
    assert last is not None
    assert abs(float(last.mean()) - 160) < 8
    assert [file.name for file in listed([flight])] == [name], "for a calibration, too"
    assert sum(picture.grey is not None for picture in pictures_of(flight / name, 1)) == 5


def test_a_bare_stream_has_no_times_of_its_own(flight: Path) -> None:
    """A decoder makes 25 Hz up for it: half a minute later the frames would lie seconds from where they were taken."""
    write(flight / "video.mjpeg", "MJPG", rate_hz=10.0)
    with pytest.raises(LogError, match=r"video\.mjpeg: is a bare stream, which holds no times; remedy: add frames\.csv"):
        open_folder(flight)
    with pytest.raises(CameraError, match=r"video\.mjpeg: states no frame rate; remedy: write the frames' times .*video\.csv"):
        VideoCamera(flight / "video.mjpeg", MODEL, JumpingClock())
    (flight / "frames.csv").write_text("t_us\n" + "".join(f"{60_000_000 + 100_000 * k}\n" for k in range(5)))
    frames = open_folder(flight).frames
    assert frames is not None
    assert frames.t_us[-1] == 60_400_000
    assert frames.pixels(4) is not None


def test_a_codec_that_cannot_be_decoded_is_told_with_the_remedy(flight: Path) -> None:
    write(flight / "video.avi", "MJPG")
    (flight / "video.avi").write_bytes((flight / "video.avi").read_bytes().replace(b"MJPG", b"ZZZZ"))
    with pytest.raises(LogError, match=r"video\.avi: cannot be decoded as a video; remedy: convert it to MP4 with H\.264"):
        open_folder(flight)
    with pytest.raises(CameraError, match=r"video\.avi: cannot be opened as a video; remedy: .*MP4 with H\.264"):
        VideoCamera(flight / "video.avi", MODEL, JumpingClock())
    assert [picture.grey for picture in pictures_of(flight / "video.avi", None)] == [None]


def test_two_frames_of_one_time_in_a_video_are_refused(flight: Path) -> None:
    """Of a table in whole tenths beside 25 frames a second, which of them was taken then nobody knows."""
    write(flight / "video.avi", "MJPG", n=3)
    (flight / "frames.csv").write_text("t_us\n60000000\n60100000\n60100000\n")
    told = r"frames\.csv, row 3, column t_us: has the time of row 2, and each frame one of its own; remedy: write finer times; "
    with pytest.raises(LogError, match=told):
        open_folder(flight)
    with pytest.raises(CameraError, match=told):
        VideoCamera(flight / "video.avi", MODEL, JumpingClock())
    (flight / "frames.csv").write_text("t_us\n60.04\n60.08\n60.12\n")
    with pytest.raises(LogError, match=r"row 2, .* remedy: write microseconds \(60\.08 looks like seconds\); "):
        open_folder(flight)


def test_the_page_names_every_ending() -> None:
    page = (DOCS / "replay.md").read_text(encoding="utf-8")
    assert [ending for ending in video_stamps.VIDEO_SUFFIXES if f"`{ending}`" not in page] == []
