"""The sheet to print: the board that is looked for, at its true size, with rulers as long as they say."""

from __future__ import annotations

import re

import cv2
import numpy as np
import pytest

from visloc_companion.errors import ConfigError
from visloc_companion.prepare.defaults import DEFAULT_BOARD
from visloc_companion.prepare.lens.board import parse_board
from visloc_companion.prepare.lens.detect import detector
from visloc_companion.prepare.lens.sheet import drawn, png, sheet_of, svg

BOARDS = (DEFAULT_BOARD, "chessboard:9x6:25mm", "charuco:5x7:30mm:22mm:6X6_250", "charuco:11x8:30mm:22mm:APRILTAG_36h11")
DOTS_A_MM = 300 / 25.4


@pytest.mark.parametrize(("name", "paper"), list(zip(BOARDS, ("A4", "A4", "A4", "A3"), strict=True)))
def test_what_is_printed_is_what_is_looked_for(name: str, paper: str) -> None:
    board = parse_board(name)
    sheet = sheet_of(board)
    assert sheet.paper == paper
    found = detector(board)(drawn(sheet))
    assert len(found.ids) == len(board.corners_m)
    across = found.pix[board.inner[0] - 1] - found.pix[0]
    assert np.hypot(*across) / DOTS_A_MM == pytest.approx((board.inner[0] - 1) * board.square_m * 1e3, abs=0.15)


def rasterised(page: bytes, dots_a_mm: float) -> np.ndarray:
    """The black boxes of an SVG of this form."""
    width, height = (float(mm) for mm in re.findall(rb'viewBox="0 0 ([\d.]+) ([\d.]+)"', page)[0])
    picture = np.full((round(height * dots_a_mm), round(width * dots_a_mm)), 255, np.uint8)
    for numbers in re.findall(rb"M([\d.]+) ([\d.]+)h([\d.]+)v([\d.]+)h-", page):
        x, y, w, h = (float(number) * dots_a_mm for number in numbers)
        picture[round(y) : round(y + h), round(x) : round(x + w)] = 0
    return picture


@pytest.mark.parametrize("name", BOARDS)
def test_both_forms_are_one_sheet(name: str) -> None:
    board = parse_board(name)
    page = svg(sheet_of(board))
    found, other = detector(board)(rasterised(page, DOTS_A_MM)), detector(board)(drawn(sheet_of(board)))
    assert found.pix == pytest.approx(other.pix, abs=0.5)
    assert f"{board.name}; print on".encode() in page


def test_rulers_are_as_long_as_they_say() -> None:
    sheet = sheet_of(parse_board(DEFAULT_BOARD))
    across, down = (box for box in sheet.rulers if max(box[2:]) > 50)
    assert across[2] == pytest.approx(100.2)
    assert down[3] == pytest.approx(100.2)  # with half a line at either end
    assert [words for *_, words in sheet.words][:2] == ["100 mm", "100 mm"]


@pytest.mark.parametrize("name", [*BOARDS, "chessboard:3x3:12mm", "charuco:3x20:13mm:9mm"])
def test_nothing_lies_beyond_the_paper_or_on_something_else(name: str) -> None:
    board = parse_board(name)
    sheet = sheet_of(board)
    boxes = np.array([*sheet.board, *sheet.rulers])
    assert boxes[:, :2].min() >= 5
    assert (boxes[:, 0] + boxes[:, 2]).max() <= sheet.width_mm - 5
    assert (boxes[:, 1] + boxes[:, 3]).max() <= sheet.height_mm - 5
    right, bottom = (max(x + w for x, _, w, _ in sheet.board), max(y + h for _, y, _, h in sheet.board))
    assert all(x >= right + 3.9 or y >= bottom + 3.9 for x, y, *_ in sheet.rulers)


def test_a_png_states_its_size() -> None:
    data = png(sheet_of(parse_board(DEFAULT_BOARD)))
    at = data.index(b"pHYs") + 4
    assert int.from_bytes(data[at : at + 4], "big") == round(300 / 0.0254)
    assert cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_GRAYSCALE).shape == (2480, 3508)


def test_a_board_that_fits_no_paper_is_refused() -> None:
    with pytest.raises(ConfigError, match="1320 x 960 mm fits no paper"):
        sheet_of(parse_board("charuco:11x8:12cm:9cm"))


@pytest.mark.parametrize("name", BOARDS)
def test_corners_of_a_png_lie_where_they_are_said_to(name: str) -> None:
    """To a tenth of a dot: with edges on whole dots they were up to 0.04 mm off, by which a flat sheet is "not quite flat"."""
    board = parse_board(name)
    found = detector(board)(drawn(sheet_of(board)))
    true = 1e3 * board.corners_m[found.ids, :2] * DOTS_A_MM
    pix = found.pix if found.pix[0, 0] < found.pix[-1, 0] else found.pix[::-1]  # a chessboard's may begin at either end
    off = pix - true
    assert np.abs(off - off.mean(axis=0)).max() < 0.1
