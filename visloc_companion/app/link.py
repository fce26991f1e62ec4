"""From the configuration to the MAVLink link: what is signed, where positions may be sent, and who owns the connection."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from visloc_companion.adapters.mavlink.channels import OpenChannel
from visloc_companion.adapters.mavlink.dialect import AUTOPILOT_COMPONENT
from visloc_companion.adapters.mavlink.mavsdk_channel import MavsdkOpener
from visloc_companion.adapters.mavlink.outputs.fence import Fence
from visloc_companion.adapters.mavlink.outputs.kinds import Output
from visloc_companion.adapters.mavlink.pymavlink_link import PymavlinkLink
from visloc_companion.adapters.mavlink.settings import SessionSettings
from visloc_companion.adapters.mavlink.signing import SigningSettings, at_zero_of, stamp_at_zero
from visloc_companion.adapters.mavlink.signing_key import read_key
from visloc_companion.adapters.mavlink.signing_stamp import StampFile
from visloc_companion.app.handover import Left
from visloc_companion.config import LEAST_REPORTS, Config, LinkConfig
from visloc_companion.errors import ConfigError, MapError
from visloc_companion.protocols import AutopilotLink, Clock
from visloc_companion.types import GeoPoint

PX4_GPS_POSITION = 1
"""Bit 0 of EKF2_GPS_CTRL: longitude and latitude are fused."""
MAX_SYSTEM_ID = 255
LOOKS = 41
"""Places along each side of the map at which its ground is looked at."""


def make_link(
    config: Config,
    clock: Clock,
    on_raw: Callable[[bytes, int, bool], None],
    on_warning: Callable[[str], None],
    left: Left | None = None,
) -> AutopilotLink:
    """The MAVLink connection of a configuration; `left` by the daemon before it.

    Raises ConfigError for a URL that is not valid or a bad key file or an origin without a map, or what contradicts itself
    (`require_sense`), MapError for a pack that cannot be read.
    """
    require_sense(config)
    fence, middle = map_extent(config)
    settings = SessionSettings(
        system_id=config.link.system_id,
        left_system_id=left.system_id if left is not None and 0 < left.system_id <= MAX_SYSTEM_ID else 0,
        component_id=config.link.component_id,
        operator_systems=config.link.operator_systems,
        gnss_source_set=config.injection.gnss_source_set,
        vision_source_set=config.injection.vision_source_set,
        px4_gps_ctrl=config.injection.px4_gps_ctrl,
        reconnect_s=config.link.reconnect_s,
        signing=_signing(config.link, clock, on_warning),
        output=None if config.injection.output == "auto" else Output(config.injection.output),
        position_sensor_id=config.injection.position_sensor_id,
        external_estimate_period_s=config.injection.external_estimate_period_s,
        max_step_m=config.injection.max_step_m,
        fence=fence,
        origin_to_set=middle if config.injection.set_origin else None,
    )
    opener = _through_mavsdk(config.link) if config.link.backend == "mavsdk" else None
    return PymavlinkLink(config.link.url, settings, clock, on_raw=on_raw, on_warning=on_warning, open_channel=opener)


def require_sense(config: Config) -> None:
    """Raises ConfigError where we would speak as the autopilot, not sign what is meant to be signed, take a receiver for silent
    that says what it was asked for, or a switch back to GNSS would not lead to it."""
    injection, remedy = config.injection, "leave it out: the default is right"
    if config.link.component_id == AUTOPILOT_COMPONENT:
        what = "1 is the autopilot's own: it passes over what seems to come from itself"
        raise ConfigError(what, where="link.component_id", remedy=remedy)
    _require_key(config.link)
    rate_hz, silence_s = config.link.gnss_rate_hz, config.gnss.silence_s
    if rate_hz * silence_s < LEAST_REPORTS:
        every = f"{rate_hz:g} Hz is a report every {1 / rate_hz:.3g} s"
        more = f"ask for {LEAST_REPORTS / silence_s:.3g} or more (5 is the default), or a longer gnss.silence_s"
        what = f"{every}, and {silence_s:g} s without one are a lost GNSS (gnss.silence_s)"
        raise ConfigError(what, where="link.gnss_rate_hz", remedy=more)
    if not injection.switch_source:
        return
    if injection.gnss_source_set == injection.vision_source_set:
        what = f"{injection.gnss_source_set} is injection.gnss_source_set, too: to switch would do nothing"
        raise ConfigError(what, where="injection.vision_source_set", remedy="name the EK3_SRC set of each (1 and 2)")
    if not injection.px4_gps_ctrl & PX4_GPS_POSITION:
        what = f"{injection.px4_gps_ctrl} has not bit 0, so PX4 would be left without position where GNSS is trusted again"
        raise ConfigError(what, where="injection.px4_gps_ctrl", remedy=remedy)


def _require_key(link: LinkConfig) -> None:
    stated = [name for name in ("signing_link_id", "signing_stamp_file") if getattr(link, name)]
    if stated and not link.signing_key_file:
        what = f"is empty, but link.{' and link.'.join(stated)} set: nothing would be signed, and everybody believed"
        raise ConfigError(what, where="link.signing_key_file", remedy="name the key's file, or leave those out")


def _through_mavsdk(link: LinkConfig) -> OpenChannel:
    if link.signing_key_file:
        remedy = 'link.backend = "pymavlink", or no key'
        raise ConfigError("MAVSDK cannot sign, and link.signing_key_file is set", where="link.backend", remedy=remedy)
    return MavsdkOpener(link.system_id, link.component_id)


def map_extent(config: Config) -> tuple[Fence | None, GeoPoint | None]:
    """Where positions may be sent, and the middle of the map at its ground's median height; neither without a pack.

    The height is read only where an origin is to be set. Raises MapError for a pack that cannot be read, ConfigError where an
    origin is to be set and there is no pack. Where another part of the start opens the pack whole, that one says what is wrong.
    """
    if not config.map.pack:
        if config.injection.set_origin:
            remedy = "name the folder that `visloc map build` made, or leave injection.set_origin off"
            raise ConfigError("is empty, but injection.set_origin takes the origin from the map", where="map.pack", remedy=remedy)
        return None, None
    from visloc_companion.maps.signature import public_keys, read_signed

    pack, trusted = Path(config.map.pack), config.map.trusted_keys
    try:
        manifest = read_signed(pack, public_keys(trusted))
    except (MapError, ConfigError):
        if config.camera.url or config.localiser.terrain or trusted:
            return None, None
        raise
    b = manifest.bounds
    fence = Fence(b.south_deg, b.west_deg, b.north_deg, b.east_deg, config.injection.max_outside_map_m)
    lon_deg = (b.west_deg + (b.east_deg - b.west_deg) % 360 / 2 + 180) % 360 - 180
    h_amsl_m = manifest.heights.plane_amsl_m
    if config.injection.set_origin and manifest.heights.grid is not None:
        h_amsl_m = _ground_amsl_m(pack)
    return fence, GeoPoint((b.south_deg + b.north_deg) / 2, lon_deg, h_amsl_m)


def _ground_amsl_m(pack: Path) -> float:
    """Median height of a pack's surface: ArduPilot takes its origin's for that of the ground where it was switched on."""
    from visloc_companion.maps.pack import PackMap

    reference = PackMap.open(pack, verify_hashes=False)
    heights = reference.heights_amsl_m(reference.spread_map_m(LOOKS).reshape(-1, 2))
    if not np.isfinite(heights).any():
        raise MapError("knows no height of its ground", where=str(pack), remedy="leave injection.set_origin off")
    return float(np.nanmedian(heights))


def _signing(link: LinkConfig, clock: Clock, on_warning: Callable[[str], None]) -> SigningSettings | None:
    if not link.signing_key_file:
        return None
    key = read_key(Path(link.signing_key_file))
    now_ns = clock.now_ns()
    at_zero = stamp_at_zero(time.time_ns(), now_ns)
    kept = StampFile(Path(link.signing_stamp_file), on_warning) if link.signing_stamp_file else None
    if kept is not None:
        at_zero = max(at_zero, at_zero_of(kept.first(), now_ns))
    return SigningSettings(key, link.signing_link_id, link.accept_unsigned, at_zero, None if kept is None else kept.keep)
