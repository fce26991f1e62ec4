"""The mask of a configuration: where its path counts from, what is refused, and that a flight's own is the one that is read."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest

from visloc_companion.adapters.camera.calibration import camera_model, masked_share
from visloc_companion.app.parts import journal_header
from visloc_companion.app.settings import core_settings
from visloc_companion.config import CameraConfig, Config, load_config, parse_config
from visloc_companion.errors import ConfigError
from visloc_companion.types import Image

WIDTH, HEIGHT = 96, 64
MIDDLE = "cx_px = 47.5\ncy_px = 31.5\n"


def painted(share_black: float = 0.25) -> Image:
    """Black on the left."""
    grey = np.full((HEIGHT, WIDTH), 255, np.uint8)
    grey[:, : round(share_black * WIDTH)] = 0
    return grey


def stated(folder: Path, content: bytes | Image | None, more: str = "") -> Path:
    """A configuration that names a mask beside it."""
    if isinstance(content, np.ndarray):
        content = cv2.imencode(".png", content)[1].tobytes()
    if content is not None:
        (folder / "mask.png").write_bytes(content)
    toml = f'[camera]\nmask = "mask.png"\nwidth_px = {WIDTH}\nheight_px = {HEIGHT}\n{more or MIDDLE}'
    (folder / "visloc.toml").write_text(toml, encoding="utf-8")
    return folder / "visloc.toml"


def test_a_mask_is_sought_beside_the_file_that_names_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = stated(tmp_path, painted())
    monkeypatch.chdir("/")
    camera = load_config(path).camera
    assert camera.mask == str(tmp_path / "mask.png")
    assert camera.mask_sha256 == hashlib.sha256((tmp_path / "mask.png").read_bytes()).hexdigest()
    model = camera_model(camera)
    assert model.mask is not None
    assert np.array_equal(model.mask.ground(), painted() > 0)
    assert masked_share(model) == pytest.approx(0.25)
    assert camera_model(CameraConfig()).mask is None
    assert load_config(path).camera.model_fields_set >= {"mask", "mask_sha256", "width_px"}


@pytest.mark.parametrize(
    "as_stored",
    [
        lambda grey: np.dstack([grey] * 3),
        lambda grey: np.dstack([grey, grey, grey, np.full_like(grey, 255)]),
        lambda grey: np.where(grey > 0, 128, 127).astype(np.uint8),
    ],
    ids=["color", "opaque", "half"],
)
def test_black_and_white_are_what_counts(tmp_path: Path, as_stored: Callable[[Image], Image]) -> None:
    model = camera_model(load_config(stated(tmp_path, as_stored(painted()))).camera)
    assert model.mask is not None
    assert np.array_equal(model.mask.ground(), painted() > 0)


@pytest.mark.parametrize(
    ("content", "told"),
    [
        (None, r"cannot be read: No such file or directory; remedy: name the mask's file"),
        (b"BM, a bitmap", r"is no PNG; remedy: make it an 8-bit PNG"),
        (cv2.imencode(".png", painted())[1].tobytes()[:60], r"is damaged; remedy: make it an 8-bit PNG"),
        (painted()[:, :80], r"has 80 x 64 pixels, frames have 96 x 64; remedy: .*camera.width_px"),
        (painted().astype(np.uint16) * 257, r"has 16 bits a channel; remedy: make it an 8-bit PNG"),
        (np.dstack([painted()] * 4), r"is transparent in places; remedy: flatten it"),
        (painted(1.0), r"is black all over \(its brightest pixel is 0 of 255\); remedy: make ground white"),
        (np.minimum(painted(), 1), r"is black all over \(its brightest pixel is 1 of 255\); remedy: make ground white"),
        (painted(0.75), r"75 % of what is looked at are black, at most 70 % may be; remedy: .* invert it"),
    ],
    ids=["missing", "bitmap", "damaged", "size", "16 bits", "transparent", "black", "ones", "inverted"],
)
def test_what_cannot_be_a_mask_is_refused_by_name(tmp_path: Path, content: bytes | Image | None, told: str) -> None:
    camera = load_config(stated(tmp_path, content)).camera
    with pytest.raises(ConfigError, match=rf"^camera.mask = {tmp_path}/mask.png: {told}"):
        camera_model(camera)


def test_the_share_is_that_of_what_is_looked_at(tmp_path: Path) -> None:
    """Most of what a fisheye shows outside its circle is never looked at, and may well be black."""
    v, u = np.mgrid[0:HEIGHT, 0:WIDTH]
    circle = np.where(np.hypot(u - 47.5, v - 31.5) < 22, 255, 0).astype(np.uint8)
    lens = 'distortion_model = "fisheye"\ndistortion = [0.0, 0.0, 0.0, 0.0]\ncx_px = 47.5\ncy_px = 31.5\n'
    model = camera_model(load_config(stated(tmp_path, circle, f"{lens}fx_px = 16.0\nfy_px = 16.0\n")).camera)
    assert np.mean(circle == 0) > 0.7
    assert masked_share(model) < 0.5


def test_a_journal_s_flight_is_looked_at_with_its_own_mask(tmp_path: Path) -> None:
    config = load_config(stated(tmp_path, painted()))
    flown = journal_header(config, 0).configuration
    again = parse_config(flown)
    assert again == config
    assert camera_model(again.camera) == camera_model(config.camera)
    cv2.imwrite(str(tmp_path / "mask.png"), painted(0.5))
    with pytest.raises(ConfigError, match=r"another file than the one that was used: .*remedy: bring that file back"):
        camera_model(again.camera)
    assert camera_model(load_config(tmp_path / "visloc.toml").camera).mask is not None, "the configuration takes the new one"
    (tmp_path / "mask.png").unlink()
    with pytest.raises(ConfigError, match=r"cannot be read: No such file"):
        camera_model(again.camera)
    assert core_settings(again) == core_settings(config), "to repeat its commands no mask is needed"


def test_no_mask_leaves_a_configuration_as_it_is(tmp_path: Path) -> None:
    (tmp_path / "visloc.toml").write_text("[camera]\nfx_px = 400.0\n", encoding="utf-8")
    assert load_config(tmp_path / "visloc.toml").camera.model_fields_set == {"fx_px"}
    assert Config().camera.mask == Config().camera.mask_sha256 == ""
