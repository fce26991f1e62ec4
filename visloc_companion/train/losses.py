"""Losses: what will be searched is what is trained.

Cross-entropy over all offsets of the masked normalised correlation (Padfield 2012; localise/search.py), and the error of one
inverse-compositional Lucas-Kanade step from a known displacement (Baker & Matthews 2004; localise/align.py).
"""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn import functional

TARGET_SIGMA_PX = 0.8
"""Spread of the right place: dates are misregistered by about half a pixel."""


def upright(
    features: Tensor, valid: Tensor, window_to_query: Tensor, turn_rad: Tensor, oriented: int = 1
) -> tuple[Tensor, Tensor]:
    """Query features (N, C, Q, Q) and mask (N, Q, Q) resampled onto the upright window; oriented pairs are turned back."""
    side = features.shape[-1]
    axis = torch.arange(side, dtype=features.dtype, device=features.device)
    v, u = torch.meshgrid(axis, axis, indexing="ij")
    window = torch.stack([u, v, torch.ones_like(u)], -1)
    query = torch.einsum("nij,hwj->nhwi", window_to_query, window)
    grid = (2 * query + 1) / side - 1
    sampled = functional.grid_sample(features, grid, align_corners=False)
    mask = functional.grid_sample(valid[:, None], grid, align_corners=False)[:, 0]
    mask = (mask > 0.99).to(features.dtype)
    c, s = (f(-2 * turn_rad)[:, None, None] for f in (torch.cos, torch.sin))
    turned = []
    for k in range(oriented):
        x, y = sampled[:, 2 * k], sampled[:, 2 * k + 1]
        turned += [c * x - s * y, s * x + c * y]
    return torch.cat([torch.stack(turned, 1), sampled[:, 2 * oriented :]], 1), mask


def correlation_surface(reference: Tensor, query: Tensor, mask: Tensor) -> Tensor:
    """(N, R - Q + 1, R - Q + 1) masked normalised correlation of (N, C, Q, Q) within (N, C, R, R), all offsets (v, u)."""
    size, side = reference.shape[-1], query.shape[-1]
    shape, n = (size, size), size - side + 1
    masked = query * mask[:, None]
    F_reference = torch.fft.rfft2(reference, s=shape)
    product = (F_reference * torch.fft.rfft2(masked, s=shape).conj()).sum(1)
    F_mask = torch.fft.rfft2(mask, s=shape).conj()
    numerator = torch.fft.irfft2(product, s=shape)[:, :n, :n]
    energy = torch.fft.irfft2(torch.fft.rfft2((reference * reference).sum(1), s=shape) * F_mask, s=shape)[:, :n, :n]
    own = (masked * query).sum((1, 2, 3))[:, None, None]
    floor = 1e-3 * mask.sum((1, 2))[:, None, None]
    scores: Tensor = numerator / torch.sqrt((energy.clamp(min=0) + floor) * (own + floor))
    return scores


def offset_loss(surface: Tensor, offset_px: Tensor, sharpness: Tensor) -> Tensor:
    """(N,) cross-entropy of the softmax over the offsets against a Gaussian about the true one (u, v)."""
    n = surface.shape[-1]
    axis = torch.arange(n, dtype=surface.dtype, device=surface.device)
    du, dv = axis[None, None] - offset_px[:, 0, None, None], axis[None, :, None] - offset_px[:, 1, None, None]
    target = torch.exp(-0.5 * (du * du + dv * dv) / TARGET_SIGMA_PX**2).flatten(1)
    target = target / target.sum(1, keepdim=True)
    return -(target * functional.log_softmax((surface * sharpness).flatten(1), 1)).sum(1)


def alignment_loss(reference: Tensor, query: Tensor, mask: Tensor, offset_px: Tensor, displaced_px: Tensor) -> Tensor:
    """(N,) error (px, Huber) of one Lucas-Kanade step that should undo a displacement (N, 2) of the template."""
    size, side = reference.shape[-1], query.shape[-1]
    axis = torch.arange(-1, side + 1, dtype=query.dtype, device=query.device)
    v, u = torch.meshgrid(axis, axis, indexing="ij")
    at = (offset_px + displaced_px)[:, None, None] + torch.stack([u, v], -1)
    template = functional.grid_sample(reference, (2 * at + 1) / size - 1, align_corners=False)
    template, frame = functional.avg_pool2d(template, 3, 1, 1), functional.avg_pool2d(query, 3, 1, 1)
    d_u = (template[..., 1:-1, 2:] - template[..., 1:-1, :-2]) / 2
    d_v = (template[..., 2:, 1:-1] - template[..., :-2, 1:-1]) / 2
    inner = template[..., 1:-1, 1:-1]
    w = mask[:, None]
    rho = (w * frame * inner).sum((1, 2, 3)) / (w * inner * inner).sum((1, 2, 3)).clamp(min=1e-6)
    residual = frame / rho.clamp(min=0.1)[:, None, None, None] - inner
    uu, uv, vv = ((w * a * b).sum((1, 2, 3)) for a, b in ((d_u, d_u), (d_u, d_v), (d_v, d_v)))
    bu, bv = ((w * d * residual).sum((1, 2, 3)) for d in (d_u, d_v))
    damping = 1e-2 * (uu + vv) + 1e-6
    uu, vv = uu + damping, vv + damping
    determinant = uu * vv - uv * uv
    step = torch.stack([(vv * bu - uv * bv) / determinant, (uu * bv - uv * bu) / determinant], 1)
    return functional.smooth_l1_loss(step, -displaced_px, reduction="none", beta=0.5).sum(1)
