"""The navigator: every event goes in here, every command comes out. No I/O, no clock, no waiting; same events, same bytes.

Trust runs one way. The filter is seeded once from the autopilot's position while GNSS is trusted; from then on the prior of
every localisation is the filter's own state, so a spoofed autopilot cannot drag the search away. What GNSS may still do is in
core/gnss_aiding.py. Nothing is injected before a first fix (or the operator's position) has anchored the filter. Distances
to the ground: core/terrain_aiding.py; the camera's own motion: core/motion.py. Baro bears on the GNSS verdict only.
"""

from __future__ import annotations

from dataclasses import replace

from visloc_companion.core import gnss_words, modes, output, requests, streams
from visloc_companion.core.asking import Asking
from visloc_companion.core.attitude import AttitudeBuffer
from visloc_companion.core.camera_watch import CameraWatch
from visloc_companion.core.estimator import Velocity
from visloc_companion.core.fusion import UNAIDED_SIGMA_MPS
from visloc_companion.core.gnss import GnssMonitor
from visloc_companion.core.gnss_aiding import GnssAiding
from visloc_companion.core.guard import Complaints, TimeCheck, TimeGuard
from visloc_companion.core.integrity import largest_sigma_m
from visloc_companion.core.settings import CoreSettings
from visloc_companion.core.switching import SourceSwitch
from visloc_companion.core.terrain_aiding import METHOD as TERRAIN
from visloc_companion.core.terrain_aiding import TerrainAiding
from visloc_companion.core.timesync import ClockOffset, ClockStep
from visloc_companion.core.tracking import Tracker
from visloc_companion.core.turns import Turns
from visloc_companion.core.validate import fault
from visloc_companion.errors import Reason
from visloc_companion.types import (
    Accepted,
    Attitude,
    Baro,
    Command,
    EkfSource,
    EstimatorStatus,
    Event,
    Fix,
    FrameRef,
    GeoPoint,
    Gnss,
    GnssIntegrity,
    GnssTime,
    Injection,
    LinkChanged,
    LocalPose,
    MapAtGnss,
    Mode,
    NavState,
    NoFix,
    Notice,
    Odometry,
    OperatorFix,
    OriginChanged,
    PriorPose,
    Range,
    Rejected,
    Severity,
    SourceSwitched,
    Tick,
    TimesyncSample,
    Vec3,
    Verdict,
    WorkerState,
)

INJECTING = (Mode.AIDING, Mode.DEAD_RECKONING)
WORKER_LOST = (Reason.WORKER_TIMEOUT, Reason.WORKER_DIED)
ATTITUDE_AGE_NS = 2_000_000_000
ORIGIN_RETRY_NS = 5_000_000_000
MAX_STAMP_ERROR_NS = 1_000_000_000
"""A message's own time is used when it differs from its arrival by no more than this."""


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
        self._attitude_rx_ns: int | None = None
        self._tracker = Tracker(settings.navigator)
        self._monitor = GnssMonitor(settings.gnss)
        self._aiding = GnssAiding(settings, self._tracker, self._monitor)
        self._queue = requests.FrameQueue(
            settings.max_rate_hz, settings.seed, Turns(settings.structure, settings.structure_every)
        )
        self._terrain = TerrainAiding() if settings.terrain else None
        self._asking = Asking(settings, self._queue, self._tracker, self._clock, self._attitude, self._terrain)
        self._switch = SourceSwitch(settings.injection.switch_source)
        self._resets = output.ResetCounter(settings.injection.max_step_m)
        self._mode = Mode.WAITING
        self._link = LinkChanged(0, up=True)
        self._anchored = False
        self._fix_taken_ns: int | None = None
        self._status: EstimatorStatus | None = None
        self._prior: PriorPose | None = None
        self._camera = CameraWatch()
        self._origin_asked_ns: int | None = None

    def on(self, event: Event, now_ns: int) -> list[Command]:
        """Take one event at the shell's monotonic time; return what is to be done, in order."""
        check = self._time.check(now_ns)
        if check is TimeCheck.RESTART:
            self._restart()
            self._time.check(now_ns)
            return [Notice(Severity.CRITICAL, "visloc: clock went back, starting anew", to_operator=True)]
        if check is TimeCheck.DROP:
            last_ns = now_ns if self._time.now_ns is None else self._time.now_ns
            return [*self._complaints.about(event, Reason.IMPLAUSIBLE_TIME, last_ns)]
        now_ns = now_ns if self._time.now_ns is None else self._time.now_ns
        reason = fault(event, now_ns)
        if reason is not None:
            return [*self._complaints.about(event, reason, now_ns), *self._free_worker(event, now_ns)]
        return self._dispatch(event, now_ns)

    def _dispatch(self, event: Event, now_ns: int) -> list[Command]:  # noqa: PLR0911, PLR0912 (the table of events)
        match event:
            case Tick():
                return self._on_tick(now_ns)
            case Attitude():
                return self._on_attitude(event, now_ns)
            case PriorPose():
                return self._on_prior(event)
            case LocalPose():
                return self._on_local(event)
            case Gnss():
                return self._aiding.on_gnss(event, self._stamped_ns(event.t_rx_ns, event.t_boot_ns), self._mode)
            case EstimatorStatus():
                self._status = event
                self._monitor.on_evidence(event)
                return []
            case GnssIntegrity() | GnssTime() | MapAtGnss() | Baro():
                self._monitor.on_evidence(event)
                return []
            case Odometry():
                self._moved(event, now_ns)
                return []
            case Range():
                return self._on_range(event)
            case FrameRef():
                return self._on_frame(event, now_ns)
            case Fix():
                self._moved(event.motion, now_ns)
                return self._on_fix(event, now_ns)
            case NoFix():
                self._moved(event.motion, now_ns)
                return self._free_worker(event, now_ns)
            case TimesyncSample():
                return self._on_step(self._clock.on_exchange(event))
            case OriginChanged():
                return self._on_origin(event)
            case LinkChanged():
                return self._on_link(event, now_ns)
            case OperatorFix():
                return self._on_operator(event, now_ns)
            case SourceSwitched():
                return self._switch.confirmed(event, now_ns)
            case WorkerState():
                self._queue.worker(event.up)
                if self._terrain is not None:
                    self._terrain.abandoned()
                return self._request(now_ns)

    # -------------------------------------------------------------------------------------------- what the autopilot says

    def _stamped_ns(self, t_rx_ns: int, t_boot_ns: int) -> int:
        t_ns = self._clock.shell_ns(t_boot_ns, t_rx_ns)
        return t_ns if abs(t_ns - t_rx_ns) <= MAX_STAMP_ERROR_NS else t_rx_ns

    def _on_step(self, step: ClockStep | None) -> list[Command]:
        if step is None:
            return []
        self._attitude.clear()
        self._tracker.forget_velocity()
        if self._terrain is not None:
            self._terrain.clear()
        self._switch.restarted()
        text = f"visloc: autopilot clock stepped {step.jump_ns * 1e-9:.1f} s"
        return [Notice(Severity.WARNING, text, to_operator=True)]

    def _on_attitude(self, event: Attitude, now_ns: int) -> list[Command]:
        commands = self._on_step(self._clock.on_arrival(event.t_rx_ns, event.t_boot_ns))
        reason = self._attitude.add(event.t_boot_ns, event.q_ned_frd, event.rate_frd_radps)
        if reason is not None:
            return [*commands, *self._complaints.about(event, reason, now_ns)]
        self._attitude_rx_ns = event.t_rx_ns
        self._monitor.on_telemetry(event.t_rx_ns)
        return commands

    def _on_prior(self, event: PriorPose) -> list[Command]:
        commands = self._on_step(self._clock.on_arrival(event.t_rx_ns, event.t_boot_ns))
        self._prior = event
        self._tracker.height_above_home_m = event.h_rel_m
        self._drive(event.t_rx_ns, event.t_boot_ns, event.v_ned_mps, event.place.h_amsl_m)
        return commands

    def _on_local(self, event: LocalPose) -> list[Command]:
        commands = self._on_step(self._clock.on_arrival(event.t_rx_ns, event.t_boot_ns))
        if self._tracker.origin is not None:
            self._drive(event.t_rx_ns, event.t_boot_ns, event.v_ned_mps, self._tracker.origin.h_amsl_m - event.p_ned_m[2])
        return commands

    def _drive(self, t_rx_ns: int, t_boot_ns: int, v_ned_mps: Vec3, h_amsl_m: float) -> None:
        feedback = self._mode in INJECTING or self._switch.source is EkfSource.VISION
        limits = self._settings.navigator
        sigma = limits.velocity_sigma_mps if self._monitor.trusted and not feedback else limits.velocity_sigma_aiding_mps
        if self._status is not None and not self._status.horizontal_position_ok:
            sigma = max(sigma, UNAIDED_SIGMA_MPS)
        t_ns = self._stamped_ns(t_rx_ns, t_boot_ns)
        if self._terrain is not None and feedback:
            v_ned_mps = self._terrain.corrected(t_ns, v_ned_mps)
        velocity = Velocity(t_ns, v_ned_mps, h_amsl_m, sigma, feedback)
        if self._tracker.drive(velocity) and self._terrain is not None:
            self._terrain.drive(velocity)

    def _on_range(self, event: Range) -> list[Command]:
        t_ns = self._stamped_ns(event.t_rx_ns, event.t_boot_ns)
        q_ned_frd = self._asking.attitude_now(t_ns)
        if self._terrain is not None and q_ned_frd is not None:
            self._terrain.on_range(event, t_ns, q_ned_frd)
        return []

    def _on_origin(self, event: OriginChanged) -> list[Command]:
        if self._tracker.set_origin(event.origin):
            self._resets.bump()
            return [Notice(Severity.NOTICE, "visloc: EKF origin moved")]
        return []

    def _on_link(self, event: LinkChanged, now_ns: int) -> list[Command]:
        self._link = event
        self._monitor.on_vehicle(event.armed, event.autopilot)
        if not event.up:
            return [Notice(Severity.WARNING, "autopilot link lost")]
        self._origin_asked_ns = now_ns
        return streams.requests_for(event.autopilot, self._settings)

    # -------------------------------------------------------------------------------------------------- frames and fixes

    def _on_frame(self, event: FrameRef, now_ns: int) -> list[Command]:
        back = self._camera.on_frame(event.t_rx_ns)
        if event.t_boot_ns is not None:
            event = replace(event, t_ns=self._clock.shell_ns(event.t_boot_ns, event.t_ns))
        self._queue.offer(event)
        return [*back, *self._request(now_ns)]

    def _request(self, now_ns: int) -> list[Command]:
        return self._asking.next(now_ns, injecting=self._mode in INJECTING, gnss_trusted=self._monitor.trusted)

    def _moved(self, motion: Odometry | None, now_ns: int) -> None:
        """The camera's own motion bears on the velocity, and on the GNSS verdict."""
        if motion is not None and fault(motion, now_ns) is None:
            self._aiding.on_odometry(motion)
            self._tracker.observe_odometry(motion)

    def _free_worker(self, event: Event, now_ns: int) -> list[Command]:
        if isinstance(event, Fix | NoFix):
            lost = isinstance(event, NoFix) and event.reason in WORKER_LOST
            self._queue.answered(event.request_id, isinstance(event, Fix), lost)
            if self._terrain is not None and isinstance(event, NoFix):
                self._terrain.answered(event)
            elif self._terrain is not None:
                self._terrain.abandoned(event.request_id)
            return self._request(now_ns)
        return []

    def _on_fix(self, fix: Fix, now_ns: int) -> list[Command]:
        if self._terrain is not None and fix.method == TERRAIN and self._terrain.answered(fix) is None:
            waits = Notice(Severity.INFO, "a fix of the terrain from far off waits for a second one")
            return [waits, *self._free_worker(fix, now_ns)]
        before, state = self._tracker.belief, self._tracker.at(fix.t_ns)
        outcome = self._tracker.observe(fix)
        after = self._tracker.belief
        origin = self._tracker.origin
        if self._terrain is not None and fix.method == TERRAIN and isinstance(outcome, Accepted) and state and origin:
            self._terrain.learn(fix, state, origin)
        commands: list[Command] = []
        if isinstance(outcome, Accepted):
            self._anchored, self._fix_taken_ns = True, now_ns
            self._aiding.compare(fix)
            if before is not None and after is not None and after.started_ns != before.started_ns:
                commands.append(Notice(Severity.WARNING, "visloc: relocalised", to_operator=True))
        elif isinstance(outcome, Rejected):
            commands += self._complaints.about(fix, outcome.reason, now_ns, Severity.INFO)
        else:
            reason = Reason.NOT_SEEDED if outcome is None else Reason.TOO_OLD
            commands += self._complaints.about(fix, reason, now_ns, Severity.INFO)
        return [*commands, *self._free_worker(fix, now_ns)]

    def _on_operator(self, event: OperatorFix, now_ns: int) -> list[Command]:
        reason = self._tracker.implausible(event.place, event.sigma_m, self._monitor.trusted)
        if reason is not None:
            return [Notice(Severity.WARNING, f"visloc: position refused, {reason}", to_operator=True)]
        if self._tracker.velocity is None:
            self._tracker.seed_without_velocity(now_ns, event.place, event.sigma_m)
        self._tracker.seed(now_ns, event.place, event.sigma_m)
        self._anchored = True
        return [Notice(Severity.NOTICE, "visloc: position set by operator", to_operator=True)]

    # ---------------------------------------------------------------------------------------------------------- the Tick

    def _on_tick(self, now_ns: int) -> list[Command]:
        commands = [*self._judge_gnss(now_ns), *self._watch(now_ns), *self._seed(now_ns)]
        state = self._tracker.at(now_ns)
        commands += self._change_mode(state, now_ns)
        commands = gnss_words.two_at_most([*commands, *self._steer_source(now_ns)])
        commands += self._request(now_ns)
        return [*commands, *self._output(state, now_ns)]

    def _judge_gnss(self, now_ns: int) -> list[Command]:
        before = self._monitor.verdict.verdict
        verdict = self._monitor.update(now_ns, self._switch.source)
        if verdict.verdict is before:
            return []
        return [gnss_words.notice(verdict, self._monitor.ever_trusted)]

    def _watch(self, now_ns: int) -> list[Command]:
        """A camera that went silent, and an origin that has not come."""
        commands = self._camera.check(now_ns)
        asked = self._origin_asked_ns
        if self._tracker.origin is None and self._link.up and asked is not None and now_ns - asked >= ORIGIN_RETRY_NS:
            self._origin_asked_ns = now_ns
            commands.append(streams.ORIGIN_REQUEST)
        return commands

    def _seed(self, now_ns: int) -> list[Command]:
        prior, velocity = self._prior, self._tracker.velocity
        if self._tracker.belief is not None or prior is None or velocity is None or not self._monitor.trusted:
            return []
        if now_ns - prior.t_rx_ns > MAX_STAMP_ERROR_NS:
            return []
        t_ns = self._stamped_ns(prior.t_rx_ns, prior.t_boot_ns)
        if not self._tracker.seed(t_ns, prior.place, self._settings.navigator.seed_sigma_m):
            return []
        return [Notice(Severity.INFO, "filter seeded from the autopilot's position")]

    def _change_mode(self, state: NavState | None, now_ns: int) -> list[Command]:
        limits = self._settings.navigator
        seen = self._attitude_rx_ns
        attitude = seen is not None and now_ns - seen <= ATTITUDE_AGE_NS
        taken_ns = self._fix_taken_ns  # by arrival: a slow localiser must not make the mode flap
        situation = modes.Situation(
            ready=self._link.up and attitude and state is not None,
            due=self._anchored and output.is_due(self._settings.injection.policy, self._monitor.verdict.verdict),
            recent_fix=taken_ns is not None and now_ns - taken_ns <= limits.dead_reckoning_after_s * 1e9,
            sigma_m=0.0 if state is None else largest_sigma_m(state.cov_ne_m2),
            lost_sigma_m=limits.lost_sigma_m,
        )
        before, self._mode = self._mode, modes.next_mode(self._mode, situation)
        if self._mode is before:
            return []
        severity = Severity.CRITICAL if self._mode is Mode.LOST else Severity.NOTICE
        data = (("from", before.value), ("sigma_m", situation.sigma_m))
        return [Notice(severity, f"visloc: {self._mode.value.upper()}", to_operator=True, data=data)]

    def _steer_source(self, now_ns: int) -> list[Command]:
        if self._monitor.verdict.verdict is Verdict.OK:
            proven = self._switch.known or self._gnss_proven(now_ns)
            return self._switch.want(EkfSource.GNSS, now_ns) if proven else []
        return self._switch.want(EkfSource.VISION, now_ns) if self._mode in INJECTING else []

    def _gnss_proven(self, now_ns: int) -> bool:
        """Whether GNSS may take over from a source that nobody confirmed: on the ground at once, in flight (we may have been
        restarted amid a spoofing) only after fixes have gone with it for the probation."""
        taken_ns = self._fix_taken_ns
        if not self._link.armed:
            return True
        recent = taken_ns is not None and now_ns - taken_ns <= self._settings.navigator.dead_reckoning_after_s * 1e9
        return recent and now_ns - self._monitor.verdict.since_ns >= self._settings.gnss.probation_s * 1e9

    def _output(self, state: NavState | None, now_ns: int) -> list[Command]:
        belief, origin = self._tracker.belief, self._tracker.origin
        verdict = self._monitor.verdict
        if state is None or belief is None or origin is None:
            return [output.empty_status(now_ns, self._mode, verdict, self._resets.count)]
        counter = self._resets.follow(state, belief.started_ns)
        injected = self._injection(state, origin, counter, now_ns) if self._mode in INJECTING else None
        level_m = self._tracker.protection_level_m(state.t_ns)
        status = output.status(state, belief.last_fix_ns, level_m, origin, self._mode, verdict, counter, injected is not None)
        return [status] if injected is None else [injected, status]

    def _injection(self, state: NavState, origin: GeoPoint, counter: int, now_ns: int) -> Injection | None:
        q_ned_frd = self._asking.attitude_now(now_ns)
        if q_ned_frd is None:
            return None
        sigma_d = requests.height_sigma_m(self._tracker.height_above_home_m or 0.0)
        return output.injection(state, q_ned_frd, origin, self._link.autopilot, self._settings.injection, counter, sigma_d)
