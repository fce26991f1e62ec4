"""The one place where sections of the configuration become adapters (the kinds of camera: adapters/camera/factory.py)."""

from __future__ import annotations

from collections.abc import Callable

from visloc_companion.adapters.mavlink.pymavlink_link import PymavlinkLink
from visloc_companion.adapters.mavlink.settings import SessionSettings
from visloc_companion.app.parts import Constructors
from visloc_companion.config import Config
from visloc_companion.protocols import AutopilotLink, Camera, Clock


def make_link(
    config: Config, clock: Clock, on_raw: Callable[[bytes, int, bool], None], on_warning: Callable[[str], None]
) -> AutopilotLink:
    """The MAVLink connection of a configuration. Raises LinkError for a URL that is not valid."""
    settings = SessionSettings(
        system_id=config.link.system_id,
        component_id=config.link.component_id,
        gnss_source_set=config.injection.gnss_source_set,
        vision_source_set=config.injection.vision_source_set,
        px4_gps_ctrl=config.injection.px4_gps_ctrl,
        reconnect_s=config.link.reconnect_s,
    )
    return PymavlinkLink(config.link.url, settings, clock, on_raw=on_raw, on_warning=on_warning)


def make_camera(config: Config, clock: Clock) -> Camera:
    """The camera of a configuration. Raises ConfigError for an unknown kind, CameraError where it cannot be used."""
    from visloc_companion.adapters.camera.factory import make_camera as make

    return make(config.camera, clock)


CONSTRUCTORS = Constructors(link=make_link, camera=make_camera)
