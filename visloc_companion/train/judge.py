"""What the files of an export answer beside the network that they were made from, and what that costs in the search."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import cast

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from visloc_companion.errors import ModelError
from visloc_companion.localise.features.network_input import network_input
from visloc_companion.localise.model_folder import VariantName
from visloc_companion.localise.runtime import run_onnx
from visloc_companion.train.networks import FeatureNetwork
from visloc_companion.train.shapes import paint_dates
from visloc_companion.train.steps import Batch, validate

Float32Array = NDArray[np.float32]
SIZES = ((1, 64, 64), (2, 48, 100), (1, 128, 256), (3, 4, 8))
"""(N, H, W) of the inputs that are compared."""
PARITY_MAX = 1e-4
"""Largest difference that is allowed between PyTorch and the float32 file; values are within ±2."""
RMS_LIMITS: dict[VariantName, float] = {"float32": 1e-5, "float16": 2e-3, "int8": 5e-2}
"""Refused beyond: such a file is another network."""


@dataclass(frozen=True, slots=True)
class Difference:
    """Of features to those of PyTorch."""

    largest: float
    rms: float


def inputs_for_comparison(batches: Mapping[str, Sequence[Batch]]) -> list[Float32Array]:
    """Random numbers and invented places in several sizes, and map pieces of the validation pairs that are given."""
    rng = np.random.default_rng(0)
    random = [rng.normal(0, 1, (n, 3, h, w)).clip(-2, 2).astype(np.float32) for n, h, w in SIZES]
    painted = [painted_input(1, 96, 160), painted_input(2, 240, 320)]
    real = [batch.reference.numpy() for some in batches.values() for batch in some[:2]]
    return [*random, *painted, *real]


def painted_input(seed: int, height: int, width: int) -> Float32Array:
    """(1, 3, height, width) of an invented place."""
    image = paint_dates(np.random.default_rng(seed), max(height, width), 1)[0][:height, :width]
    return network_input(image, np.ones(image.shape, np.bool_))[None]


@torch.no_grad()
def answer(network: FeatureNetwork, given: Float32Array) -> Float32Array:
    """What PyTorch answers."""
    return np.asarray(network(torch.from_numpy(given)).numpy(), dtype=np.float32)


def compare(network: FeatureNetwork, content: bytes, inputs: Sequence[Float32Array]) -> Difference:
    """Of the file's answers to PyTorch's, over all inputs."""
    differences = [run_onnx(content, given) - answer(network, given) for given in inputs]
    every = np.concatenate([difference.ravel() for difference in differences]).astype(np.float64)
    return Difference(float(np.abs(every).max()), float(np.sqrt(np.mean(every * every))))


def check(variant: VariantName, found: Difference) -> None:
    """Raises ModelError for a file that does not answer as the network does; so written that NaN is wrong."""
    worst = PARITY_MAX if variant == "float32" else float("inf")
    if not (found.largest <= worst and found.rms <= RMS_LIMITS[variant]):
        raise ModelError(
            f"the {variant} file answers otherwise than PyTorch: off by {found.largest:.3g} at most and {found.rms:.3g} rms, "
            f"allowed are {worst:.3g} and {RMS_LIMITS[variant]:.3g}",
            where="visloc train export",
            remedy="nothing was written; export with the versions of constraints.txt",
        )


class _OnnxNetwork(torch.nn.Module):
    """A file in the place of the network."""

    def __init__(self, content: bytes) -> None:
        super().__init__()
        self._content = content

    def forward(self, image: Tensor) -> Tensor:
        return torch.from_numpy(run_onnx(self._content, image.numpy()))


def placed_wrong(content: bytes | None, batches: Mapping[str, Sequence[Batch]]) -> dict[str, float]:
    """Share of the validation queries that a file (None: gradient features alone) places wrong, by source."""
    network = None if content is None else cast(FeatureNetwork, _OnnxNetwork(content))
    return {name: 1 - validate(network, some)[0] for name, some in batches.items()}
