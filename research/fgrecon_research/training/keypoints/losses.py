"""Losses of the networks."""

from __future__ import annotations

from typing import Any

import torch
from torch.nn import functional

from fgrecon.perception.keypoints.layout import AZIMUTH_BINS, STRIDE
from fgrecon_research.training.keypoints.knet import KNetOutput

HIDDEN_WEIGHT = 0.25
"""How much the place of a hidden keypoint counts beside a visible one's."""

_AZIMUTH_SIGMA = 8.0  # degrees: about three times the spread of the annotated azimuths
_SHARES = (1.0, 0.5, 0.3, 0.2)  # of maps, visibility, azimuth and kind


def gaussian_maps(points: Any, side: int, stride: float, sigma: float) -> Any:
    """Gaussians around points (..., 2) in pixels, as distributions over side x side cells; flat in the last axis.

    Args:
        points: Pixels; the centre of cell i is at (i + 0.5) * stride - 0.5.
        sigma: Standard deviation, pixels.
    """
    cells = (torch.arange(side, device=points.device) + 0.5) * stride - 0.5
    column, row = (-((points[..., i : i + 1] - cells) ** 2) / (2.0 * sigma**2) for i in (0, 1))
    return torch.softmax((row[..., :, None] + column[..., None, :]).flatten(-2), dim=-1)


def map_loss(maps: Any, points: Any, weight: Any, stride: float, sigma: float) -> Any:
    """Cross entropy of likelihood maps (..., H, W) to Gaussians around points (..., 2), averaged by weight (...)."""
    target = gaussian_maps(points, maps.shape[-1], stride, sigma)
    entropy = -(target * torch.log_softmax(maps.float().flatten(-2), dim=-1)).sum(dim=-1)
    return (entropy * weight).sum() / weight.sum().clamp(min=1.0)


def knet_loss(output: KNetOutput, points: Any, visible: Any, azimuth: Any, kind: Any, sigma: float) -> dict[str, Any]:
    """The parts of KNet's loss, and their weighted sum as `total`.

    Args:
        points: (B, K, 2) pixels of the crop; NaN where unknown: these keypoints do not count.
        visible: (B, K) probability of being seen.
        azimuth: (B,) radians.
        kind: (B,) number of the vehicle's kind; -1 where it is unknown: these do not count.
        sigma: Standard deviation of the targets, pixels.
    """
    size = output.maps.shape[-1] * STRIDE
    inside = ((points > -0.5) & (points < size - 0.5)).all(dim=-1)
    weight = (HIDDEN_WEIGHT + (1.0 - HIDDEN_WEIGHT) * visible) * inside
    maps = map_loss(output.maps, points.nan_to_num(), weight, STRIDE, sigma)
    known = torch.isfinite(points).all(dim=-1).float()
    seen = functional.binary_cross_entropy_with_logits(output.visible.float(), visible, known, reduction="sum")
    seen = seen / known.sum().clamp(min=1.0)
    centres = torch.arange(AZIMUTH_BINS, device=azimuth.device) * (2.0 * torch.pi / AZIMUTH_BINS)
    closeness = (torch.cos(azimuth[:, None] - centres) - 1.0) / torch.deg2rad(torch.tensor(_AZIMUTH_SIGMA)) ** 2
    turn = functional.cross_entropy(output.azimuth.float(), torch.softmax(closeness, dim=1))
    total = _SHARES[0] * maps + _SHARES[1] * seen + _SHARES[2] * turn
    parts = {"maps": maps, "visible": seen, "azimuth": turn}
    if output.kind is not None:
        named = functional.cross_entropy(output.kind.float(), kind, ignore_index=-1, reduction="sum")
        parts["kind"] = named / (kind >= 0).sum().clamp(min=1)
        total = total + _SHARES[3] * parts["kind"]
    return {"total": total, **parts}
