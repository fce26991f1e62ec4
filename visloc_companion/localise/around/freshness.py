"""Refuses a picture that is identical to one of the latest: a camera that froze goes on sending its last frames.

A frozen picture would be localised well, at a place that the vehicle has long left.
"""

from __future__ import annotations

from visloc_companion.errors import Reason
from visloc_companion.localise.answer import refused
from visloc_companion.localise.asking import Asking
from visloc_companion.localise.seen_before import SeenBefore
from visloc_companion.protocols import Localiser, ReferenceMap
from visloc_companion.types import Fix, Image, LocaliseRequest, NoFix


class FreshFramesOnly(Asking):
    """A Localiser that asks another one, but only about frames that differ from the latest that it was asked about."""

    def __init__(self, localiser: Localiser) -> None:
        super().__init__(localiser)
        self._seen = SeenBefore()

    def localise(self, request: LocaliseRequest, pixels: Image, ref: ReferenceMap) -> Fix | NoFix:
        """As the localiser that is asked; FROZEN for another frame with the very same pixels."""
        if not self._seen.another(request.frame.frame_id, pixels):
            return self._localiser.localise(request, pixels, ref)
        return refused(request, self.method, Reason.FROZEN, "identical to a frame before: the camera is frozen")
