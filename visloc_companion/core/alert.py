"""The alert: a protection level beyond its limit, told to the operator within two seconds, and not again at every wobble."""

from __future__ import annotations

from typing import NamedTuple

from visloc_companion.core.settings import NavigatorSettings
from visloc_companion.types import BeyondLimit, Notice, Severity

CONFIRM_NS = 1_000_000_000
"""A level must exceed its limit for so long: one odd fix may raise it for a moment. With a Tick this is within 1.2 s."""
CLEAR_NS = 5_000_000_000
CLEAR_SHARE = 0.8
"""It must stay below this share of the limit for CLEAR_NS before all is well again."""


class Limits(NamedTuple):
    """The alert limits of a phase of flight, metres."""

    horizontal_m: float
    vertical_m: float


class Levels(NamedTuple):
    """Protection levels, None where none can be stated, which is beyond any limit."""

    horizontal_m: float | None
    vertical_m: float | None

    def are_within(self, limits: Limits) -> bool:
        """Whether both are stated and within the limits."""
        horizontal, vertical = self.horizontal_m, self.vertical_m
        return (
            horizontal is not None
            and vertical is not None
            and horizontal <= limits.horizontal_m
            and vertical <= limits.vertical_m
        )


def limits_at(height_above_home_m: float | None, height_offset_m: float, settings: NavigatorSettings) -> Limits:
    """Low limits where the vehicle may be low: by the autopilot's height above home, or by that which fixes make of it."""
    low = height_above_home_m is not None and height_above_home_m + min(0.0, height_offset_m) < settings.low_height_m
    if low:
        return Limits(settings.alert_limit_low_m, settings.vertical_alert_limit_low_m)
    return Limits(settings.alert_limit_m, settings.vertical_alert_limit_m)


class Beyond:
    """Whether one level counts as beyond its limit, with hysteresis."""

    def __init__(self) -> None:
        self.raised = False
        self._since_ns: int | None = None

    def update(self, level_m: float | None, limit_m: float, now_ns: int) -> None:
        """Take a level at a time."""
        other = level_m is not None and level_m < CLEAR_SHARE * limit_m if self.raised else level_m is None or level_m > limit_m
        if not other:
            self._since_ns = None
            return
        since_ns = self._since_ns = now_ns if self._since_ns is None else self._since_ns
        if now_ns - since_ns >= (CLEAR_NS if self.raised else CONFIRM_NS):
            self.raised, self._since_ns = not self.raised, None


class AlertWatch:
    """Both levels against their limits, and what the operator was told of it."""

    def __init__(self, policy: BeyondLimit) -> None:
        self._policy = policy
        self._horizontal, self._vertical = Beyond(), Beyond()
        self._told = (False, False)

    @property
    def raised(self) -> bool:
        """Whether one level counts as beyond its limit."""
        return self._horizontal.raised or self._vertical.raised

    @property
    def stops(self) -> bool:
        """Whether nothing is to be injected because of the horizontal level."""
        return self._horizontal.raised and self._policy is BeyondLimit.STOP

    @property
    def widens(self) -> bool:
        """Whether what is injected is to claim no more than the horizontal level does."""
        return self._horizontal.raised and self._policy is BeyondLimit.WIDEN

    def update(self, levels: Levels, limits: Limits, now_ns: int) -> None:
        """Take the levels of a Tick."""
        self._horizontal.update(levels.horizontal_m, limits.horizontal_m, now_ns)
        self._vertical.update(levels.vertical_m, limits.vertical_m, now_ns)

    def notices(self, levels: Levels, *, relied_on: bool, room: bool) -> list[Notice]:
        """At most one message: of what changed since the last one. Nothing while nobody relies on the position; where there is
        no `room` beside other messages it waits for the next Tick."""
        if not relied_on:
            self._told = (False, False)
            return []
        now = (self._horizontal.raised, self._vertical.raised)
        if now == self._told or not room:
            return []
        before = self._told
        data = tuple(
            (name, value)
            for name, value in (("level_m", levels.horizontal_m), ("vertical_level_m", levels.vertical_m))
            if value is not None
        )
        worse = (now[0] and not before[0], now[1] and not before[1])
        if any(worse):
            self._told = (before[0] or now[0], before[1] or now[1])  # what is better again is told at the next Tick
            severity = Severity.CRITICAL if worse[0] and self._policy is BeyondLimit.STOP else Severity.WARNING
            return [Notice(severity, _unsure(levels, worse, self._policy), to_operator=True, data=data)]
        self._told, better = now, (before[0] and not now[0], before[1] and not now[1])
        return [Notice(Severity.NOTICE, _sure(levels, better), to_operator=True, data=data)]


def _unsure(levels: Levels, worse: tuple[bool, bool], policy: BeyondLimit) -> str:
    horizontal, vertical = _metres(levels.horizontal_m), _metres(levels.vertical_m)
    if worse[0] and policy is BeyondLimit.STOP:
        return f"visloc: POSITION may be off {horizontal}, NOT SENT"
    if all(worse):
        return f"visloc: POSITION may be off {horizontal}, HEIGHT {vertical}"
    return f"visloc: POSITION may be off {horizontal}" if worse[0] else f"visloc: HEIGHT may be off {vertical}"


def _sure(levels: Levels, better: tuple[bool, bool]) -> str:
    if all(better):
        return "visloc: position and height sure again"
    what, level_m = ("position", levels.horizontal_m) if better[0] else ("height", levels.vertical_m)
    return f"visloc: {what} sure again, within {_metres(level_m)}"


def _metres(level_m: float | None) -> str:
    return "unknown" if level_m is None else f"{min(level_m, 9999.0):.0f} m"
