"""What the worker is asked next, and the prior that goes with it: the filter's own state, never the autopilot's position.

Where there is no state, or one that says hardly more than that the vehicle is on the map, the place is searched for
(core/places/place_search.py); in turns also where no frame is recognised about a GNSS that is trusted
(core/places/beside_gnss.py).
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from visloc_companion.core import requests
from visloc_companion.core.attitude import AttitudeBuffer
from visloc_companion.core.camera.onboard_camera import OnboardCamera
from visloc_companion.core.covariance import largest_sigma_m
from visloc_companion.core.filter.propagation import VELOCITY, Drive
from visloc_companion.core.places import beside_gnss, place_search
from visloc_companion.core.places.beside_gnss import BesideGnss
from visloc_companion.core.places.place_search import PlaceSearch, Reach, tile_radius_m
from visloc_companion.core.settings import CoreSettings
from visloc_companion.core.terrain.ranges import Ranges
from visloc_companion.core.terrain.terrain_aiding import TerrainAiding
from visloc_companion.core.timesync import ClockOffset
from visloc_companion.core.tracking import Tracker
from visloc_companion.core.without_position import LOOK_SIGMA_M, WithoutPosition
from visloc_companion.geo import se3
from visloc_companion.types import (
    Beam,
    FrameRef,
    GeoPoint,
    LocaliseRequest,
    NavState,
    NoFix,
    PosePrior,
    Quat,
    Range,
    Readout,
    TerrainRequest,
    Vec2,
    Vec3,
)

Request = LocaliseRequest | TerrainRequest
LEVEL: Quat = (1.0, 0.0, 0.0, 0.0)
SEARCH_AFTER_NS = 3_000_000_000
"""Without a first position the search begins when the autopilot is heard and GNSS has not been trusted for so long."""
SEARCH_SIGMA_H_M = 5.0
"""1-sigma of the autopilot's height above the map's zero before fixes have taught how far it is off."""
LEVEL_SIGMAS = 5.3
"""What a protection level is worth that only the filter's own covariance makes. It is larger where the last fixes may have been
wrong: then the search must reach as far, for a filter that follows one is sure of itself at the wrong place."""
REACH_SIGMA = 4.0
"""After a loss the vehicle is searched for within so many sigma of where it is believed to be."""


class Asking:
    """Makes the requests from what the navigator knows; `queue` holds the frame that waits and what is outstanding."""

    def __init__(
        self,
        settings: CoreSettings,
        queue: requests.FrameQueue,
        tracker: Tracker,
        clock: ClockOffset,
        attitude: AttitudeBuffer,
        camera: OnboardCamera,
        terrain: TerrainAiding | None,
        search: PlaceSearch | None = None,
        without: WithoutPosition | None = None,
    ) -> None:
        self._settings, self._queue, self._tracker = settings, queue, tracker
        self._clock, self._attitude, self._camera = clock, attitude, camera
        self._terrain, self._search = terrain, search
        self._without, self._beside, self._ranges = without, BesideGnss(), Ranges()
        self._untrusted_ns: int | None = None
        self._turn = 0

    def next(self, now_ns: int, *, injecting: bool, gnss_trusted: bool) -> list[Request]:
        """The worker's next question: about the ground below the track where that is due, else about a frame."""
        if (gnss_trusted and not self._unplaced) or self._tracker.velocity is None or self._tracker.origin is None:
            self._untrusted_ns = None
        elif self._untrusted_ns is None:
            self._untrusted_ns = now_ns
        return self._about_terrain(now_ns, injecting, gnss_trusted) or self._about_frame(now_ns, injecting)

    def refused(self, answer: NoFix, *, gnss_trusted: bool) -> None:
        """Take an answer without a fix to a question that was not the search's for the place."""
        goes_on = self._without is not None and self._without.goes_on
        self._beside.refused(answer, self._tracker.rests, held_there=gnss_trusted or goes_on)

    def seen_on_map(self, now_ns: int) -> None:
        """Take that the search of the map had a fix: it may have seen a place that is likelier right than wrong."""
        seen_ne_m = None if self._search is None else self._search.seen_ne_m
        if self._without is None or seen_ne_m is None:
            return
        self._without.recognised(now_ns)
        if self.beside_gnss():
            self._without.seen_at(seen_ne_m, now_ns)

    def beside_gnss(self) -> bool:
        """Whether the map is searched in turns because no frame is recognised about a GNSS that is, or was, trusted, or about
        what the autopilot was sent before the daemon came."""
        return self._search is not None and self._beside.due(self._tracker.rests)

    def attitude_now(self, now_ns: int) -> Quat | None:
        """The vehicle's attitude at a shell time, the newest one known where that is ahead of it."""
        t_boot_ns, newest = self._clock.boot_ns(now_ns), self._attitude.newest_boot_ns()
        if t_boot_ns is None or newest is None:
            return None
        return self._attitude.at(t_boot_ns) or self._attitude.at(newest)

    def on_range(self, event: Range, t_ns: int) -> None:
        """Keep a distance to the ground, measured at a time, if frames are to have it."""
        if self._settings.rangefinder:
            self._ranges.on_range(event, t_ns)

    def forget_ranges(self) -> None:
        """A clock stepped."""
        self._ranges.clear()

    def _about_terrain(self, now_ns: int, injecting: bool, gnss_trusted: bool) -> list[Request]:
        terrain = self._terrain
        if terrain is None or not self._queue.free or not terrain.due(now_ns):
            return []
        belief, state, q_ned_frd = self._tracker.belief, self._tracker.at(now_ns), self.attitude_now(now_ns)
        origin = self._tracker.origin
        if belief is None or state is None or origin is None or q_ned_frd is None:
            return []
        prior = self._prior(state, origin, q_ned_frd, LEVEL, injecting)
        steady = gnss_trusted and belief.drive is Drive.AUTOPILOT
        known_mps = math.sqrt(float(np.diag(belief.P[VELOCITY, VELOCITY]).max()))
        sigma_v_mps = belief.sigma_v_mps if belief.drive is Drive.INERTIAL else known_mps  # of the autopilot's own velocity
        asked = terrain.request(self._queue.claimed(), now_ns, prior, sigma_v_mps, steady)
        return [] if asked is None else [asked]

    def _about_frame(self, now_ns: int, injecting: bool) -> list[Request]:
        if self._search is not None and self._tracker.velocity is not None:
            self._search.moving(self._tracker.velocity.t_ns, self._tracker.velocity.v_ned_mps[:2])
        frame = self._queue.next_frame(now_ns)
        if frame is None or self._tracker.low:
            return []
        poses = self._attitudes_at(frame, now_ns)
        if poses is None:
            return []
        q_ned_frd, q_ned_carrier = poses
        state, origin = self._tracker.at(frame.t_ns), self._tracker.origin
        unplaced = self._about_receiver(state, frame, poses, now_ns)
        unplaced = self._about_search(state, frame, poses, now_ns) if unplaced is None else unplaced
        if unplaced is not None:
            return unplaced
        if state is None or origin is None or not self._tracker.takes(frame.t_ns):
            return []
        state = self._of_camera(self._wide(state) if injecting else state, q_ned_frd)
        prior = self._prior(state, origin, q_ned_carrier, self._camera.q_carrier_cambody, injecting)
        tilt, sun = self._camera.tilt(frame.t_ns, q_ned_carrier), self._camera.sun(frame.t_ns)
        if tilt is not None or sun is not None:
            prior = replace(prior, tilt=tilt, sun=sun)
        zoom, try_zoom = self._camera.zoom.factor, self._camera.zoom.next(now_ns, self._tracker.gnss)
        asked = self._queue.taken(frame, prior, now_ns, zoom=zoom, try_zoom=try_zoom)
        return [self._with_beam(self._read_out(asked, state.v_ned_mps), q_ned_frd, state.v_ned_mps)]

    def _read_out(self, request: LocaliseRequest, v_ned_mps: Vec3) -> LocaliseRequest:
        """The request with how the camera moves while a rolling shutter reads the frame, as far as that is known."""
        span_s, height_m = self._settings.readout_s, self._tracker.height_above_home_m
        if span_s == 0.0 or height_m is None:
            return request
        t_boot_ns = self._boot_ns(request.frame)
        rate_cambody = None if t_boot_ns is None else self._camera.rate_radps(t_boot_ns, round(abs(span_s) * 1e9))
        if rate_cambody is None:
            return request
        return replace(request, readout=Readout(span_s, rate_cambody, v_ned_mps, height_m))

    def _with_beam(self, request: LocaliseRequest, q_ned_frd: Quat, v_ned_mps: Vec3) -> LocaliseRequest:
        """The request with what a rangefinder met, which looks down the vehicle's body whatever carries the camera, and by the
        1-sigma of a mounting beside where it should."""
        t_ns = request.frame.t_ns
        measured = self._ranges.near(t_ns, math.hypot(*v_ned_mps))
        t_boot_ns = None if measured is None else self._clock.boot_ns(measured.t_ns)
        q_then = None if t_boot_ns is None else self._attitude.at(t_boot_ns)
        if measured is None or q_then is None:
            return request
        along = se3.rotate(q_then, (0.0, 0.0, measured.distance_m))
        dt_s = (measured.t_ns - t_ns) * 1e-9
        camera = self._camera.camera_ned_m((0.0, 0.0, 0.0), q_ned_frd)
        north, east, down = (a + dt_s * v - c for a, v, c in zip(along, v_ned_mps, camera, strict=True))
        sigma_m = math.hypot(measured.sigma_m, self._settings.mount_sigma_rad * math.hypot(*along[:2]))
        if self._terrain is not None:  # whose fixes may have taught the altitude, from the same distances
            news = sigma_m**-2 - request.believed.sigma_h_m**-2
            if news <= 0:
                return request
            sigma_m = news**-0.5
        return replace(request, beam=Beam((north, east, down), sigma_m))

    def _of_camera(self, state: NavState, q_ned_frd: Quat) -> NavState:
        return replace(state, p_ned_m=self._camera.camera_ned_m(state.p_ned_m, q_ned_frd))

    def _wide(self, state: NavState) -> NavState:
        """A state of dead reckoning with a covariance that allows for wrong last fixes, too."""
        if state.age_of_fix_s <= self._settings.navigator.dead_reckoning_after_s:
            return state
        level_m = self._tracker.protection_level_m(state.t_ns) or 0.0
        return replace(state, cov_ne_m2=requests.as_wide_as(state.cov_ne_m2, level_m / LEVEL_SIGMAS))

    def _anywhere(self, state: NavState | None, now_ns: int) -> bool:
        """Whether GNSS has not been trusted for a while and the state, if any, leaves open more than a search of one region."""
        velocity, origin, since_ns = self._tracker.velocity, self._tracker.origin, self._untrusted_ns
        if velocity is None or origin is None or since_ns is None or now_ns - since_ns < SEARCH_AFTER_NS:
            return False
        radius_m = tile_radius_m(velocity.h_amsl_m - origin.h_amsl_m, self._settings.max_search_radius_m)
        return state is None or 3 * largest_sigma_m(state.cov_ne_m2) > radius_m

    def _about_search(
        self, state: NavState | None, frame: FrameRef, poses: tuple[Quat, Quat], now_ns: int
    ) -> list[Request] | None:
        """A question of the search for the vehicle's place, where there is a search and its turn; else it ends, or waits."""
        search = self._search
        if search is None:
            return None
        if self._anywhere(state, now_ns):
            about = Reach() if state is None else Reach(state.p_ned_m[:2], REACH_SIGMA * largest_sigma_m(state.cov_ne_m2))
            return [*self._about_place(search, about, frame, poses, now_ns, place_search.RISK)]
        if state is not None and self.beside_gnss():
            if not self._beside.takes_turn():
                return None
            about = Reach() if self._beside.off_map else Reach(state.p_ned_m[:2])
            asked = self._about_place(search, about, frame, poses, now_ns, beside_gnss.RISK)
            return self._over_ground_at(state, asked, poses)
        if search.active:
            search.clear()
        return None

    @property
    def _looks(self) -> bool:
        return self._without is not None and self._without.looks

    @property
    def _unplaced(self) -> bool:
        return self._without is not None and self._without.unplaced

    @property
    def _may_have_been_dragged(self) -> bool:
        """Whether GNSS, about which no frame was recognised yet, may lie as far off as an attack hides, since before we came."""
        found = self._without is not None and self._without.found_in_flight
        return found and self._beside.missed(self._tracker.rests)

    def _about_receiver(
        self, state: NavState | None, frame: FrameRef, poses: tuple[Quat, Quat], now_ns: int
    ) -> list[Request] | None:
        """A question about where a receiver has a vehicle that nothing else places, in turns with the search of the map; or about
        where else than the filter has it it may be, in turns with that."""
        about = self._elsewhere(state) if state is not None else self._at_receiver(frame.t_ns, now_ns)
        if about is None:
            return None
        where = place_search.Where(about, ((LOOK_SIGMA_M**2, 0.0), (0.0, LOOK_SIGMA_M**2)))
        asked = self._about_where(where, frame, poses, now_ns)
        return [*asked] if state is None else self._over_ground_at(state, asked, poses)

    def _over_ground_at(self, state: NavState, asked: list[LocaliseRequest], poses: tuple[Quat, Quat]) -> list[Request]:
        """Questions about another place, with the camera's motion measured over the ground where the filter has the vehicle."""
        believed, origin = self._of_camera(state, poses[0]), self._tracker.origin
        carrier, body = poses[1], self._camera.q_carrier_cambody
        ground = None if origin is None else self._prior(believed, origin, carrier, body, injecting=False)
        return [replace(each, motion_prior=ground) for each in asked]

    def _at_receiver(self, t_ns: int, now_ns: int) -> Vec2 | None:
        about = self._without.about_ne_m(t_ns) if self._without is not None and self._looks else None
        if about is None or (self._search is not None and self._anywhere(None, now_ns) and self._beside.takes_turn()):
            return None
        return about

    def _elsewhere(self, state: NavState) -> Vec2 | None:
        """In turns None, which leaves the question to where the filter is, and the other places where the vehicle may be."""
        places = () if self._without is None else self._without.elsewhere_ne_m(state)
        self._turn = (self._turn + 1) % (len(places) + 1)
        return places[self._turn - 1] if self._turn else None

    def _about_place(
        self, search: PlaceSearch, about: Reach, frame: FrameRef, poses: tuple[Quat, Quat], now_ns: int, risk: float
    ) -> list[LocaliseRequest]:
        """The next question of the search for the vehicle's place, which is found where it is false with less than a risk."""
        velocity, origin = self._tracker.velocity, self._tracker.origin
        if velocity is None or origin is None:
            return []
        height_m = velocity.h_amsl_m - origin.h_amsl_m
        where = search.next(self._queue.next_id, frame.t_ns, height_m, velocity.sigma_mps, about, risk)
        return self._about_where(where, frame, poses, now_ns)

    def _about_where(
        self, where: place_search.Where, frame: FrameRef, poses: tuple[Quat, Quat], now_ns: int
    ) -> list[LocaliseRequest]:
        """A question about a place at which no filter has the vehicle."""
        q_ned_frd, q_ned_carrier = poses
        velocity, origin = self._tracker.velocity, self._tracker.origin
        if velocity is None or origin is None:
            return []
        height_m = velocity.h_amsl_m - origin.h_amsl_m
        asked = NavState(
            frame.t_ns, (*where.place_ne_m, -height_m), velocity.v_ned_mps, where.cov_ne_m2, SEARCH_SIGMA_H_M, math.inf
        )
        prior = self._pose_prior(self._of_camera(asked, q_ned_frd), origin, q_ned_carrier, self._camera.q_carrier_cambody)
        share = where.share_of_sigmas
        sigmas = share * prior.sigma_h_m, share * prior.sigma_yaw_rad
        prior = replace(prior, sigma_h_m=sigmas[0], sigma_yaw_rad=sigmas[1], within_m=where.within_m)
        request = self._queue.taken(frame, prior, now_ns, aside=True, zoom=self._camera.zoom.factor)
        return [self._with_beam(self._read_out(request, velocity.v_ned_mps), q_ned_frd, velocity.v_ned_mps)]

    def _prior(self, state: NavState, origin: GeoPoint, q_ned_carrier: Quat, q_carrier_body: Quat, injecting: bool) -> PosePrior:
        """The prior of a state for the camera's body on what carries it, or for another one that is mounted so on another."""
        if not injecting:
            since_s = math.inf if self._may_have_been_dragged else state.age_of_fix_s
            cov = requests.held_by_gnss(state.cov_ne_m2, since_s, self._settings.navigator.seed_sigma_m)
            state = replace(state, cov_ne_m2=cov)
        return self._pose_prior(state, origin, q_ned_carrier, q_carrier_body)

    def _pose_prior(self, state: NavState, origin: GeoPoint, q_ned_carrier: Quat, q_carrier_body: Quat) -> PosePrior:
        height = self._tracker.height.known(state.t_ns, origin.h_amsl_m - state.p_ned_m[2])
        return requests.pose_prior(
            state,
            origin,
            q_ned_carrier,
            q_carrier_body,
            height.offset_m,
            requests.least_height_sigma_m(self._tracker.height_above_home_m or 0.0, height.unseen_s),
            self._settings.mount_sigma_rad,
            self._settings.max_search_radius_m,
            requests.heading_sigma_rad(self._camera.sigma_yaw_rad, self._tracker.heading.since_fixes_rad),
        )

    def _attitudes_at(self, frame: FrameRef, now_ns: int) -> tuple[Quat, Quat] | None:
        """Of the vehicle and of what carries the camera, when a frame was taken; None where one of them makes it useless."""
        t_boot_ns = self._boot_ns(frame)
        q_ned_frd = None if t_boot_ns is None else self._attitude.at(t_boot_ns)
        if t_boot_ns is None or q_ned_frd is None:
            return None
        q_ned_carrier = self._camera.carrier(t_boot_ns, q_ned_frd, now_ns)
        return None if q_ned_carrier is None else (q_ned_frd, q_ned_carrier)

    def _boot_ns(self, frame: FrameRef) -> int | None:
        return self._clock.boot_ns(frame.t_ns) if frame.t_boot_ns is None else frame.t_boot_ns
