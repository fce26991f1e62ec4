"""Pictures that were there already: two exposures of a real sensor never agree in every pixel.

A camera that froze goes on with its last picture, and a driver that lost it may hand out its ring of buffers over and over: every
picture differs from the one before then, and is an old one.
"""

from __future__ import annotations

import hashlib
from collections import deque

import numpy as np

from visloc_companion.types import Image

MOST = 16
"""Pictures that are known again: more than drivers and pipelines have buffers."""


class SeenBefore:
    """Knows the latest pictures that were new, each by a number that tells frames apart."""

    def __init__(self) -> None:
        self._new: deque[tuple[int, bytes]] = deque(maxlen=MOST)

    def another(self, frame: int, pixels: Image) -> bool:
        """Whether another frame has had these very pixels. What has is not kept, so it ages no other."""
        this = frame, hashlib.blake2b(np.ascontiguousarray(pixels).data, digest_size=16).digest()
        if any(known == this[1] and other != frame for other, known in self._new):
            return True
        if this not in self._new:
            self._new.append(this)
        return False
