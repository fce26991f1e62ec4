from __future__ import annotations

import re

import pytest

from visloc_companion.adapters.camera.calibration import lens_model
from visloc_companion.config import CameraConfig, parse_config
from visloc_companion.errors import ConfigError


def camera(**keys: object) -> CameraConfig:
    return parse_config({"camera": keys}).camera


@pytest.mark.parametrize(
    ("keys", "told"),
    [
        ({"fx_px": 5.0}, "camera.fx_px: 5 px are a view of 178° over the 640 px of the picture"),
        ({"fx_px": 1e6}, "camera.fx_px: 1e+06 px are a view of 0.0367° over the 640 px of the picture"),
        ({"fy_px": 3.6}, "camera.fy_px: 3.6 px are a view of 178° over the 480 px of the picture"),
        ({"cx_px": 1279.0}, "camera.cx_px: 1279 lies outside of the picture, which has 640 px"),
        ({"cy_px": 480.0}, "camera.cy_px: 480 lies outside of the picture, which has 480 px"),
        ({"width_px": 64, "height_px": 48}, "camera.cx_px: 319.5 lies outside of the picture, which has 64 px"),
        (
            {"distortion": (-1.5, 0.0, 0.0, 0.0, 0.0)},
            "camera.distortion: the mapping of this brown_conrady lens folds back within the picture, at 65 % of the way",
        ),
    ],
)
def test_what_no_lens_makes_is_refused_by_its_field(keys: dict[str, object], told: str) -> None:
    with pytest.raises(ConfigError, match=rf"^{re.escape(told)}.*; remedy: "):
        lens_model(camera(**keys))


@pytest.mark.parametrize(
    "keys",
    [
        {},
        {"fx_px": 18_000.0, "fy_px": 18_000.0},
        {"fx_px": 640 / 2 / 1.92, "fy_px": 640 / 2 / 1.92, "distortion_model": "fisheye", "distortion": (0.0,) * 4},
        {"fx_px": 250.0, "fy_px": 250.0, "distortion": (-0.28, 0.07, 0.0, 0.0, 0.0)},
        {"cx_px": 0.0, "cy_px": 479.0},
    ],
    ids=["default", "zoom of 2°", "fisheye of 220°", "wide action camera", "principal point in a corner"],
)
def test_what_lenses_there_are_is_accepted(keys: dict[str, object]) -> None:
    lens_model(camera(**keys))
