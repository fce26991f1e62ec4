"""From the configuration (degrees, urls, texts) to what the parts are told (radians, quaternions, models)."""

from __future__ import annotations

import math
from dataclasses import fields
from pathlib import Path
from typing import Any, TypeVar

from visloc_companion.config import Config, LocaliserConfig
from visloc_companion.config_camera import CameraConfig
from visloc_companion.config_section import Section
from visloc_companion.core.settings import CoreSettings, GimbalSettings, GnssSettings, InjectionSettings, NavigatorSettings
from visloc_companion.geo.se3 import quat_from_euler
from visloc_companion.localise.runtime import NetworkChoice
from visloc_companion.types import BeyondLimit, GimbalFrame, InjectionPolicy, Quat

_Settings = TypeVar("_Settings", NavigatorSettings, GnssSettings, InjectionSettings)


def core_settings(config: Config) -> CoreSettings:
    """What the navigator is told. Angles in radians; the mounting as quaternion `q_frd_cambody`."""
    return CoreSettings(
        navigator=_same_names(NavigatorSettings, config.navigator),
        gnss=_same_names(GnssSettings, config.gnss),
        injection=_same_names(
            InjectionSettings,
            config.injection,
            policy=InjectionPolicy(config.injection.policy),
            beyond_alert_limit=BeyondLimit(config.injection.beyond_alert_limit),
        ),
        q_frd_cambody=mounting(config.camera),
        lever_frd_m=config.camera.lever_arm_frd_m,
        mount_sigma_rad=math.radians(config.camera.mount_sigma_deg),
        readout_s=config.camera.readout_ms * 1e-3,
        has_camera=bool(config.camera.url),
        max_rate_hz=config.localiser.max_rate_hz,
        structure=config.localiser.structure,
        structure_every=config.localiser.structure_every,
        terrain=config.localiser.terrain,
        rangefinder=config.localiser.rangefinder,
        max_search_radius_m=config.localiser.max_search_radius_m,
        max_probability_wrong=config.localiser.max_probability_wrong,
        attitude_rate_hz=config.link.attitude_rate_hz,
        position_rate_hz=config.link.position_rate_hz,
        gnss_rate_hz=config.link.gnss_rate_hz,
        status_rate_hz=config.link.status_rate_hz,
        seed=config.seed,
        gimbal=gimbal(config),
    )


def gimbal(config: Config) -> GimbalSettings | None:
    """The gimbal that carries the camera, None where the airframe does."""
    camera = config.camera
    if camera.mount == "fixed":
        return None
    frame = None if camera.gimbal_frame == "auto" else GimbalFrame(camera.gimbal_frame)
    return GimbalSettings(camera.gimbal_id, frame, math.radians(camera.gimbal_yaw_sigma_deg), config.link.gimbal_rate_hz)


def network_choice(localiser: LocaliserConfig) -> NetworkChoice:
    """Which network, and on what."""
    folder = Path(localiser.model) if localiser.model else None
    return NetworkChoice(folder, localiser.providers, localiser.threads or None, localiser.model_variant)


def mounting(camera: CameraConfig) -> Quat:
    """Attitude of the camera's body in the body of what carries it, `q_frd_cambody` (intrinsic yaw, pitch, roll)."""
    return quat_from_euler(
        math.radians(camera.mount_roll_deg), math.radians(camera.mount_pitch_deg), math.radians(camera.mount_yaw_deg)
    )


def _same_names(kind: type[_Settings], section: Section, **translated: Any) -> _Settings:
    values = {item.name: getattr(section, item.name) for item in fields(kind)}
    return kind(**(values | translated))
