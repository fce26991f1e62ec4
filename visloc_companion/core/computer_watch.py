"""Tells the operator when the computer contradicts itself (localise/around/twice.py)."""

from __future__ import annotations

from visloc_companion.errors import Reason
from visloc_companion.types import Command, Fix, NoFix, Notice, Severity


class ComputerWatch:
    """Knows whether the localiser has switched itself off."""

    def __init__(self) -> None:
        self._off = False

    def on_answer(self, answer: Fix | NoFix) -> list[Command]:
        """What is to be said of an answer: once that there will be no fixes any more, once that there are again."""
        if isinstance(answer, Fix):
            was_off, self._off = self._off, False
            return [Notice(Severity.NOTICE, "visloc: camera fixes are back", to_operator=True)] if was_off else []
        data = (("detail", answer.detail), ("method", answer.method))
        if answer.reason is Reason.COMPUTATION_DIFFERS:
            return [Notice(Severity.WARNING, "a fix differs when it is computed again", data=data)]
        if answer.reason is not Reason.SWITCHED_OFF or self._off:
            return []
        self._off = True
        return [Notice(Severity.CRITICAL, "visloc: COMPUTER FAULTY, no camera fixes", to_operator=True, data=data)]
