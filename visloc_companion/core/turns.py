"""Whose vote the next request asks for: the image's, or the structure's when the image fails and in turn."""

from __future__ import annotations

from visloc_companion.types import Vote

REST = 4
"""After a structure vote without a fix, so many image votes come before the next: it costs several times as much."""

MOST_LOST = 2
"""Structure votes that cost the worker its life before no more are asked for: each takes the image's votes away for seconds."""


class Turns:
    """Image by default. Structure after an image vote without a fix, and after `every` image fixes (0: not in turn)."""

    def __init__(self, structure: bool, every: int) -> None:
        self._structure, self._every = structure, every
        self._fixes = 0
        self._rest = 0
        self._lost = 0
        self.vote = Vote.IMAGE

    def answered(self, found: bool, lost: bool = False) -> None:
        """The vote that was asked for gave a fix, or none; `lost`: because the worker died or was ended at its deadline."""
        if self.vote is Vote.STRUCTURE:
            self._lost += lost
            self._structure = self._structure and self._lost < MOST_LOST
            self.vote, self._rest, self._fixes = Vote.IMAGE, 0 if found else REST, 0
            return
        self._rest = max(self._rest - 1, 0)
        self._fixes += found
        in_turn = self._every > 0 and self._fixes >= self._every
        if self._structure and self._rest == 0 and (in_turn or not found):
            self.vote = Vote.STRUCTURE
