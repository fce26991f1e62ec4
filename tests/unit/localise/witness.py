"""A localiser that remembers what it was asked about."""

from __future__ import annotations

from visloc_companion.errors import Reason
from visloc_companion.protocols import ReferenceMap
from visloc_companion.types import Image, LocaliseRequest, NoFix


class Witness:
    """Answers NO_MATCH, and remembers which frames it was asked about."""

    method = "witness"

    def __init__(self) -> None:
        self.asked: list[int] = []

    def localise(self, request: LocaliseRequest, pixels: Image, ref: ReferenceMap) -> NoFix:
        self.asked.append(request.frame.frame_id)
        return NoFix(0, 0, request.request_id, request.frame.frame_id, self.method, Reason.NO_MATCH, 1.0)
