"""The mode that the navigator is in, and the position source that the autopilot is brought to: what follows from all the rest."""

from __future__ import annotations

from visloc_companion.core import modes, output
from visloc_companion.core.covariance import largest_sigma_m
from visloc_companion.core.gnss import PROBATION, GnssMonitor
from visloc_companion.core.satellites.gnss_trust import TRUSTED_BELOW
from visloc_companion.core.settings import CoreSettings
from visloc_companion.core.source.switching import SourceSwitch
from visloc_companion.types import Command, EkfSource, InjectionPolicy, Mode, NavState, Notice, Severity, Verdict

LOW_VELOCITY_SIGMA_MPS = 1.0
"""A vehicle too low for fixes gets no positions any more once the velocity that carries them may be off by more (1-sigma): it
would hold that velocity down to the ground. Without positions the autopilots level the vehicle instead."""
SERIES_GAP_NS, SERIES_LEAST = 10_000_000_000, 5
"""Fixes further apart do not bear each other out; and fewer have not told a false GNSS from a good one."""

UNSEEN_S = 40.0
"""So long nothing is recognised before an autopilot without a position is given to a GNSS that nobody has shown right: of 206
flights over aerial photos the search of the map found none later than after 30 s (docs/start-anywhere.md)."""
UNPROVEN = "visloc: NO POSITION but GNSS, which is NOT PROVEN"


class Steering:
    """Nothing is injected before a first fix has anchored the filter."""

    def __init__(self, settings: CoreSettings, monitor: GnssMonitor, switch: SourceSwitch) -> None:
        self._settings, self._monitor, self._switch = settings, monitor, switch
        self._anchored = False
        self._fix_taken_ns: int | None = None
        self._series_ns = self._series_n = 0
        self._stranded = self._put_down = self._told_unproven = False
        self.mode = Mode.WAITING

    @property
    def injecting(self) -> bool:
        """Whether positions are sent."""
        return self.mode in modes.INJECTING

    @property
    def feedback(self) -> bool:
        """Whether what the autopilot says of itself may rest on what it was sent."""
        return self.injecting or self._switch.found or self._switch.source is EkfSource.VISION

    def taken(self, now_ns: int, *, anew: bool) -> None:
        """A fix was accepted, or the filter began `anew` there; it counts by its arrival, for a slow localiser must not make the
        mode flap."""
        last_ns = self._fix_taken_ns
        if anew or last_ns is None or now_ns - last_ns > SERIES_GAP_NS:
            self._series_ns, self._series_n = now_ns, 0
        self._series_n += 1
        self._anchored, self._fix_taken_ns = True, now_ns
        self._stranded = self._put_down = False

    @property
    def believed(self) -> bool:
        """Whether the filter rests on fixes, and has not lost its way since; a vehicle that landed may have been carried away."""
        return self._anchored and not self._put_down and self.mode is not Mode.LOST

    def would_end_loss(self, state: NavState, *, stated: bool = False, shared_m: float = 0.0) -> bool:
        """Whether a fix that meets this state is what the way out of LOST hangs on; not where the operator `stated` the place
        well enough for a vehicle that is not lost. A link that is away, which makes LOST WAITING, ends no loss. `shared_m`: of
        the 1-sigma, what all fixes have in common."""
        sigma_m, lost_sigma_m = largest_sigma_m(state.cov_ne_m2), self._settings.navigator.lost_sigma_m
        if sigma_m > lost_sigma_m:
            return True
        return self.mode is Mode.LOST and not stated and not modes.recovered(sigma_m, lost_sigma_m, shared_m)

    def doubt(self) -> None:
        """The filter starts at a place that no fix has confirmed."""
        self._anchored, self._fix_taken_ns = False, None

    def change_mode(
        self, state: NavState | None, ready: bool, low: bool, armed: bool, now_ns: int, shared_m: float = 0.0
    ) -> list[Command]:
        """One step of the table of modes; `ready`: link, attitude and state are there; `low`: too low to be localised;
        `shared_m`: of the state's 1-sigma, what all fixes have in common.

        A vehicle that is low without fixes and not `armed` has landed: it needs no positions, which is nothing to warn of. It may
        have been carried elsewhere before it climbs again, so only a fix, or a GNSS that is trusted, tells where it took off.
        """
        limits = self._settings.navigator
        trusted = self._monitor.verdict.verdict is Verdict.OK
        self._put_down = not trusted and (self._put_down or (low and not armed))
        self._stranded = (low or self._put_down) and (self._stranded or self._may_drift(state, now_ns))
        landed = self._stranded and low and not armed
        situation = modes.Situation(
            ready=ready,
            due=self._anchored and self._is_due(now_ns) and not landed,
            recent_fix=self._fix_within(limits.dead_reckoning_after_s, now_ns),
            sigma_m=0.0 if state is None else largest_sigma_m(state.cov_ne_m2),
            lost_sigma_m=limits.lost_sigma_m,
            stranded=self._stranded and not landed,
            landed=landed,
            shared_m=shared_m,
        )
        before, self.mode = self.mode, modes.next_mode(self.mode, situation)
        if self.mode is before:
            return []
        severity = Severity.CRITICAL if self.mode is Mode.LOST else Severity.NOTICE
        data = (("from", before.value), ("sigma_m", situation.sigma_m))
        return [Notice(severity, f"visloc: {self.mode.value.upper()}", to_operator=True, data=data)]

    def _may_drift(self, state: NavState | None, now_ns: int) -> bool:
        """Whether a vehicle without fixes must not come down on this state; once so, until a fix."""
        if not self._fix_within(self._settings.navigator.low_dead_reckoning_s, now_ns):
            return True
        cov_v = None if state is None else state.cov_v_ne_m2ps2
        return cov_v is not None and largest_sigma_m(cov_v) > LOW_VELOCITY_SIGMA_MPS

    def _is_due(self, now_ns: int) -> bool:
        """By the policy; and on the way back to GNSS until the autopilot may use that."""
        policy = self._settings.injection.policy
        back = policy is not InjectionPolicy.NEVER and self._switch.leaving_vision(now_ns)
        return back or output.is_due(policy, self._monitor.verdict.verdict)

    def steer_source(self, armed: bool, stopped: bool, now_ns: int, *, only_gnss: bool = False) -> list[Command]:
        """Bring the autopilot to the source that fits the verdict, or to the other one where it does not use that; to none that
        gives it no positions: `stopped` says that the alert keeps them back. One that was found on vision is left there while
        nothing but its probation stands against GNSS. `only_gnss`: there is nothing else, proven or not."""
        verdict = self._monitor.verdict.verdict
        only_gnss = only_gnss and not self._fix_within(UNSEEN_S, now_ns)
        at_hand = {EkfSource.GNSS: verdict is not Verdict.DENIED, EkfSource.VISION: self.injecting and not stopped}
        other = {EkfSource.GNSS: EkfSource.VISION, EkfSource.VISION: EkfSource.GNSS}
        unproven = False
        commands = self._switch.verify(at_hand[other[self._switch.source]], now_ns)
        if verdict is Verdict.OK:
            known = self._switch.known or self._gnss_proven(armed, now_ns)
            unproven = only_gnss and not known
            wish = EkfSource.GNSS if known or only_gnss else None
        elif self._switch.found and self._monitor.verdict.reasons == (PROBATION,):
            wish = None
        else:
            wish = EkfSource.VISION if at_hand[EkfSource.VISION] else None
        if wish is not None and self._switch.shuns(wish, now_ns) and at_hand[other[wish]]:
            wish = other[wish]
        wanted = [] if wish is None else self._switch.want(wish, now_ns)
        if wanted and unproven and not self._told_unproven:
            self._told_unproven = True
            commands.append(Notice(Severity.CRITICAL, UNPROVEN, to_operator=True))
        return [*commands, *wanted]

    def _gnss_proven(self, armed: bool, now_ns: int) -> bool:
        """Whether GNSS may take over from a source that nobody confirmed: on the ground at once, in flight (we may have been
        restarted amid a spoofing) only after fixes have gone with it for the probation, and show that it is not false."""
        if not armed or self._monitor.returned:
            return True
        verdict = self._monitor.verdict
        recent = self._fix_within(self._settings.navigator.dead_reckoning_after_s, now_ns)
        shown = recent and self._series_n >= SERIES_LEAST and verdict.probability_false < TRUSTED_BELOW
        since_ns = max(verdict.since_ns, self._series_ns)
        return shown and now_ns - since_ns >= self._settings.gnss.probation_s * 1e9

    def _fix_within(self, limit_s: float, now_ns: int) -> bool:
        return self._fix_taken_ns is not None and now_ns - self._fix_taken_ns <= limit_s * 1e9
