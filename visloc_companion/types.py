"""The nouns: events into the navigator, commands out of it, and the values that localisers exchange.

Everything is a frozen dataclass of plain numbers and tuples (so that it compares, hashes and journals exactly), except
rasters and pixels, which are numpy arrays. Frames and units are in the names (docs/conventions.md): `ned` is north, east,
down at the autopilot's EKF origin; `frd` is the body; `t_ns` is the time of validity and `t_rx_ns` the arrival, both on the
shell's monotonic clock; `t_boot_ns` is the autopilot's own clock. Quaternions are Hamilton, wxyz, w >= 0.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any

import numpy as np
from numpy.typing import NDArray

from visloc_companion.errors import Reason

Vec2 = tuple[float, float]
Vec3 = tuple[float, float, float]
Quat = tuple[float, float, float, float]
Cov2 = tuple[Vec2, Vec2]
"""A symmetric 2x2 covariance, row by row, axes north and east."""
FloatArray = NDArray[np.float64]
Image = NDArray[np.uint8]
"""Pixels: (H, W) grey or (H, W, 3) RGB, uint8."""


class AutopilotKind(StrEnum):
    """Which autopilot software answers."""

    ARDUPILOT = "ardupilot"
    PX4 = "px4"
    UNKNOWN = "unknown"


class Verdict(StrEnum):
    """What the GNSS monitor believes of the satellite position."""

    OK = "ok"
    SUSPECT = "suspect"
    DENIED = "denied"


class Mode(StrEnum):
    """The navigator's state (transitions: core/modes.py)."""

    WAITING = "waiting"
    SHADOW = "shadow"
    AIDING = "aiding"
    DEAD_RECKONING = "dead_reckoning"
    LOST = "lost"


class InjectionPolicy(StrEnum):
    """When external positions are sent."""

    NEVER = "never"
    WHEN_UNRELIABLE = "when_unreliable"
    ALWAYS = "always"


class Severity(StrEnum):
    """Severity of a Notice, mapped to MAV_SEVERITY when it goes to the operator."""

    INFO = "info"
    NOTICE = "notice"
    WARNING = "warning"
    CRITICAL = "critical"


class EkfSource(StrEnum):
    """Which horizontal position the autopilot is told to use."""

    GNSS = "gnss"
    VISION = "vision"


@dataclass(frozen=True, slots=True)
class GeoPoint:
    """A place: WGS 84 latitude and longitude in degrees, height above mean sea level in metres.

    The height is orthometric, as the autopilot reports it; a pack with another vertical datum converts (maps/).
    """

    lat_deg: float
    lon_deg: float
    h_amsl_m: float


# ---------------------------------------------------------------------------------------------------------------- events


@dataclass(frozen=True, slots=True)
class Attitude:
    """Body attitude and rates (ATTITUDE, ATTITUDE_QUATERNION)."""

    t_rx_ns: int
    t_boot_ns: int
    q_ned_frd: Quat
    rate_frd_radps: Vec3


@dataclass(frozen=True, slots=True)
class PriorPose:
    """The autopilot's own global position (GLOBAL_POSITION_INT). `h_rel_m` is the height above home."""

    t_rx_ns: int
    t_boot_ns: int
    place: GeoPoint
    v_ned_mps: Vec3
    h_rel_m: float


@dataclass(frozen=True, slots=True)
class LocalPose:
    """The autopilot's own local position (LOCAL_POSITION_NED), in the autopilot's projection about its EKF origin."""

    t_rx_ns: int
    t_boot_ns: int
    p_ned_m: Vec3
    v_ned_mps: Vec3


@dataclass(frozen=True, slots=True)
class Gnss:
    """The raw receiver (GPS_RAW_INT). Unknown accuracies are None. `receiver` numbers the receivers from 0 (GPS2_RAW is 1)."""

    t_rx_ns: int
    t_boot_ns: int
    fix_type: int
    n_satellites: int | None
    place: GeoPoint
    h_acc_m: float | None
    v_acc_m: float | None
    v_ned_mps: Vec3 | None
    receiver: int = 0


@dataclass(frozen=True, slots=True)
class EstimatorStatus:
    """The autopilot's estimator health (EKF_STATUS_REPORT on ArduPilot, ESTIMATOR_STATUS on PX4).

    Ratios are innovation test ratios (> 1 is rejected), None where the autopilot does not send them. `gnss_glitch` is
    ArduPilot bit 15 or PX4 bit 0x400; `gnss_in_use` is PX4 bit 0x200, None on ArduPilot.
    """

    t_rx_ns: int
    position_ratio: float | None
    velocity_ratio: float | None
    height_ratio: float | None
    horizontal_position_ok: bool
    gnss_glitch: bool
    gnss_in_use: bool | None


@dataclass(frozen=True, slots=True)
class Range:
    """Distance along a body axis to the surface (DISTANCE_SENSOR, RANGEFINDER), metres; down-looking unless stated."""

    t_rx_ns: int
    t_boot_ns: int
    distance_m: float
    valid: bool


@dataclass(frozen=True, slots=True)
class Baro:
    """Static pressure (SCALED_PRESSURE), hPa, and temperature in degrees Celsius."""

    t_rx_ns: int
    t_boot_ns: int
    pressure_hpa: float
    temperature_c: float


@dataclass(frozen=True, slots=True)
class FrameRef:
    """A camera frame that lies in a shared-memory slot. `t_ns` is mid-exposure on the shell's clock.

    Where the camera is stamped with the autopilot's clock, `t_boot_ns` is set and the core converts it (core/timesync.py).
    """

    t_rx_ns: int
    t_ns: int
    frame_id: int
    slot: int
    width_px: int
    height_px: int
    channels: int
    t_boot_ns: int | None = None


@dataclass(frozen=True, slots=True)
class Odometry:
    """Displacement between two frames, NED metres, with its 2x2 horizontal covariance."""

    t_rx_ns: int
    t_from_ns: int
    t_to_ns: int
    displacement_ned_m: Vec3
    cov_ne_m2: Cov2


@dataclass(frozen=True, slots=True)
class Fix:
    """An absolute pose of the camera at image time, from one frame.

    `place` is the camera's position; `q_ned_frd` the attitude of the camera's body (top edge of the image forward, optical
    axis down). `cov_ne_m2` is the claimed covariance of the horizontal position, `sigma_h_m` that of the height.
    `probability_wrong` is the calibrated probability that the fix is a wrong match (error beyond what the covariance
    explains). `score` and `runner_up` are correlation peaks, `evidence` holds named numbers for reports.
    """

    t_rx_ns: int
    t_ns: int
    request_id: int
    frame_id: int
    method: str
    place: GeoPoint
    q_ned_frd: Quat
    cov_ne_m2: Cov2
    sigma_h_m: float
    sigma_yaw_rad: float
    probability_wrong: float
    elapsed_ms: float
    evidence: tuple[tuple[str, float], ...] = ()


@dataclass(frozen=True, slots=True)
class NoFix:
    """The localiser declines to answer, and says why."""

    t_rx_ns: int
    t_ns: int
    request_id: int
    frame_id: int
    method: str
    reason: Reason
    elapsed_ms: float
    detail: str = ""
    evidence: tuple[tuple[str, float], ...] = ()


@dataclass(frozen=True, slots=True)
class TimesyncSample:
    """One finished TIMESYNC exchange that we asked for: remote clock (autopilot boot time, ns) at half of the round trip."""

    t_rx_ns: int
    t_sent_ns: int
    t_remote_ns: int


@dataclass(frozen=True, slots=True)
class OriginChanged:
    """The autopilot's EKF origin (GPS_GLOBAL_ORIGIN)."""

    t_rx_ns: int
    origin: GeoPoint


@dataclass(frozen=True, slots=True)
class LinkChanged:
    """The link to the autopilot came up (kind, version and sysid known) or went down."""

    t_rx_ns: int
    up: bool
    autopilot: AutopilotKind = AutopilotKind.UNKNOWN
    version: str = ""
    system_id: int = 0
    armed: bool = False


@dataclass(frozen=True, slots=True)
class OperatorFix:
    """The operator says where the vehicle is: place and 1-sigma radius in metres."""

    t_rx_ns: int
    place: GeoPoint
    sigma_m: float


@dataclass(frozen=True, slots=True)
class SourceSwitched:
    """The autopilot confirmed (or refused) a switch of its position source."""

    t_rx_ns: int
    source: EkfSource
    accepted: bool
    detail: str = ""


@dataclass(frozen=True, slots=True)
class WorkerState:
    """The worker came up or died; `restarts` counts those of the last 60 s."""

    t_rx_ns: int
    up: bool
    restarts: int
    detail: str = ""


@dataclass(frozen=True, slots=True)
class Tick:
    """The output clock."""

    t_rx_ns: int


Event = (
    Attitude
    | PriorPose
    | LocalPose
    | Gnss
    | EstimatorStatus
    | Range
    | Baro
    | FrameRef
    | Odometry
    | Fix
    | NoFix
    | TimesyncSample
    | OriginChanged
    | LinkChanged
    | OperatorFix
    | SourceSwitched
    | WorkerState
    | Tick
)

# -------------------------------------------------------------------------------------------------------------- commands


@dataclass(frozen=True, slots=True)
class PosePrior:
    """A Gaussian prior of the camera's pose: place, attitude of the camera's body, and 1-sigma of each."""

    place: GeoPoint
    q_ned_frd: Quat
    cov_ne_m2: Cov2
    sigma_h_m: float
    sigma_yaw_rad: float
    sigma_tilt_rad: float


@dataclass(frozen=True, slots=True)
class LocaliseRequest:
    """Ask the worker to localise the frame in `frame.slot`. `seed` feeds whatever is random."""

    request_id: int
    frame: FrameRef
    prior: PosePrior
    seed: int


@dataclass(frozen=True, slots=True)
class Injection:
    """An external position for the autopilot, valid at `t_ns` (the propagated-to-now state).

    `p_ned_m` is in the autopilot's own projection about its EKF origin (core/output.py converts). `place` is the same
    position as geodetic coordinates. `cov_ne_m2` and `sigma_d_m` are true (co)variances; encoding them as each autopilot
    reads them is the codec's work.
    """

    t_ns: int
    p_ned_m: Vec3
    place: GeoPoint
    q_ned_frd: Quat
    cov_ne_m2: Cov2
    sigma_d_m: float
    sigma_yaw_rad: float
    reset_counter: int


@dataclass(frozen=True, slots=True)
class RequestMessage:
    """Ask the autopilot to stream a MAVLink message at a rate (MAV_CMD_SET_MESSAGE_INTERVAL); 0 Hz asks once."""

    message_id: int
    rate_hz: float


@dataclass(frozen=True, slots=True)
class SwitchSource:
    """Tell the autopilot which horizontal position to use (MAV_CMD_SET_EKF_SOURCE_SET, or EKF2_GPS_CTRL on PX4)."""

    source: EkfSource


@dataclass(frozen=True, slots=True)
class Notice:
    """Something to log; `to_operator` also sends it as STATUSTEXT (at most 50 characters are shown)."""

    severity: Severity
    text: str
    to_operator: bool = False
    data: tuple[tuple[str, float | str], ...] = ()


@dataclass(frozen=True, slots=True)
class Status:
    """The navigator's state at a Tick, for the journal, the status socket and reports; never sent to the autopilot.

    `place`, `v_ned_mps` and the covariances are None / zero while there is no state. `protection_level_m` bounds the
    horizontal error at the configured risk. `injected` tells whether this Tick also sent an Injection.
    """

    t_ns: int
    mode: Mode
    verdict: Verdict
    reasons: tuple[str, ...]
    place: GeoPoint | None
    v_ned_mps: Vec3
    cov_ne_m2: Cov2
    sigma_d_m: float
    protection_level_m: float | None
    age_of_fix_s: float | None
    injected: bool
    reset_counter: int


Command = LocaliseRequest | Injection | RequestMessage | SwitchSource | Notice | Status

# ---------------------------------------------------------------------------------------------------------------- values


@dataclass(frozen=True, slots=True)
class CameraModel:
    """Pinhole camera with Brown-Conrady distortion (OpenCV order k1 k2 p1 p2 k3), in pixels of `pix`."""

    width_px: int
    height_px: int
    fx_px: float
    fy_px: float
    cx_px: float
    cy_px: float
    distortion: tuple[float, float, float, float, float] = (0.0, 0.0, 0.0, 0.0, 0.0)


@dataclass(frozen=True, slots=True, eq=False)
class ReferencePatch:
    """A window of the reference map, immutable: pixels, validity, heights and where it lies.

    `T_map_pix` (2, 3) maps homogeneous `pix` coordinates (u, v, 1) (centre of the top-left pixel = 0, 0) to easting and
    northing in the map's CRS. `dsm_amsl_m` is the surface height per pixel in metres above sea level.
    """

    pixels: Image
    valid: NDArray[np.bool_]
    dsm_amsl_m: NDArray[np.float32]
    T_map_pix: FloatArray
    gsd_m: float
    heading_rad: float
    features: dict[str, NDArray[Any]] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class NavState:
    """The filter's state at `t_ns`: position and velocity in NED at the EKF origin, covariances, and what they rest on."""

    t_ns: int
    p_ned_m: Vec3
    v_ned_mps: Vec3
    cov_ne_m2: Cov2
    sigma_d_m: float
    age_of_fix_s: float


@dataclass(frozen=True, slots=True)
class Accepted:
    """The filter took the measurement; `nis` is its normalised innovation squared (2 degrees of freedom)."""

    nis: float


@dataclass(frozen=True, slots=True)
class Rejected:
    """The filter refused the measurement."""

    reason: Reason
    nis: float


@dataclass(frozen=True, slots=True)
class TooOld:
    """The measurement is older than the filter's memory."""

    age_s: float


@dataclass(frozen=True, slots=True)
class GnssVerdict:
    """The monitor's verdict with its evidence: each item is (name, value, threshold)."""

    verdict: Verdict
    since_ns: int
    reasons: tuple[str, ...]
    evidence: tuple[tuple[str, float, float], ...]
