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
    """Widths of full, half and quarter resolution, dilations of the residual blocks (in pixels of theirs), learned channels.

    Without `quarter_dilations` there is no quarter resolution.
    """

    full_width: int = 16
    half_width: int = 32
    dilations: tuple[int, ...] = (1, 2, 4, 8, 4, 1)
    descriptors: int = 8
    quarter_width: int = 48
    quarter_dilations: tuple[int, ...] = ()


def begin_small(blocks: nn.ModuleList, width: int) -> None:
    """First weights of residual blocks: close to the identity."""
    for block in blocks:
        nn.init.normal_(cast(Tensor, block.weight), std=0.3 / (9 * width) ** 0.5)


class Quarter(nn.Module):
    """(N, half, H, W) -> the same, by way of half that resolution: what lies further off. Adds nothing before it has learned."""

    def __init__(self, half: int, width: int, dilations: tuple[int, ...]) -> None:
        super().__init__()
        self.down = nn.Conv2d(half, width, 3, stride=2, padding=1)
        self.blocks = nn.ModuleList(nn.Conv2d(width, width, 3, padding=d, dilation=d) for d in dilations)
        self.back = nn.Conv2d(width, half, 1)
        begin_small(self.blocks, width)
        nn.init.zeros_(self.back.weight)
        nn.init.zeros_(cast(Tensor, self.back.bias))

    def forward(self, half: Tensor) -> Tensor:
        """What is added at half resolution."""
        quarter = functional.relu(self.down(half))
        for block in self.blocks:
            quarter = quarter + functional.relu(block(quarter))
        return functional.interpolate(self.back(quarter), scale_factor=2.0, mode="bilinear", align_corners=False)


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
        self.quarter = Quarter(half, settings.quarter_width, settings.quarter_dilations) if settings.quarter_dilations else None
        self.merge = nn.Conv2d(full + half, full, 3, padding=1)
        self.head = nn.Conv2d(full, settings.descriptors + 2, 1)
        begin_small(self.blocks, half)
        with torch.no_grad():
            cast(Tensor, self.head.bias)[:2] = torch.tensor([2.0, -1.0])
            self.head.weight[:2] *= 0.1

    def forward(self, image: Tensor) -> Tensor:
        """Features (N, 2 + descriptors, H, W)."""
        full = functional.relu(self.entry(image))
        half = functional.relu(self.down(full))
        for block in self.blocks:
            half = half + functional.relu(block(half))
        if self.quarter is not None:
            half = half + self.quarter(half)
        up = functional.interpolate(half, scale_factor=2.0, mode="bilinear", align_corners=False)
        merged = self.head(functional.relu(self.merge(torch.cat([full, up], 1))))
        weights, described = torch.sigmoid(merged[:, :2]), merged[:, 2:]
        length = torch.sqrt((described * described).sum(1, keepdim=True) + 1e-4)
        return torch.cat([image[:, 1:3] * weights[:, :1], described / length * weights[:, 1:]], 1)
