"""From configuration to settings."""

from __future__ import annotations

import math

import pytest

from visloc_companion.adapters.camera.calibration import camera_model
from visloc_companion.app.settings import core_settings, mounting
from visloc_companion.config import (
    CameraConfig,
    Config,
    GnssConfig,
    InjectionConfig,
    LinkConfig,
    NavigatorConfig,
    parse_config,
)
from visloc_companion.config_section import Section
from visloc_companion.core.settings import CoreSettings, GimbalSettings
from visloc_companion.errors import ConfigError
from visloc_companion.geo.se3 import rotate
from visloc_companion.types import CameraModel, GimbalFrame, InjectionPolicy


def test_the_default_configuration_gives_the_default_settings() -> None:
    assert core_settings(parse_config({})) == CoreSettings()


def test_every_value_reaches_its_place() -> None:
    config = parse_config(
        {
            "navigator": {"gate_sigma": 3.5, "output_rate_hz": 20},
            "gnss": {"probation_s": 7.0, "min_satellites": 9},
            "injection": {"policy": "always", "switch_source": True},
            "localiser": {"max_rate_hz": 2.0, "max_search_radius_m": 300.0},
            "link": {"attitude_rate_hz": 25.0, "position_rate_hz": 4.0, "gnss_rate_hz": 3.0, "status_rate_hz": 1.0},
            "camera": {"mount_sigma_deg": 2.0, "readout_ms": 25.0},
            "seed": 77,
        }
    )
    settings = core_settings(config)
    assert (settings.navigator.gate_sigma, settings.navigator.output_rate_hz) == (3.5, 20.0)
    assert (settings.gnss.probation_s, settings.gnss.min_satellites) == (7.0, 9)
    assert settings.injection.policy is InjectionPolicy.ALWAYS
    assert settings.injection.switch_source
    assert (settings.max_rate_hz, settings.max_search_radius_m) == (2.0, 300.0)
    rates = settings.attitude_rate_hz, settings.position_rate_hz, settings.gnss_rate_hz, settings.status_rate_hz
    assert rates == (25.0, 4.0, 3.0, 1.0)
    assert settings.mount_sigma_rad == pytest.approx(math.radians(2.0))
    assert settings.readout_s == pytest.approx(0.025)
    assert settings.seed == 77


SECTIONS: dict[str, type[Section]] = {"navigator": NavigatorConfig, "gnss": GnssConfig, "injection": InjectionConfig}
OF_THE_LINK = {"output", "position_sensor_id", "external_estimate_period_s", "max_outside_map_m", "set_origin"}
"""Of section `injection`: what the link alone is told (test_constructors.py)."""
OTHERS = {
    "localiser": ("max_probability_wrong", "max_rate_hz", "structure", "structure_every", "rangefinder", "terrain"),
    "link": ("attitude_rate_hz", "position_rate_hz", "gnss_rate_hz", "status_rate_hz"),
    "camera": ("mount_roll_deg", "mount_pitch_deg", "mount_yaw_deg", "mount_sigma_deg", "readout_ms", "lever_arm_frd_m"),
}
KEYS = [(section, key) for section, model in SECTIONS.items() for key in model.model_fields if key not in OF_THE_LINK]
KEYS += [(section, key) for section, keys in OTHERS.items() for key in keys]


def another(section: str, key: str) -> object:
    """A value that is allowed and not the default."""
    default = getattr(getattr(Config(), section), key)
    texts = {"policy": "always", "beyond_alert_limit": "stop"}
    if isinstance(default, bool):
        return not default
    if isinstance(default, str):
        return texts[key]
    if isinstance(default, tuple):
        return (0.1, 0.2, 0.3)
    return default + 1 if isinstance(default, int) else default * 0.9 + (default == 0.0)


@pytest.mark.parametrize(("section", "key"), KEYS)
def test_no_key_of_the_navigator_is_lost_on_the_way(section: str, key: str) -> None:
    """Also of those that are to come: one that is added to the configuration alone would change nothing."""
    told = core_settings(parse_config({section: {key: another(section, key)}}))
    assert told != CoreSettings()


def test_a_camera_turned_to_the_right_sees_forward_where_the_vehicle_has_right() -> None:
    q = mounting(CameraConfig(mount_yaw_deg=90.0))
    assert rotate(q, (1.0, 0.0, 0.0)) == pytest.approx((0.0, 1.0, 0.0), abs=1e-12)


def test_a_camera_pitched_up_by_90_degrees_looks_forward() -> None:
    q = mounting(CameraConfig(mount_pitch_deg=90.0))
    assert rotate(q, (0.0, 0.0, 1.0)) == pytest.approx((1.0, 0.0, 0.0), abs=1e-12)


def test_camera_model_is_the_calibration() -> None:
    camera = CameraConfig(
        width_px=320, height_px=240, fx_px=250, fy_px=251, cx_px=160, cy_px=121, distortion=(0.1, -0.2, 0.001, 0.002, 0.05)
    )
    assert camera_model(camera) == CameraModel(320, 240, 250.0, 251.0, 160.0, 121.0, (0.1, -0.2, 0.001, 0.002, 0.05))


def test_camera_model_names_the_lens() -> None:
    camera = CameraConfig(distortion_model="fisheye", distortion=(0.1, -0.02, 0.0, 0.0), fx_px=300, fy_px=300)
    assert camera_model(camera) == CameraModel(640, 480, 300.0, 300.0, 319.5, 239.5, (0.1, -0.02, 0.0, 0.0), "fisheye")


def test_a_lens_that_folds_within_the_picture_is_refused() -> None:
    wrong_order = CameraConfig(distortion_model="fisheye", distortion=(-0.6, 0.1, 0.0, 0.0), fx_px=300, fy_px=300)
    with pytest.raises(
        ConfigError, match=r"camera.distortion: the mapping of this fisheye lens folds back .* at \d+ % of the way"
    ):
        camera_model(wrong_order)
    in_the_corners = CameraConfig(distortion_model="fisheye", distortion=(-0.15, 0.0, 0.0, 0.0), fx_px=300, fy_px=300)
    assert camera_model(in_the_corners).distortion_model == "fisheye"


def test_a_fixed_camera_has_no_gimbal() -> None:
    assert core_settings(Config()).gimbal is None


def test_a_gimbal_is_told_in_the_cores_units() -> None:
    camera = CameraConfig(mount="gimbal", gimbal_id=2, gimbal_frame="airframe", gimbal_yaw_sigma_deg=4.0)
    config = Config(camera=camera, link=LinkConfig(gimbal_rate_hz=30.0))
    assert core_settings(config).gimbal == GimbalSettings(2, GimbalFrame.AIRFRAME, math.radians(4.0), 30.0)
    as_it_says = core_settings(Config(camera=CameraConfig(mount="gimbal"))).gimbal
    assert as_it_says is not None
    assert as_it_says.frame is None, "as its messages say"
