"""Which position the autopilot should fly on, and how it is told: neither autopilot changes its source by itself."""

from __future__ import annotations

from visloc_companion.types import Command, EkfSource, Notice, Severity, SourceSwitched, SwitchSource

RETRY_NS = 3_000_000_000


class SourceSwitch:
    """Commands the switch where that is allowed, repeats it until it is confirmed, and else asks the operator once."""

    def __init__(self, allowed: bool) -> None:
        self._allowed = allowed
        self._source = EkfSource.GNSS
        self._asked_ns: int | None = None
        self._operator_told = EkfSource.GNSS

    @property
    def source(self) -> EkfSource:
        """What the autopilot flies on, as far as it confirmed."""
        return self._source

    def confirmed(self, event: SourceSwitched) -> list[Command]:
        """The autopilot's answer; a refusal goes to the operator and is tried again later."""
        if event.accepted:
            self._source, self._asked_ns = event.source, None
            return [Notice(Severity.INFO, f"visloc: EKF source is {event.source.value}")]
        text = f"visloc: EKF source {event.source.value} refused"
        return [Notice(Severity.WARNING, text, to_operator=True, data=(("detail", event.detail),))]

    def restarted(self) -> None:
        """The autopilot restarted: its source is what its parameters say, GNSS."""
        self._source, self._asked_ns, self._operator_told = EkfSource.GNSS, None, EkfSource.GNSS

    def want(self, source: EkfSource, now_ns: int) -> list[Command]:
        """Bring the autopilot to a source."""
        if not self._allowed:
            return self._ask_operator(source)
        waiting = self._asked_ns is not None and now_ns - self._asked_ns < RETRY_NS
        if source is self._source or waiting:
            return []
        self._asked_ns = now_ns
        return [SwitchSource(source)]

    def _ask_operator(self, source: EkfSource) -> list[Command]:
        if source is self._operator_told:
            return []
        self._operator_told = source
        return [Notice(Severity.CRITICAL, f"visloc: set EKF position source to {source.value.upper()}", to_operator=True)]
