"""What the networks look at: the square crop around a vehicle, and the patches around KNet's estimates in it.

Pixel centres are integers.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import ArrayLike, NDArray

from fgrecon.core.arrays import Array
from fgrecon.core.repr import brief_repr
from fgrecon.perception.keypoints.layout import PATCH, SETTINGS
from fgrecon.perception.keypoints.sessions import Network

MARGIN = 1.2
"""Side of the crop relative to the longer side of the box."""

FILL = 127
"""Value of pixels beyond the image's border: zero to the network."""


@dataclass(frozen=True)
class Crop:
    """A square of an image, resampled to S x S pixels."""

    centre: NDArray[np.float64]  # (2,) its centre in the image, pixels
    side: float  # its side in the image, pixels
    size: int  # S

    __repr__ = brief_repr

    @property
    def scale(self) -> float:
        """Pixels of the crop per pixel of the image."""
        return self.size / self.side

    def to_image(self, pixels: ArrayLike) -> NDArray[np.float64]:
        """Pixels of the crop (..., 2) as pixels of the image."""
        return (np.asarray(pixels) - (self.size - 1) / 2) / self.scale + self.centre

    def from_image(self, pixels: ArrayLike) -> NDArray[np.float64]:
        """Pixels of the image (..., 2) as pixels of the crop."""
        return (np.asarray(pixels) - self.centre) * self.scale + (self.size - 1) / 2


def crop_of(box: ArrayLike, size: int, margin: float = MARGIN) -> Crop:
    """The crop around a box x1, y1, x2, y2 in pixels."""
    x1, y1, x2, y2 = np.asarray(box, dtype=np.float64)
    return Crop(np.array([(x1 + x2) / 2, (y1 + y2) / 2]), max(x2 - x1, y2 - y1) * margin, size)


def extract(image: NDArray[np.uint8], crop: Crop) -> NDArray[np.uint8]:
    """The pixels (S, S, 3) of a crop of an image (H, W, 3); averaged where the image is finer than the crop."""
    import cv2

    # Only the part of the image under the crop: OpenCV cannot warp images of more than 32767 pixels a side.
    height, width = image.shape[:2]
    reach = crop.side / 2 + 2.0 / min(crop.scale, 1.0)
    low = np.clip(np.floor(crop.centre - reach), 0, [width - 1, height - 1]).astype(int)
    high = np.clip(np.ceil(crop.centre + reach) + 1, low + 1, [width, height]).astype(int)
    part = np.ascontiguousarray(image[low[1] : high[1], low[0] : high[0]])
    centre = crop.centre - low
    while crop.side / crop.size > 2.0 and max(part.shape) > 1024:  # bring enormous parts down to a workable size first
        shrink = max(int(crop.side / crop.size), 2)
        part = part[: max(len(part) // shrink, 1) * shrink, : max(part.shape[1] // shrink, 1) * shrink]
        smaller = (max(part.shape[1] // shrink, 1), max(part.shape[0] // shrink, 1))
        part = np.asarray(cv2.resize(part, smaller, interpolation=cv2.INTER_AREA), dtype=np.uint8)
        centre, crop = (centre + 0.5) / shrink - 0.5, Crop(crop.centre, crop.side / shrink, crop.size)
    finer = 2 ** max(0, int(np.ceil(np.log2(crop.side / crop.size))))
    size = crop.size * finer
    scale = size / crop.side
    shift = (size - 1) / 2 - scale * centre
    matrix = np.array([[scale, 0.0, shift[0]], [0.0, scale, shift[1]]])
    pixels = cv2.warpAffine(
        part, matrix, (size, size), flags=cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=(FILL,) * 3
    )
    if finer > 1:
        pixels = cv2.resize(pixels, (crop.size, crop.size), interpolation=cv2.INTER_AREA)
    return np.asarray(pixels, dtype=np.uint8)


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
