"""Tells once that not a single fix has been taken for long, and why most frames were refused: while GNSS is good nothing else
shows it, and camera, map or heights may have been set up wrongly."""

from __future__ import annotations

from collections import Counter

from visloc_companion.core.terrain.terrain_aiding import METHOD as TERRAIN
from visloc_companion.types import Command, NoFix, Notice, Severity

AFTER_NS, FEWEST = 90_000_000_000, 100
"""So long after the first refused frame, and so many of them: a flight begins over ground that the map knows."""


class UnmatchedWatch:
    """Counts refused frames until the first fix is taken."""

    def __init__(self) -> None:
        self._reasons: Counter[str] | None = Counter()
        self._since_ns: int | None = None

    def recognised(self) -> None:
        """A fix was taken: what is refused later has reasons of its own."""
        self._reasons = None

    def on_refusal(self, answer: NoFix, now_ns: int) -> list[Command]:
        """Take a frame's answer; what is to be said now."""
        if self._reasons is None or answer.method == TERRAIN:
            return []
        self._since_ns = now_ns if self._since_ns is None else self._since_ns
        self._reasons[answer.reason.value] += 1
        if now_ns - self._since_ns < AFTER_NS or self._reasons.total() < FEWEST:
            return []
        counted = self._reasons.most_common()
        self._reasons = None
        data = tuple((name, float(count)) for name, count in counted)
        return [Notice(Severity.WARNING, f"visloc: no fix yet, {counted[0][0]}", to_operator=True, data=data)]
