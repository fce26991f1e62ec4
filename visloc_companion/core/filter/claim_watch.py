"""Tells the operator once that fixes err by more than they claim: the filter allows for it (claims.py), but something that nobody
stated bends the pictures, or the map is of another time."""

from __future__ import annotations

import math

from visloc_companion.core.filter.belief import Belief
from visloc_companion.core.filter.claims import Claim
from visloc_companion.types import Command, Notice, Severity

LEAST_RATIO = 2.0
"""Of the 1-sigma."""


class ClaimWatch:
    """Looks at each belief that a fix has led to."""

    def __init__(self) -> None:
        self._told: set[str] = set()

    def after(self, belief: Belief) -> list[Command]:
        """What is to be said now."""
        found = [c for c in belief.claims if c.over >= LEAST_RATIO**2 and c.method not in self._told]
        self._told.update(claim.method for claim in found)
        return [_notice(claim) for claim in found]


def _notice(claim: Claim) -> Notice:
    text = f"visloc: fixes err {math.sqrt(claim.over):.1f} x their claim"
    return Notice(Severity.WARNING, text, to_operator=True, data=((claim.method, claim.over),))
