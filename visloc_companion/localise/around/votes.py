"""Image and structure as one localiser: the request says which of them votes; structure sees every frame that is asked about."""

from __future__ import annotations

from visloc_companion.localise.around.map_shape import MapShape
from visloc_companion.localise.structure.localiser import StructureLocaliser
from visloc_companion.protocols import Localiser, ReferenceMap
from visloc_companion.types import Fix, Image, LocaliseRequest, NoFix, Vote


class TwoVotes:
    """protocols.Localiser of an image localiser and a structure localiser over the same frames of one map.

    Over a map without a shape (no surface model, no cloud) the image is asked whatever the request says, and no frame is kept.
    """

    def __init__(self, image: Localiser, structure: StructureLocaliser) -> None:
        self._image, self._structure = image, structure
        self._shape = MapShape()

    @property
    def method(self) -> str:
        """Name of the image localiser; answers name the one that gave them."""
        return self._image.method

    def localise(self, request: LocaliseRequest, pixels: Image, ref: ReferenceMap) -> Fix | NoFix:
        """The answer of the vote that is asked for."""
        if not self._shape.known(request, ref):
            return self._image.localise(request, pixels, ref)
        self._structure.remember(request, pixels, ref)
        asked = self._structure if request.vote is Vote.STRUCTURE else self._image
        return asked.localise(request, pixels, ref)
