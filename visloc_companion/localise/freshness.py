"""Refuses a picture that is identical to the one before: a camera that froze goes on sending its last frame.

Two exposures of a real sensor never agree in every pixel. A frozen picture would be localised well, at a place that the
vehicle has long left.
"""

from __future__ import annotations

import hashlib

import numpy as np

from visloc_companion.errors import Reason
from visloc_companion.localise.answer import refused
from visloc_companion.localise.asking import Asking
from visloc_companion.protocols import Localiser, ReferenceMap
from visloc_companion.types import Fix, Image, LocaliseRequest, NoFix


class FreshFramesOnly(Asking):
    """A Localiser that asks another one, but only about frames that differ from the last one answered."""

    def __init__(self, localiser: Localiser) -> None:
        super().__init__(localiser)
        self._last: tuple[int, bytes] | None = None

    def localise(self, request: LocaliseRequest, pixels: Image, ref: ReferenceMap) -> Fix | NoFix:
        """As the localiser that is asked; FROZEN for another frame with the very same pixels."""
        digest = hashlib.blake2b(np.ascontiguousarray(pixels).data, digest_size=16).digest()
        frame_id = request.frame.frame_id
        repeated = self._last is not None and self._last[0] != frame_id and self._last[1] == digest
        if not repeated:
            self._last = (frame_id, digest)
            return self._localiser.localise(request, pixels, ref)
        return refused(request, self.method, Reason.FROZEN, "identical to the frame before: the camera is frozen")
