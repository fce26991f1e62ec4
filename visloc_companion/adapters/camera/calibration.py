"""From the section `camera` of a configuration to the model of the camera."""

from __future__ import annotations

import math
from dataclasses import replace

from visloc_companion.adapters.camera.mask import read_mask, stated
from visloc_companion.config_camera import CameraConfig
from visloc_companion.errors import ConfigError
from visloc_companion.geo.camera import scaled
from visloc_companion.geo.pinhole_view import pinhole_view, why_folded
from visloc_companion.types import CameraMask, CameraModel, Image

SHARE_PX = 480
MOST_MASKED = 0.7
"""Of what is looked at. Beyond it black and white are the wrong way round, or too little ground is left to be found again."""
VIEWS_DEG = (1.0, 160.0)
"""Angles that a pinhole of the focal length sees from side to side. Lenses with less are telescopes; a fisheye of 220° whose
circle lies within the picture has almost 150°, and a focal length that was written in millimetres more than that."""


def camera_model(camera: CameraConfig) -> CameraModel:
    """The calibrated model with its mask. Raises ConfigError as `lens_model`, `read_mask` and `with_mask`."""
    model, mask = lens_model(camera), read_mask(camera)
    return model if mask is None else with_mask(model, mask, stated(camera))


def wrong_size(pixels: Image, calibrated: CameraModel | CameraConfig) -> str | None:
    """What is wrong with the size of a frame, (H, W, 3) or (H, W); None where it is the calibrated one."""
    height, width = pixels.shape[:2]
    if (width, height) == (calibrated.width_px, calibrated.height_px):
        return None
    return f"{width} x {height} px, calibrated for {calibrated.width_px} x {calibrated.height_px}"


def with_mask(model: CameraModel, mask: CameraMask, where: str) -> CameraModel:
    """The model with a mask of its frames' size. Raises ConfigError for one that leaves less than three tenths of what is looked
    at."""
    model = replace(model, mask=mask)
    if (share := masked_share(model)) > MOST_MASKED:
        what = f"{100 * share:.0f} % of what is looked at are black, at most {100 * MOST_MASKED:.0f} % may be"
        remedy = "if it is the wrong way round, invert it (white is ground); else move the camera to where it sees more ground"
        raise ConfigError(what, where=where, remedy=remedy)
    return model


def masked_share(model: CameraModel) -> float:
    """Of what is looked at, the part that shows no ground, to a percent or two; 0 without a mask."""
    mask = pinhole_view(scaled(model, min(1.0, SHARE_PX / model.width_px))).mask
    return 0.0 if mask is None else mask.masked_share


def lens_model(camera: CameraConfig) -> CameraModel:
    """The calibrated model without its mask. Raises ConfigError for a focal length that no lens has, a principal point outside of
    the picture, and where the mapping folds between the principal point and the nearest border: its coefficients are wrong, or in
    another order.

    A mapping that folds further out is that of a calibration which no view of the corners supports; what lies there is left out.
    """
    _require_lens(camera)
    model = CameraModel(
        camera.width_px,
        camera.height_px,
        camera.fx_px,
        camera.fy_px,
        camera.cx_px,
        camera.cy_px,
        camera.distortion,
        camera.distortion_model,
    )
    if why := why_folded(model):
        raise ConfigError(
            why,
            where="camera.distortion",
            remedy="check order and signs of the coefficients, and that they belong to this width_px and fx_px; or calibrate",
        )
    return model


def _require_lens(camera: CameraConfig) -> None:
    """Refuse what is no camera's, but mistaken for it: another unit, the values of another image size or of another row."""
    for axis, focal_px, size_px in (("x", camera.fx_px, camera.width_px), ("y", camera.fy_px, camera.height_px)):
        view_deg = math.degrees(2 * math.atan(size_px / 2 / focal_px))
        if not VIEWS_DEG[0] <= view_deg <= VIEWS_DEG[1]:
            raise ConfigError(
                f"{focal_px:g} px are a view of {view_deg:.3g}° over the {size_px} px of the picture",
                where=f"camera.f{axis}_px",
                remedy="write the focal length in pixels, not millimetres, as calibrated for this image size",
            )
    for axis, centre_px, size_px in (("x", camera.cx_px, camera.width_px), ("y", camera.cy_px, camera.height_px)):
        if centre_px > size_px - 1:
            raise ConfigError(
                f"{centre_px:g} lies outside of the picture, which has {size_px} px",
                where=f"camera.c{axis}_px",
                remedy="write the principal point as calibrated for this image size (half the size gives half the values)",
            )
