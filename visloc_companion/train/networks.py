"""The feature network: fully convolutional, U-shaped, on normalised grey and gradient orientation.

It begins as plain gradient features, with two weights of each pixel: what lasts is emphasised, what will be gone is muted, and
learned descriptors of unit length stand beside the orientation (Goforth & Lucey 2019 use VGG16 up to conv3 in this place).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import cast

import torch
from torch import Tensor, nn
from torch.nn import functional

MULTIPLE_PX = 4
ORIENTED = 1
BOUND = 2.0


@dataclass(frozen=True, slots=True)
class NetworkSettings:
    """Width of the full and the half resolution, dilations (half-resolution pixels) of the residual blocks, learned channels."""

    full_width: int = 16
    half_width: int = 32
    dilations: tuple[int, ...] = (1, 2, 4, 8, 4, 1)
    descriptors: int = 8


class FeatureNetwork(nn.Module):
    """(N, 3, H, W) of localise.features.network_input -> (N, 2 + descriptors, H, W); H and W multiples of 4.

    Channels 0 and 1: the gradient's cosine and sine times a weight in 0..1; the others a unit vector times a weight in 0..1.
    """

    def __init__(self, settings: NetworkSettings) -> None:
        super().__init__()
        full, half = settings.full_width, settings.half_width
        self.entry = nn.Conv2d(3, full, 3, padding=1)
        self.down = nn.Conv2d(full, half, 3, stride=2, padding=1)
        self.blocks = nn.ModuleList(nn.Conv2d(half, half, 3, padding=d, dilation=d) for d in settings.dilations)
        self.merge = nn.Conv2d(full + half, full, 3, padding=1)
        self.head = nn.Conv2d(full, settings.descriptors + 2, 1)
        for block in self.blocks:
            nn.init.normal_(cast(Tensor, block.weight), std=0.3 / (9 * half) ** 0.5)
        with torch.no_grad():
            cast(Tensor, self.head.bias)[:2] = torch.tensor([2.0, -1.0])
            self.head.weight[:2] *= 0.1

    def forward(self, image: Tensor) -> Tensor:
        """Features (N, 2 + descriptors, H, W)."""
        full = functional.relu(self.entry(image))
        half = functional.relu(self.down(full))
        for block in self.blocks:
            half = half + functional.relu(block(half))
        up = functional.interpolate(half, scale_factor=2.0, mode="bilinear", align_corners=False)
        merged = self.head(functional.relu(self.merge(torch.cat([full, up], 1))))
        weights, described = torch.sigmoid(merged[:, :2]), merged[:, 2:]
        length = torch.sqrt((described * described).sum(1, keepdim=True) + 1e-4)
        return torch.cat([image[:, 1:3] * weights[:, :1], described / length * weights[:, 1:]], 1)
