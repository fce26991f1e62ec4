"""Boards by their names, and the files that pictures of them come in."""

from __future__ import annotations

from inspect import signature
from pathlib import Path

import cv2
import numpy as np
import pytest

from visloc_companion.cli.calibrate import calibrate
from visloc_companion.errors import CameraError, ConfigError
from visloc_companion.prepare.defaults import DEFAULT_BOARD
from visloc_companion.prepare.lens.board import parse_board
from visloc_companion.prepare.lens.pictures import listed, pictures_of


@pytest.mark.parametrize(
    ("text", "name"),
    [
        (DEFAULT_BOARD, "charuco:11x8:22mm:16mm:4X4_50"),
        ("charuco:14x9:2cm:1.5cm", "charuco:14x9:20mm:15mm:4X4_100"),
        ("charuco:5x7:0.04m:30mm:dict_6x6_250", "charuco:5x7:40mm:30mm:6X6_250"),
        ("charuco:5x7:40mm:30mm:apriltag_36h11", "charuco:5x7:40mm:30mm:APRILTAG_36H11"),
        ("chessboard:9x6:25mm", "chessboard:9x6:25mm"),
    ],
)
def test_a_board_is_what_it_is_called(text: str, name: str) -> None:
    assert parse_board(text).name == name
    assert parse_board(name) == parse_board(text)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("charuko:11x8:22mm:16mm", "did you mean 'charuco'"),
        ("charuco:11x8:22mm", "size of that of a marker|size of a square, that of a marker"),
        ("charuco:11x8:22mm:30mm", "markers of 30mm in squares of 22mm"),
        ("charuco:11x8:22:16mm", "'22' is no length in mm, cm or m"),
        ("charuco:11x8:0mm:16mm", "'0mm' is no length"),
        ("charuco:11:22mm:16mm", "'11' is not COLUMNSxROWS"),
        ("charuco:2x8:22mm:16mm", "2x8: 3 to 60"),
        ("charuco:11x8:22mm:16mm:4X4_51", "there is no dictionary 4X4_51 did you mean '4X4_50'"),
        ("charuco:20x8:22mm:16mm:4X4_50", "20x8 squares need 80 markers, 4X4_50 has 50"),
        ("chessboard:9x6", "inner corners and the size"),
        ("", "'' is no kind of board"),
    ],
)
def test_what_is_wrong_with_a_name_is_told(text: str, said: str) -> None:
    with pytest.raises(ConfigError, match=said) as refused:
        parse_board(text)
    assert refused.value.where == "--board"
    assert "charuco:11x8:22mm:16mm" in refused.value.remedy


def test_corners_are_counted_as_opencv_counts_them() -> None:
    board = parse_board(DEFAULT_BOARD)
    assert board.corners_m == pytest.approx(np.array(board.charuco().getChessboardCorners()), abs=1e-7)
    assert len(parse_board("chessboard:9x6:25mm").corners_m) == 54


def test_the_command_has_the_same_board_by_default() -> None:
    assert signature(calibrate).parameters["board"].default == DEFAULT_BOARD


def test_files_are_taken_from_folders_by_name(tmp_path: Path) -> None:
    for name in ("b.JPG", "a.png", "notes.txt", "c.mp4"):
        (tmp_path / name).write_bytes(b"x")
    assert [file.name for file in listed([tmp_path])] == ["a.png", "b.JPG", "c.mp4"]
    assert listed([tmp_path / "notes.txt"]) == [tmp_path / "notes.txt"]


def test_what_is_not_there_is_named(tmp_path: Path) -> None:
    with pytest.raises(CameraError, match=r"gone\.jpg: is not there"):
        listed([tmp_path / "gone.jpg"])
    with pytest.raises(CameraError, match="holds no picture and no video"):
        listed([tmp_path])
    with pytest.raises(CameraError, match=r"gone.jpg: cannot be read"):
        next(pictures_of(tmp_path / "gone.jpg", None))


def test_what_is_no_picture_is_none(tmp_path: Path) -> None:
    for name in ("a.png", "a.mp4"):
        (tmp_path / name).write_bytes(b"no picture at all")
        assert [(picture.name, picture.grey) for picture in pictures_of(tmp_path / name, None)] == [(name, None)]


def test_colour_becomes_grey_and_videos_are_thinned(tmp_path: Path) -> None:
    cv2.imwrite(str(tmp_path / "a.png"), np.full((48, 64, 3), (0, 0, 200), np.uint8))
    (only,) = pictures_of(tmp_path / "a.png", None)
    assert only.grey is not None
    assert only.grey.shape == (48, 64)
    assert only.grey[0, 0] == round(0.299 * 200)
    video = cv2.VideoWriter(str(tmp_path / "v.avi"), cv2.VideoWriter.fourcc(*"MJPG"), 10.0, (64, 48))
    for level in range(12):
        video.write(np.full((48, 64, 3), 20 * level, np.uint8))
    video.release()
    assert [picture.name for picture in pictures_of(tmp_path / "v.avi", None)] == [
        "v.avi frame 0",
        "v.avi frame 5",
        "v.avi frame 10",
    ]
    levels = [int(p.grey[0, 0]) for p in pictures_of(tmp_path / "v.avi", 4) if p.grey is not None]
    assert levels == pytest.approx([0, 80, 160], abs=4)
