"""All that goes wrong in a flight, as a pure function of the time since its start."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from random import Random

from visloc_companion.errors import ConfigError
from visloc_companion.sim.faults.camera import (
    CameraFault,
    CameraFreeze,
    CameraSilence,
    FramesLate,
    GimbalSilence,
    Optics,
    OpticsFault,
    optics_of,
)
from visloc_companion.sim.faults.gnss import GnssEffect, GnssFault, bad_s, effect_of
from visloc_companion.sim.faults.installation import FocalError, InstallationFault, MapShift, MountError
from visloc_companion.sim.faults.onboard import (
    AutopilotClockStep,
    BaroDrift,
    CompanionClockStep,
    CompassError,
    LinkGap,
    OnboardFault,
    WorkerCrash,
    ramped,
)
from visloc_companion.sim.faults.sound import require_sound

Fault = GnssFault | CameraFault | OnboardFault | InstallationFault
NS_PER_S = 1e9


@dataclass(frozen=True)
class FaultSchedule:
    """Faults that act together; offsets add up, jamming wins over spoofing. Empty means a flight without faults.

    Raises ConfigError for a fault that cannot happen as it is stated (one that ends before it begins, a negative time), and where
    the autopilot's clock would step to before its boot, a time that no message can carry.
    """

    faults: tuple[Fault, ...] = ()

    def __post_init__(self) -> None:
        for fault in self.faults:
            require_sound(fault)
            if isinstance(fault, AutopilotClockStep) and (boot_s := self._boot_s(max(fault.at_s, 0.0))) < 0:
                what = f"leads to {-boot_s:g} s before the autopilot's boot, which is when the flight begins"
                remedy = "let it come later, or step back by less"
                raise ConfigError(what, where=f"AutopilotClockStep at {fault.at_s:g} s by {fault.by_s:g} s", remedy=remedy)

    def _boot_s(self, t_s: float) -> float:
        return t_s + self.autopilot_clock_ns(t_s) / NS_PER_S

    def __add__(self, other: FaultSchedule) -> FaultSchedule:
        return FaultSchedule(self.faults + other.faults)

    @cached_property
    def _of_gnss(self) -> tuple[GnssFault, ...]:
        return tuple(f for f in self.faults if isinstance(f, GnssFault))

    @cached_property
    def _of_optics(self) -> tuple[OpticsFault, ...]:
        return tuple(f for f in self.faults if isinstance(f, OpticsFault))

    @cached_property
    def _ramps(self) -> tuple[CompassError | BaroDrift, ...]:
        return tuple(f for f in self.faults if isinstance(f, CompassError | BaroDrift))

    # ------------------------------------------------------------------------------------------------------- the autopilot

    def gnss(self, t_s: float) -> GnssEffect:
        """What the receiver gets at a time since the start of the flight, seconds."""
        return effect_of(self._of_gnss, t_s)

    @property
    def gnss_start_s(self) -> float | None:
        """When the first fault of GNSS begins, None without any."""
        return min((f.start_s for f in self._of_gnss), default=None)

    def gnss_intervals_s(self, duration_s: float) -> list[tuple[float, float]]:
        """When the receiver says nothing or something false in a flight of so long, seconds; what touches is one interval."""
        found: list[tuple[float, float]] = []
        for start_s, end_s in sorted(bad_s(fault) for fault in self._of_gnss):
            begin_s, stop_s = max(start_s, 0.0), min(end_s, duration_s)
            if begin_s >= stop_s:
                continue
            if found and begin_s <= found[-1][1]:
                begin_s, stop_s = found[-1][0], max(found.pop()[1], stop_s)
            found.append((begin_s, stop_s))
        return found

    def compass_error_rad(self, t_s: float) -> float:
        """What is added to the autopilot's heading."""
        return sum((f.error_rad * ramped(f, t_s) for f in self._ramps if isinstance(f, CompassError)), 0.0)

    def baro_error_m(self, t_s: float) -> float:
        """What is added to the barometer's height (up)."""
        return sum((f.error_m * ramped(f, t_s) for f in self._ramps if isinstance(f, BaroDrift)), 0.0)

    def autopilot_clock_ns(self, t_s: float) -> int:
        """What is added to the autopilot's clock."""
        return round(sum(f.by_s for f in self.faults if isinstance(f, AutopilotClockStep) and f.at_s <= t_s) * NS_PER_S)

    # ------------------------------------------------------------------------------------------------------- the companion

    def companion_clock_ns(self, t_s: float) -> int:
        """What is added to the companion's clock."""
        return round(sum(f.by_s for f in self.faults if isinstance(f, CompanionClockStep) and f.at_s <= t_s) * NS_PER_S)

    def link_down(self, t_s: float) -> bool:
        """Whether bytes get lost between autopilot and companion."""
        return any(isinstance(f, LinkGap) and f.start_s <= t_s < f.end_s for f in self.faults)

    def worker_down(self, t_s: float) -> bool:
        """Whether there is no process that localises."""
        return any(isinstance(f, WorkerCrash) and f.at_s <= t_s < f.at_s + f.restart_s for f in self.faults)

    # ------------------------------------------------------------------------------------------------------------ the camera

    def camera_frozen(self, t_s: float) -> bool:
        """Whether the camera repeats its last picture."""
        return any(isinstance(f, CameraFreeze) and f.start_s <= t_s < f.end_s for f in self.faults)

    def camera_anew(self, t_s: float) -> bool:
        """Whether the picture that it repeats has other noise each time."""
        return any(isinstance(f, CameraFreeze) and f.anew and f.start_s <= t_s < f.end_s for f in self.faults)

    def camera_silent(self, t_s: float) -> bool:
        """Whether the camera sends nothing."""
        return any(isinstance(f, CameraSilence) and f.start_s <= t_s < f.end_s for f in self.faults)

    def gimbal_silent(self, t_s: float) -> bool:
        """Whether nobody says where the camera's gimbal points."""
        return any(isinstance(f, GimbalSilence) and f.start_s <= t_s < f.end_s for f in self.faults)

    def frame_delay_s(self, t_s: float, frame_id: int, seed: int) -> float:
        """How long after its exposure a frame arrives, drawn for each fault from the flight's seed and the frame's number."""
        late = [f for f in self.faults if isinstance(f, FramesLate) and f.start_s <= t_s < f.end_s]
        drawn = Random(f"{seed}/late/{frame_id}")
        return sum((f.delay_s + f.spread_s * drawn.random() for f in late), 0.0)

    def optics(self, t_s: float) -> Optics:
        """How pictures are taken at a time."""
        return optics_of(self._of_optics, t_s)

    # ------------------------------------------------------------------------------------------------------ the installation

    @property
    def mount_error(self) -> MountError:
        """How the camera is mounted otherwise than configured (the errors of several add up)."""
        errors = [f for f in self.faults if isinstance(f, MountError)]
        return MountError(sum(e.roll_rad for e in errors), sum(e.pitch_rad for e in errors), sum(e.yaw_rad for e in errors))

    @property
    def focal_scale(self) -> float:
        """The lens's focal length over the calibrated one."""
        return 1.0 + sum((f.share for f in self.faults if isinstance(f, FocalError)), 0.0)

    @property
    def map_shift_ne_m(self) -> tuple[float, float]:
        """How far north and east of the truth the map lies."""
        shifts = [f for f in self.faults if isinstance(f, MapShift)]
        return sum((s.north_m for s in shifts), 0.0), sum((s.east_m for s in shifts), 0.0)
