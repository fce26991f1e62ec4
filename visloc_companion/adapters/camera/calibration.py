"""From the section `camera` of a configuration to the model of the camera."""

from __future__ import annotations

from dataclasses import replace

from visloc_companion.adapters.camera.mask import mask_error, read_mask
from visloc_companion.config import CameraConfig
from visloc_companion.errors import ConfigError
from visloc_companion.geo.camera import scaled
from visloc_companion.geo.pinhole_view import pinhole_view, why_folded
from visloc_companion.types import CameraModel

SHARE_PX = 480
MOST_MASKED = 0.7
"""Of what is looked at. Beyond it black and white are the wrong way round, or too little ground is left to be found again."""


def camera_model(camera: CameraConfig) -> CameraModel:
    """The calibrated model with its mask. Raises ConfigError as `lens_model` and `read_mask`, and for a mask that leaves less
    than three tenths of what is looked at."""
    model, mask = lens_model(camera), read_mask(camera)
    if mask is None:
        return model
    model = replace(model, mask=mask)
    if (share := masked_share(model)) > MOST_MASKED:
        what = f"{100 * share:.0f} % of what is looked at are black, at most {100 * MOST_MASKED:.0f} % may be"
        remedy = "if it is the wrong way round, invert it (white is ground); else move the camera to where it sees more ground"
        raise mask_error(camera, what, remedy)
    return model


def masked_share(model: CameraModel) -> float:
    """Of what is looked at, the part that shows no ground, to a percent or two; 0 without a mask."""
    mask = pinhole_view(scaled(model, min(1.0, SHARE_PX / model.width_px))).mask
    return 0.0 if mask is None else mask.masked_share


def lens_model(camera: CameraConfig) -> CameraModel:
    """The calibrated model without its mask. Raises ConfigError where a rational or fisheye lens's mapping folds between the
    principal point and the nearest border: its coefficients are wrong, or in another order.

    A mapping that folds further out is that of a calibration which no view of the corners supports; what lies there is left out.
    """
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
            remedy="check order and signs of the coefficients and that they belong to this width_px and fx_px, or calibrate anew",
        )
    return model
