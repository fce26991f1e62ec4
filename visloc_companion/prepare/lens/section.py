"""A lens as the configuration's section `camera` states it."""

from __future__ import annotations

from typing import Any

from visloc_companion.types import CameraModel

_DECIMALS, _DIGITS = 3, 10


def section(model: CameraModel) -> dict[str, Any]:
    """Size, lens and distortion, by the names of config_camera.CameraConfig; pixels to a thousandth."""
    return {
        "width_px": model.width_px,
        "height_px": model.height_px,
        **{key: round(getattr(model, key), _DECIMALS) for key in ("fx_px", "fy_px", "cx_px", "cy_px")},
        "distortion_model": model.distortion_model,
        "distortion": [float(f"{k:.{_DIGITS}g}") for k in model.distortion],
    }
