"""Over a map whose ground is a plane nobody knows how high the ground really is."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
import pytest

from tests.unit.localise.around.test_with_motion import MODEL, Witness, along, flown
from tests.unit.localise.conftest import FlatMap
from visloc_companion.errors import MapError, OutsideMap
from visloc_companion.localise.around.map_shape import OverPlane
from visloc_companion.localise.around.with_motion import GROUND_SIGMA_M, WithMotion
from visloc_companion.localise.asking import Asking
from visloc_companion.protocols import Localiser, ReferenceMap
from visloc_companion.types import Fix, FloatArray, Image, LocaliseRequest, NoFix


@dataclass
class PlaneMap(FlatMap):
    """A map whose pack was built with a ground height alone."""

    def cloud_around(self, center_map_m: tuple[float, float], radius_m: float, max_points: int) -> FloatArray:
        raise MapError("the map has no shape: its ground is a plane")


@dataclass
class ShapedMap(FlatMap):
    """A map with a surface model; a place beyond 240 m is off it."""

    def cloud_around(self, center_map_m: tuple[float, float], radius_m: float, max_points: int) -> FloatArray:
        if math.hypot(*center_map_m) > 240:
            raise OutsideMap("outside")
        return np.zeros((1, 3))


class Asked(Witness):
    """Keeps what it was asked."""

    def __init__(self) -> None:
        super().__init__()
        self.sigma_h_m: list[float] = []
        self.believed_sigma_h_m: list[float] = []

    def localise(self, request: LocaliseRequest, pixels: Image, ref: ReferenceMap) -> Fix | NoFix:
        self.sigma_h_m.append(request.prior.sigma_h_m)
        self.believed_sigma_h_m.append(request.believed.sigma_h_m)
        return super().localise(request, pixels, ref)


def test_relief_is_a_part_of_what_is_unknown_of_the_height_over_a_plane_alone(flat, support) -> None:
    pixels = np.zeros((480, 640), np.uint8)
    beyond, within = (support.request_at((north, 0.0, -200.0), (0.0, 0.0, 0.0), sigma_h_m=1.0) for north in (400.0, 0.0))
    for ref, expected in ((PlaneMap, math.hypot(1.0, GROUND_SIGMA_M)), (ShapedMap, 1.0), (FlatMap, 1.0)):
        asked = Asked()
        localiser = OverPlane(asked)
        assert localiser.method == "witness"
        for request in (beyond, replace(within, motion_prior=beyond.prior), within):
            localiser.localise(request, pixels, ref(flat.pixels, flat.surface))
        assert asked.sigma_h_m[-1] == pytest.approx(expected)
        assert asked.believed_sigma_h_m[-2] == pytest.approx(expected), "of what motion is measured over, as well"


class Elsewhere(Asking):
    """Looks at another map than that which the pictures are of."""

    def __init__(self, localiser: Localiser, ref: ReferenceMap) -> None:
        super().__init__(localiser)
        self._ref = ref

    def localise(self, request: LocaliseRequest, pixels: Image, ref: ReferenceMap) -> Fix | NoFix:
        return self._localiser.localise(request, pixels, self._ref)


def test_motion_over_ground_that_has_risen_above_the_plane_is_within_its_claim(flat, support) -> None:
    """The camera is 100 m above the ground, which lies 12 m above the plane: displacements come out 12 % too long."""
    points = along(6)
    plane = PlaneMap(flat.pixels, flat.surface - np.float32(12.0))

    def off_sigmas(localiser: Localiser) -> list[float]:
        found = []
        for answer in flown(support, flat, Elsewhere(localiser, plane), points):
            if (motion := answer.motion) is None:
                continue
            k0, k1 = (round((t_ns / 1e6 - 1000) / 200) for t_ns in (motion.t_from_ns, motion.t_to_ns))
            truth = (np.array(points[k1]) - np.array(points[k0]))[:2]
            error = np.array(motion.displacement_ned_m)[:2] - truth
            assert np.hypot(*error) / np.hypot(*truth) == pytest.approx(0.12, abs=0.04)
            found.append(math.sqrt(float(error @ np.linalg.solve(np.array(motion.cov_ne_m2), error))))
        return found

    assert 0 < max(off_sigmas(OverPlane(WithMotion(Witness(), MODEL)))) < 3.3
    assert max(off_sigmas(WithMotion(Witness(), MODEL))) > 5.0
