from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
import pytest

from visloc_companion.localise.registration.base import RegistrationPrior
from visloc_companion.localise.registration.pair import Pair, make_pair
from visloc_companion.localise.registration.similarity import moved

SIDE_M = 300
"""Of the ground on which something else stands than before."""
TRUE_M = np.array([24.0, -31.0])
"""From where a source of it lies to where it belongs."""
PRIOR = RegistrationPrior(40.0, 3.0, np.radians(3.0), np.radians(0.5), 0.01)


@dataclass(frozen=True)
class Scene:
    """A source that belongs 17 m to the east, 11 m to the south and 2 m above where it lies, turned by 2.5 deg, 1 % larger."""

    source_m: np.ndarray
    reference_m: np.ndarray
    T_true: np.ndarray
    prior: RegistrationPrior

    def offset_m(self, T: np.ndarray) -> np.ndarray:
        """(N, 3) between the source's points after T and where they belong."""
        return self.source_m @ (T[:3, :3] - self.T_true[:3, :3]).T + T[:3, 3] - self.T_true[:3, 3]


def terrain(seed: int, side_m: int = 160):
    """Heights at places: hills, and crowns and roofs on them."""
    return at_places(hills(seed, side_m + 40), side_m / 2 + 20)


def hills(seed: int, n: int) -> np.ndarray:
    """(n, n) heights, one a metre: hills, and crowns and roofs on them."""
    rng = np.random.default_rng(seed)
    grid = cv2.GaussianBlur(rng.standard_normal((n, n)), (0, 0), 15)
    grid *= 3 / grid.std()
    for _ in range(90):
        u, v = rng.integers(0, n, 2)
        w, h = rng.integers(4, 12, 2)
        grid[v : v + h, u : u + w] += rng.uniform(3, 9)
    return grid


def at_places(grid: np.ndarray, zero_px: float):
    """Heights at places about zero, which lies at that row and column of a grid of a metre."""

    def heights(xy: np.ndarray) -> np.ndarray:
        at = (xy + zero_px).astype(np.float32)
        return cv2.remap(grid.astype(np.float32), at[None, :, 0], at[None, :, 1], cv2.INTER_LINEAR)[0].astype(float)

    return heights


def cloud(heights, rng, centre, side_m: float, per_m2: float, noise_m: float) -> np.ndarray:
    xy = rng.uniform(-side_m / 2, side_m / 2, (int(per_m2 * side_m**2), 2)) + centre
    parts = [heights(some) for some in np.array_split(xy, max(1, len(xy) // 20_000))]
    return np.column_stack([xy, np.concatenate(parts) + rng.normal(0, noise_m, len(xy))])


def gentle(seed: int = 3) -> np.ndarray:
    """(SIDE_M, SIDE_M) heights of gentle ground, a slope of 0.05."""
    grid = cv2.GaussianBlur(np.random.default_rng(seed).standard_normal((SIDE_M, SIDE_M)), (0, 0), 25)
    return grid * (0.05 / np.gradient(grid)[0].std())


def before_and_now(before: np.ndarray, now: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Source and reference of gentle ground with this on it (SIDE_M, SIDE_M); the source lies TRUE_M from where it belongs."""
    rng = np.random.default_rng(8)
    reference = cloud(at_places(gentle() + before, SIDE_M / 2), rng, np.zeros(2), SIDE_M - 20, 1.0, 0.05)
    source = cloud(at_places(gentle() + now, SIDE_M / 2), rng, TRUE_M, 66, 4.0, 0.15)
    return source - np.append(TRUE_M, 0.0), reference


def pair_of(clouds: tuple[np.ndarray, np.ndarray], prior: RegistrationPrior = PRIOR) -> Pair:
    pair = make_pair(*clouds, prior)
    assert isinstance(pair, Pair)
    return pair


def off_m(pair: Pair, T: np.ndarray) -> float:
    return float(np.hypot(*(moved(T, pair.centre_m) - pair.centre_m)[:2] - TRUE_M))


@pytest.fixture(scope="session")
def scene() -> Scene:
    rng = np.random.default_rng(4)
    heights = terrain(5)
    reference = cloud(heights, rng, np.zeros(2), 150, 3.0, 0.05)
    source = cloud(heights, rng, np.array([17.0, -11.0]), 60, 3.0, 0.15)
    angle, shift = np.radians(2.5), np.array([17.0, -11.0, 2.0])
    linear = 1.01 * np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]])
    middle = np.array([17.0, -11.0, source[:, 2].mean()])
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = linear, middle - linear @ (middle - shift)
    lies = (source - T[:3, 3]) @ np.linalg.inv(linear).T
    return Scene(lies, reference, T, RegistrationPrior(20.0, 3.0, np.radians(3.0), np.radians(0.5), 0.012))
