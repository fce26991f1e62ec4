"""Commands: what the navigator wants done."""

from __future__ import annotations

from dataclasses import dataclass

from visloc_companion.types.basic import Cov2, EkfSource, GeoPoint, Mode, Quat, Severity, Sun, Vec2, Vec3, Verdict, Vote
from visloc_companion.types.events import FrameRef


@dataclass(frozen=True, slots=True)
class TiltBefore:
    """The same of the frame before: when that was, and the attitude of the camera's body that was reported then."""

    t_ns: int
    q_ned_frd: Quat
    turn_ne_rad: Vec2
    sigma_rad: float


@dataclass(frozen=True, slots=True)
class TiltPrior:
    """What earlier fixes tell of a prior's attitude: the rotation about north and east (rad) that sets its tilt right, and the
    1-sigma (rad) of what is still unknown on each axis. `before`: for whoever sees how the camera has turned since."""

    turn_ne_rad: Vec2
    sigma_rad: float
    before: TiltBefore | None = None


MAP_SIDES: dict[str, tuple[int, int]] = {"map_north": (1, 0), "map_south": (-1, 0), "map_east": (0, 1), "map_west": (0, -1)}
"""Evidence of an answer to a prior with `within_m`, the share of that side of the searched square which lies on the map, and
where the side is (north, east)."""


@dataclass(frozen=True, slots=True)
class PosePrior:
    """A Gaussian prior of the camera's pose: place, attitude of the camera's body, and 1-sigma of each.

    Of the place's height, `height_offset_m` is what was added to the autopilot's. `tilt` is for whoever localises a single frame:
    `q_ned_frd` is without it, for it changes from frame to frame and is no turn of the camera. `sun`: where earlier
    pictures show it. `within_m`: the camera is no further than this north or south, nor east or west, of the place.
    """

    place: GeoPoint
    q_ned_frd: Quat
    cov_ne_m2: Cov2
    sigma_h_m: float
    sigma_yaw_rad: float
    sigma_tilt_rad: float
    height_offset_m: float = 0.0
    tilt: TiltPrior | None = None
    sun: Sun | None = None
    within_m: float | None = None


@dataclass(frozen=True, slots=True)
class Readout:
    """How the camera moves while its rows are exposed one after another, the last row `readout_s` after the first: body rates of
    the camera's body (rad/s) and velocity (NED, m/s), and how far the ground lies below it (m)."""

    readout_s: float
    rate_frd_radps: Vec3
    v_ned_mps: Vec3
    height_m: float


@dataclass(frozen=True, slots=True)
class Beam:
    """What a rangefinder met: north, east, down from the camera when the frame was taken (m), and the 1-sigma of how far down it
    is (m), most of which stays wrong for minutes."""

    end_ned_m: Vec3
    sigma_m: float


@dataclass(frozen=True, slots=True)
class LocaliseRequest:
    """Ask the worker to localise the frame in `frame.slot`. `seed` feeds what is random; `readout` is of a rolling shutter;
    `zoom` is by how much the picture is believed to be enlarged beyond the calibrated lens, `try_zoom` how it is to be looked at
    as well where it is not recognised so. `motion_prior`: where the vehicle is believed to be, in a request that searches for it
    elsewhere: the camera's motion is measured over the ground there, as in those before and after. `beam`: of a rangefinder, near
    the frame's time."""

    request_id: int
    frame: FrameRef
    prior: PosePrior
    seed: int
    vote: Vote = Vote.IMAGE
    readout: Readout | None = None
    zoom: float = 1.0
    try_zoom: float | None = None
    motion_prior: PosePrior | None = None
    beam: Beam | None = None

    @property
    def believed(self) -> PosePrior:
        """Where the vehicle is believed to be, wherever it is searched for."""
        return self.prior if self.motion_prior is None else self.motion_prior


Sounding = tuple[float, float, float, float, float, float, float]
"""One distance measured downwards: age (s), place of the vehicle then from its place now by dead reckoning, and the beam's end
from the vehicle then, both north, east, up (m)."""


@dataclass(frozen=True, slots=True)
class TerrainRequest:
    """Ask the worker where the ground below the track is that of the map. `prior` is the vehicle's pose at `t_ns`.

    `soundings` from the oldest to the newest; over them, per axis, `sigma_drift_mps` and `sigma_drift_mps2` are the 1-sigma of
    the dead reckoning's error of velocity and acceleration, `sigma_wander_m` what remains beside. Unless `final` the worker first
    judges whether the ground below can tell enough.
    """

    request_id: int
    t_ns: int
    prior: PosePrior
    sigma_drift_mps: float
    sigma_drift_mps2: float
    sigma_wander_m: float
    soundings: tuple[Sounding, ...]
    final: bool


@dataclass(frozen=True, slots=True)
class Injection:
    """An external position for the autopilot, valid at `t_ns` (the propagated-to-now state).

    `p_ned_m` is in the autopilot's own projection about its EKF origin (core/output.py converts). `place` is the same
    position as geodetic coordinates. `cov_ne_m2` and `sigma_d_m` are true (co)variances; encoding them as each autopilot
    reads them is the codec's work. `v_ned_mps` is the velocity (its vertical part the autopilot's own), `cov_v_ne_m2ps2` the
    covariance of its horizontal part; None where unknown. `stream_sigma_m`: 1-sigma that this position, as one of many, claims at
    least to a filter that takes each for news.
    """

    t_ns: int
    p_ned_m: Vec3
    place: GeoPoint
    q_ned_frd: Quat
    cov_ne_m2: Cov2
    sigma_d_m: float
    sigma_yaw_rad: float
    reset_counter: int
    v_ned_mps: Vec3 | None = None
    cov_v_ne_m2ps2: Cov2 | None = None
    stream_sigma_m: float = 0.0


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
    horizontal error at the configured risk, `vertical_protection_level_m` that of the height in `place`, which is the autopilot's
    own; fixes would raise it by `height_offset_m`. `available`: both levels are within the alert limits of this phase of flight.
    `alert`: one of them is not, for long enough that it counts. `open_places`: how many places the frames since
    the last fix leave open, 0 where they do not say. `injected` tells whether this Tick also sent an Injection.
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
    vertical_protection_level_m: float | None = None
    height_offset_m: float | None = None
    alert_limit_m: float | None = None
    vertical_alert_limit_m: float | None = None
    available: bool = False
    alert: bool = False
    open_places: int = 0


Command = LocaliseRequest | TerrainRequest | Injection | RequestMessage | SwitchSource | Notice | Status
