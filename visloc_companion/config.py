"""Configuration: TOML to frozen models. Units are in the key names; an unknown key is an error with the nearest valid name."""

from __future__ import annotations

import contextlib
import hashlib
import tomllib
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BaseModel, Field, ValidationError, model_validator

from visloc_companion.config_camera import CameraConfig
from visloc_companion.config_section import NonNegative, Positive, Section, Share
from visloc_companion.errors import ConfigError, did_you_mean

Method = Literal["deep", "gradient", "cross-view", "iclk", "ncc", "mi", "keypoint"]
DEFAULT_METHOD: Method = "deep"
"""What localises where nobody chose: the daemon, `visloc evaluate image`, simulated and demonstrated flights."""


class LinkConfig(Section):
    """The MAVLink connection."""

    url: str = "udpin:127.0.0.1:14550"
    """`udpin:HOST:PORT`, `udpout:HOST:PORT`, `tcp:HOST:PORT`, `tcpin:HOST:PORT` or `serial:DEVICE:BAUD`."""
    backend: Literal["pymavlink", "mavsdk"] = "pymavlink"
    """Who owns the connection: this program, or MAVSDK (`pip install 'visloc-companion[mavsdk]'`), which cannot sign."""
    system_id: Annotated[int, Field(ge=0, le=255)] = 0
    """Only this autopilot is listened to; 0 takes the first one that is heard and keeps to it."""
    component_id: Annotated[int, Field(ge=1, le=255)] = 197
    """Our own MAVLink component (MAV_COMP_ID_VISUAL_INERTIAL_ODOMETRY)."""
    operator_systems: tuple[Annotated[int, Field(ge=1, le=255)], ...] = (255,)
    """Ground stations (MAVLink system ids) that may say where the vehicle is (docs/start-anywhere.md); none: `[]`."""
    attitude_rate_hz: Positive = 50.0
    """ATTITUDE and SCALED_IMU asked of the autopilot; ArduPlane denies 50 Hz and is then asked for less."""
    position_rate_hz: Positive = 10.0
    """GLOBAL_POSITION_INT and LOCAL_POSITION_NED asked of the autopilot."""
    gnss_rate_hz: Positive = 5.0
    """GPS_RAW_INT asked of the autopilot."""
    status_rate_hz: Positive = 2.0
    """EKF_STATUS_REPORT or ESTIMATOR_STATUS asked of the autopilot."""
    gimbal_rate_hz: Positive = 25.0
    """GIMBAL_DEVICE_ATTITUDE_STATUS asked of the autopilot where `camera.mount` is `gimbal`."""
    signing_key_file: str = ""
    """File with the key of MAVLink 2 signing (`visloc link-key` makes one; owner only, mode 0600); empty signs nothing."""
    signing_link_id: Annotated[int, Field(ge=0, le=255)] = 0
    """Our link id in signatures; two links of one component to one vehicle need different ones."""
    signing_stamp_file: str = ""
    """With a key: where the newest time of signing is kept between starts; wanted where the computer's clock may be behind."""
    accept_unsigned: bool = False
    """With a key: believe unsigned messages, too. Without a key all are believed."""
    telemetry_rate_hz: Annotated[float, Field(ge=0, le=20)] = 1.0
    """NAMED_VALUE messages for the ground station (docs/mavlink.md); 0 sends none."""
    computer_status: bool = True
    """Send ONBOARD_COMPUTER_STATUS once a second."""
    reconnect_s: Positive = 2.0
    """The pause before the connection is opened anew, twice as long from try to try up to 10 s; a serial device that was gone is
    opened as soon as it is there. A TCP or serial one is given up after so long and 3 s without a byte."""


class MapConfig(Section):
    """The map pack."""

    pack: str = ""
    """Folder of the pack (`visloc map build` makes it)."""
    verify_hashes: bool = True
    """Check the SHA-256 of every file of the pack at start-up."""
    trusted_keys: tuple[str, ...] = ()
    """Files with public keys (`visloc map key` makes them): a pack that none of them has signed is not used (docs/maps.md)."""

    @model_validator(mode="after")
    def _trust_is_of_hashes(self) -> MapConfig:
        if self.trusted_keys and not self.verify_hashes:
            raise ValueError("with trusted_keys verify_hashes must be true: what is signed are the hashes of the files")
        return self


class LocaliserConfig(Section):
    """How frames are localised."""

    method: Method = DEFAULT_METHOD
    """Which localiser answers; `deep`, `cross-view` and `iclk` need onnxruntime (`pip install 'visloc-companion[cpu]'`)."""
    model: str = ""
    """Folder of the network for `deep`, `cross-view` and `iclk`; empty takes the one that came with this version."""
    model_variant: Literal["float32", "float16", "int8"] = "float32"
    """Which of the network's files is used."""
    providers: Annotated[tuple[Literal["tensorrt", "cuda", "openvino", "qnn", "cpu"], ...], Field(min_length=1)] = ("cpu",)
    """What the network may compute on, in order: the first that is really there is taken, and one that fails later gives way
    to the next; `cpu` is always there."""
    threads: Annotated[int, Field(ge=0, le=256)] = 0
    """Threads of the network and of the search; 0 takes one less than the cores."""
    max_probability_wrong: Share = 0.05
    """Fixes with a larger calibrated probability of being wrong are declined."""
    max_rate_hz: Positive = 5.0
    """Localisations asked for per second, at most."""
    structure: bool = True
    """Ask for the structure vote (motion stereo against the map's surface model or cloud) when the image is not recognised."""
    structure_every: Annotated[int, Field(ge=0, le=1000)] = 0
    """Ask for it in turn as well, after so many image fixes; 0 asks only when the image is not recognised."""
    odometry: bool = True
    """Follow the ground from frame to frame: corrects the velocity between fixes and while there are none."""
    rangefinder: bool = False
    """Ask the autopilot for DISTANCE_SENSOR, and let odometry take heights above ground from it where they can be believed."""
    terrain: bool = False
    """Ask the autopilot for DISTANCE_SENSOR, and match the profile of the ground below the track with the map's surface model."""
    terrain_sigma_m: Positive = 2.0
    """1-sigma of the heights of the map's surface model."""
    check_every: Annotated[int, Field(ge=0, le=10000)] = 20
    """Every so many image fixes one is computed a second time, on the CPU with weights of its own, and must come out the same; 0
    never. 20 costs 5 % of the localiser's time. Three that differ one after the other switch it off (docs/safety.md)."""
    max_search_radius_m: Positive = 2000.0
    """The search region never grows beyond this, however unsure the prior is."""


class WorkerConfig(Section):
    """The localisation process."""

    deadline_s: Positive = 5.0
    """A localisation that computes for longer is killed and the worker restarted; one that waits for a core may last six times
    as long."""
    max_restarts: Annotated[int, Field(ge=1)] = 3
    """After more restarts than this within 60 s the operator is told, and the next tries come a minute apart; where the map could
    not be opened 1 s, 2 s, 4 s and so on."""
    nice: Annotated[int, Field(ge=0, le=19)] = 10
    """Niceness of the localisation process."""


class NavigatorConfig(Section):
    """The filter and the modes."""

    output_rate_hz: Annotated[float, Field(ge=5, le=30)] = 10.0
    """Rate of the output clock, and so of injected positions."""
    velocity_sigma_mps: Positive = 0.3
    """1-sigma of the slowly varying error of the autopilot's velocity while its GNSS is trusted."""
    velocity_sigma_aiding_mps: Positive = 0.8
    """The same while the autopilot flies on our injections or on a GNSS that is not trusted."""
    velocity_correlation_s: Positive = 20.0
    """Correlation time of that error."""
    acceleration_sigma_mps2: Positive = 0.2
    """1-sigma of the slow error of the accelerations that drive the filter while GNSS is not trusted, until it is learned."""
    acceleration_correlation_s: Annotated[float, Field(ge=0.1)] = 20.0
    """Correlation time of that error."""
    gate_sigma: Positive = 4.0
    """Fixes further than this many sigma from the filter are rejected."""
    relocalise_after_rejections: Annotated[int, Field(ge=2, le=10)] = 4
    """So many consecutive rejected fixes that agree with each other restart the filter from them; two more where only a false
    velocity explains them, and no more than the last 12 are remembered."""
    dead_reckoning_after_s: Positive = 2.0
    """Without an accepted fix for so long the mode becomes DEAD_RECKONING."""
    low_dead_reckoning_s: Positive = 10.0
    """Below `min_height_m` injection ends so long after the last fix, or once the velocity's 1-sigma is beyond 1 m/s: a landing
    must not end on a position that drifts."""
    lost_sigma_m: Positive = 60.0
    """Horizontal 1-sigma beyond which injection stops."""
    start_anywhere: bool = True
    """Search the whole map where there is no trusted position to begin with, or none any more (docs/start-anywhere.md)."""
    seed_sigma_m: Positive = 5.0
    """1-sigma of the autopilot's position that seeds the filter while GNSS is trusted."""
    min_height_m: NonNegative = 15.0
    """Less than this above or below its home the vehicle counts as landing or on the ground: no localisation is asked for, unless
    a fix of the last 30 s showed it four times as high over the ground (a home on a ridge)."""
    map_sigma_m: NonNegative = 0.5
    """1-sigma of the map's own registration, added to the claimed position."""
    map_sigma_h_m: NonNegative = 1.0
    """1-sigma of the heights of the map, as far as all fixes over it have it in common."""
    height_walk_m_per_sqrt_s: Positive = 0.1
    """Random walk of the autopilot's height (its barometer): 0.1 is 6 m in an hour."""
    integrity_risk: Annotated[float, Field(gt=0, lt=0.1)] = 1e-5
    """Probability, at any time, that the true position is further away than the protection level; the same for the height."""
    alert_limit_m: Positive = 25.0
    """The operator is told when the horizontal protection level exceeds this while positions are injected."""
    alert_limit_low_m: Positive = 10.0
    """The same below `low_height_m`."""
    vertical_alert_limit_m: Positive = 50.0
    """The same of the vertical protection level, which bounds the error of the autopilot's own height."""
    vertical_alert_limit_low_m: Positive = 20.0
    """The same below `low_height_m`."""
    low_height_m: NonNegative = 30.0
    """Below this height above home the low limits hold: approach and landing."""


LEAST_REPORTS = 2
"""Of a receiver within `gnss.silence_s`: with fewer the time between two of them is the silence that counts as lost."""


class GnssConfig(Section):
    """The GNSS monitor."""

    min_fix_type: Annotated[int, Field(ge=2, le=6)] = 3
    """GPS_RAW_INT fix types below this are no position (3 is a 3-D fix)."""
    min_satellites: Annotated[int, Field(ge=0)] = 6
    """Fewer satellites count against GNSS."""
    max_h_acc_m: Positive = 10.0
    """A larger horizontal accuracy claimed by the receiver counts against GNSS."""
    silence_s: Positive = 2.0
    """No GPS_RAW_INT for so long counts as lost; with `link.gnss_rate_hz` two of them have to come in that time."""
    suspect_sigma: Positive = 3.0
    """Vision against GNSS: the normalised difference at which one comparison starts a probation anew."""
    drift_threshold: Positive = 10.5
    """Threshold of the sequential tests of GNSS against vision, odometry and barometer; one more means about 2.7 times fewer
    false alarms (docs/gnss-verdict.md)."""
    gnss_sigma_m: Positive = 1.5
    """1-sigma of a healthy receiver where it states none."""
    denied_after_s: Positive = 1.5
    """A sign against GNSS counts once it has lasted so long (until then it stays trusted); the first trust of a flight needs as
    long without any."""
    probation_s: Positive = 20.0
    """A GNSS that comes back is trusted again after so long without any sign; where there is vision it must agree with that."""


class InjectionConfig(Section):
    """What is sent to the autopilot."""

    policy: Literal["never", "when_unreliable", "always"] = "when_unreliable"
    """When external positions are sent."""
    switch_source: bool = False
    """Let the daemon switch the autopilot's position source (MAV_CMD_SET_EKF_SOURCE_SET, EKF2_GPS_CTRL)."""
    gnss_source_set: Annotated[int, Field(ge=1, le=3)] = 1
    """EK3_SRC set of ArduPilot that uses GNSS."""
    vision_source_set: Annotated[int, Field(ge=1, le=3)] = 2
    """EK3_SRC set of ArduPilot that uses external positions."""
    px4_gps_ctrl: Annotated[int, Field(ge=0, le=15)] = 7
    """Value of EKF2_GPS_CTRL that is restored when GNSS is trusted again."""
    output: Literal[
        "auto",
        "vision_position_estimate",
        "odometry",
        "global_position_sensor",
        "gps_input",
        "external_position_estimate",
    ] = "auto"
    """Which message carries positions; `auto` decides by the autopilot and its parameters (docs/mavlink.md)."""
    position_sensor_id: Annotated[int, Field(ge=1, le=255)] = 1
    """Our number among PX4's auxiliary position sensors: EKF2_AGP0_ID (or another slot's) must be the same."""
    external_estimate_period_s: Positive = 2.0
    """Time between two MAV_CMD_EXTERNAL_POSITION_ESTIMATE, each of which resets a plane's position."""
    max_outside_map_m: NonNegative = 1000.0
    """No position is ever sent that lies further outside the map than this."""
    set_origin: bool = False
    """Give an autopilot that has no EKF origin and no GNSS the middle of the map, at its ground's median height, as its origin,
    before take-off."""
    min_sigma_m: Positive = 0.5
    """Smallest 1-sigma that is ever claimed to the autopilot."""
    max_step_m: Positive = 5.0
    """A larger step between two injections raises reset_counter."""
    beyond_alert_limit: Literal["inject", "widen", "stop"] = "inject"
    """While the horizontal protection level exceeds the alert limit: `inject` goes on, `widen` claims a sigma that fits the
    level, `stop` sends nothing, so that the autopilot's failsafe acts (docs/safety.md)."""


class JournalConfig(Section):
    """The flight record."""

    folder: str = ""
    """Where journals are written; empty writes none."""
    record_frames: bool = False
    """Also record the camera frames (large)."""
    max_bytes: Annotated[int, Field(ge=1_000_000)] = 2_000_000_000
    """A journal stops growing at this size; a notice says so."""
    keep_bytes: Annotated[int, Field(ge=0)] = 0
    """At a start on the ground the oldest journals, never the newest, are deleted until those that stay take no more than this; 0
    keeps all. One that is to stay needs another name than `visloc-*.mcap`, or another folder."""


class ClockConfig(Section):
    """Time base of the daemon."""

    speed: Positive = 1.0
    """Faster than real time, for simulators that run so; 1 on a vehicle."""


class StatusConfig(Section):
    """What other processes on the vehicle can ask the daemon."""

    socket: str = ""
    """Path of a Unix socket; each connection gets one JSON snapshot of the state. Empty makes none."""


class Config(Section):
    """Everything that `visloc run --config FILE` reads."""

    link: LinkConfig = LinkConfig()
    camera: CameraConfig = CameraConfig()
    map: MapConfig = MapConfig()
    localiser: LocaliserConfig = LocaliserConfig()
    worker: WorkerConfig = WorkerConfig()
    navigator: NavigatorConfig = NavigatorConfig()
    gnss: GnssConfig = GnssConfig()
    injection: InjectionConfig = InjectionConfig()
    journal: JournalConfig = JournalConfig()
    clock: ClockConfig = ClockConfig()
    status: StatusConfig = StatusConfig()
    seed: Annotated[int, Field(ge=0)] = 1
    """Feeds whatever is random."""


def load_config(path: Path) -> Config:
    """Read a TOML file. Raises ConfigError naming the file, every wrong field and the remedy."""
    try:
        text = path.read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as why:
        raise ConfigError(f"cannot be read: {why}", where=str(path), remedy="name a readable UTF-8 TOML file") from why
    try:
        data = tomllib.loads(text)
    except tomllib.TOMLDecodeError as why:
        raise ConfigError(f"is not valid TOML: {why}", where=str(path), remedy="correct the line that is named") from why
    _require_whole_paths(data, path)
    config = parse_config(data, where=str(path))
    return config.model_copy(update={"camera": mask_found(config.camera, path)}) if config.camera.mask else config


def _require_whole_paths(data: dict[str, Any], path: Path) -> None:
    """Raises ConfigError for a path in somebody's home: taken as it stands, it would make a folder of that name elsewhere."""
    for section, keys in data.items():
        for key, value in keys.items() if isinstance(keys, dict) else ():
            for item in value if isinstance(value, list) else [value]:
                if isinstance(item, str) and item.removeprefix("files:").removeprefix("video:").startswith("~"):
                    what, remedy = f"{section}.{key}: only a shell knows what ~ is (got {item!r})", "write the whole path"
                    raise ConfigError(what, where=str(path), remedy=remedy)


def mask_found(camera: CameraConfig, stated_in: Path) -> CameraConfig:
    """The section with its mask's absolute path, counted from the file that states it, and the SHA-256 of what is there.

    A file that is not there is for those to tell who need it (adapters/camera/mask.py).
    """
    if not camera.mask:
        return camera
    path, digest = (stated_in.parent / camera.mask).resolve(), camera.mask_sha256
    if not digest:
        with contextlib.suppress(OSError):
            digest = hashlib.sha256(path.read_bytes()).hexdigest()
    return camera.model_copy(update={"mask": str(path), "mask_sha256": digest})


def parse_config(data: dict[str, Any], where: str = "configuration") -> Config:
    """Validate a nested dictionary. Raises ConfigError with all problems at once."""
    try:
        return Config.model_validate(data)
    except ValidationError as why:
        problems = [_explain(error) for error in why.errors()]
        raise ConfigError("; ".join(problems), where=where, remedy="see docs/configuration.md") from why


def _explain(error: Any) -> str:
    location = [str(part) for part in error["loc"]]
    name = ".".join(location)
    if error["type"] != "extra_forbidden":
        return f"{name}: {error['msg']} (got {error.get('input')!r})"
    valid = _valid_names(location[:-1])
    return f"{name}: unknown key, {did_you_mean(location[-1], valid) or 'valid are ' + ', '.join(valid)}"


def _valid_names(section: list[str]) -> list[str]:
    model: type[BaseModel] = Config
    for part in section:
        annotation = model.model_fields[part].annotation
        if not (isinstance(annotation, type) and issubclass(annotation, BaseModel)):
            return []
        model = annotation
    return list(model.model_fields)
