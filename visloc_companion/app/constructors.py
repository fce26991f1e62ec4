"""The one place where sections of the configuration become adapters (the kinds of camera: adapters/camera/factory.py)."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

from visloc_companion.adapters.mavlink.pymavlink_link import PymavlinkLink
from visloc_companion.adapters.mavlink.settings import SessionSettings
from visloc_companion.adapters.mavlink.signing import SigningSettings, stamp_at_zero
from visloc_companion.adapters.mavlink.signing_key import read_key
from visloc_companion.app.parts import Constructors
from visloc_companion.config import Config, LinkConfig
from visloc_companion.protocols import AutopilotLink, Camera, Clock


def make_link(
    config: Config, clock: Clock, on_raw: Callable[[bytes, int, bool], None], on_warning: Callable[[str], None]
) -> AutopilotLink:
    """The MAVLink connection of a configuration. Raises LinkError for a URL that is not valid, ConfigError for a bad key file."""
    settings = SessionSettings(
        system_id=config.link.system_id,
        component_id=config.link.component_id,
        gnss_source_set=config.injection.gnss_source_set,
        vision_source_set=config.injection.vision_source_set,
        px4_gps_ctrl=config.injection.px4_gps_ctrl,
        reconnect_s=config.link.reconnect_s,
        signing=_signing(config.link, clock),
    )
    return PymavlinkLink(config.link.url, settings, clock, on_raw=on_raw, on_warning=on_warning)


def _signing(link: LinkConfig, clock: Clock) -> SigningSettings | None:
    if not link.signing_key_file:
        return None
    at_zero = stamp_at_zero(time.time_ns(), clock.now_ns())
    return SigningSettings(read_key(Path(link.signing_key_file)), link.signing_link_id, link.accept_unsigned, at_zero)


def make_camera(config: Config, clock: Clock) -> Camera:
    """The camera of a configuration. Raises ConfigError for an unknown kind, CameraError where it cannot be used."""
    from visloc_companion.adapters.camera.factory import make_camera as make

    return make(config.camera, clock)


CONSTRUCTORS = Constructors(link=make_link, camera=make_camera)
