"""`visloc calibrate`: what it prints, writes and exits with."""

from __future__ import annotations

import json
import tomllib
from pathlib import Path

import cv2
import numpy as np
import pytest
from typer.testing import CliRunner, Result

from tests.unit.prepare.board_pictures import BROWN, Photographer, poses
from visloc_companion.adapters.camera.calibration import lens_model
from visloc_companion.cli import main as module
from visloc_companion.config import load_config, parse_config
from visloc_companion.errors import CameraError, ConfigError
from visloc_companion.prepare.defaults import DEFAULT_BOARD
from visloc_companion.prepare.lens.board import parse_board
from visloc_companion.types import Image

EXAMPLES = sorted((Path(__file__).parents[3] / "docs" / "examples").glob("*.toml"))
BOARD = parse_board(DEFAULT_BOARD)


def visloc(*arguments: object) -> Result:
    return CliRunner().invoke(module.app, ["calibrate", *map(str, arguments)])


@pytest.fixture(scope="module")
def shots() -> list[Image]:
    rng, take = np.random.default_rng(200), Photographer(BROWN, BOARD)
    return [take(pose, rng) for pose in poses(BROWN, BOARD, 11, rng)]


@pytest.fixture(scope="module")
def photos(shots: list[Image], tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("photos")
    for k, shot in enumerate(shots):
        cv2.imwrite(str(folder / f"p{k:02d}.jpg"), shot, [cv2.IMWRITE_JPEG_QUALITY, 90])
    (folder / "cut.jpg").write_bytes((folder / "p00.jpg").read_bytes()[:3000])
    return folder


@pytest.fixture(scope="module")
def done(photos: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[Result, Path]:
    folder = tmp_path_factory.mktemp("results")
    wishes = ("--out", folder / "camera.toml", "--json", folder / "c.json", "--report", folder / "c.html")
    return visloc(photos, *wishes), folder


def test_the_section_is_one_that_the_daemon_takes(done: tuple[Result, Path]) -> None:
    result, folder = done
    assert result.exit_code == 0, result.output
    text = (folder / "camera.toml").read_text(encoding="utf-8")
    assert text in result.stdout
    comment, *_ = text.splitlines()
    assert "11 views of charuco:11x8:22mm:16mm:4X4_50" in comment
    assert "px on views held out" in comment
    camera = parse_config(tomllib.loads(text)).camera
    assert camera.unstated == []
    assert lens_model(camera).fx_px == pytest.approx(BROWN.fx_px, abs=1.0)


@pytest.mark.parametrize("example", EXAMPLES, ids=lambda path: path.stem)
def test_it_can_be_pasted_into_a_configuration(done: tuple[Result, Path], example: Path, tmp_path: Path) -> None:
    """In place of the lines of the same names; the rest of the section stays."""
    text = (done[1] / "camera.toml").read_text(encoding="utf-8")
    keys = set(tomllib.loads(text)["camera"])
    lines = example.read_text(encoding="utf-8").splitlines()
    at = lines.index("[camera]") if "[camera]" in lines else len(lines)
    kept = [line for line in lines[at + 1 :] if line.partition(" =")[0] not in keys]
    (tmp_path / "visloc.toml").write_text("\n".join([*lines[:at], text, *kept]), encoding="utf-8")
    camera = load_config(tmp_path / "visloc.toml").camera
    assert (camera.width_px, camera.height_px, camera.unstated) == (640, 480, [])


def test_everything_is_in_the_json(done: tuple[Result, Path]) -> None:
    found = json.loads((done[1] / "c.json").read_text(encoding="utf-8"))
    assert found["good"]
    assert found["camera"]["distortion_model"] == "brown_conrady"
    assert found["left_out"] == {"cut.jpg": "cannot be read as a picture"}
    assert {each["model"] for each in found["models"]} == {"brown_conrady", "fisheye", "rational"}
    assert len(found["views"]) == 11
    assert 0 < found["sigma"]["focal_share"] < 0.005
    assert np.sqrt(np.array(found["covariance"]).diagonal()[0]) == pytest.approx(found["sigma"]["fx_px"])


def test_what_is_said(done: tuple[Result, Path]) -> None:
    said = done[0].stdout
    assert "not used: cut.jpg cannot be read as a picture" in said
    assert "11 views of 640 x 480 px" in said
    assert "so much of every height above ground" in said


def test_a_result_that_is_not_good_is_written_and_is_1(tmp_path: Path) -> None:
    rng, take = np.random.default_rng(7), Photographer(BROWN, BOARD)
    for k, pose in enumerate(poses(BROWN, BOARD, 8, rng, tilt_deg=0.0)):
        cv2.imwrite(str(tmp_path / f"{k}.png"), take(pose, rng))
    result = visloc(tmp_path, "--model", "brown_conrady", "--out", tmp_path / "camera.toml")
    assert result.exit_code == 1
    assert "NOT GOOD: the focal length is not determined" in result.stderr
    assert "tilted by 30 to 45°" in result.stderr
    assert "NOT GOOD" in (tmp_path / "camera.toml").read_text(encoding="utf-8").splitlines()[0]
    assert parse_config(tomllib.loads((tmp_path / "camera.toml").read_text(encoding="utf-8")))


def test_a_video_serves_as_well(shots: list[Image], tmp_path: Path) -> None:
    file = tmp_path / "board.avi"
    video = cv2.VideoWriter(str(file), cv2.VideoWriter.fourcc(*"MJPG"), 10.0, (640, 480))
    for shot in shots:
        for _ in range(2):
            video.write(cv2.cvtColor(shot, cv2.COLOR_GRAY2BGR))
    video.release()
    result = visloc(file, "--every", 1, "--model", "brown_conrady", "--json", tmp_path / "c.json")
    assert result.exit_code == 0, result.output
    found = json.loads((tmp_path / "c.json").read_text(encoding="utf-8"))
    assert len(found["views"]) == 11
    assert found["left_out"]["board.avi frame 1"] == "is the same view as board.avi frame 0"


def test_wrong_usage(photos: Path, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="no pictures are named"):
        module.app(["calibrate"], standalone_mode=False)
    with pytest.raises(ConfigError, match="--board"):
        module.app(["calibrate", str(photos), "--board", "chess"], standalone_mode=False)
    with pytest.raises(ConfigError, match="folder does not exist"):
        module.app(["calibrate", str(photos), "--out", str(tmp_path / "no" / "camera.toml")], standalone_mode=False)
    assert visloc(photos, "--model", "pinhole").exit_code == 2


def test_pictures_that_are_none_are_3(tmp_path: Path) -> None:
    (tmp_path / "a.jpg").write_bytes(b"no picture")
    for path, said in ((tmp_path / "gone.jpg", "gone.jpg: is not there"), (tmp_path, "a.jpg: cannot be read as a picture")):
        with pytest.raises(CameraError, match=said) as refused:
            module.app(["calibrate", str(path)], standalone_mode=False)
        assert module.exit_code(refused.value) == 3


def test_the_report_shows_all_of_it(done: tuple[Result, Path]) -> None:
    page = (done[1] / "c.html").read_text(encoding="utf-8")
    for words in ("GOOD", "every limit is met", "p03.jpg", "cannot be read as a picture", "fx_px = ", "chosen"):
        assert words in page
    assert page.count('<svg viewBox="0 0 664') == 2
    assert "nan" not in page


@pytest.mark.parametrize("name", ["board.svg", "board.png"])
def test_the_board_is_written_to_print(tmp_path: Path, name: str) -> None:
    result = visloc("--print-board", tmp_path / name)
    assert result.exit_code == 0
    assert "charuco:11x8:22mm:16mm:4X4_50 for A4" in result.stdout
    assert (tmp_path / name).stat().st_size > 5000


def test_a_board_to_print_has_a_form_of_its_own(photos: Path, tmp_path: Path) -> None:
    for arguments, said in ((["--print-board", "board.pdf"], "neither"), ([str(photos), "--print-board", "b.svg"], "named, too")):
        with pytest.raises(ConfigError, match=said):
            module.app(["calibrate", *arguments], standalone_mode=False)
