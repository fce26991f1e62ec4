"""The filter's life: origin, seeding, what drives it, and whether GNSS or the operator can be right."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from visloc_companion.core.estimator import PositionFilter
from visloc_companion.core.filter.belief import Belief, lens_doubted, seeded
from visloc_companion.core.filter.driving import Velocity
from visloc_companion.core.filter.fusion import MAX_STEP_M, UNAIDED_SIGMA_MPS
from visloc_companion.core.filter.lasting import BY_SHAPE
from visloc_companion.core.filter.motion import Motion
from visloc_companion.core.filter.moved_alike import MovedAlike
from visloc_companion.core.filter.propagation import Drive
from visloc_companion.core.filter.reckoned import Reckoned, way_ne_m
from visloc_companion.core.heights.height_aiding import HeightAiding
from visloc_companion.core.odometry_aiding import OdometryAiding
from visloc_companion.core.satellites.gnss_track import GnssTrack
from visloc_companion.core.satellites.reach import out_of_reach
from visloc_companion.core.settings import NavigatorSettings
from visloc_companion.core.velocity.air_velocity import AirError, AirVelocity, gusty
from visloc_companion.core.velocity.drag_velocity import DragLearner
from visloc_companion.core.velocity.forces import MIN_HEIGHT_M, Forces
from visloc_companion.core.velocity.heading_pull import HeadingPull
from visloc_companion.core.velocity.inertial import InertialVelocity
from visloc_companion.core.velocity.pitot import Airspeed, PitotLearner
from visloc_companion.core.velocity.teaching import Teaching
from visloc_companion.geo import wgs84
from visloc_companion.types import Accepted, Fix, FloatArray, GeoPoint, NavState, Odometry, Quat, Rejected, TooOld, Vec2, Vec3

MIN_VELOCITY_INTERVAL_NS = 5_000_000
LEAST_ACCELERATION_SIGMA_MPS2 = 0.05
"""A tilt of 0.3 degrees, which no autopilot without GNSS is free of."""
TEACHES_MPS = 0.5
"""Until the air tells the velocity, one that is known as well teaches it."""
FLIES_MPS = 5.0
"""What moves as fast over the ground does not stand there."""


class Tracker:
    """Position filter with the inputs that it keeps for it: velocity, the receiver's positions (`gnss`), and how far the
    autopilot's height (`height`) and heading (`heading`) are off. `max_step_m`: larger corrections are sent to the autopilot as
    resets. `gnss_false`: probability that GNSS was false when it last held the filter for its level (by_gnss.py)."""

    def __init__(self, settings: NavigatorSettings, max_step_m: float = MAX_STEP_M) -> None:
        self._settings, self._max_step_m = settings, max_step_m
        self._filter: PositionFilter | None = None
        self._velocity: Velocity | None = None
        self._odometry = OdometryAiding()
        self._inertial, self._velocity_boot_ns = InertialVelocity(), 0
        self._forces, self._drag, self._pitot, self._teaching = Forces(), DragLearner(), PitotLearner(), Teaching()
        self._alone, self._drives_itself, self._sigma_a_mps2 = False, False, 0.0
        self.gnss = GnssTrack()
        self.height = HeightAiding(settings)
        self.heading, self.gnss_false = HeadingPull(), 1.0
        self.origin: GeoPoint | None = None
        self.height_above_home_m: float | None = None
        self.takeoff_unseen = self.restarted_aloft = False
        self.longer_share, self._lasting_share, self.zoom_share, self.alike = 0.0, 0.0, 0.0, MovedAlike(settings.map_sigma_m)

    @property
    def belief(self) -> Belief | None:
        """The filter's newest belief, None before seeding."""
        return None if self._filter is None else self._filter.newest

    @property
    def rests(self) -> Belief | None:
        """As `belief`, of which only what it rests on is asked (estimator.PositionFilter.rests)."""
        return None if self._filter is None else self._filter.rests

    @property
    def velocity(self) -> Velocity | None:
        """The last velocity sample."""
        return self._velocity

    @property
    def settled(self) -> bool:
        """Whether the autopilot's velocity was known without us, or has had the time to come right by what we send."""
        return self._teaching.settled

    @property
    def low(self) -> bool:
        """Whether the vehicle is known to be too low to be localised. Far below its home it flies in a valley.

        Not where fixes show that the autopilot's height is off by more than that: ArduPilot's, without any position, says 0 m all
        the way up; nor that the ground lies far below a home on a ridge. A vehicle that was found flying on vision may have had
        its home set there: until a fix tells it is not low while it moves. Nor is one whose autopilot restarted in flight.
        """
        height_m, least_m = self.height_above_home_m, self._settings.min_height_m
        if height_m is None or abs(height_m) >= least_m:
            return False
        if self._velocity is None:
            return True
        moves = math.hypot(*self._velocity.v_ned_mps[:2]) > FLIES_MPS
        if self.restarted_aloft or (self.takeoff_unseen and moves and not self.height.ground_seen):
            return False
        stated = self._velocity.t_ns, self._velocity.h_amsl_m
        shown_m, aloft = self.height.shown_m(*stated), self.height.far_above_ground(*stated, least_m)
        return not aloft and (abs(shown_m) < least_m or abs(height_m + shown_m) < least_m)

    def set_origin(self, origin: GeoPoint) -> bool:
        """Take the EKF origin; True when it moved a frame that was in use.

        In height alone it moves nothing: ArduPilot corrects that of its origin in flight, by centimetres (EK3_OGN_HGT_MASK).
        """
        before, self.origin = self.origin, origin
        if self._filter is None or origin == before:
            return False
        self._filter.move_origin(origin)
        return not wgs84.same_spot(origin, before)

    def drive(self, velocity: Velocity, t_boot_ns: int, *, alone: bool) -> bool:
        """Take the autopilot's velocity; the same sample in another message is ignored (False).

        `alone`: it does not rest on a GNSS that is trusted. The filter is then driven by the accelerations, while something
        teaches it their error; alone for long they carry it away faster than what the autopilot has learnt of its own sensors.
        """
        last = self._velocity
        if last is not None and velocity.t_ns < last.t_ns + MIN_VELOCITY_INTERVAL_NS:
            return False
        self._velocity, self._velocity_boot_ns = velocity, t_boot_ns
        self._forces.on_velocity(velocity.v_ned_mps, alone=alone)
        self._alone = alone
        unknown, tau_s = self._settings.acceleration_sigma_mps2, self._settings.acceleration_correlation_s
        sigma_a = self._inertial.bias.sigma_mps2(unknown, LEAST_ACCELERATION_SIGMA_MPS2, tau_s)
        self._teaching.velocity_known |= not alone
        taught = self._teaching.lasts(velocity.t_ns, self._settings.velocity_sigma_aiding_mps, min(unknown, sigma_a))
        v_ne_mps = self._inertial.at(t_boot_ns) if alone and taught else None
        self._drives_itself, self._sigma_a_mps2 = v_ne_mps is not None, sigma_a
        if v_ne_mps is None:
            near = self.height_above_home_m is not None and abs(self.height_above_home_m) < MIN_HEIGHT_M
            stands = near and math.hypot(*velocity.v_ned_mps) < FLIES_MPS  # no thrust shakes its sensors, nothing tilts it
            self._inertial.anchor(t_boot_ns, velocity.v_ned_mps[:2], teaches=not alone and not stands)
        else:
            v_ned_mps, more_rad2 = (*v_ne_mps, velocity.v_ned_mps[2]), self.heading.more_rad2()
            velocity = replace(
                velocity, v_ned_mps=v_ned_mps, drive=Drive.INERTIAL, sigma_a_mps2=sigma_a, more_heading_rad2=more_rad2
            )
        if self._filter is not None:
            self._filter.drive(velocity)
        return True

    def on_force(self, t_boot_ns: int, force_frd_mps2: Vec3, q_ned_frd: Quat) -> None:
        """Take what the accelerometers measured, with the attitude of that time."""
        self._inertial.on_force(t_boot_ns, force_frd_mps2, q_ned_frd)
        height_m = self.height_above_home_m
        if height_m is None or abs(height_m) < MIN_HEIGHT_M:
            return
        second = self._forces.on_force(t_boot_ns, force_frd_mps2, q_ned_frd)
        if second is None:
            return
        tells = second.alone and self._teaching.rare(self._shell_ns(t_boot_ns))
        told = self._drag.velocity(second.felt, second.v_ned_mps) if tells else None
        if told is not None:
            self._told(told, self._drag, t_boot_ns)
        elif (known := self._known(second.felt.t_boot_ns, second.v_ned_mps, alone=second.alone)) is not None:
            self._drag.learn(second.felt, *known)

    def on_airspeed(self, t_boot_ns: int, v_ne_mps: Vec2) -> None:
        """Take a velocity through the air, of a plane."""
        if self._velocity is None or self._drag.known:
            return
        air = Airspeed(t_boot_ns, v_ne_mps)
        told = self._pitot.velocity(air) if self._alone and self._teaching.rare(self._shell_ns(t_boot_ns)) else None
        if told is not None:
            self._told(told, self._pitot, t_boot_ns)
        elif (known := self._known(t_boot_ns, self._velocity.v_ned_mps, alone=self._alone)) is not None:
            self._pitot.learn(air, *known)

    def _shell_ns(self, t_boot_ns: int) -> int:
        return t_boot_ns if self._velocity is None else t_boot_ns + self._velocity.t_ns - self._velocity_boot_ns

    def _known(self, t_boot_ns: int, autopilots_ned_mps: Vec3, *, alone: bool) -> tuple[Vec3, FloatArray] | None:
        """The velocity at a time and the covariance of its error (2, 2), where it is known well without what the air tells."""
        if not alone:
            return autopilots_ned_mps, np.zeros((2, 2))
        t_ns = self._shell_ns(t_boot_ns)
        if self._filter is None or self._teaching.blind(t_ns) or not self._teaching.own(t_ns):
            return None
        state = self._filter.at(t_ns)
        cov = np.array(state.cov_v_ne_m2ps2)
        return (state.v_ned_mps, cov) if np.trace(cov) <= 2 * TEACHES_MPS**2 else None

    def _told(self, told: AirVelocity, by: DragLearner | PitotLearner, t_boot_ns: int) -> None:
        """Take the velocity that the air tells; what it says of its lasting error must reach the filter."""
        t_ns, v_ne_mps = self._shell_ns(t_boot_ns), self._inertial.at(told.t_boot_ns)
        if told.holds:
            self._teaching.told(t_ns)
        if self._filter is None or v_ne_mps is None or not self._drives_itself:
            by.filter_restarted()
            return
        off = (told.v_ne_mps[0] - v_ne_mps[0], told.v_ne_mps[1] - v_ne_mps[1])
        self._filter.observe_air(AirError(t_ns, off, gusty(told, self._teaching.since_air_s(t_ns))))
        self._teaching.air_told(t_ns)

    def know_map(self, sigma_m: float) -> None:
        """Take another 1-sigma of the map's registration, on each axis."""
        same = self.alike.map_sigma_m == sigma_m
        self._moved_alike(self.alike if same else replace(self.alike, map_sigma_m=sigma_m))

    def retimed(self, later_s: float) -> None:
        """Frames turned out to be taken so much later than was believed."""
        self._odometry = OdometryAiding()
        if self._filter is not None:
            self._filter.retimed(later_s)

    def doubt_bend(self, bend: float) -> None:
        """The lens may bend pictures otherwise than configured (distortion_watch.DistortionWatch.bend): what a height of way
        turns them by is taken for a tilt, which shifts all fixes alike."""
        self._moved_alike(replace(self.alike, lens_bend=bend))

    def doubt_aim(self, share: float, open_share: float) -> None:
        """The camera may look beside where it should by so much of the height, of which so much is not taken off (aim.Aim)."""
        self._moved_alike(replace(self.alike, aim_share=share, aim_open=open_share))

    @property
    def lens_doubt_lasts(self) -> bool:
        """Whether the lens is doubted for the flight."""
        return self._lasting_share != 0

    @property
    def astray_m(self) -> float:
        """1-sigma, on each axis, of what fixes are off by beside GNSS (moved_alike.MovedAlike)."""
        return self.alike.astray_m(self._flown_m)

    @property
    def shared_m(self) -> float:
        """1-sigma, on each axis, of what states have of that which is common to all fixes: none of them takes it away."""
        return self._settings.map_sigma_m

    @property
    def _flown_m(self) -> float:
        """How far from home's height, 0 while that is not known."""
        return abs(self.height_above_home_m or 0.0)

    def _moved_alike(self, alike: MovedAlike) -> None:
        self.alike = alike
        sigma_m = alike.sigma_m(self._flown_m)
        if sigma_m == self._settings.map_sigma_m:
            return
        self._settings = replace(self._settings, map_sigma_m=sigma_m)
        if self._filter is not None:
            self._filter.know_map(sigma_m)

    def doubt_lens(self, fix: Fix, longer_share: float, *, lasts: bool = False) -> None:
        """Fixes, of which this is the last, show that the lens may be longer than calibrated by a share, which `lasts` for the
        flight where they show it beside GNSS."""
        self.longer_share = longer_share
        self._lasting_share = longer_share if lasts else self._lasting_share
        if self._filter is not None:
            self._filter.doubt_lens(abs(longer_share), fix.per_focal_ne_m)

    def know_lens(self, share: float, *, lasts: bool = True) -> None:
        """Frames are looked at through another lens, which may be off by a share, or the lens is doubted no more (0) beyond what
        lasts, or (`lasts` no more) for that, too."""
        self._lasting_share = self._lasting_share if lasts else 0.0
        self.longer_share = max(self._lasting_share, share, key=abs)
        if self._filter is not None:
            self._filter.know_lens(abs(self.longer_share))

    def doubt_motion(self) -> None:
        """What the camera showed of its motion lately was wrong."""
        self._odometry = OdometryAiding()
        if self._filter is not None and self._velocity is not None:
            self._filter.doubt_motion(self._velocity.v_ned_mps[:2])

    def forget_velocity(self) -> None:
        """The autopilot restarted; its next velocity may bear any time."""
        self._velocity = None
        self._odometry = OdometryAiding()
        self._inertial.clear()
        self._forces.clear()
        self.heading.interrupted()

    def stood(self, t_ns: int, stood_ns: int) -> None:
        """Our own clock stepped back; now that it has caught up, so much time went by that it did not count."""
        self._odometry = OdometryAiding()
        if self._filter is not None:
            self._filter.stood(t_ns, stood_ns)

    def leapt(self, t_ns: int, leapt_ns: int, since_ns: int) -> None:
        """Our own clock stepped forward at since_ns: so much time did not go by that it counted."""
        self._odometry = OdometryAiding()
        if self._filter is not None:
            self._filter.leapt(t_ns, leapt_ns, since_ns)

    def dragged(self, t_ns: int, sigma_m: float) -> None:
        """GNSS, which alone held the filter, is trusted no more; it may have been dragged by so much."""
        if self._filter is not None:
            self._filter.dragged(t_ns, sigma_m)

    def seed(self, t_ns: int, place: GeoPoint, sigma_m: float) -> bool:
        """Start (or restart) the filter from where the vehicle was at a time; False while origin or velocity is missing."""
        if self.origin is None or self._velocity is None:
            return False
        north, east, _ = wgs84.ned_from_geo(place, self.origin)
        v, since_s = self._velocity, max(0, self._velocity.t_ns - t_ns) * 1e-9
        way_n, way_e = way_ne_m(self.reckoned(t_ns), self.reckoned(v.t_ns), v.v_ned_mps[:2], since_s)
        place_ne_m, sigma_m = (north + way_n, east + way_e), math.hypot(sigma_m, v.sigma_mps * since_s)
        start = seeded(max(t_ns, v.t_ns), place_ne_m, sigma_m, v.sigma_mps, v.drive, self._settings)
        if self.longer_share != 0:
            start = lens_doubted(start, abs(self.longer_share), (0.0, 0.0))
        self._inertial.anchor(self._velocity_boot_ns, v.v_ned_mps[:2])
        self._teaching.restarted()
        self._drag.filter_restarted()
        self._pitot.filter_restarted()
        self._filter = PositionFilter(self._settings, self.origin, start, v, self._max_step_m)
        return True

    def forget(self) -> None:
        """What taught the filter was wrong: it has to be seeded anew."""
        self._filter = None
        self._odometry = OdometryAiding()

    def seed_without_velocity(self, t_ns: int, t_boot_ns: int, place: GeoPoint, sigma_m: float) -> None:
        """Start from a place while the autopilot gives no velocity or height (PX4 without any position).

        The velocity is taken as zero with a large error, which fixes teach; the height is that of the place.
        """
        still = Velocity(t_ns, (0.0, 0.0, 0.0), place.h_amsl_m, UNAIDED_SIGMA_MPS, Drive.AUTOPILOT)
        self.drive(still, t_boot_ns, alone=False)
        self.height.drive(t_ns, place.h_amsl_m, None)
        self._teaching.velocity_known = False
        self.seed(t_ns, place, sigma_m)
        self._inertial.release()

    def at(self, t_ns: int) -> NavState | None:
        """The state at a time, with what is known of the autopilot's height."""
        if self._filter is None or self.origin is None:
            return None
        known = self._filter.at(t_ns)
        sigma_d_m = self.height.known(t_ns, self.origin.h_amsl_m - known.p_ned_m[2]).sigma_m
        about = known.p_ned_m, known.v_ned_mps, known.cov_ne_m2
        return NavState(t_ns, *about, sigma_d_m, known.age_of_fix_s, known.cov_v_ne_m2ps2)

    def reckoned(self, t_ns: int) -> Reckoned | None:
        """What the driving velocity has come to at a time; None before seeding, or where that is forgotten."""
        return self._filter.reckoned(t_ns) if self._filter is not None and self.takes(t_ns) else None

    def takes(self, t_ns: int) -> bool:
        """Whether the filter, where there is one, can take what was seen at a time."""
        return self._filter is not None and t_ns >= self._filter.earliest_ns

    def protection_level_m(self, t_ns: int) -> float | None:
        """Horizontal protection level at a time; None before seeding."""
        return None if self._filter is None else self._filter.protection_level_m(t_ns, self.gnss_false)

    def observe(self, fix: Fix, mounting_rad: float = 0.0) -> Accepted | Rejected | TooOld | None:
        """Take a fix (estimator.PositionFilter.observe); None before seeding."""
        if self._filter is None:
            return None
        outcome = self._teach(fix.t_ns, self._filter.observe(fix, mounting_rad))
        if isinstance(outcome, Accepted) and fix.method not in BY_SHAPE:
            self.heading.borne_out()
        return outcome

    def _teach(self, t_ns: int, outcome: Accepted | Rejected | TooOld) -> Accepted | Rejected | TooOld:
        if isinstance(outcome, Accepted):
            self._teaching.recognised(t_ns)
        return outcome

    def observe_odometry(self, odometry: Odometry, *, doubted: bool = False) -> Motion | None:
        """Learn the velocity's error from what the camera saw of its own motion, unless it is doubted; the interval for the GNSS
        monitor that it completes, if it does."""
        odometry = self.heading.doubted(odometry)
        if self.alike.lens_bend:
            odometry = replace(odometry, sigma_scale=math.hypot(odometry.sigma_scale, self.alike.lens_bend))
        completed = self._odometry.on_odometry(odometry, inertial_mps2=self._sigma_a_mps2 if self._drives_itself else None)
        if not doubted:
            self._learn_motion(completed.of_filter)
        return completed.of_monitor

    def odometry_lost(self) -> None:
        """An answer without the camera's motion: nothing waits for a longer interval any more."""
        self._learn_motion(self._odometry.lost())

    def _learn_motion(self, motion: Motion | None) -> None:
        if motion is not None and self._filter is not None:
            self._teach(motion.t_ns, self._filter.observe_motion(motion))

    def beside_gnss(self, t_ns: int, place: GeoPoint, sigma_m: float) -> None:
        """Take a trusted GNSS position for the level alone."""
        if self._filter is not None:
            self._filter.beside_gnss(t_ns, place, sigma_m)

    def observe_gnss(self, t_ns: int, place: GeoPoint, sigma_m: float) -> Accepted | Rejected | TooOld | None:
        """Take a trusted GNSS position; None before seeding."""
        return None if self._filter is None else self._filter.observe_gnss(t_ns, place, sigma_m)

    def out_of_reach(self, t_ns: int, place: GeoPoint, sigma_m: float, gate_sigma: float | None = None) -> bool:
        """Whether a GNSS position is outside a gate (None: the usual one) about our own state."""
        state = self.at(t_ns)
        if state is None or self.origin is None:
            return False
        north, east, _ = wgs84.ned_from_geo(place, self.origin)
        off_ne_m = north - state.p_ned_m[0], east - state.p_ned_m[1]
        return out_of_reach(off_ne_m, state.cov_ne_m2, sigma_m, gate_sigma or self._settings.gate_sigma)
