"""What a Tick sends: the position for the autopilot, while the mode injects, and the Status."""

from __future__ import annotations

from visloc_companion.core import output, requests
from visloc_companion.core.asking import Asking
from visloc_companion.core.filter.belief import Belief
from visloc_companion.core.protection import Protected
from visloc_companion.core.settings import InjectionSettings
from visloc_companion.core.tracking import Tracker
from visloc_companion.types import AutopilotKind, Command, GeoPoint, GnssVerdict, Injection, Mode, NavState


class Sending:
    """Keeps the reset counter. `rate_hz`: how many Ticks there are a second."""

    def __init__(self, settings: InjectionSettings, tracker: Tracker, asking: Asking, rate_hz: float) -> None:
        self._settings, self._tracker, self._asking, self._rate_hz = settings, tracker, asking, rate_hz
        self._resets = output.ResetCounter(settings.max_step_m)

    @property
    def reset_counter(self) -> int:
        """Of what was sent last."""
        return self._resets.count

    def jumped(self) -> None:
        """What is sent does not go on from what was sent before: it is about another origin, or time stood meanwhile."""
        self._resets.bump()

    def begin_beside(self, reset_counter: int) -> None:
        """What is sent does not go on from what the daemon before this one sent with about this counter."""
        self._resets.begin_beside(reset_counter)

    def tick(
        self,
        state: NavState | None,
        protected: Protected,
        mode: Mode,
        injecting: bool,
        verdict: GnssVerdict,
        autopilot: AutopilotKind,
        n_open: int,
        now_ns: int,
    ) -> list[Command]:
        """An Injection where `injecting` and the alert does not stop it, and the Status, for a state at `now_ns`.

        `n_open`: places between which frames have not decided yet.
        """
        belief, origin = self._tracker.belief, self._tracker.origin
        if state is None or belief is None or origin is None:
            return [output.empty_status(now_ns, mode, verdict, self._resets.count)]
        counter = self._resets.follow(state, belief.started_ns)
        sent = injecting and not protected.stopped
        injected = self._injection(state, belief, protected, origin, autopilot, counter, now_ns) if sent else None
        of_fix, sends, place = belief.last_fix_ns, injected is not None, None if injected is None else injected.place
        status = output.status(state, of_fix, protected, origin, mode, verdict, counter, sends, n_open, place)
        return [status] if injected is None else [injected, status]

    def _injection(
        self,
        state: NavState,
        belief: Belief,
        protected: Protected,
        origin: GeoPoint,
        autopilot: AutopilotKind,
        counter: int,
        now_ns: int,
    ) -> Injection | None:
        q_ned_frd = self._asking.attitude_now(now_ns)
        if q_ned_frd is None:
            return None
        sigma_d = requests.height_sigma_m(self._tracker.height_above_home_m or 0.0)
        stream_m = output.stream_sigma_m(belief.fix_noise_m2s, belief.sigma_a_mps2, self._rate_hz)
        least_m, stream_m = protected.least_sigma_m, 0.0 if self._tracker.low else stream_m
        return output.injection(state, q_ned_frd, origin, autopilot, self._settings, counter, sigma_d, least_m, stream_m)
