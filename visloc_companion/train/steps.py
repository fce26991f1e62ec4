"""One training step and one validation, from a mixture of sources; everything random comes from (seed, step)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from visloc_companion.train.losses import alignment_loss, correlation_surface, offset_loss, upright
from visloc_companion.train.networks import ORIENTED, FeatureNetwork
from visloc_companion.train.pairs import PaintedStack, Pair, PairSettings, StackPyramid, make_pair

ALIGNMENT_WEIGHT = 0.3
DISPLACED_PX = 1.5
PAINTED_PX = 300
WITHIN_PX = 1.5


@dataclass(frozen=True, slots=True, eq=False)
class Source:
    """A kind of place in the mixture: its stacks (none: invented shapes), its share of the pairs, its range of scales."""

    name: str
    stacks: tuple[StackPyramid, ...]
    share: float
    scales: tuple[float, float]


@dataclass(frozen=True, slots=True, eq=False)
class Batch:
    """Pairs stacked to tensors; see `Pair`."""

    reference: Tensor
    query: Tensor
    query_valid: Tensor
    window_to_query: Tensor
    turn_rad: Tensor
    offset_px: Tensor


def make_batch(
    seed: Sequence[int], sources: Sequence[Source], settings: PairSettings, size: int, window_px: int | None = None
) -> Batch:
    """The pairs of a step, all with one window size; the same for the same seed."""
    rng = np.random.default_rng(list(seed))
    window = window_px or int(rng.choice(settings.windows_px))
    share = np.array([source.share for source in sources])
    pairs = []
    for _ in range(size):
        source = sources[int(rng.choice(len(sources), p=share / share.sum()))]
        stack: StackPyramid | PaintedStack
        stack = source.stacks[int(rng.integers(len(source.stacks)))] if source.stacks else PaintedStack(rng, PAINTED_PX)
        pairs.append(make_pair(rng, stack, settings, window, source.scales))
    return as_batch(pairs)


def as_batch(pairs: Sequence[Pair]) -> Batch:
    """Tensors of pairs of one size."""
    return Batch(
        torch.from_numpy(np.stack([p.reference for p in pairs])),
        torch.from_numpy(np.stack([p.query for p in pairs])),
        torch.from_numpy(np.stack([p.query_valid for p in pairs])),
        torch.from_numpy(np.stack([p.window_to_query for p in pairs])),
        torch.tensor([p.turn_rad for p in pairs], dtype=torch.float32),
        torch.from_numpy(np.stack([p.offset_px for p in pairs])),
    )


def surfaces(network: FeatureNetwork, batch: Batch) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Correlation surface, reference features, upright query features and mask."""
    reference = network(batch.reference)
    query = network(batch.query) * batch.query_valid[:, None]
    window, mask = upright(query, batch.query_valid, batch.window_to_query, batch.turn_rad, ORIENTED)
    return correlation_surface(reference, window, mask), reference, window, mask


def training_loss(network: FeatureNetwork, log_sharpness: Tensor, batch: Batch, seed: Sequence[int]) -> Tensor:
    """Loss of a batch: offsets over the own map piece and a neighbour's, and the Lucas-Kanade step."""
    surface, reference, window, mask = surfaces(network, batch)
    other = correlation_surface(reference.roll(1, 0), window, mask)
    sharpness = torch.exp(log_sharpness) * torch.sqrt(mask.sum((1, 2)))[:, None, None] / 50
    classified = offset_loss(surface, batch.offset_px, sharpness)
    right = torch.logsumexp((surface * sharpness).flatten(1), 1)
    wrong = torch.logsumexp((other * sharpness).flatten(1), 1)
    elsewhere = torch.nn.functional.softplus(wrong - right)
    rng = np.random.default_rng([*seed, 1])
    displaced = torch.from_numpy(rng.uniform(-DISPLACED_PX, DISPLACED_PX, (len(mask), 2)).astype(np.float32)).to(window.device)
    aligned = alignment_loss(reference, window, mask, batch.offset_px, displaced)
    return (classified + elsewhere + ALIGNMENT_WEIGHT * aligned).mean()


@torch.no_grad()
def validate(network: FeatureNetwork | None, batches: Sequence[Batch]) -> tuple[float, float]:
    """Share of the queries whose highest score is within 1.5 px (and half a diagonal of a cell) of the truth, and their mean
    margin over the rest of the surface.

    Without a network: of the gradient features alone.
    """
    right, margin = [], []
    for batch in batches:
        if network is None:
            query = batch.query[:, 1:3] * batch.query_valid[:, None]
            window, mask = upright(query, batch.query_valid, batch.window_to_query, batch.turn_rad, ORIENTED)
            surface = correlation_surface(batch.reference[:, 1:3], window, mask)
        else:
            surface = surfaces(network, batch)[0]
        n = surface.shape[-1]
        axis = torch.arange(n, dtype=surface.dtype, device=surface.device)
        du, dv = axis[None, None] - batch.offset_px[:, 0, None, None], axis[None, :, None] - batch.offset_px[:, 1, None, None]
        near = torch.hypot(du, dv) <= WITHIN_PX + 0.75
        best_near = torch.where(near, surface, torch.tensor(-1.0)).flatten(1).amax(1)
        best_far = torch.where(near, torch.tensor(-1.0), surface).flatten(1).amax(1)
        right.append((best_near > best_far).float())
        margin.append(best_near - best_far)
    return float(torch.cat(right).mean()), float(torch.cat(margin).mean())
