"""Registration cases over the procedural landscape: a cloud of the later date, in the whole of the map's date.

The reference is 2 km of the map's date, a point a square metre; the source 67 m of it anywhere, in March five years later
(leafless, fields divided anew, stands felled, buildings new), 4 points a square metre, 0.2 m of noise. Heading errors up to
5 deg, tilt 0.5 deg, scale 2 %, height 5 m, all uniform. A third of the places is level field or wood felled in between.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from benchmarks.cloud_sets.cloud_cases import CloudCase
from visloc_companion.localise.registration.base import RegistrationPrior
from visloc_companion.localise.registration.similarity import turned, with_linear
from visloc_companion.sim.landscape import build_landscape

Array = NDArray[np.float64]
SIZE_M, GSD_M, SOURCE_M, NOISE_M = 2000.0, 1.0, 67.0, 0.2
YAW_DEG, TILT_DEG, SCALE, UP_M = 5.0, 0.5, 0.02, 5.0
TRAINING = ((100.0, 50), (60.0, 8), (250.0, 12), (500.0, 3))
"""Errors of the prior and how many places of each, to fit claims on."""
TRAINING_ELSEWHERE, ELSEWHERE_M = 14, 100.0
"""How many sources on the seed before's reference, and the error of their prior."""


@dataclass(frozen=True, slots=True, eq=False)
class LandscapeWorld:
    """The surface of the later date (H, W), heights in metres, and the reference's points (N, 3)."""

    seed: int
    surface: NDArray[np.float32]
    reference_m: Array

    @classmethod
    def built(cls, seed: int) -> LandscapeWorld:
        """Of a seed."""
        old, new = (build_landscape(seed, date, SIZE_M, GSD_M).dsm_amsl_m for date in ("map", "flight"))
        return cls(seed, new, _points(old, np.random.default_rng(seed), np.zeros(2), SIZE_M - 4, 1.0, 0.05))

    def case(self, k: int, error_m: float) -> CloudCase:
        """Place k; the prior is off by at most `error_m` on each axis, uniformly, in the same direction at every error."""
        rng = np.random.default_rng([self.seed, k])
        place = rng.uniform(-1, 1, 2) * (SIZE_M / 2 - SOURCE_M)
        source = _points(self.surface, rng, place, SOURCE_M, 4.0, NOISE_M)
        yaw, tilt_x, tilt_y = np.radians(rng.uniform(-1, 1, 3) * [YAW_DEG, TILT_DEG, TILT_DEG])
        linear = (1 + rng.uniform(-SCALE, SCALE)) * turned(tilt_x, tilt_y, yaw)
        middle = np.append(place, source[:, 2].mean())
        lies = middle - np.append(error_m * rng.uniform(-1, 1, 2), rng.uniform(-UP_M, UP_M))
        T = with_linear(linear, lies, middle)
        moved = (source - T[:3, 3]) @ np.linalg.inv(linear).T
        sigmas = np.array([error_m, UP_M, np.radians(YAW_DEG), np.radians(TILT_DEG), SCALE]) / np.sqrt(3)
        cloud = f"landscape_{self.seed}"
        return CloudCase(f"{cloud}_{k}", cloud, "reach", "years", moved, self.reference_m, RegistrationPrior(*sigmas), T)

    def elsewhere(self, k: int, other: LandscapeWorld) -> CloudCase:
        """Place k on the other's reference, lifted to where its own lies: there is no right place."""
        case = self.case(k, ELSEWHERE_M)
        lift = float(np.median(self.reference_m[:, 2]) - np.median(other.reference_m[:, 2]))
        reference = other.reference_m + np.array([0.0, 0.0, lift])
        return replace(case, name=f"{case.name}_on_{other.seed}", reference_m=reference, T_true=None)


def training_cases(
    seed: int, before: int | None, places: Sequence[tuple[float, int]] = TRAINING, elsewhere: int = TRAINING_ELSEWHERE
) -> Iterator[CloudCase]:
    """To fit claims on, of one world: so many `places` for each error of the prior, and so many `elsewhere`, on the ground of the
    world before if there is one; every place is another one."""
    world, k = _world(seed), 0
    for error_m, n in places:
        yield from (world.case(i, error_m) for i in range(k, k + n))
        k += n
    if before is not None:
        yield from (world.elsewhere(i, _world(before)) for i in range(k, k + elsewhere))


@lru_cache(maxsize=2)
def _world(seed: int) -> LandscapeWorld:
    return LandscapeWorld.built(seed)


def _points(
    surface: NDArray[np.float32], rng: np.random.Generator, place: Array, side_m: float, per_m2: float, noise_m: float
) -> Array:
    """Points at random on a square of the surface; its middle is (0, 0), rows run south."""
    xy = place + rng.uniform(-side_m / 2, side_m / 2, (int(per_m2 * side_m**2), 2))
    pixel = (np.column_stack([xy[:, 0], -xy[:, 1]]) + SIZE_M / 2) / GSD_M - 0.5
    parts = np.array_split(pixel.astype(np.float32), len(pixel) // 20_000 + 1)
    z = np.concatenate([cv2.remap(surface, p[None, :, 0], p[None, :, 1], cv2.INTER_LINEAR)[0] for p in parts])
    return np.column_stack([xy, z + rng.normal(0, noise_m, len(z))])
