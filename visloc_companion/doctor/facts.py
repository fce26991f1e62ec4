"""What the doctor knows: plain values that were read before any of them is judged. A part that could not be read is None."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from visloc_companion.adapters.mavlink.outputs.choice import Choice, choose_output
from visloc_companion.adapters.mavlink.outputs.kinds import Output, Vehicle
from visloc_companion.config import Config
from visloc_companion.types import AutopilotKind, GeoPoint


@dataclass(frozen=True, slots=True)
class GimbalHeard:
    """A gimbal that says where it points: its number as in GimbalAttitude, how often, and what its attitude counted from
    (GimbalFrame; none where its flags name what is not allowed)."""

    gimbal_id: int
    rate_hz: float
    frames: frozenset[str]


@dataclass(frozen=True, slots=True)
class LinkFacts:
    """What was seen on the link in a few seconds.

    Rates are messages a second by name: `asked_hz` what was asked of the autopilot as the daemon would, `rates_hz` what came,
    `refused` what it denied. `rtt_ms` are TIMESYNC round trips; `timesync_requests_hz` are the autopilot's own requests.
    `drift_ppm` is how much faster its clock runs than ours, within `drift_sigma_ppm`. `mission` is None where the autopilot
    did not answer, and empty where it has none. `signed`: the autopilot signs, `another_key`: not with our key.
    `others` are (system, component) of further senders of HEARTBEAT, `strangers` addresses that are not listened to.
    `gnss_h_amsl_m` and `barometer_h_amsl_m` are heights above sea level as the receiver (with a 3D fix) and PX4's barometer have
    them. `lost_share`: messages lost, of all that were sent. `gimbals` said where they point, `old_gimbal`: in MOUNT_ORIENTATION.
    """

    url: str
    system_id: int
    vehicle: str
    armed: bool
    mavlink_version: int
    garbage_share: float
    parameters_expected: int
    asked_hz: Mapping[str, float]
    rates_hz: Mapping[str, float]
    refused: frozenset[str]
    rtt_ms: tuple[float, ...]
    timesync_requests_hz: float
    drift_ppm: float | None
    drift_sigma_ppm: float
    origin: GeoPoint | None
    home: GeoPoint | None
    mission: tuple[GeoPoint, ...] | None
    position: GeoPoint | None
    claims_position: bool | None
    position_ratio: float | None
    fix_type: int | None
    n_satellites: int | None
    signed: bool = False
    another_key: bool = False
    other_autopilots: tuple[int, ...] = ()
    others: tuple[tuple[int, int], ...] = ()
    strangers: tuple[str, ...] = ()
    lost_share: float = 0.0
    gimbals: tuple[GimbalHeard, ...] = ()
    old_gimbal: bool = False
    gnss_h_amsl_m: float | None = None
    barometer_h_amsl_m: float | None = None


@dataclass(frozen=True, slots=True)
class CameraFacts:
    """What the camera gave in a few seconds. `problem` says why it could not be used; then the rest is empty.

    Of what is looked at in flight, without what the camera's mask names, `dark` and `bright` are the shares of pixels at the ends
    of the range, `unlit` that of pixels that are black in every frame while the middle is not; `repeated` is that of frames equal
    to the one before. `still` is the share that has the same edges in every frame while the rest moves; None where it does not.
    """

    problem: str = ""
    rate_hz: float = 0.0
    n_frames: int = 0
    dark: float = 0.0
    bright: float = 0.0
    repeated: float = 0.0
    unlit: float = 0.0
    still: float | None = None


@dataclass(frozen=True, slots=True)
class MapFacts:
    """The map pack. `problem` says why it could not be used; then the rest is empty.

    Margins are the distances in metres from a place to the nearest edge of the map, negative outside; None where there is no
    such place. `home_empty`: the map shows nothing there; `mission_empty` is the share of the way over such ground.
    `height_above_surface_m` is the height of home above the map's surface there. `crs_accuracy_m` is what is stated
    of the relation of the map's CRS to WGS 84, None where nothing is. `signed_by` is the fingerprint of the trusted key
    that signed it, `signature_problem` why none of those that are trusted did; both are empty where none is.
    """

    problem: str = ""
    capture_date: str = ""
    gsd_m: float = 0.0
    has_surface: bool = False
    share_valid: float = 0.0
    home_margin_m: float | None = None
    mission_margin_m: float | None = None
    height_above_surface_m: float | None = None
    features_missing: str = ""
    crs_accuracy_m: float | None = 0.0
    signed_by: str = ""
    signature_problem: str = ""
    home_empty: bool = False
    mission_empty: float = 0.0


@dataclass(frozen=True, slots=True)
class ModelFacts:
    """The localiser's network. `problem` says why it cannot be used. `needed` False: the method computes without one."""

    needed: bool
    problem: str = ""
    about: str = ""
    provider: str = ""
    skipped: tuple[str, ...] = ()
    variant: str = ""


@dataclass(frozen=True, slots=True)
class SystemFacts:
    """This computer. None where the system does not tell."""

    cores: int
    load: float
    memory_free_mb: float | None
    swap_used_mb: float | None
    temperature_c: float | None
    governor: str | None
    clock_synchronised: bool | None
    bits: int
    disk_free_mb: float | None = None
    journal_problem: str = ""
    serial_problem: str = ""
    console_on_serial: bool | None = None


@dataclass(frozen=True, slots=True)
class Facts:
    """Everything. `parameters` are the autopilot's, empty where it gave none; `config` None means that none was named."""

    autopilot: AutopilotKind = AutopilotKind.UNKNOWN
    version: str = ""
    parameters: Mapping[str, float] = field(default_factory=dict)
    config: Config | None = None
    link: LinkFacts | None = None
    camera: CameraFacts | None = None
    map: MapFacts | None = None
    model: ModelFacts | None = None
    system: SystemFacts | None = None

    @property
    def assumed(self) -> Config:
        """The configuration, or the defaults where none was named."""
        return self.config or Config()

    @property
    def parameters_complete(self) -> bool:
        """Whether what `parameters` lacks the autopilot does not have; False where some were lost on the way."""
        return self.link is None or 0 < self.link.parameters_expected <= len(self.parameters)

    @property
    def choice(self) -> Choice:
        """What the daemon would send to this autopilot (adapters/mavlink/outputs/choice.py)."""
        wanted = self.assumed.injection
        vehicle = Vehicle(
            kind=self.autopilot,
            plane=None if self.link is None else self.link.vehicle == "plane",
            parameters=self.parameters,
            complete=bool(self.parameters) and self.parameters_complete,
            vision_source_set=wanted.vision_source_set,
            sensor_id=wanted.position_sensor_id,
        )
        return choose_output(None if wanted.output == "auto" else Output(wanted.output), vehicle)

    @property
    def sends_poses(self) -> bool:
        """Whether positions go the way of a vision system, and not as a receiver's or as another sensor's on purpose."""
        named = self.assumed.injection.output
        on_purpose = (Output.GPS_INPUT, Output.GLOBAL_POSITION_SENSOR)
        output = self.choice.output if named == "auto" else Output(named)
        return output not in (on_purpose if named == "auto" else (*on_purpose, Output.EXTERNAL_POSITION_ESTIMATE))
