"""The navigator: every event goes in here, every command comes out. No I/O, no clock, no waiting; same events, same bytes.

Trust runs one way. The filter is seeded once from the autopilot's position while GNSS is trusted; from then on the prior of every
localisation is the filter's own state, so a spoofed autopilot cannot drag the search away. What GNSS may still do is in
core/gnss_aiding.py. Nothing is injected before a first fix has anchored the filter. Without a first position, and when it is lost
for long, the whole map is searched (core/places/place_search.py). Distances to the ground: core/terrain/terrain_aiding.py; the
camera's own motion: core/filter/motion.py; accelerations: core/velocity/inertial.py.
"""

from __future__ import annotations

from typing import assert_never

from visloc_companion.core import requests, streams
from visloc_companion.core.asking import Asking
from visloc_companion.core.attitude import AttitudeBuffer
from visloc_companion.core.camera.gimbal import Gimbal
from visloc_companion.core.camera.onboard_camera import OnboardCamera
from visloc_companion.core.gnss import ODOMETRY, GnssMonitor
from visloc_companion.core.gnss_aiding import GnssAiding
from visloc_companion.core.guard import Complaints, TimeCheck, TimeGuard
from visloc_companion.core.places.place_search import PlaceSearch
from visloc_companion.core.protection import Protection
from visloc_companion.core.satellites import gnss_words
from visloc_companion.core.sending import Sending
from visloc_companion.core.settings import CoreSettings
from visloc_companion.core.source.steering import Steering
from visloc_companion.core.source.switching import SourceSwitch
from visloc_companion.core.telemetry import Telemetry
from visloc_companion.core.terrain.terrain_aiding import TerrainAiding
from visloc_companion.core.timesync import ClockOffset
from visloc_companion.core.tracking import Tracker
from visloc_companion.core.turns import Turns
from visloc_companion.core.validate import fault
from visloc_companion.core.vision import Vision
from visloc_companion.core.without_position import WithoutPosition
from visloc_companion.errors import Reason
from visloc_companion.geo import wgs84
from visloc_companion.types import (
    Attitude,
    Baro,
    Command,
    EstimatorStatus,
    Event,
    Fix,
    FoundOnVision,
    FrameRef,
    GimbalAttitude,
    Gnss,
    GnssIntegrity,
    GnssTime,
    Imu,
    InjectionPolicy,
    LinkChanged,
    LocalPose,
    MapAtGnss,
    NoFix,
    Notice,
    Odometry,
    OperatorFix,
    OriginChanged,
    PriorPose,
    Range,
    Severity,
    SourceSwitched,
    Tick,
    TimesyncSample,
    Verdict,
    WorkerState,
)

ORIGIN_RETRY_NS = 5_000_000_000


class Navigator:
    """The pure navigation core (protocols.NavigatorLike)."""

    def __init__(self, settings: CoreSettings) -> None:
        self._settings = settings
        self._complaints = Complaints()
        self._restart()

    def _restart(self) -> None:
        settings = self._settings
        self._time = TimeGuard()
        self._clock = ClockOffset()
        self._attitude = AttitudeBuffer()
        self._tracker = Tracker(settings.navigator, settings.injection.max_step_m)
        self._monitor = GnssMonitor(settings.gnss)
        self._aiding = GnssAiding(settings, self._tracker, self._monitor)
        self._without = WithoutPosition(self._tracker, self._monitor, self._aiding)
        self._queue = requests.FrameQueue(
            settings.max_rate_hz, settings.seed, Turns(settings.structure, settings.structure_every)
        )
        self._terrain = TerrainAiding() if settings.terrain else None
        self._search = PlaceSearch(settings.max_search_radius_m) if settings.navigator.start_anywhere else None
        gimbal = None if settings.gimbal is None else Gimbal(settings.gimbal, self._clock, self._attitude)
        self._onboard = onboard = OnboardCamera(
            settings.q_frd_cambody,
            settings.mount_sigma_rad,
            settings.lever_frd_m,
            self._clock,
            self._attitude,
            self._tracker,
            gimbal,
        )
        self._asking = Asking(
            settings,
            self._queue,
            self._tracker,
            self._clock,
            self._attitude,
            onboard,
            self._terrain,
            self._search,
            self._without,
        )
        self._switch = SourceSwitch(settings.injection.switch_source)
        self._protection = Protection(settings, self._tracker)
        self._telemetry = Telemetry(
            settings.navigator,
            self._clock,
            self._attitude,
            self._tracker,
            self._monitor,
            self._switch,
            self._asking,
            self._terrain,
            self._complaints,
            gimbal,
        )
        self._steering = Steering(settings, self._monitor, self._switch)
        self._sending = Sending(settings.injection, self._tracker, self._asking, settings.navigator.output_rate_hz)
        self._link = LinkChanged(0, up=True)
        self._vision = Vision(
            self._queue,
            self._asking,
            onboard,
            self._tracker,
            self._aiding,
            self._without,
            self._monitor,
            self._steering,
            self._terrain,
            self._search,
            self._complaints,
            settings.max_probability_wrong,
            settings.max_search_radius_m,
            settings.has_camera,
        )
        self._origin_asked_ns: int | None = None
        self._origin_told = False

    def _start_anew(self, now_ns: int) -> list[Command]:
        """Nothing that is remembered has a time any more; who is on the link, its origin and that it may fly on vision have none,
        and are not told again."""
        link, origin, told, heard = self._link, self._tracker.origin, self._origin_told, self._origin_asked_ns is not None
        last_ns, counter = self._time.now_ns or 0, self._sending.reset_counter
        on_vision = link.armed and (self._steering.injecting or self._switch.leaving_vision(last_ns))
        self._restart()
        self._time.check(now_ns)
        if heard:
            self._link, self._origin_asked_ns = link, now_ns
            self._monitor.on_vehicle(link.armed, link.autopilot)
        if origin is not None:
            self._tracker.set_origin(origin)
            self._origin_told = told
        if on_vision:
            self._begin_on_vision(counter)
        return [Notice(Severity.CRITICAL, "visloc: clock went back, starting anew", to_operator=True)]

    def on(self, event: Event, now_ns: int) -> list[Command]:
        """Take one event at the shell's monotonic time; return what is to be done, in order."""
        check = self._time.check(now_ns)
        if check is TimeCheck.RESTART:
            return self._start_anew(now_ns)
        if check is TimeCheck.DROP:
            last_ns = now_ns if self._time.now_ns is None else self._time.now_ns
            return [*self._complaints.about(event, Reason.IMPLAUSIBLE_TIME, last_ns)]
        now_ns = now_ns if self._time.now_ns is None else self._time.now_ns
        if check is TimeCheck.BEHIND and isinstance(event, Tick | FrameRef):
            return []
        if check is TimeCheck.FINE and (stood_ns := self._time.stood_ns()):
            self._tracker.stood(now_ns, stood_ns)
            self._sending.jumped()
            self._vision.stood()
        reason = fault(event, now_ns)
        if reason is not None:
            return [*self._complaints.about(event, reason, now_ns), *self._vision.free_worker(event, now_ns)]
        return self._dispatch(event, now_ns)

    def _dispatch(self, event: Event, now_ns: int) -> list[Command]:  # noqa: PLR0911, PLR0912 (the table of events)
        match event:
            case Tick():
                return self._on_tick(now_ns)
            case Attitude():
                return self._telemetry.on_attitude(event, now_ns)
            case GimbalAttitude():
                self._onboard.on_gimbal(event, now_ns)
                return []
            case PriorPose():
                self._without.on_prior(event)
                return self._telemetry.on_prior(event, self._steering.feedback)
            case LocalPose():
                return self._telemetry.on_local(event, self._steering.feedback)
            case Gnss():
                t_ns = self._telemetry.stamped_ns(event.t_rx_ns, event.t_boot_ns)
                told = self._aiding.on_gnss(event, t_ns, self._steering.mode, holds=not self._without.unplaced)
                if self._aiding.began_anew:
                    self._steering.doubt()
                return told
            case EstimatorStatus():
                self._telemetry.on_status(event)
                self._without.on_status(event)
                self._switch.hear(event, now_ns)
                return []
            case Imu():
                self._telemetry.on_imu(event)
                return []
            case Baro():
                self._monitor.on_evidence(event)
                self._telemetry.on_baro(event)
                return []
            case GnssIntegrity() | GnssTime() | MapAtGnss():
                self._monitor.on_evidence(event)
                return []
            case Odometry():
                self._vision.moved(event, now_ns)
                return []
            case Range():
                self._telemetry.on_range(event)
                return []
            case FrameRef():
                return self._vision.on_frame(event, now_ns)
            case Fix() | NoFix():
                return self._vision.on_answer(event, now_ns)
            case TimesyncSample():
                return self._on_exchange(event, now_ns)
            case OriginChanged():
                return self._on_origin(event)
            case LinkChanged():
                return self._on_link(event, now_ns)
            case OperatorFix():
                return self._on_operator(event, now_ns)
            case SourceSwitched():
                return self._switch.confirmed(event, now_ns)
            case FoundOnVision():
                return self._on_found(event)
            case WorkerState():
                self._queue.worker(event.up)
                if self._terrain is not None:
                    self._terrain.abandoned()
                return self._vision.request(now_ns)
            case _:
                assert_never(event)

    # ------------------------------------------------------------------------------------------- the link and its origin

    def _on_exchange(self, event: TimesyncSample, now_ns: int) -> list[Command]:
        step = self._clock.on_exchange(event)
        since_ns = None if step is None else self._time.leapt_since_ns(step.jump_ns)
        if step is not None and since_ns is not None:
            self._tracker.leapt(now_ns, step.jump_ns, since_ns)
            self._sending.jumped()
            self._vision.stood()
        return self._telemetry.on_step(step, own=since_ns is not None)

    def _on_origin(self, event: OriginChanged) -> list[Command]:
        self._origin_told = True
        if self._search is not None and not wgs84.same_spot(event.origin, self._tracker.origin):
            self._search.clear()
        if self._tracker.set_origin(event.origin):
            self._sending.jumped()
            return [Notice(Severity.NOTICE, "visloc: EKF origin moved")]
        return []

    def _on_link(self, event: LinkChanged, now_ns: int) -> list[Command]:
        self._link = event
        self._monitor.on_vehicle(event.armed, event.autopilot)
        if not event.up:
            self._origin_told = False  # an autopilot that was restarted has another one, or none
            return [Notice(Severity.WARNING, "autopilot link lost")]
        self._origin_asked_ns = now_ns
        return streams.requests_for(event.autopilot, self._settings)

    def _on_operator(self, event: OperatorFix, now_ns: int) -> list[Command]:
        went_on, before = self._aiding.goes_on, self._tracker.at(now_ns)
        told = self._vision.on_operator(event, self._clock.boot_ns(now_ns) or 0, now_ns)
        if went_on:
            self._aiding.gone_on()  # his word frees no GNSS that lies elsewhere, too
            self._without.word_replaced(before, now_ns)
        return told

    def _on_found(self, event: FoundOnVision) -> list[Command]:
        if self._settings.injection.policy is InjectionPolicy.NEVER:
            return []
        self._begin_on_vision(event.reset_counter)
        return [Notice(Severity.NOTICE, "visloc: restarted, EKF may be on VISION", to_operator=True)]

    def _begin_on_vision(self, reset_counter: int) -> None:
        self._switch.found_on_vision()
        self._telemetry.found_flying()
        self._sending.begin_beside(reset_counter)

    # ---------------------------------------------------------------------------------------------------------- the Tick

    def _on_tick(self, now_ns: int) -> list[Command]:
        commands = [*self._judge_gnss(now_ns), *self._watch(now_ns)]
        if not self._without.looks:
            commands += self._seed(now_ns)
        state = self._tracker.at(now_ns)
        heard = self._link.up and self._origin_told and self._telemetry.attitude_fresh(now_ns)
        ready = heard and state is not None
        commands += self._steering.change_mode(state, ready, self._tracker.low, self._link.armed, now_ns, self._tracker.shared_m)
        protected = self._protection.judge(state, now_ns)
        steered = self._steer(protected.stopped, now_ns) if self._link.up else []
        commands = gnss_words.two_at_most([*commands, *steered])
        mode, injecting = self._steering.mode, self._steering.injecting
        relied_on = injecting and self._link.armed
        commands += self._protection.notices(relied_on=relied_on, room=gnss_words.has_room(commands))
        commands += self._vision.request(now_ns)
        verdict, autopilot, n_open = self._monitor.verdict, self._link.autopilot, self._vision.n_open
        sent = self._sending.tick(state, protected, mode, injecting, verdict, autopilot, n_open, now_ns)
        return [*commands, *sent]

    def _seed(self, now_ns: int) -> list[Command]:
        seeded = self._telemetry.seed(now_ns, self._settings.navigator.seed_sigma_m)
        if seeded and self._telemetry.goes_on:
            self._aiding.gone_on()
        return seeded

    def _steer(self, stopped: bool, now_ns: int) -> list[Command]:
        only_gnss = self._without.only_gnss(now_ns)
        return self._steering.steer_source(self._link.armed, stopped, now_ns, only_gnss=only_gnss)

    def _judge_gnss(self, now_ns: int) -> list[Command]:
        before = self._monitor.verdict.verdict
        self._monitor.on_height(low=self._tracker.low)
        verdict = self._monitor.update(now_ns, self._switch.judged_source(now_ns))
        self._aiding.judged(now_ns)
        if verdict.verdict is before:
            return []
        told: list[Command] = [gnss_words.notice(verdict, self._monitor.ever_trusted)]
        belief = self._tracker.rests
        alone = verdict.verdict is Verdict.SUSPECT and verdict.reasons[0] == ODOMETRY
        if alone and belief is not None and belief.last_fix_ns is None:
            told.append(Notice(Severity.NOTICE, gnss_words.OR_CAMERA, to_operator=True))
        return told

    def _watch(self, now_ns: int) -> list[Command]:
        """A camera that went silent, and an origin that has not come."""
        asked = self._origin_asked_ns
        heard = self._link.up and asked is not None
        commands = self._vision.check(now_ns, heard)
        if not self._origin_told and heard and asked is not None and now_ns - asked >= ORIGIN_RETRY_NS:
            self._origin_asked_ns = now_ns
            commands.append(streams.ORIGIN_REQUEST)
        return commands
