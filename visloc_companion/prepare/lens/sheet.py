"""The sheet to print: a board at its true size, with rulers to check the print by."""

from __future__ import annotations

import math
import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from html import escape

import cv2
import numpy as np

from visloc_companion.errors import ConfigError
from visloc_companion.prepare.lens.board import Board
from visloc_companion.types import FloatArray, Image

PAPERS_MM = {"A4": (297.0, 210.0), "A3": (420.0, 297.0), "A2": (594.0, 420.0), "A1": (841.0, 594.0), "A0": (1189.0, 841.0)}
"""Lying; a board that is taller than wide stands on them."""
RULER_MM, _LEAST_RULER_MM = 100, 30
"""The rulers' length; of boards that are smaller a shorter one."""
_MARGIN_MM, _STRIP_MM, _GAP_MM = 5.0, 13.0, 4.0
"""Paper that printers leave white, what words and rulers take below the board and beside it, and how far they begin from it."""
_QUIET_MM = 5.0
"""About a chessboard, whose outer squares are found against white."""
_DOTS_A_MM = 300 / 25.4
_TICKS_MM = ((10, 4.0), (5, 2.8), (1, 1.6))
_LINE_MM, _TEXT_MM, _WORDS_MM = 0.2, 3.2, 140.0

Box = tuple[float, float, float, float]


@dataclass(frozen=True)
class Sheet:
    """A page with black boxes of board and rulers (left, top, width, height) and words (left, baseline, turned, text), in mm."""

    paper: str
    width_mm: float
    height_mm: float
    board: list[Box]
    rulers: list[Box]
    words: list[tuple[float, float, bool, str]]


def sheet_of(board: Board) -> Sheet:
    """The smallest paper that takes the board, lying or standing as it is. Raises ConfigError where none does."""
    across_mm, down_mm = board.columns * board.square_m * 1e3, board.rows * board.square_m * 1e3
    for paper, (long_mm, short_mm) in PAPERS_MM.items():
        width_mm, height_mm = (long_mm, short_mm) if across_mm >= down_mm else (short_mm, long_mm)
        quiet_mm = _QUIET_MM if board.kind == "chessboard" else 0.0
        needed_mm = 2 * (_MARGIN_MM + quiet_mm) + _STRIP_MM
        if across_mm + needed_mm <= width_mm and down_mm + needed_mm <= height_mm:
            left_mm, top_mm = (width_mm - _STRIP_MM - across_mm) / 2, (height_mm - _STRIP_MM - down_mm) / 2
            black = [(left_mm + x, top_mm + y, w, h) for x, y, w, h in board_boxes(board)]
            ruler_mm = next(mm for mm in range(RULER_MM, 0, -10) if mm <= min(across_mm, down_mm) or mm == _LEAST_RULER_MM)
            below_mm, beside_mm = top_mm + down_mm + quiet_mm + _GAP_MM, left_mm + across_mm + quiet_mm + _GAP_MM
            rulers = [*_ruler(left_mm, below_mm, ruler_mm, False), *_ruler(beside_mm, top_mm, ruler_mm, True)]
            told = f"visloc calibrate --board {board.name}; print on {paper} at 100 %, not fitted to the page"
            words = [
                (left_mm + ruler_mm + 2, below_mm + 3.4, False, f"{ruler_mm} mm"),
                (beside_mm + 5, top_mm + 1, True, f"{ruler_mm} mm"),
                (max(_MARGIN_MM, min(left_mm, width_mm - _WORDS_MM)), below_mm + 8.5, False, told),
            ]
            return Sheet(paper, width_mm, height_mm, black, rulers, words)
    raise ConfigError(
        f"a board of {across_mm:.0f} x {down_mm:.0f} mm fits no paper up to A0",
        where="--print-board",
        remedy="fewer or smaller squares",
    )


def board_boxes(board: Board) -> Iterator[Box]:
    """Black boxes of a board, mm from its upper left corner: squares, and the rows of its markers' dark cells."""
    side_mm = board.square_m * 1e3
    for row in range(board.rows):
        yield from ((column * side_mm, row * side_mm, side_mm, side_mm) for column in range(row % 2, board.columns, 2))
    if board.kind == "chessboard":
        return
    drawn = board.charuco()
    pattern = drawn.getDictionary()
    cells = pattern.markerSize + 2
    cell_mm = board.marker_m * 1e3 / cells
    for number, corners in zip(np.ravel(drawn.getIds()), drawn.getObjPoints(), strict=True):
        left_mm, top_mm = (1e3 * np.asarray(corners)[:, :2].min(axis=0)).tolist()
        dark = pattern.generateImageMarker(int(number), cells, borderBits=1) == 0
        for row in range(cells):
            edges = np.flatnonzero(np.diff(np.concatenate([[False], dark[row], [False]])))
            for start, end in edges.reshape(-1, 2).tolist():
                yield left_mm + start * cell_mm, top_mm + row * cell_mm, (end - start) * cell_mm, cell_mm


def svg(sheet: Sheet) -> bytes:
    """The sheet as SVG in millimetres."""
    size = f"{sheet.width_mm:g}mm"
    board, rulers = (
        "".join(f"M{x:.4f} {y:.4f}h{w:.4f}v{h:.4f}h{-w:.4f}z" for x, y, w, h in boxes) for boxes in (sheet.board, sheet.rulers)
    )
    words = "".join(
        f'<text x="{x:.2f}" y="{y:.2f}"'
        + (f' transform="rotate(90 {x:.2f} {y:.2f})"' if turned else "")
        + f">{escape(text)}</text>"
        for x, y, turned, text in sheet.words
    )
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{size}" height="{sheet.height_mm:g}mm" '
        f'viewBox="0 0 {sheet.width_mm:g} {sheet.height_mm:g}"><style>@page{{size:{size} {sheet.height_mm:g}mm;margin:0}}'
        f"text{{font:{_TEXT_MM}px sans-serif}}</style>"
        f'<rect width="100%" height="100%" fill="#fff"/><path d="{board}" shape-rendering="crispEdges"/>'
        f'<path d="{rulers}"/>{words}</svg>\n'
    ).encode()


def png(sheet: Sheet) -> bytes:
    """The sheet as a PNG of 300 dots an inch, which it states, so that programs print it at its size."""
    pixels = drawn(sheet)
    _, data = cv2.imencode(".png", pixels)
    dots_a_m = round(1e3 * _DOTS_A_MM)
    head, told = 33, b"pHYs" + struct.pack(">IIB", dots_a_m, dots_a_m, 1)
    content = data.tobytes()
    return content[:head] + struct.pack(">I", 9) + told + struct.pack(">I", zlib.crc32(told)) + content[head:]


def drawn(sheet: Sheet) -> Image:
    """(H, W) grey, 300 dots an inch. Edges that lie between two dots are grey: rounded to dots, corners would be up to 0.04 mm
    off, the same in every view, and a flat sheet would be taken for one that is not."""
    white = np.ones((round(sheet.height_mm * _DOTS_A_MM), round(sheet.width_mm * _DOTS_A_MM)), np.float32)
    for x, y, w, h in (*sheet.board, *sheet.rulers):
        (rows, down), (columns, across) = _covered(y, h), _covered(x, w)
        white[rows, columns] -= np.outer(down, across).astype(np.float32)
    page = np.asarray(np.round(255 * np.clip(white, 0, 1)), dtype=np.uint8)
    for x, y, turned, text in sheet.words:
        _write(page, round(x * _DOTS_A_MM), round(y * _DOTS_A_MM), turned, text)
    return page


def _covered(start_mm: float, long_mm: float) -> tuple[slice, FloatArray]:
    """The dots that a stretch lies on, and (N,) how much of each it covers."""
    start, end = start_mm * _DOTS_A_MM, (start_mm + long_mm) * _DOTS_A_MM
    dots = np.arange(math.floor(start), math.ceil(end))
    return slice(int(dots[0]), int(dots[-1]) + 1), np.minimum(dots + 1, end) - np.maximum(dots, start)


def _write(page: Image, left: int, base: int, turned: bool, text: str) -> None:
    """Words in OpenCV's letters, which are ASCII; turned ones run downwards from where they begin."""
    plain = text.replace("°", " deg")
    size = cv2.getFontScaleFromHeight(cv2.FONT_HERSHEY_SIMPLEX, round(0.72 * _TEXT_MM * _DOTS_A_MM), 2)
    (width, height), below = cv2.getTextSize(plain, cv2.FONT_HERSHEY_SIMPLEX, size, 2)
    line = np.full((height + below + 4, width + 4), 255, np.uint8)
    cv2.putText(line, plain, (0, height + 1), cv2.FONT_HERSHEY_SIMPLEX, size, 0, 2, cv2.LINE_AA)
    top = base - height - 1
    if turned:
        line, top, left = np.rot90(line, -1), base, left - below
    room = page[top : top + line.shape[0], left : left + line.shape[1]]
    room[:] = np.minimum(room, line[: room.shape[0], : room.shape[1]])


def _ruler(left_mm: float, top_mm: float, long_mm: int, down: bool) -> Iterator[Box]:
    """Ticks of every millimetre from a line; the ruler runs from the middle of its first tick to the middle of its last."""
    half = _LINE_MM / 2
    boxes = [(-half, 0.0, long_mm + _LINE_MM, _LINE_MM)]
    for mm in range(long_mm + 1):
        tick_mm = next(tick for every, tick in _TICKS_MM if mm % every == 0)
        boxes.append((mm - half, 0.0, _LINE_MM, tick_mm))
    for x, y, w, h in boxes:
        yield (left_mm + y, top_mm + x, h, w) if down else (left_mm + x, top_mm + y, w, h)
