"""What the autopilot says of itself: attitude, position, velocity and the distance to the ground, on the shell's clock."""

from __future__ import annotations

import math

from visloc_companion.core.asking import Asking
from visloc_companion.core.attitude import AttitudeBuffer
from visloc_companion.core.attitude_pace import AttitudePace
from visloc_companion.core.camera.gimbal import Gimbal
from visloc_companion.core.filter.driving import Velocity
from visloc_companion.core.filter.propagation import Drive
from visloc_companion.core.gnss import GnssMonitor
from visloc_companion.core.guard import Complaints
from visloc_companion.core.heights.home_height import HomeHeight
from visloc_companion.core.heights.takeoff_height import RestartedAloft, TakeoffHeight
from visloc_companion.core.settings import NavigatorSettings
from visloc_companion.core.source.switching import SourceSwitch
from visloc_companion.core.terrain.terrain_aiding import TerrainAiding
from visloc_companion.core.timesync import ClockOffset, ClockStep
from visloc_companion.core.tracking import Tracker
from visloc_companion.core.velocity.pitot import LEAST_MPS, true_airspeed_mps
from visloc_companion.core.velocity.vouching import Vouching
from visloc_companion.geo import se3
from visloc_companion.types import (
    Attitude,
    Baro,
    Command,
    EstimatorStatus,
    Imu,
    LocalPose,
    Notice,
    PriorPose,
    Range,
    Severity,
    Vec3,
)

GOES_ON_SIGMA_M = 20.0
"""1-sigma of a position that the autopilot has carried on by itself since the last one that it was sent, some seconds ago."""
MAX_STAMP_ERROR_NS = 1_000_000_000
"""A message's own time is used when it differs from its arrival by no more than this."""


class Telemetry:
    """Keeps clock and attitude, and drives the filter with the autopilot's velocity and height."""

    def __init__(
        self,
        settings: NavigatorSettings,
        clock: ClockOffset,
        attitude: AttitudeBuffer,
        tracker: Tracker,
        monitor: GnssMonitor,
        switch: SourceSwitch,
        asking: Asking,
        terrain: TerrainAiding | None,
        complaints: Complaints,
        gimbal: Gimbal | None = None,
    ) -> None:
        self._settings, self._clock, self._attitude = settings, clock, attitude
        self._tracker, self._monitor, self._switch = tracker, monitor, switch
        self._asking, self._terrain, self._complaints, self._gimbal = asking, terrain, complaints, gimbal
        self._pace = AttitudePace()
        self._status: EstimatorStatus | None = None
        self._vouching = Vouching()
        self._prior: PriorPose | None = None
        self._home, self._takeoff, self._aloft = HomeHeight(), TakeoffHeight(), RestartedAloft()

    def attitude_fresh(self, now_ns: int) -> bool:
        """Whether an attitude arrived lately, of a stream that is of use."""
        return self._pace.fresh(now_ns)

    def stamped_ns(self, t_rx_ns: int, t_boot_ns: int) -> int:
        """A message's time of validity on the shell's clock; its arrival where its own time cannot be right."""
        t_ns = self._clock.shell_ns(t_boot_ns, t_rx_ns)
        return t_ns if abs(t_ns - t_rx_ns) <= MAX_STAMP_ERROR_NS else t_rx_ns

    def on_step(self, step: ClockStep | None, own: bool = False) -> list[Command]:
        """Forget what is older than a step of the autopilot's clock or (`own`) of this one, if there was one."""
        if step is None:
            return []
        flew = self._tracker.height_above_home_m is not None and not self._tracker.low
        self._attitude.clear()
        self._tracker.forget_velocity()
        self._tracker.height.forget_heights(restarted=not own)
        self._vouching.forget()
        self._asking.forget_ranges()
        if self._terrain is not None:
            self._terrain.clear()
        if self._gimbal is not None:
            self._gimbal.clear()
        if not own and step.of_restart:
            self._switch.restarted()
            self._home.forget()
            self._takeoff = TakeoffHeight()
            self._takeoff.unseen = flew
            self._aloft.restarted(flew=flew)
        return [Notice(Severity.WARNING, _of_step(step, own), to_operator=True)]

    def on_attitude(self, event: Attitude, now_ns: int) -> list[Command]:
        """Keep an attitude."""
        commands = self.on_step(self._clock.on_arrival(event.t_rx_ns, event.t_boot_ns))
        reason = self._attitude.add(event.t_boot_ns, event.q_ned_frd, event.rate_frd_radps)
        if reason is not None:
            return [*commands, *self._complaints.about(event, reason, now_ns)]
        self._tracker.heading.on_attitude(event.t_boot_ns, event.q_ned_frd, event.rate_frd_radps)
        self._monitor.on_telemetry(event.t_rx_ns)
        return [*commands, *self._pace.came(event.t_rx_ns)]

    def on_status(self, event: EstimatorStatus) -> None:
        """Keep what the autopilot's estimator says of its health."""
        self._status = event
        self._vouching.on_status(event)
        self._monitor.on_evidence(event)

    def on_prior(self, event: PriorPose, feedback: bool) -> list[Command]:
        """Take velocity and height; `feedback`: they rest on what we inject."""
        commands = self.on_step(self._clock.on_arrival(event.t_rx_ns, event.t_boot_ns))
        self._prior = event
        above_m = self._above_takeoff_m(event)
        self._tracker.height_above_home_m, self._tracker.takeoff_unseen = above_m, self._takeoff.unseen
        self._home.told(event.t_rx_ns, above_m)
        self._drive(event.t_rx_ns, event.t_boot_ns, event.v_ned_mps, event.place.h_amsl_m, feedback)
        return commands

    def found_flying(self) -> None:
        """The daemon before this one sent the autopilot positions: the vehicle took off in its time."""
        self._takeoff.unseen = True

    def _above_takeoff_m(self, event: PriorPose) -> float:
        """By the autopilot's word; of a vehicle that was found flying by the last fix where that shows the ground far below."""
        above_m = self._takeoff.above_m(event, disarmed=self._monitor.disarmed)
        t_ns, h_amsl_m, least_m = event.t_rx_ns, event.place.h_amsl_m, self._settings.min_height_m
        over_ground_m = self._tracker.height.above_ground_m(t_ns, h_amsl_m)
        if not self._takeoff.unseen or over_ground_m is None or abs(above_m) >= least_m:
            return above_m
        far = self._tracker.height.far_above_ground(t_ns, h_amsl_m, least_m)
        return self._takeoff.found_m(over_ground_m) if far else above_m

    def on_local(self, event: LocalPose, feedback: bool) -> list[Command]:
        """The same of a local position, also while there is no global one (PX4 without aiding)."""
        commands = self.on_step(self._clock.on_arrival(event.t_rx_ns, event.t_boot_ns))
        above_home_m = self._home.by_local(event.t_rx_ns, event.p_ned_m[2], disarmed=self._monitor.disarmed)
        if above_home_m is not None:
            self._tracker.height_above_home_m = above_home_m
        if self._tracker.origin is not None:
            h_amsl_m = self._tracker.origin.h_amsl_m - event.p_ned_m[2]
            self._drive(event.t_rx_ns, event.t_boot_ns, event.v_ned_mps, h_amsl_m, feedback)
        return commands

    def on_range(self, event: Range) -> None:
        """Take a distance to the ground, for frames, and for its profile where the vehicle's attitude is known."""
        t_ns = self.stamped_ns(event.t_rx_ns, event.t_boot_ns)
        self._asking.on_range(event, t_ns)
        q_ned_frd = self._asking.attitude_now(t_ns)
        if self._terrain is not None and q_ned_frd is not None:
            self._terrain.on_range(event, t_ns, q_ned_frd)

    def on_imu(self, event: Imu) -> None:
        """Take accelerations where the attitude of their time is known."""
        q_ned_frd = self._attitude.at(event.t_boot_ns)
        if q_ned_frd is not None:
            self._tracker.on_force(event.t_boot_ns, event.force_frd_mps2, q_ned_frd)

    def on_baro(self, event: Baro) -> None:
        """Take the velocity through the air, along the heading, of a vehicle that measures one."""
        q_ned_frd = self._attitude.at(event.t_boot_ns)
        speed_mps = true_airspeed_mps(event.pressure_hpa, event.dynamic_hpa)
        if q_ned_frd is not None and speed_mps >= LEAST_MPS:
            _, _, yaw = se3.euler_from_quat(q_ned_frd)
            self._tracker.on_airspeed(event.t_boot_ns, (speed_mps * math.cos(yaw), speed_mps * math.sin(yaw)))

    def seed(self, now_ns: int, sigma_m: float) -> list[Command]:
        """Start the filter from the autopilot's position, once, while GNSS is trusted; or where it goes on by what the daemon
        before this one sent it."""
        prior, velocity, trusted = self._prior, self._tracker.velocity, self._monitor.trusted
        if self._tracker.belief is not None or prior is None or velocity is None or not (trusted or self.goes_on):
            return []
        if now_ns - prior.t_rx_ns > MAX_STAMP_ERROR_NS:
            return []
        t_ns = self.stamped_ns(prior.t_rx_ns, prior.t_boot_ns)
        if not self._tracker.seed(t_ns, prior.place, max(sigma_m, GOES_ON_SIGMA_M) if self.goes_on else sigma_m):
            return []
        return [Notice(Severity.INFO, "filter seeded from the autopilot's position")]

    @property
    def goes_on(self) -> bool:
        """Whether the autopilot has a position that its receiver cannot have given it, for it says that it has none; or need not
        have given it: to wait until GNSS is trusted would take 1.5 s of the 4 to 5 s after which PX4's failsafe comes."""
        vouched = self._status is not None and self._status.horizontal_position_ok
        return vouched and (self._monitor.armed_without_fix or self._switch.found)

    def _drive(self, t_rx_ns: int, t_boot_ns: int, v_ned_mps: Vec3, h_amsl_m: float, feedback: bool) -> None:
        limits, disarmed = self._settings, self._monitor.disarmed
        ground_seen = self._tracker.height.ground_seen
        self._tracker.restarted_aloft = self._aloft.flies(t_rx_ns, disarmed=disarmed, ground_seen=ground_seen)
        sigma = limits.velocity_sigma_mps if self._monitor.trusted and not feedback else limits.velocity_sigma_aiding_mps
        drive = Drive.FED_BACK if feedback else Drive.AUTOPILOT
        believed = self._vouching.judged(v_ned_mps, t_rx_ns, sigma, drive, settled=self._tracker.settled)
        v_ned_mps = believed.v_ned_mps
        t_ns = self.stamped_ns(t_rx_ns, t_boot_ns)
        if self._terrain is not None and believed.drive is Drive.FED_BACK:
            v_ned_mps = self._terrain.corrected(t_ns, v_ned_mps)
        self._tracker.height.drive(t_ns, h_amsl_m, self._tracker.height_above_home_m, v_ned_mps[2])
        velocity = Velocity(t_ns, v_ned_mps, h_amsl_m, believed.sigma_mps, believed.drive)
        alone = feedback or not self._monitor.trusted or believed.drive is Drive.NONE
        if self._tracker.drive(velocity, t_boot_ns, alone=alone) and self._terrain is not None:
            self._terrain.drive(velocity)


def _of_step(step: ClockStep, own: bool) -> str:
    jump_s = step.jump_ns * 1e-9
    if own:
        return f"visloc: companion clock stepped {jump_s:+.1f} s"
    if step.of_autopilot:
        return f"visloc: autopilot clock stepped {-jump_s:+.1f} s"
    return f"visloc: clocks stepped apart by {abs(jump_s):.1f} s"
