"""A recorded video whose middle is damaged: decoding ends there, and what follows is not seen."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from visloc_companion.adapters.camera.table import times_of_video
from visloc_companion.adapters.camera.video_stamps import not_shown
from visloc_companion.adapters.logs.video import VideoFrames, notes_on_video, own_times_us
from visloc_companion.errors import LogError

N_FRAMES = 60


def video(path: Path) -> Path:
    """Frames of a texture that moves, five a second."""
    ground = cv2.GaussianBlur(np.random.default_rng(5).uniform(0, 255, (400, 400)), (0, 0), 2)
    ground = cv2.normalize(ground, np.empty_like(ground), 0, 255, cv2.NORM_MINMAX).astype(np.uint8)
    out = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"mp4v"), 5.0, (160, 120))
    for k in range(N_FRAMES):
        out.write(np.repeat(ground[k : k + 120, 2 * k : 2 * k + 160, np.newaxis], 3, axis=2))
    out.release()
    return path


def damaged(path: Path) -> Path:
    content = bytearray(path.read_bytes())
    begin, end = content.find(b"mdat") + 8, content.find(b"moov")
    at, n = begin + (end - begin) * 2 // 5, (end - begin) // 5
    content[at : at + n] = bytes(n)
    path.write_bytes(content)
    return path


def test_frames_that_are_lost_to_damage_are_told_with_where_it_begins(tmp_path: Path) -> None:
    path = damaged(video(tmp_path / "video.mp4"))
    times_us = own_times_us(path, 0)
    assert 0 < len(times_us) < N_FRAMES
    (note,) = notes_on_video(VideoFrames(path, times_us))
    second = f"{times_us[-1] / 1e6:.1f}"
    assert note.startswith(f"video.mp4 holds {N_FRAMES} frames and shows {len(times_us)}, the last at its second {second}")
    assert "ffmpeg -i video.mp4" in note


def test_a_whole_one_is_not_spoken_of(tmp_path: Path) -> None:
    path = video(tmp_path / "video.mp4")
    assert not_shown(path, N_FRAMES) == 0
    assert notes_on_video(VideoFrames(path, own_times_us(path, 0))) == []


def test_a_table_that_has_a_row_for_each_frame_is_not_blamed_for_the_damage(tmp_path: Path) -> None:
    """It was told to write a row for each frame, of which it has one."""
    path, table = damaged(video(tmp_path / "video.mp4")), tmp_path / "frames.csv"
    table.write_text("t_us\n" + "".join(f"{200_000 * k}\n" for k in range(N_FRAMES)), encoding="utf-8")
    shown = len(own_times_us(path, 0))
    told = (
        rf"has 60 rows, video.mp4 {shown} frames that can be shown and {N_FRAMES - shown} behind damage.*remedy: copy the video"
    )
    with pytest.raises(LogError, match=told):
        times_of_video(table, path, LogError)
    table.write_text("t_us\n" + "".join(f"{200_000 * k}\n" for k in range(N_FRAMES + 1)), encoding="utf-8")
    with pytest.raises(LogError, match=r"has 61 rows, whole.mp4 60 frames; remedy: write a row for each frame"):
        times_of_video(table, video(tmp_path / "whole.mp4"), LogError)
