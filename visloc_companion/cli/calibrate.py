"""`visloc calibrate`: a camera's lens from pictures of a board."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from visloc_companion.prepare.defaults import DEFAULT_BOARD

if TYPE_CHECKING:
    from visloc_companion.prepare.lens.board import Board
    from visloc_companion.prepare.lens.calibrate import Calibration
    from visloc_companion.prepare.lens.pictures import Picture


def calibrate(
    pictures: Annotated[
        list[Path] | None, typer.Argument(metavar="PICTURES", help="Pictures of the board, folders of them, or videos.")
    ] = None,
    board: Annotated[
        str,
        typer.Option(
            metavar="BOARD", help="charuco:SQUARES:SIDE:MARKER or chessboard:INNER_CORNERS:SIDE, e.g. chessboard:9x6:25mm."
        ),
    ] = DEFAULT_BOARD,
    model: Annotated[
        Literal["auto", "brown_conrady", "fisheye", "rational"],
        typer.Option(help="camera.distortion_model; auto takes the simplest that views held out do not contradict."),
    ] = "auto",
    every: Annotated[int | None, typer.Option(min=1, help="Of videos every so many frames; two a second by default.")] = None,
    out: Annotated[Path | None, typer.Option(metavar="FILE.toml", help="Write the section here, too.")] = None,
    json_file: Annotated[Path | None, typer.Option("--json", metavar="FILE", help="Write the result here.")] = None,
    report: Annotated[Path | None, typer.Option(metavar="FILE.html", help="Write a page with pictures of it here.")] = None,
    print_board: Annotated[
        Path | None, typer.Option(metavar="FILE.svg|FILE.png", help="Write the board to print at its true size, and end.")
    ] = None,
) -> None:
    """Calibrate a camera from some 25 pictures of a printed board. Exit codes: 0 good, 1 not good enough, 2 usage, 3 pictures."""
    from visloc_companion.cli.progress import require_folder, write_json, write_text
    from visloc_companion.errors import ConfigError
    from visloc_companion.prepare.lens.board import parse_board
    from visloc_companion.prepare.lens.document import document, lines, short_line
    from visloc_companion.prepare.lens.limits import shortcomings
    from visloc_companion.prepare.lens.pictures import listed

    sheet = parse_board(board)
    if print_board is not None:
        _write_sheet(print_board, sheet, bool(pictures))
        return
    if not pictures:
        raise ConfigError(
            "no pictures are named", where="calibrate", remedy="name pictures of the board, a folder of them, or a video"
        )
    files = listed(pictures)
    require_folder(out, "--out", *files)
    require_folder(json_file, "--json", *files, out)
    require_folder(report, "--report", *files, out, json_file)
    found = _calibrated(files, sheet, model, every)
    toml = _toml(found)
    try:
        for line in lines(found):
            typer.echo(line)
        typer.echo("\n" + toml)
    finally:  # a reader that went away must not cost the files
        if out is not None:
            write_text(out, toml, "--out")
        if json_file is not None:
            write_json(json_file, document(found))
        if report is not None:
            from visloc_companion.evaluate.lens_report import lens_report

            write_text(report, lens_report(found, toml), "--report")
    short = shortcomings(found)
    for each in short:
        typer.echo(short_line(each), err=True)
    raise typer.Exit(1 if short else 0)


def _calibrated(files: list[Path], board: Board, model: str, every: int | None) -> Calibration:
    from visloc_companion.cli.progress import bar
    from visloc_companion.prepare.lens.calibrate import calibrate as calibrated
    from visloc_companion.prepare.lens.choose import MODELS
    from visloc_companion.prepare.lens.pictures import names_of, pictures_of

    def all_of_them() -> Iterator[Picture]:
        with bar("looking for the board", len(files)) as advance:
            for k, (file, name) in enumerate(zip(files, names_of(files), strict=True), start=1):
                yield from pictures_of(file, every, name)
                advance(k)

    kinds = MODELS if model == "auto" else tuple(kind for kind in MODELS if kind == model)
    return calibrated(all_of_them(), board, kinds, lambda kind: typer.echo(f"fitting {kind}", err=True))


def _toml(found: Calibration) -> str:
    """Section [camera] with the line above it that says what it is from."""
    from datetime import date

    from visloc_companion.cli.toml import to_toml
    from visloc_companion.prepare.lens.document import comment
    from visloc_companion.prepare.lens.section import section

    return f"{comment(found, date.today())}\n{to_toml({'camera': section(found.lens.model)})}"


def _write_sheet(path: Path, board: Board, with_pictures: bool) -> None:
    from visloc_companion.cli.progress import require_folder, result_to
    from visloc_companion.errors import ConfigError
    from visloc_companion.prepare.lens.sheet import png, sheet_of, svg
    from visloc_companion.whole_file import write_result

    forms = {".svg": svg, ".png": png}
    made = forms.get(path.suffix.lower())
    if made is None or with_pictures:
        what = "pictures are named, too" if with_pictures else "its name ends in neither .svg nor .png"
        raise ConfigError(
            what, where=str(path), remedy="write visloc calibrate --print-board board.svg, print it, then calibrate"
        )
    require_folder(path, "--print-board")
    sheet = sheet_of(board)
    with result_to(path, "--print-board"):
        write_result(path, made(sheet))
    typer.echo(f"{path}: {board.name} for {sheet.paper}. Print it at 100 %, not fitted to the page, and measure both rulers.")
