"""The camera that a configuration's `camera.url` names."""

from __future__ import annotations

from visloc_companion.adapters.camera.calibration import camera_model
from visloc_companion.adapters.camera.device import DeviceCamera
from visloc_companion.adapters.camera.files import FilesCamera
from visloc_companion.adapters.camera.tcp import TcpCamera
from visloc_companion.adapters.camera.video import VideoCamera
from visloc_companion.config_camera import CameraConfig
from visloc_companion.errors import ConfigError
from visloc_companion.protocols import Camera, Clock

KINDS = ("files:FOLDER", "video:FILE", "device:/dev/video0", "tcp:HOST:PORT")


def make_camera(config: CameraConfig, clock: Clock) -> Camera:
    """Open the camera. Raises ConfigError for a URL of no known kind or a lens that folds, CameraError for one that fails."""
    kind, _, address = config.url.partition(":")
    model = camera_model(config)
    if address and kind == "files":
        return FilesCamera(address, model, clock)
    if address and kind == "video":
        return VideoCamera(address, model, clock)
    if address and kind == "device":
        return DeviceCamera(address, model, clock, config.latency_s)
    if address and kind == "tcp":
        return TcpCamera(address, model, clock, config.latency_s)
    raise ConfigError(f"{config.url!r} names no camera", where="camera.url", remedy=f"use one of {', '.join(KINDS)}")
