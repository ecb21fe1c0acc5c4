"""Patches around KNet's estimates: the input and output of the refinement networks."""

from __future__ import annotations

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from fgrecon.core.arrays import Array
from fgrecon.perception.keypoints.layout import PATCH, SETTINGS
from fgrecon.perception.keypoints.sessions import Network

_WINDOW = SETTINGS.fusion_window_px


def patch_offsets(count: int, keypoints: int, seed: int = 0) -> NDArray[np.int64]:
    """(N, K, 2) whole pixels by which patches' centres are off the estimate; the first is centred."""
    rng = np.random.default_rng(seed)
    most = SETTINGS.max_patch_offset_px
    drawn = np.clip(rng.normal(0.0, SETTINGS.patch_sigma_px, (count, keypoints, 2)), -most, most)
    drawn[:1] = 0.0
    return np.rint(drawn).astype(np.int64)


def cut_patches(crops: NDArray[np.uint8], corners: NDArray[np.int64]) -> NDArray[np.uint8]:
    """Patches (B, N, K, 3, 32, 32) of crops (B, S, S, 3) at upper left corners (B, N, K, 2); edges are repeated."""
    size = crops.shape[1]
    edged = np.pad(crops, ((0, 0), (PATCH, PATCH), (PATCH, PATCH), (0, 0)), mode="edge")
    column, row = np.moveaxis(np.clip(corners, -PATCH, size) + PATCH, -1, 0)  # further out there is nothing but edge
    many = np.arange(len(crops))[:, None, None]
    return sliding_window_view(edged, (PATCH, PATCH), axis=(1, 2))[many, row, column]


def fuse(
    patch_log: Array, offsets: NDArray[np.int64], centres: NDArray[np.int64], before_log: Array, trust: float
) -> tuple[Array, NDArray[np.int64]]:
    """One likelihood per keypoint from those of its patches and of KNet.

    Args:
        patch_log: (B, N, K, 32, 32) log likelihoods over the patches.
        offsets: (N, K, 2) by which the patches' centres are off the estimates, pixels of the finer crop.
        centres: (B, K, 2) rounded estimates.
        before_log: (B, K, W, W) KNet's log likelihood over the windows.
        trust: How much the patches count beside KNet.

    Returns:
        (B, K, W, W) normalised likelihoods over windows of `_WINDOW` pixels, and (B, K, 2) their upper left corners.
    """
    batch, count, keypoints = patch_log.shape[:3]
    corner = offsets + (_WINDOW - PATCH) // 2
    total = np.zeros((batch, keypoints, _WINDOW, _WINDOW))
    count_at = np.zeros(total.shape[1:])
    for n, k in np.ndindex(count, keypoints):
        column, row = (slice(low, low + PATCH) for low in corner[n, k])
        total[:, k, row, column] += patch_log[:, n, k]
        count_at[k, row, column] += 1.0
    # In place from here on: new arrays of this size cost more than the numbers in them.
    lowest = total.min(axis=(2, 3), keepdims=True)
    total /= np.maximum(count_at, 1.0)
    np.copyto(total, lowest, where=count_at == 0)
    total *= trust
    total += before_log
    total -= total.max(axis=(2, 3), keepdims=True)
    np.exp(total, out=total)
    total /= total.sum(axis=(2, 3), keepdims=True)
    return total, centres - _WINDOW // 2


def window_of(likelihood: Array, centres: NDArray[np.int64], size: int) -> Array:
    """KNet's log likelihood (B, K, W, W) per pixel of the windows around centres in a finer crop of S pixels.

    Args:
        likelihood: (B, K, H, H) KNet's maps over the same crop.
        centres: (B, K, 2) pixels of the finer crop.
        size: S.
    """
    side = likelihood.shape[-1]
    span = np.arange(_WINDOW) - _WINDOW // 2
    # Bilinear: a pixel of the finer crop lies between cells.
    place = (centres[..., None, :] + span[:, None] + 0.5) * (side / size) - 0.5  # (B, K, W, 2)
    low = np.clip(np.floor(place), 0, side - 2).astype(np.int64)
    part = np.clip(place - low, 0.0, 1.0)
    # Logarithms of the cells under the window, and of no others.
    reach = int((low[:, :, -1] - low[:, :, 0]).max()) + 2
    first = np.minimum(low[:, :, 0], side - reach)  # (B, K, 2)
    cells = first[:, :, None] + np.arange(reach)[:, None]
    b, k = np.mgrid[: len(likelihood), : likelihood.shape[1]][..., None]
    columns, rows = cells[..., 0], cells[..., 1]
    logs = np.log(likelihood[b[..., None], k[..., None], rows[..., None, :], columns[..., :, None]] + 1e-7)
    column, row = np.moveaxis(low - first[:, :, None], -1, 0)
    x, y = np.moveaxis(part[..., None], -2, 0)
    along = logs[b, k, column] * (1 - x) + logs[b, k, column + 1] * x  # (B, K, W, cells)
    along = np.ascontiguousarray(along.swapaxes(2, 3))
    return along[b, k, row] * (1 - y) + along[b, k, row + 1] * y


def run_networks(network: Network, patches: NDArray[np.uint8]) -> Array:
    """Log likelihoods (B, N, K, 32, 32) over patches (B, N, K, 3, 32, 32)."""
    batch, count, keypoints = patches.shape[:3]
    (logs,) = network(patches.reshape(batch * count, keypoints * 3, PATCH, PATCH))
    return np.asarray(logs, dtype=np.float64).reshape(batch, count, keypoints, PATCH, PATCH)
