"""A localiser whose answers also say how the camera turned since the frame before, which tells when frames were really taken."""

from __future__ import annotations

from dataclasses import replace

from visloc_companion.localise.odometry.rotation import TurnWatch
from visloc_companion.protocols import Localiser, ReferenceMap
from visloc_companion.types import CameraModel, Fix, Image, LocaliseRequest, NoFix


class WithTurn:
    """protocols.Localiser: asks another one and adds `turn` to its answer where one is seen."""

    def __init__(self, localiser: Localiser, model: CameraModel) -> None:
        self._localiser, self._watch = localiser, TurnWatch(model)

    @property
    def method(self) -> str:
        """Name of the localiser that answers."""
        return self._localiser.method

    def localise(self, request: LocaliseRequest, pixels: Image, ref: ReferenceMap) -> Fix | NoFix:
        """The other localiser's answer, with the camera's turn."""
        found = self._localiser.localise(request, pixels, ref)
        turn = self._watch.step(pixels, request.frame.t_ns, request.prior.q_ned_frd)
        return found if turn is None else replace(found, turn=turn)
