"""Frames out to the worker, answers back into the filter, and what the operator says in place of an answer."""

from __future__ import annotations

import math

from visloc_companion.core.asking import Asking
from visloc_companion.core.camera.camera_watch import CameraWatch
from visloc_companion.core.camera.onboard_camera import OnboardCamera
from visloc_companion.core.camera.unmatched_watch import UnmatchedWatch
from visloc_companion.core.computer_watch import ComputerWatch
from visloc_companion.core.covariance import largest_sigma_m
from visloc_companion.core.filter.belief import Belief
from visloc_companion.core.filter.second_opinion import SecondOpinion
from visloc_companion.core.gnss import ODOMETRY, GnssMonitor
from visloc_companion.core.gnss_aiding import GnssAiding
from visloc_companion.core.guard import Complaints
from visloc_companion.core.places import operator_word
from visloc_companion.core.places.first_fixes import FirstFixes
from visloc_companion.core.places.open_tracks import OpenTracks
from visloc_companion.core.places.place_search import Found, PlaceSearch
from visloc_companion.core.places.regaining import Regaining
from visloc_companion.core.places.travel import TravelLog
from visloc_companion.core.requests import FrameQueue
from visloc_companion.core.source.steering import Steering
from visloc_companion.core.terrain.terrain_aiding import METHOD as TERRAIN
from visloc_companion.core.terrain.terrain_aiding import TerrainAiding
from visloc_companion.core.tracking import Tracker
from visloc_companion.core.validate import fault
from visloc_companion.core.without_position import WithoutPosition
from visloc_companion.errors import Reason
from visloc_companion.geo import wgs84
from visloc_companion.types import (
    Accepted,
    Command,
    Event,
    Fix,
    FrameRef,
    GeoPoint,
    LocaliseRequest,
    Mode,
    NavState,
    NoFix,
    Notice,
    Odometry,
    OperatorFix,
    Rejected,
    Severity,
)

SEED_SIGMA_M = 5.0
"""1-sigma of a place by fixes through a lens whose length they told."""
BESIDE_GNSS_M = 50.0
"""A place that is found is said to lie elsewhere than a trusted GNSS from so far on."""
WORKER_LOST = (Reason.WORKER_TIMEOUT, Reason.WORKER_DIED)


class Vision:
    """What the navigator does with pictures."""

    def __init__(
        self,
        queue: FrameQueue,
        asking: Asking,
        onboard: OnboardCamera,
        tracker: Tracker,
        aiding: GnssAiding,
        without: WithoutPosition,
        monitor: GnssMonitor,
        steering: Steering,
        terrain: TerrainAiding | None,
        search: PlaceSearch | None,
        complaints: Complaints,
        max_probability_wrong: float,
        max_search_radius_m: float,
        has_camera: bool,
    ) -> None:
        self._queue, self._asking, self._onboard = queue, asking, onboard
        self._tracker, self._aiding, self._without = tracker, aiding, without
        self._monitor, self._steering = monitor, steering
        self._terrain, self._search, self._complaints = terrain, search, complaints
        self._camera, self._computer = CameraWatch(has_camera), ComputerWatch()
        self._second, self._unmatched = SecondOpinion(), UnmatchedWatch()
        self._travel = TravelLog()
        self._open = OpenTracks(max_probability_wrong, self._travel.displacements)
        self._regaining, self._first = Regaining(self._travel), FirstFixes(self._travel)
        self._searching = self._lens_doubted = False
        self._to_confirm: OperatorFix | None = None
        self._off_map_since_ns: int | None = None
        self._max_search_radius_m = max_search_radius_m

    @property
    def n_open(self) -> int:
        """How many places are open between which frames have not decided yet."""
        return len(self._open.weights)

    def stood(self) -> None:
        """The clock showed no progress while the vehicle went on: nobody knows how far."""
        self._nothing_open()
        self._regaining.clear()

    def _nothing_open(self) -> None:
        self._open.clear()
        self._second.clear()

    def check(self, now_ns: int, heard: bool) -> list[Command]:
        """What is to be said of the camera at a Tick (`heard`: the autopilot is), and that the place is searched for."""
        was_searching, self._searching = self._searching, self._search is not None and self._search.active
        begun = self._searching and not was_searching
        if self._monitor.trusted and not self._without.unplaced:
            self._to_confirm = None  # from here on GNSS says the place, and what fixes confirm is not the operator's word
        self._follow(now_ns)
        told = [*self._camera.check(now_ns, heard), *self._onboard.check(now_ns, heard=heard, needed=self._steering.injecting)]
        if not begun:
            return told
        beside = self._asking.beside_gnss() and self._monitor.trusted
        text = "visloc: no fix near GNSS, searching the map" if beside else "visloc: searching the map, keep moving"
        return [*told, Notice(Severity.NOTICE, text, to_operator=True)]

    def _follow(self, now_ns: int) -> None:
        """Fixes that wait are held against the way in between."""
        lost = self._steering.mode is Mode.LOST
        if not lost:
            self._regaining.clear()
        state = self._tracker.at(now_ns) if lost or self._camera_in_question else None
        if state is not None:
            self._travel.velocity(now_ns, state.v_ned_mps[:2])

    @property
    def _camera_in_question(self) -> bool:
        """Whether GNSS moved unlike the camera before anything was recognised."""
        return not self._first.decided and ODOMETRY in self._monitor.verdict.reasons

    def on_frame(self, event: FrameRef, now_ns: int) -> list[Command]:
        """A frame lies in its slot."""
        if not self._camera.is_new(event):
            return []
        frame = self._onboard.on_frame(event)
        back = self._camera.on_frame(event.t_rx_ns, frame.t_ns)
        if back is None:
            return []
        self._queue.offer(frame)
        return [*back, *self.request(now_ns)]

    def request(self, now_ns: int) -> list[Command]:
        """Ask the worker the next question, where there is one."""
        trusted, velocity = self._monitor.trusted, self._tracker.velocity
        if velocity is not None:
            self._open.moving(velocity.t_ns, velocity.v_ned_mps[:2])
        asked = self._asking.next(now_ns, injecting=self._steering.injecting, gnss_trusted=trusted)
        for request in asked:
            told = self._onboard.asked_of_vehicle(request) if isinstance(request, LocaliseRequest) else request
            self._tracker.height.asked(told)
            if isinstance(told, LocaliseRequest):
                self._open.asked(told)
                self._onboard.zoom.asked(told, self._tracker.height_above_home_m or 0.0)
        return self._onboard.asked([*asked])

    def moved(self, motion: Odometry | None, now_ns: int, *, recognised: bool = True) -> None:
        """The camera's own motion bears on the velocity, and on the GNSS verdict; `recognised`: the frame that shows it was."""
        if motion is None or self._aiding.scaled:
            self._tracker.odometry_lost()
        elif fault(motion, now_ns) is None:
            doubted = not recognised and self._onboard.zoom.doubts(motion)
            interval = self._tracker.observe_odometry(motion, doubted=doubted)
            if interval is not None:
                self._onboard.zoom.moved(interval)
                self._aiding.on_motion(interval)
            self._travel.odometry(motion)  # for the open places, too
            if self._search is not None and not self._asking.beside_gnss():  # else by the ground where GNSS has the vehicle
                self._search.moved(motion)

    def on_answer(self, event: Fix | NoFix, now_ns: int) -> list[Command]:
        """The worker answered."""
        event = self._onboard.of_vehicle(event)
        before = self._tracker.rests
        self.moved(event.motion, now_ns, recognised=isinstance(event, Fix))
        told = [*self._camera.on_answer(event), *self._computer.on_answer(event), *self._learned(event)]
        return [*told, *self._localised(event, before, now_ns)]

    def _learned(self, event: Fix | NoFix) -> list[Command]:
        """What an answer tells of the camera; a mounting or lens that is wrong also takes back what it said against GNSS."""
        knew, knew_level = self._onboard.set_up_wrong, self._onboard.keeps_level
        doubted, retimed_s = self._lens_doubted, self._onboard.retimed_s
        told = self._onboard.on_answer(event)
        self._lens_doubted |= self._tracker.alike.lens_bend > 0
        if self._lens_doubted and not doubted:
            self._monitor.disown_camera(in_use=True)
        if self._onboard.retimed_s != retimed_s:
            self._tracker.retimed(self._onboard.retimed_s - retimed_s)
            self._aiding.retimed()
        if self._onboard.set_up_wrong and not knew:
            self._aiding.disown_camera()
            self._steering.doubt()
        if self._onboard.keeps_level and not knew_level:
            self._aiding.camera_changed(self._onboard.level_until_ns, in_use=False)
        if event.method == TERRAIN or self._onboard.keeps_level or self._onboard.set_up_wrong:
            return told
        speed_mps = 0.0 if self._tracker.velocity is None else math.hypot(*self._tracker.velocity.v_ned_mps[:2])
        told = [*told, *self._zoomed(self._onboard.zoom.answered(event, speed_mps))]
        return [*told, *self._onboard.ramp.check(event.t_ns)] if isinstance(event, NoFix) else told

    def _zoomed(self, told: list[Command]) -> list[Command]:
        """Where `told` says so, the lens is another one by now: what the camera showed lately went by the wrong one, the filter
        starts where frames are recognised through the right one, unless GNSS says where."""
        found = self._onboard.zoom.found
        if not told or found is None:
            return told
        self._onboard.ramp.found(found.t_ns)
        self._aiding.camera_changed(self._onboard.zoom.recognised_ns, in_use=True)
        self._nothing_open()
        self._regaining.clear()
        if not self._monitor.trusted:
            self._tracker.seed(found.t_ns, found.place, max(SEED_SIGMA_M, largest_sigma_m(found.cov_ne_m2)))
        return told

    def _localised(self, event: Fix | NoFix, before: Belief | None, now_ns: int) -> list[Command]:
        search, origin = self._search, self._tracker.origin
        if search is not None and origin is not None and search.is_asked(event.request_id):
            found = search.answered(event, origin, now_ns)
            if isinstance(event, Fix):
                self._asking.seen_on_map(now_ns)
            told = [] if found is None else self._on_found(found, search, origin, now_ns)
            return [*told, *self.free_worker(event, now_ns)]
        if isinstance(event, Fix):
            return self._on_fix(event, before, now_ns)
        if event.method != TERRAIN:
            self._asking.refused(event, gnss_trusted=self._monitor.trusted)
        told = [*self._stated_off_map(event), *self._unmatched.on_refusal(event, now_ns)]
        return [*told, *self._on_open(event, now_ns), *self.free_worker(event, now_ns)]

    def _stated_off_map(self, event: NoFix) -> list[Command]:
        """Once: a frame taken after the operator's word shows that there is no map there, so nothing can confirm it."""
        since_ns = self._off_map_since_ns
        if self._to_confirm is None or since_ns is None or event.t_ns < since_ns:
            return []
        if event.reason is not Reason.OUTSIDE_MAP or event.method == TERRAIN:
            return []
        self._off_map_since_ns = None
        return [Notice(Severity.WARNING, "visloc: stated position is outside the map", to_operator=True)]

    def _on_open(self, event: NoFix, now_ns: int) -> list[Command]:
        """An answer that leaves several places open; the filter takes the one that earlier and later answers leave."""
        origin, velocity, had = self._tracker.origin, self._tracker.velocity, self.n_open
        if origin is None or velocity is None or self._tracker.belief is None:
            return []
        fix = self._open.answered(event, origin, velocity.sigma_mps)
        if fix is None:
            begun = self.n_open > 1 >= had
            return [Notice(Severity.INFO, f"{self.n_open} places are open")] if begun else []
        self._nothing_open()
        held, before = self._tracker.at(fix.t_ns), self._tracker.rests
        fix = self._onboard.stated(fix, held)
        outcome = self._tracker.observe(fix, self._onboard.mounting_rad)
        if isinstance(outcome, Rejected):
            return [*self._complaints.about(fix, outcome.reason, now_ns, Severity.INFO)]
        if not isinstance(outcome, Accepted):
            return []
        data = (("probability_wrong", fix.probability_wrong), *fix.evidence)
        told = Notice(Severity.INFO, "one of the open places is left", data=data)
        return [told, *self._taken(fix, now_ns, held, anew=self._began_anew(before))]

    def _on_found(self, found: Found, search: PlaceSearch, origin: GeoPoint, now_ns: int) -> list[Command]:
        """The search of the whole map has found the vehicle: the filter starts (again) there."""
        search.clear()
        self._nothing_open()
        self._to_confirm = None
        place = wgs84.geo_from_ned((*found.place_ne_m, 0.0), origin)
        if not self._tracker.seed(found.t_ns, place, found.sigma_m):
            return []
        self._aiding.placed()
        self._steering.taken(now_ns, anew=True)
        data = (("probability_wrong", found.probability_wrong), ("answers", float(found.hits)))
        return [Notice(Severity.WARNING, f"visloc: position found {self._where(place)}", to_operator=True, data=data)]

    def _where(self, place: GeoPoint) -> str:
        """In words, where a place lies that was found on the map."""
        newest = self._tracker.gnss.newest if self._monitor.trusted else None
        off_m = 0.0 if newest is None else wgs84.distance_m(newest, place)
        return "on the map" if off_m < BESIDE_GNSS_M else f"{off_m:.0f} m from GNSS"

    def free_worker(self, event: Event, now_ns: int) -> list[Command]:
        """After an answer, used or not: nothing is outstanding, and the next question may be asked; not of a worker that was lost
        with this one, whose end is told next."""
        if isinstance(event, Fix | NoFix):
            lost = isinstance(event, NoFix) and event.reason in WORKER_LOST
            self._queue.answered(event.request_id, isinstance(event, Fix), lost)
            if self._terrain is not None and isinstance(event, NoFix):
                self._terrain.answered(event)
            elif self._terrain is not None:
                self._terrain.abandoned(event.request_id)
            return [] if lost else self.request(now_ns)
        return []

    @property
    def _doubts(self) -> tuple[bool, bool, bool]:
        """Whether the lens is in doubt, a zoom followed, or where the camera looks in doubt."""
        return self._tracker.longer_share != 0, self._onboard.ramp.following, self._tracker.alike.aim_open != 0

    def _on_fix(self, fix: Fix, before: Belief | None, now_ns: int) -> list[Command]:
        if self._terrain is not None and fix.method == TERRAIN and self._terrain.answered(fix) is None:
            waits = Notice(Severity.INFO, "a fix of the terrain from far off waits for a second one")
            return [waits, *self.free_worker(fix, now_ns)]
        if self._without.looks:
            return [*self._without.on_fix(self._onboard.stated(fix, None), now_ns), *self.free_worker(fix, now_ns)]
        self._without.recognised(now_ns)
        state = self._tracker.at(fix.t_ns)
        fix = self._onboard.stated(fix, state)
        why = None if fix.method == TERRAIN else self._why_waits(fix, state)
        if why is not None:
            return [*why, *self.free_worker(fix, now_ns)]
        outcome = self._tracker.observe(fix, self._onboard.mounting_rad)
        anew, origin = self._began_anew(before), self._tracker.origin
        if self._terrain is not None and fix.method == TERRAIN and isinstance(outcome, Accepted) and state and origin:
            self._terrain.learn(fix, state, origin)
        taken, trusted = isinstance(outcome, Accepted), self._monitor.trusted
        doubted, aimed = self._doubts, self._onboard.aimed
        commands = [] if fix.method == TERRAIN else self._onboard.on_fix(fix, taken=taken, gnss_trusted=trusted)
        if any(now and not before for now, before in zip(self._doubts, doubted, strict=True)):
            self._monitor.disown_camera(in_use=True)
        if self._onboard.aimed and not aimed:
            self._aiding.reaimed()
            return [*commands, *self.free_worker(fix, now_ns)]
        if isinstance(outcome, Accepted):
            commands = [*commands, *self._taken(fix, now_ns, state, anew=anew)]
            velocity = self._tracker.velocity
            if not self._onboard.ramp.following:
                self._tracker.height.taken(fix, (0.0, 0.0) if velocity is None else velocity.v_ned_mps[:2])
            if anew:
                commands.append(Notice(Severity.WARNING, "visloc: relocalised", to_operator=True))
        elif isinstance(outcome, Rejected):
            if outcome.reason is Reason.GATED:
                self._aiding.refused(fix)
            commands += self._complaints.about(fix, outcome.reason, now_ns, Severity.INFO)
        else:
            reason = Reason.NOT_SEEDED if outcome is None else Reason.TOO_OLD
            commands += self._complaints.about(fix, reason, now_ns, Severity.INFO)
        return [*commands, *self.free_worker(fix, now_ns)]

    def _why_waits(self, fix: Fix, state: NavState | None) -> list[Command] | None:
        """What is to be said of a fix that waits for others, given the filter's state at its time; None where it does not."""
        origin = self._tracker.origin
        if state is None or origin is None:
            return None
        if self._camera_in_question:
            beside_ne_m = self._tracker.gnss.minus(fix, state.v_ned_mps)
            if self._first.waits(fix, beside_ne_m, -state.p_ned_m[2]):
                return [Notice(Severity.INFO, "a first fix waits: GNSS or camera, who is wrong is open")]
        stated, shared_m = self._to_confirm is not None, self._tracker.shared_m
        if not self._steering.would_end_loss(state, stated=stated, shared_m=shared_m):
            waits = not self._camera.rare and self._second.waits(fix, state, origin)
            return [Notice(Severity.INFO, "a fix that may be wrong, from far off, waits for a second one")] if waits else None
        begun = not self._regaining.waiting
        if not self._regaining.waits(fix, state, origin, self._max_search_radius_m):
            return None
        if begun:
            return [Notice(Severity.NOTICE, "visloc: a place is seen, fly on to confirm it", to_operator=True)]
        return [Notice(Severity.INFO, "a fix after a loss waits for others over other ground")]

    def _began_anew(self, before: Belief | None) -> bool:
        """Whether a fix made the filter start again."""
        after = self._tracker.rests
        return before is not None and after is not None and after.started_ns != before.started_ns

    def _taken(self, fix: Fix, now_ns: int, held: NavState | None, *, anew: bool) -> list[Command]:
        """The filter, which had the vehicle at `held` then, took a fix or began `anew` there: no place is open any more, and GNSS
        is compared with it."""
        self._nothing_open()
        self._unmatched.recognised()
        self._first.taken()
        self._steering.taken(now_ns, anew=anew)
        return [*self._aiding.compare(fix, held, delay_told=self._onboard.mistimed), *self._confirmed(fix, held, anew)]

    def _confirmed(self, fix: Fix, held: NavState | None, anew: bool) -> list[Command]:
        said, self._to_confirm = self._to_confirm, None
        if said is None or (anew and operator_word.elsewhere(said, fix, held, self._tracker.origin)):
            return []
        return [Notice(Severity.NOTICE, "visloc: operator's position confirmed", to_operator=True)]

    def on_operator(self, event: OperatorFix, t_boot_ns: int, now_ns: int) -> list[Command]:
        """The operator says where the vehicle is; `t_boot_ns`: now, on the autopilot's clock."""
        tracker, trusted = self._tracker, self._monitor.trusted and not self._without.unplaced
        held = tracker.at(now_ns) if trusted or self._steering.believed else None
        receiver = tracker.gnss.newest if trusted else None
        reason = operator_word.objection(event, tracker.origin, receiver, held)
        if reason is not None:
            return [Notice(Severity.WARNING, f"visloc: position refused, {reason}", to_operator=True)]
        if held is not None:
            return [Notice(Severity.NOTICE, "visloc: position agrees, nothing changed", to_operator=True)]
        if tracker.velocity is None:
            tracker.seed_without_velocity(now_ns, t_boot_ns, event.place, event.sigma_m)
        else:
            tracker.seed(now_ns, event.place, event.sigma_m)
        self._nothing_open()
        self._regaining.clear()
        if self._search is not None:
            self._search.clear()
        self._steering.doubt()
        self._to_confirm, self._off_map_since_ns = event, now_ns
        return [Notice(Severity.NOTICE, "visloc: position taken, looking there", to_operator=True)]
