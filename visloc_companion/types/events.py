"""Events: what the navigator is told. Each carries its arrival `t_rx_ns`."""

from __future__ import annotations

from dataclasses import dataclass

from visloc_companion.errors import Reason
from visloc_companion.types.basic import AutopilotKind, Cov2, EkfSource, GeoPoint, Quat, Sun, Vec2, Vec3
from visloc_companion.types.gimbal import GimbalAttitude


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


FIX_3D = 3
"""`fix_type` of GPS_RAW_INT, of ArduPilot's logs and of PX4's: neither autopilot takes less for a position."""


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
class GnssIntegrity:
    """What the receiver itself says of interference (GNSS_INTEGRITY; PX4's STATUSTEXT); None where it does not know.

    `jammed` and `spoofed` are True for "detected"; what the receiver has mitigated is False. `authentic` is False where the
    signals' authentication failed.
    """

    t_rx_ns: int
    receiver: int
    jammed: bool | None
    spoofed: bool | None
    authentic: bool | None


@dataclass(frozen=True, slots=True)
class GnssTime:
    """Calendar time that the autopilot took from GNSS (SYSTEM_TIME), beside its own clock; `t_boot_ns` 0 where unknown."""

    t_rx_ns: int
    t_boot_ns: int
    t_unix_ns: int


@dataclass(frozen=True, slots=True)
class MapAtGnss:
    """What the map says of the place where GNSS puts the vehicle: inside it or not, and the height of its surface there."""

    t_rx_ns: int
    place: GeoPoint
    inside: bool
    surface_amsl_m: float | None


@dataclass(frozen=True, slots=True)
class EstimatorStatus:
    """The autopilot's estimator health (EKF_STATUS_REPORT on ArduPilot, ESTIMATOR_STATUS on PX4).

    Ratios are innovation test ratios (> 1 is rejected), None where the autopilot does not send them. `gnss_glitch` is
    ArduPilot bit 15 (of its on-board log bit 14) or PX4 bit 0x400; `gnss_in_use` is PX4 bit 0x200 (GNSS or an auxiliary
    position), `aided` its bit 0x100 (anything horizontal); None on ArduPilot. `velocity_ok`: whether the autopilot vouches for
    its horizontal velocity (bit 0x2 of either, ArduPilot's without 0x80), None where that is not known.
    """

    t_rx_ns: int
    position_ratio: float | None
    velocity_ratio: float | None
    height_ratio: float | None
    horizontal_position_ok: bool
    gnss_glitch: bool
    gnss_in_use: bool | None
    aided: bool | None = None
    velocity_ok: bool | None = None


@dataclass(frozen=True, slots=True)
class Range:
    """Distance along a body axis to the surface (DISTANCE_SENSOR, RANGEFINDER), metres; down-looking unless stated. `sensor`: its
    number, of a message without a time (RANGEFINDER, `t_boot_ns` 0) none. `sigma_m`: 1-sigma of its noise where that is told."""

    t_rx_ns: int
    t_boot_ns: int
    distance_m: float
    valid: bool
    sensor: int = 0
    sigma_m: float | None = None


@dataclass(frozen=True, slots=True)
class Imu:
    """Specific force that the accelerometers measured along the body's axes, m/s² (SCALED_IMU, HIGHRES_IMU, RAW_IMU)."""

    t_rx_ns: int
    t_boot_ns: int
    force_frd_mps2: Vec3


@dataclass(frozen=True, slots=True)
class Baro:
    """Static and dynamic pressure (SCALED_PRESSURE), hPa, and temperature in degrees Celsius; dynamic 0 without a pitot tube."""

    t_rx_ns: int
    t_boot_ns: int
    pressure_hpa: float
    temperature_c: float
    dynamic_hpa: float = 0.0


@dataclass(frozen=True, slots=True)
class FrameRef:
    """A camera frame that lies in a shared-memory slot. `t_ns` is mid-exposure on the shell's clock.

    Where the camera is stamped with the autopilot's clock, `t_boot_ns` is set and the core converts it (core/timesync.py).
    `checksum` is that of its pixels: two exposures of a real sensor never agree, a camera that froze repeats its last picture.
    """

    t_rx_ns: int
    t_ns: int
    frame_id: int
    slot: int
    width_px: int
    height_px: int
    channels: int
    t_boot_ns: int | None = None
    checksum: int | None = None


@dataclass(frozen=True, slots=True)
class Odometry:
    """Displacement between two frames, NED metres, with its 2x2 horizontal covariance.

    Of that covariance, `sigma_scale` (a share of the displacement), `sigma_heading_rad` and `sigma_focal` (a share of the focal
    length: times `per_focal_ne_m`, what such a lens adds to a displacement in which the camera turned) are errors that
    neighbouring displacements have in common: they add up along a flight and cancel on a way back (core/odometry.py).
    `inlier_share` of the tracks fit the motion.
    """

    t_rx_ns: int
    t_from_ns: int
    t_to_ns: int
    displacement_ned_m: Vec3
    cov_ne_m2: Cov2
    sigma_scale: float = 0.0
    sigma_heading_rad: float = 0.0
    inlier_share: float = 1.0
    method: str = ""
    sigma_focal: float = 0.0
    per_focal_ne_m: Vec2 = (0.0, 0.0)


@dataclass(frozen=True, slots=True)
class Turn:
    """How the camera's body turned between two frames, by the picture alone.

    `q_from_to` is its attitude at `t_to_ns` in its axes at `t_from_ns`; `cov_rad2` (3x3) is of the small turn about its axes at
    `t_to_ns` that is wrong with it.
    """

    t_from_ns: int
    t_to_ns: int
    q_from_to: Quat
    cov_rad2: tuple[Vec3, Vec3, Vec3]


@dataclass(frozen=True, slots=True)
class TiltSeen:
    """How far the attitude of a request is tilted as the picture alone has it: the rotation about north and east (rad) that sets
    it right, with its covariance (rad²)."""

    turn_ne_rad: Vec2
    cov_rad2: Cov2


@dataclass(frozen=True, slots=True)
class Fix:
    """An absolute pose of the camera at image time, from one frame.

    `place` is the camera's position; `q_ned_frd` the attitude of the camera's body (top edge of the image forward, optical
    axis down). `cov_ne_m2` is the claimed covariance of the horizontal position, `sigma_h_m` that of the height.
    `probability_wrong` is the calibrated probability that the fix is a wrong match (error beyond what the covariance
    explains). `score` and `runner_up` are correlation peaks, `evidence` holds named numbers for reports. `motion`: how the camera
    moved until the frame that was asked about, `turn`: how it turned since the frame before, `turn_since_kept`: since one further
    back that is kept for seconds (`turn` again where the frame before was chosen for it), `tilt`: how its prior's attitude was
    tilted, where that was seen. `per_focal_ne_m`: how far off the place is, metres north and east, per share of the focal length
    by which the lens is longer than calibrated (a camera that leans takes a wrong lens for a step to the side). `sun`: where the
    picture shows it to stand, where it was looked for. `above_ground_m`: how high the camera is over the ground that it looks at,
    where that is known. `footprint_m`: side of a square as large as the ground in view, of a method that compares pictures of it.
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
    motion: Odometry | None = None
    turn: Turn | None = None
    tilt: TiltSeen | None = None
    per_focal_ne_m: Vec2 = (0.0, 0.0)
    turn_since_kept: Turn | None = None
    sun: Sun | None = None
    above_ground_m: float | None = None
    footprint_m: float | None = None


@dataclass(frozen=True, slots=True)
class OpenPlace:
    """A place of the camera that an answer leaves open, at image time, with the covariance of its horizontal position.

    `log_evidence`: natural logarithm of the probability that the camera is there, were it equally likely anywhere in the searched
    region. What the probabilities of all open places lack of 1 belongs to places that are not listed.
    """

    place: GeoPoint
    cov_ne_m2: Cov2
    log_evidence: float


@dataclass(frozen=True, slots=True)
class NoFix:
    """The localiser declines to answer, and says why. `motion`, `turn` and `turn_since_kept` as in a Fix.

    `open_places`: where the camera may be all the same, likeliest first; none where the search told nothing. `footprint_m`: side
    of the square with the area of the ground that was seen, None where that is not known. `zoomed`: the fix that there would be
    through a lens as long as the request's `try_zoom` says.
    """

    t_rx_ns: int
    t_ns: int
    request_id: int
    frame_id: int
    method: str
    reason: Reason
    elapsed_ms: float
    detail: str = ""
    evidence: tuple[tuple[str, float], ...] = ()
    motion: Odometry | None = None
    turn: Turn | None = None
    open_places: tuple[OpenPlace, ...] = ()
    footprint_m: float | None = None
    turn_since_kept: Turn | None = None
    zoomed: Fix | None = None


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
    """The autopilot confirmed a switch of its position source, refused it, or gave no answer (`answered`).

    `shows_use`: whether its estimator's reports can tell that it uses the source (positions between which it dead-reckons leave
    no trace there).
    """

    t_rx_ns: int
    source: EkfSource
    accepted: bool
    detail: str = ""
    shows_use: bool = True
    answered: bool = True


@dataclass(frozen=True, slots=True)
class FoundOnVision:
    """A daemon before this one sent positions to this autopilot until a short while ago, which may still fly on them; with
    `reset_counter` where it last noted that."""

    t_rx_ns: int
    reset_counter: int = 0


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
    | GimbalAttitude
    | PriorPose
    | LocalPose
    | Gnss
    | GnssIntegrity
    | GnssTime
    | MapAtGnss
    | EstimatorStatus
    | Range
    | Imu
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
    | FoundOnVision
    | WorkerState
    | Tick
)
