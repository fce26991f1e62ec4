"""What the navigator is told: frozen values. Names, units and defaults are those of the configuration (config.py)."""

from __future__ import annotations

import math
from dataclasses import dataclass

from visloc_companion.types import BeyondLimit, GimbalFrame, InjectionPolicy, Quat, Vec3


@dataclass(frozen=True, slots=True)
class NavigatorSettings:
    """The filter and the modes (section `navigator`)."""

    output_rate_hz: float = 10.0
    velocity_sigma_mps: float = 0.3
    velocity_sigma_aiding_mps: float = 0.8
    velocity_correlation_s: float = 20.0
    acceleration_sigma_mps2: float = 0.2
    acceleration_correlation_s: float = 20.0
    gate_sigma: float = 4.0
    relocalise_after_rejections: int = 4
    dead_reckoning_after_s: float = 2.0
    low_dead_reckoning_s: float = 10.0
    lost_sigma_m: float = 60.0
    start_anywhere: bool = True
    seed_sigma_m: float = 5.0
    min_height_m: float = 15.0
    map_sigma_m: float = 0.5
    map_sigma_h_m: float = 1.0
    height_walk_m_per_sqrt_s: float = 0.1
    integrity_risk: float = 1e-5
    alert_limit_m: float = 25.0
    alert_limit_low_m: float = 10.0
    vertical_alert_limit_m: float = 50.0
    vertical_alert_limit_low_m: float = 20.0
    low_height_m: float = 30.0


@dataclass(frozen=True, slots=True)
class GnssSettings:
    """The GNSS monitor (section `gnss`)."""

    min_fix_type: int = 3
    min_satellites: int = 6
    max_h_acc_m: float = 10.0
    silence_s: float = 2.0
    suspect_sigma: float = 3.0
    drift_threshold: float = 10.5
    gnss_sigma_m: float = 1.5
    denied_after_s: float = 1.5
    probation_s: float = 20.0


@dataclass(frozen=True, slots=True)
class InjectionSettings:
    """What is sent to the autopilot (section `injection`)."""

    policy: InjectionPolicy = InjectionPolicy.WHEN_UNRELIABLE
    switch_source: bool = False
    gnss_source_set: int = 1
    vision_source_set: int = 2
    px4_gps_ctrl: int = 7
    beyond_alert_limit: BeyondLimit = BeyondLimit.INJECT
    min_sigma_m: float = 0.5
    max_step_m: float = 5.0


@dataclass(frozen=True, slots=True)
class GimbalSettings:
    """The gimbal that carries the camera: which one (0: the first that is heard), what its attitude counts from (None: as it
    says), 1-sigma of its yaw, and how often it is to be told."""

    gimbal_id: int = 0
    frame: GimbalFrame | None = None
    sigma_yaw_rad: float = math.radians(3.0)
    rate_hz: float = 25.0


@dataclass(frozen=True, slots=True)
class CoreSettings:
    """Everything that `Navigator` needs to know.

    `q_frd_cambody` is the attitude of the camera's body (looks along its down axis, top edge of the image forward) in the
    vehicle's body, with a `gimbal` in that of core/camera/gimbal.py; `lever_frd_m` its position in the vehicle's body, metres
    from the IMU; `mount_sigma_rad` the 1-sigma tilt of mounting and attitude together, `readout_s` the time from the first row of
    an image to the last, `has_camera` whether one is configured.
    `max_rate_hz` bounds the requests to the localiser, `max_search_radius_m` the 3-sigma radius of their search,
    `max_probability_wrong` what a fix may claim. For `structure`, `structure_every` see core/turns.py, for `terrain`
    core/terrain/terrain_aiding.py, for `rangefinder` core/terrain/ranges.py. The link rates go into RequestMessage.
    """

    navigator: NavigatorSettings = NavigatorSettings()
    gnss: GnssSettings = GnssSettings()
    injection: InjectionSettings = InjectionSettings()
    q_frd_cambody: Quat = (1.0, 0.0, 0.0, 0.0)
    lever_frd_m: Vec3 = (0.0, 0.0, 0.0)
    mount_sigma_rad: float = math.radians(1.0)
    readout_s: float = 0.0
    has_camera: bool = False
    max_rate_hz: float = 5.0
    structure: bool = True
    structure_every: int = 0
    terrain: bool = False
    rangefinder: bool = False
    max_search_radius_m: float = 2000.0
    max_probability_wrong: float = 0.05
    attitude_rate_hz: float = 50.0
    position_rate_hz: float = 10.0
    gnss_rate_hz: float = 5.0
    status_rate_hz: float = 2.0
    seed: int = 1
    gimbal: GimbalSettings | None = None
