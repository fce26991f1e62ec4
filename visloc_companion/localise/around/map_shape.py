"""Whether a map has a shape (a surface model, a cloud) or its ground is a plane, and what a plane leaves unknown."""

from __future__ import annotations

import math
from dataclasses import replace

from visloc_companion.errors import MapError, OutsideMap
from visloc_companion.localise.around.with_motion import GROUND_SIGMA_M
from visloc_companion.localise.asking import Asking
from visloc_companion.protocols import Localiser, ReferenceMap, ShapeMap
from visloc_companion.types import Fix, Image, LocaliseRequest, NoFix, PosePrior

PROBE_M, PROBE_POINTS = 20.0, 100


class MapShape:
    """Looks it up until a request lies on the map; one map only."""

    def __init__(self) -> None:
        self._shaped: bool | None = None

    def known(self, request: LocaliseRequest, ref: ReferenceMap) -> bool | None:
        """Whether the map has a shape; None where that is not known yet, or nothing tells it."""
        if self._shaped is None and isinstance(ref, ShapeMap):
            place = request.prior.place
            try:
                ref.cloud_around(ref.to_map(place.lat_deg, place.lon_deg), PROBE_M, PROBE_POINTS)
                self._shaped = True
            except OutsideMap:
                return None
            except MapError:
                self._shaped = False
        return self._shaped


class OverPlane(Asking):
    """protocols.Localiser: asks another one, over a map whose ground is a plane with a height above it that is known no better
    than the relief allows that no plane has.

    Else fixes keep the height that they began with while a hill comes up, and odometry claims its scale to 2 % where it is off by
    as much as the ground has risen.
    """

    def __init__(self, localiser: Localiser) -> None:
        super().__init__(localiser)
        self._shape = MapShape()

    def localise(self, request: LocaliseRequest, pixels: Image, ref: ReferenceMap) -> Fix | NoFix:
        """The other localiser's answer."""
        if self._shape.known(request, ref) is False:
            believed = None if request.motion_prior is None else _over_plane(request.motion_prior)
            request = replace(request, prior=_over_plane(request.prior), motion_prior=believed)
        return self._localiser.localise(request, pixels, ref)


def _over_plane(prior: PosePrior) -> PosePrior:
    return replace(prior, sigma_h_m=math.hypot(prior.sigma_h_m, GROUND_SIGMA_M))
