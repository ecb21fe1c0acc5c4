"""Silhouettes in an image: of vehicles, and of what hides them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from copy import copy
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from factors.distance_field import DistanceField
from fgrecon.core.camera import Camera
from fgrecon.core.checks import as_finite, as_shape, own
from fgrecon.core.errors import InvalidInputError

_FIX = "Give (H, W) numbers, zero where the vehicle is not, with a pixel at least where it is."
_PIECE = 0.05  # of the largest piece of a mask: smaller ones are strays
_SIGMA = 0.01  # of a mask's size, of its outline: no network's is much better, and no shape of the prior meets it
_MARGIN = 2  # pixels about a mask that are kept: what its distance field needs
_MOST_PIXELS = 1 << 28  # of an image: more fill the memory


@dataclass(frozen=True, eq=False, init=False, repr=False)
class Mask:
    """Where a vehicle is in the image, or what hides it.

    Of several masks a vehicle's is the one about where its 2D box is, or its keypoints; the others hide it.

    Attributes:
        pixels: (h, w) whether a pixel belongs to it, of the part of the image where it is.
        corner: (2,) pixel (u, v) of the first of them.
        image_size: Width and height of the whole image, pixels.
        hides: Whether it is no vehicle but something that hides some.
        sigma: Standard deviation of its outline, pixels; None for 1 % of its size, and half a pixel.
    """

    pixels: NDArray[np.bool_]
    corner: NDArray[np.intp]
    image_size: tuple[int, int]
    hides: bool = False
    sigma: float | None = None

    def __init__(self, pixels: ArrayLike, *, hides: bool = False, sigma: float | None = None) -> None:
        """Take a mask of the whole image.

        Args:
            pixels: (H, W) boolean, or numbers that are zero where it is not. An array or a tensor.
            hides: Whether it is something that hides vehicles.
            sigma: Standard deviation of its outline, pixels.

        Raises:
            InvalidInputError: It is no mask, or empty.
        """
        whole = as_shape("mask", pixels, (None, None), _FIX) > 0.0
        rows, columns = np.flatnonzero(whole.any(axis=1)), np.flatnonzero(whole.any(axis=0))
        if not len(rows):
            raise InvalidInputError("mask", "no pixel", _FIX)
        if sigma is not None:
            sigma = float(as_finite("mask.sigma", sigma, (), "Give pixels, above zero."))
            if sigma <= 0.0:
                raise InvalidInputError("mask.sigma", sigma, "Give pixels, above zero.")
        top, left = max(int(rows[0]) - _MARGIN, 0), max(int(columns[0]) - _MARGIN, 0)
        part = whole[top : int(rows[-1]) + _MARGIN + 1, left : int(columns[-1]) + _MARGIN + 1]
        object.__setattr__(self, "pixels", own(part))
        object.__setattr__(self, "corner", own(np.array((left, top))))
        object.__setattr__(self, "image_size", (whole.shape[1], whole.shape[0]))
        object.__setattr__(self, "hides", bool(hides))
        object.__setattr__(self, "sigma", sigma)

    def __repr__(self) -> str:
        """How large it is, and where."""
        x1, y1, x2, y2 = self.box.tolist()
        what = "hides, " if self.hides else ""
        return f"{type(self).__name__}({what}{int(self.pixels.sum())} pixels in {x1:.0f}, {y1:.0f}, {x2:.0f}, {y2:.0f})"

    @classmethod
    def of_polygons(
        cls,
        polygons: Any,
        image_size: tuple[int, int],
        *,
        hides: bool = False,
        sigma: float | None = None,
    ) -> Mask:
        """The inside of polygons.

        Args:
            polygons: (P, 2) pixels (u, v), or several such, or COCO's flat lists of u, v, u, v, ...
            image_size: Width and height, pixels.
            hides: See the constructor.
            sigma: See the constructor.

        Raises:
            InvalidInputError: They are no polygons, or have no pixel in the image.
        """
        import cv2  # on use: importing fgrecon must not import OpenCV

        _check_size(*image_size, "mask.polygon")
        whole = np.zeros(image_size[::-1], dtype=np.uint8)
        fix = "Give three corners (u, v) at least, in pixels."
        try:
            listed = isinstance(polygons, list | tuple) and len(polygons) > 0
            pairs = not listed or np.size(polygons[0]) <= 2  # one polygon: its corners, or its numbers
            several = [polygons] if pairs else polygons
            each = [np.reshape(np.asarray(one, dtype=np.float64), (-1, 2)) for one in several]
        except (TypeError, ValueError):
            raise InvalidInputError("mask.polygon", polygons, fix) from None
        for one in each:
            corners = as_finite("mask.polygon", one, (None, 2), fix)
            if len(corners) < 3:
                raise InvalidInputError("mask.polygon", corners.tolist(), fix)
            cv2.fillPoly(whole, [np.round(corners * 16.0).astype(np.int32)], 1, shift=4)
        return cls(whole, hides=hides, sigma=sigma)

    @classmethod
    def of_rle(cls, rle: Mapping[str, Any], *, hides: bool = False, sigma: float | None = None) -> Mask:
        """A mask in COCO's run lengths.

        Args:
            rle: `size` (height, width), and `counts` of columns one after the other, as a list or as COCO's string.
            hides: See the constructor.
            sigma: See the constructor.

        Raises:
            InvalidInputError: They are none, or do not fill the image.
        """
        fix = "Give {'size': [height, width], 'counts': [...] or '...'} as COCO has it."
        try:
            height, width = (int(side) for side in rle["size"])
            counts = rle["counts"]
            runs = _run_lengths(counts) if isinstance(counts, str | bytes) else [int(one) for one in counts]
        except (KeyError, TypeError, ValueError, IndexError):
            raise InvalidInputError("mask.rle", type(rle).__name__, fix) from None
        if min(runs, default=-1) < 0 or height < 1 or width < 1 or sum(runs) != height * width:
            raise InvalidInputError("mask.rle", f"{sum(runs)} pixels of {height} x {width}", fix)
        _check_size(width, height, "mask.rle")
        filled = np.repeat(np.arange(len(runs)) % 2, runs)
        return cls(filled.reshape(width, height).T, hides=hides, sigma=sigma)

    @property
    def hiding(self) -> Mask:
        """The same as something that hides vehicles."""
        other = copy(self)
        object.__setattr__(other, "hides", True)
        return other

    @cached_property
    def box(self) -> NDArray[np.float64]:
        """(4,) x1, y1, x2, y2 of its outermost pixels."""
        rows, columns = np.flatnonzero(self.pixels.any(axis=1)), np.flatnonzero(self.pixels.any(axis=0))
        left, top = self.corner.tolist()
        return np.array([left + columns[0], top + rows[0], left + columns[-1], top + rows[-1]], dtype=np.float64)

    @cached_property
    def outline_sigma(self) -> float:
        """Standard deviation of its outline, pixels."""
        size = float((self.box[2:] - self.box[:2]).max())
        return float(np.hypot(0.5, _SIGMA * size)) if self.sigma is None else self.sigma

    @cached_property
    def field(self) -> DistanceField:
        """Signed distance of the pixels about it from its outline."""
        import cv2

        margin = int(max(self.pixels.shape)) // 2 + _MARGIN
        filled = np.pad(self.pixels, margin).astype(np.uint8)
        inside, outside = (
            cv2.distanceTransform(one, cv2.DIST_L2, cv2.DIST_MASK_PRECISE).astype(np.float64)
            for one in (filled, 1 - filled)
        )
        distance = np.where(filled > 0, 0.5 - inside, outside - 0.5)
        return DistanceField((self.corner - margin).astype(np.float64), distance)

    def farthest(self, directions: NDArray[np.float64]) -> NDArray[np.float64]:
        """(M, 2) its farthest points in directions (2, M), pixels; small pieces apart from the others do not count."""
        import cv2

        count, pieces, about, _ = cv2.connectedComponentsWithStats(self.pixels.astype(np.uint8))
        sizes = about[:, cv2.CC_STAT_AREA]
        large = [i for i in range(1, count) if sizes[i] >= _PIECE * sizes[1:].max()]
        row, column = np.nonzero(np.isin(pieces, large))
        first = np.flatnonzero(np.diff(row, prepend=-1))  # the ends of rows: of the convex hull no others are corners
        ends = np.unique(np.concatenate([first, np.append(first[1:], len(row)) - 1]))
        pixels = np.stack([column[ends], row[ends]], axis=1) + self.corner
        return pixels[(pixels @ directions).argmax(axis=0)] + 0.5 * directions.T

    @property
    def whole(self) -> NDArray[np.bool_]:
        """(H, W) the mask in the whole image."""
        filled = np.zeros(self.image_size[::-1], dtype=bool)
        left, top = self.corner.tolist()
        filled[top : top + self.pixels.shape[0], left : left + self.pixels.shape[1]] = self.pixels
        return filled

    def undistorted(self, camera: Camera) -> Mask | None:
        """The mask freed of a camera's lens distortion; None where nothing of it is left in the image."""
        if camera.distortion is None:
            return self
        width, height = self.image_size
        grid = np.stack(np.meshgrid(np.arange(width), np.arange(height)), axis=-1).reshape(-1, 2).astype(np.float64)
        column, row = np.round(camera.distort(grid)).astype(np.intp).T
        within = (column >= 0) & (row >= 0) & (column < width) & (row < height)
        filled = np.zeros(width * height, dtype=bool)
        filled[within] = self.whole[row[within], column[within]]
        return Mask(filled.reshape(height, width), hides=self.hides, sigma=self.sigma) if filled.any() else None

    def __getstate__(self) -> dict[str, Any]:
        """What it is made of; another process makes its distance field again."""
        return {name: value for name, value in vars(self).items() if name not in {"field", "box", "outline_sigma"}}


def joined(masks: Sequence[Mask]) -> Mask:
    """What several masks of an image hide together."""
    filled = masks[0].whole
    for one in masks[1:]:
        filled |= one.whole
    return Mask(filled, hides=True)


def of_vehicle(masks: Sequence[Mask], box: NDArray[np.float64], least: float) -> tuple[Mask | None, list[Mask]]:
    """Of an image's masks the vehicle's, None where none is there, and those of what may hide it.

    Args:
        box: (4,) where the vehicle is, pixels.
        least: Intersection over union of both boxes from which on a mask is the vehicle's.
    """
    alike = [-1.0 if one.hides else _overlap(one.box, box) for one in masks]
    best = int(np.argmax(alike))
    if alike[best] < least:
        return None, []
    about = np.concatenate([np.minimum(masks[best].box[:2], box[:2]), np.maximum(masks[best].box[2:], box[2:])])
    others = [one for i, one in enumerate(masks) if i != best and _overlap(one.box, about) > 0.0]
    return masks[best], others


def _overlap(one: NDArray[np.float64], other: NDArray[np.float64]) -> float:
    """Intersection over union of two boxes (4,)."""
    sides = np.minimum(one[2:], other[2:]) - np.maximum(one[:2], other[:2]) + 1.0
    if sides.min() <= 0.0:
        return 0.0
    both = float(np.prod(sides))
    return both / (float(np.prod(one[2:] - one[:2] + 1.0) + np.prod(other[2:] - other[:2] + 1.0)) - both)


def _check_size(width: int, height: int, field: str) -> None:
    if width * height > _MOST_PIXELS:
        raise InvalidInputError(field, f"an image of {width} x {height} pixels", f"Give at most {_MOST_PIXELS} pixels.")


def _run_lengths(packed: str | bytes) -> list[int]:
    """Run lengths of COCO's string: five bits a character, from the third on as the change to two before."""
    codes = [code - 48 for code in (packed.encode() if isinstance(packed, str) else packed)]
    runs: list[int] = []
    place = 0
    while place < len(codes):
        value = shift = 0
        more = True
        while more:
            code = codes[place]
            value |= (code & 31) << shift
            more, place, shift = bool(code & 32), place + 1, shift + 5
            if not more and code & 16:
                value -= 1 << shift
        runs.append(value + runs[-2] if len(runs) > 2 else value)
    return runs
