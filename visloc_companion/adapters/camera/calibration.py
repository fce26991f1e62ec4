"""From the section `camera` of a configuration to the model of the camera."""

from __future__ import annotations

from visloc_companion.config import CameraConfig
from visloc_companion.errors import ConfigError
from visloc_companion.geo.pinhole_view import why_folded
from visloc_companion.types import CameraModel


def camera_model(camera: CameraConfig) -> CameraModel:
    """The calibrated model. Raises ConfigError where a rational or fisheye lens's mapping folds between the principal point and
    the nearest border: its coefficients are wrong, or in another order.

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
