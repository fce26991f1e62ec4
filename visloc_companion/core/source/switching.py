"""Which position the autopilot should fly on, and how it is told: neither autopilot changes its source by itself."""

from __future__ import annotations

from visloc_companion.core.source.use_check import UseCheck
from visloc_companion.types import Command, EkfSource, EstimatorStatus, Notice, Severity, SourceSwitched, SwitchSource

RETRY_NS = 3_000_000_000
RETRY_REFUSED_NS = 15_000_000_000
SHUN_NS = 30_000_000_000
"""A source that the autopilot did not use is not wished for again so soon, where there is another."""

HAND_BACK_NS = 60_000_000_000
"""So long an operator who was asked to go back to GNSS is given positions: without them ArduPilot lands after 8 s."""


class SourceSwitch:
    """Commands the switch where that is allowed, repeats it until it is confirmed, and else asks the operator once.

    Until something was confirmed the autopilot may be on either source (the daemon may have restarted in flight), so the first
    wish is always sent. When GNSS may be wished for then is the navigator's to say. After each switch it is watched whether the
    autopilot uses the source (use_check.py).
    """

    def __init__(self, allowed: bool) -> None:
        self._allowed = allowed
        self._check = UseCheck()
        self.restarted()

    @property
    def source(self) -> EkfSource:
        """What the autopilot flies on, as far as it confirmed; GNSS before that."""
        return self._source

    @property
    def known(self) -> bool:
        """Whether the autopilot ever confirmed a source since we know it. Of an operator it is known what he was asked, but for
        what a daemon before this one asked him."""
        return self._confirmed or not (self._allowed or self._found_on_vision)

    @property
    def found(self) -> bool:
        """Whether the autopilot was sent positions before we came, and nobody has said since what it flies on."""
        return self._found_on_vision

    def judged_source(self, now_ns: int) -> EkfSource:
        """What the autopilot's own word on its position is of: of vision, too, while an operator who switches may be on that, or
        where it was found there."""
        if self._allowed and not self._found_on_vision:
            return self._source
        return EkfSource.VISION if self.leaving_vision(now_ns) else EkfSource.GNSS

    def leaving_vision(self, now_ns: int) -> bool:
        """Whether the autopilot may still fly on vision: as far as it confirmed, or on a GNSS that it has yet to be seen to use
        (or was seen not to, and has not confirmed vision since); or until an operator who was asked has had the time; or as long
        as nobody has said where one is that was sent positions before we came."""
        if self._found_on_vision:
            return True
        if not self._allowed:
            asked_ns = self._asked_back_ns
            return self._operator_told is EkfSource.VISION or (asked_ns is not None and now_ns - asked_ns < HAND_BACK_NS)
        return self._source is EkfSource.VISION or EkfSource.GNSS in (self._check.source, self._unused)

    def restarted(self) -> None:
        """The autopilot (or we) restarted: its source is what its parameters say, most likely GNSS."""
        self._check.stop()
        self._found_on_vision = False
        self._shunned: dict[EkfSource, int] = {}
        self._unused: EkfSource | None = None
        self._told_unheard = False
        self._source, self._confirmed = EkfSource.GNSS, False
        self._not_before_ns: int | None = None
        self._operator_told = EkfSource.GNSS
        self._asked_back_ns: int | None = None

    def found_on_vision(self) -> None:
        """A daemon before this one sent positions until a short while ago: it may have brought the autopilot to vision."""
        self._found_on_vision = True

    def confirmed(self, event: SourceSwitched, now_ns: int) -> list[Command]:
        """The autopilot's answer, or that there was none. Where it did not switch the operator is told, and it is ordered again:
        soon what it may not have heard, later what it refused."""
        if event.accepted:
            if event.shows_use and (event.source is not self._source or event.source is self._unused):
                self._check.begin(event.source, now_ns)
            self._source, self._confirmed, self._not_before_ns, self._unused = event.source, True, None, None
            self._found_on_vision = False
            self._told_unheard = False
            return [Notice(Severity.INFO, f"visloc: EKF source is {event.source.value}")]
        if event.answered:
            self._not_before_ns = now_ns + RETRY_REFUSED_NS
        text = f"visloc: EKF source {event.source.value} {'refused' if event.answered else 'not confirmed'}"
        told, self._told_unheard = self._told_unheard and not event.answered, not event.answered
        return [Notice(Severity.WARNING, text, to_operator=not told, data=(("detail", event.detail),))]

    def hear(self, status: EstimatorStatus, now_ns: int) -> None:
        """Take a report of the autopilot's estimator."""
        self._check.hear(status, now_ns)

    def verify(self, other_at_hand: bool, now_ns: int) -> list[Command]:
        """Tell the operator, once, of a source that the autopilot does not use; it is shunned where there is another."""
        source = self._check.source
        if source is None or self._check.judged(now_ns) is not False:
            return []
        if other_at_hand:
            self._shunned[source], self._unused = now_ns + SHUN_NS, source
        then = "switching back" if other_at_hand else "CHECK IT"
        text = f"visloc: EKF does not use {source.value.upper()}, {then}"
        return [Notice(Severity.CRITICAL, text, to_operator=True)]

    def shuns(self, source: EkfSource, now_ns: int) -> bool:
        """Whether a source was found unused a short while ago."""
        return now_ns < self._shunned.get(source, now_ns)

    def want(self, source: EkfSource, now_ns: int) -> list[Command]:
        """Bring the autopilot to a source."""
        if not self._allowed:
            return self._ask_operator(source, now_ns)
        waiting = self._not_before_ns is not None and now_ns < self._not_before_ns
        if waiting or (self._confirmed and source is self._source and source is not self._unused):
            return []
        self._not_before_ns = now_ns + RETRY_NS
        return [SwitchSource(source)]

    def _ask_operator(self, source: EkfSource, now_ns: int) -> list[Command]:
        if source is self._operator_told and not self._found_on_vision:
            return []
        self._found_on_vision = False
        self._operator_told, self._asked_back_ns = source, now_ns if source is EkfSource.GNSS else None
        return [Notice(Severity.CRITICAL, f"visloc: set EKF position source to {source.value.upper()}", to_operator=True)]
