"""How high what stands on the ground is at most; for those, too, who need nothing else of the terrain."""

from __future__ import annotations

TALLEST_M = 28.0
