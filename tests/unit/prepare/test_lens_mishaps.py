"""What goes wrong with pictures before anything is fitted: the wrong board, the wrong folder, pictures that nothing reads."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from tests.unit.prepare.board_pictures import BROWN, Photographer, poses
from visloc_companion.cli import main as module
from visloc_companion.errors import CameraError, ConfigError
from visloc_companion.prepare.defaults import DEFAULT_BOARD
from visloc_companion.prepare.lens.board import parse_board
from visloc_companion.prepare.lens.look import look_at
from visloc_companion.prepare.lens.pictures import Picture, listed, names_of, pictures_of

BOARD = parse_board(DEFAULT_BOARD)


def shots(board: str, n: int) -> list[Picture]:
    rng, sheet = np.random.default_rng(8), parse_board(board)
    take = Photographer(BROWN, sheet)
    return [Picture(f"{k}.png", take(pose, rng)) for k, pose in enumerate(poses(BROWN, sheet, n, rng, far=1.6))]


@pytest.mark.parametrize(
    ("shown", "named", "said"),
    [
        (
            "chessboard:9x6:25mm",
            "chessboard:10x7:25mm",
            "9x6 inner corners are seen, of 10x7 squares: name --board chessboard:9x6:25mm",
        ),
        (DEFAULT_BOARD, "chessboard:9x6:25mm", "markers of dictionary 4X4_1000 are seen: name the ChArUco board"),
        ("chessboard:9x6:25mm", "chessboard:8x7:25mm", "check --board chessboard:8x7:25mm against the sheet"),
    ],
)
def test_another_board_than_the_one_that_is_named(shown: str, named: str, said: str) -> None:
    with pytest.raises(CameraError) as refused:
        look_at(shots(shown, 2), parse_board(named))
    assert said in str(refused.value)


def test_pictures_lie_in_a_folder_of_the_folder(tmp_path: Path) -> None:
    """As cameras leave them: DCIM/100MEDIA."""
    (tmp_path / "100MEDIA").mkdir()
    (tmp_path / "empty").mkdir()
    (tmp_path / "100MEDIA" / "a.jpg").touch()
    with pytest.raises(CameraError, match=r"holds no picture.*name the folder in it that does: .*100MEDIA"):
        listed([tmp_path])


def test_pictures_of_telephones_are_told(tmp_path: Path) -> None:
    (tmp_path / "IMG_1.HEIC").write_bytes(b"\0\0\0\x18ftypheic" + b"\0" * 99)
    with pytest.raises(CameraError, match=r"IMG_1\.HEIC: cannot be read as a picture; remedy: .*PNG or JPEG"):
        module.app(["calibrate", str(tmp_path)], standalone_mode=False)


@pytest.mark.parametrize("option", ["--out", "--json", "--report"])
def test_no_picture_is_written_over(tmp_path: Path, option: str) -> None:
    """One of a folder that is named was."""
    cv2.imwrite(str(tmp_path / "a.png"), np.zeros((48, 64), np.uint8))
    content = (tmp_path / "a.png").read_bytes()
    with pytest.raises(ConfigError, match=rf"a\.png: is named twice, and would be overwritten.*{option}"):
        module.app(["calibrate", str(tmp_path), option, str(tmp_path / "a.png")], standalone_mode=False)
    assert (tmp_path / "a.png").read_bytes() == content


def test_pictures_of_two_cards_are_told_apart(tmp_path: Path) -> None:
    """Two of one name were told as one, and one was "the same view as" itself."""
    rng, take = np.random.default_rng(9), Photographer(BROWN, BOARD)
    files = []
    for k, pose in enumerate(poses(BROWN, BOARD, 5, rng)):
        shot = take(pose, rng)
        files += [tmp_path / "a" / f"{k}.png", tmp_path / "b" / f"{k}.png"]
        for file in files[-2:]:
            file.parent.mkdir(exist_ok=True)
        cv2.imwrite(str(files[-2]), shot)
        cv2.imwrite(str(files[-1]), cv2.GaussianBlur(shot, (0, 0), 2.5) if k == 0 else np.full((480, 640), 90, np.uint8))
    twice = listed([tmp_path / "a", files[0], tmp_path / "b"])
    assert sorted(twice) == sorted(files)
    found = look_at([p for file, name in zip(twice, names_of(twice), strict=True) for p in pictures_of(file, None, name)], BOARD)
    assert [view.name for view in found.views] == [str(file) for file in files[::2]]
    assert set(found.left_out) == {str(file) for file in files[1::2]}
    assert names_of([Path("a/x.png"), Path("a/y.png")]) == ["x.png", "y.png"]
