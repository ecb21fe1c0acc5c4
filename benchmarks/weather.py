"""Pictures made worse on purpose: night, rain, haze, blur, fewer pixels, another lens.

What a camera would have seen is made up from what it saw by day, so figures on such pictures say where a method begins
to fail, and not how often it will.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np

from fgrecon.core.arrays import Array
from fgrecon.core.camera import Camera

__all__ = ["CHANGES", "View"]

Pixels = np.ndarray[Any, np.dtype[np.uint8]]

_GAMMA = 2.2
_BARREL = np.array([-0.25, 0.06, 0.0, 0.0, 0.0])
"""k1, k2, p1, p2, k3 of a wide lens: KITTI's corners move by a tenth of the image."""


@dataclass(frozen=True)
class View:
    """A picture with boxes.

    Attributes:
        image: (H, W, 3) RGB.
        boxes: (N, 4) x1, y1, x2, y2.
        camera: The camera that is given.
    """

    image: Pixels
    boxes: Array
    camera: Camera


Change = Callable[[View, np.random.Generator], View]


def _night(light: float, electrons: float) -> Change:
    """So much of the daylight, and noise as of a pixel that holds so many electrons when it is white by day."""

    def change(view: View, rng: np.random.Generator) -> View:
        linear = (view.image / 255.0) ** _GAMMA * light
        seen = rng.poisson(np.clip(linear, 0.0, 1.0) * electrons) + rng.normal(0.0, 2.0, linear.shape)
        gained = seen / electrons / light * 0.35  # a camera turns its gain up, not all the way
        return _with(view, np.clip(gained, 0.0, 1.0) ** (1.0 / _GAMMA))

    return change


def _rain(view: View, rng: np.random.Generator) -> View:
    """Streaks, drops on the glass, and little contrast."""
    height, width = view.image.shape[:2]
    grey = 0.65 * view.image / 255.0 + 0.35 * 0.6
    streaks = np.zeros((height, width), np.float32)
    for x, y, length in zip(
        rng.integers(0, width, 900), rng.integers(0, height, 900), rng.integers(8, 30, 900), strict=True
    ):
        cv2.line(streaks, (int(x), int(y)), (int(x + 0.2 * length), int(y + length)), 1.0, 1, cv2.LINE_AA)
    grey += 0.18 * cv2.GaussianBlur(streaks, (0, 0), 0.7)[..., None]
    drops = np.zeros((height, width), np.float32)
    for x, y, radius in zip(
        rng.integers(0, width, 40), rng.integers(0, height, 40), rng.integers(4, 16, 40), strict=True
    ):
        cv2.circle(drops, (int(x), int(y)), int(radius), 1.0, -1)
    share = cv2.GaussianBlur(drops, (0, 0), 2.0)[..., None]
    return _with(view, (1.0 - share) * grey + share * cv2.GaussianBlur(grey, (0, 0), 7.0))


def _hazy(lost: float) -> Change:
    """So much of the contrast lost to a bright veil, near and far."""
    return lambda view, _: _with(view, (1.0 - lost) * view.image / 255.0 + lost * 0.8)


def _blurred(length: int) -> Change:
    """By a camera that pans by so many pixels."""
    kernel = np.full((1, length), 1.0 / length)
    return lambda view, _: replace(view, image=cv2.filter2D(view.image, -1, kernel))


def _coarser(factor: int) -> Change:
    """With so many times fewer pixels along each side, enlarged again."""

    def change(view: View, rng: np.random.Generator) -> View:
        del rng
        height, width = view.image.shape[:2]
        small = cv2.resize(view.image, (width // factor, height // factor), interpolation=cv2.INTER_AREA)
        return replace(view, image=cv2.resize(small, (width, height), interpolation=cv2.INTER_LINEAR))

    return change


def _compressed(quality: int) -> Change:
    """As a JPEG of that quality."""

    def change(view: View, rng: np.random.Generator) -> View:
        del rng
        kept, packed = cv2.imencode(".jpg", view.image, [cv2.IMWRITE_JPEG_QUALITY, quality])
        assert kept
        return replace(view, image=cv2.imdecode(packed, cv2.IMREAD_COLOR))

    return change


def _through_barrel(*, known: bool) -> Change:
    """Through a lens that bends straight lines, which is known or not."""

    def change(view: View, rng: np.random.Generator) -> View:
        del rng
        bent, (height, width) = replace(view.camera, distortion=_BARREL), view.image.shape[:2]
        grid = np.stack(np.meshgrid(np.arange(width), np.arange(height)), axis=-1).reshape(-1, 2).astype(np.float64)
        source = bent.undistort(grid).reshape(height, width, 2).astype(np.float32)
        image = cv2.remap(view.image, source[..., 0], source[..., 1], cv2.INTER_LINEAR)
        left, up, right, down = view.boxes.T
        side = np.linspace(0.0, 1.0, 9)[:, None]
        x, y = left + side * (right - left), up + side * (down - up)
        edges = [(x, up + 0 * x), (x, down + 0 * x), (left + 0 * y, y), (right + 0 * y, y)]
        points = np.stack([np.concatenate([e[i] for e in edges]) for i in (0, 1)], axis=-1)  # (36, N, 2)
        seen = bent.distort(points.reshape(-1, 2)).reshape(points.shape)
        boxes = np.concatenate([seen.min(axis=0), seen.max(axis=0)], axis=1)
        return View(image, boxes, bent if known else view.camera)

    return change


def _with(view: View, image: Array) -> View:
    return replace(view, image=np.clip(255.0 * image + 0.5, 0.0, 255.0).astype(np.uint8))


CHANGES: Mapping[str, Change] = {
    "as it is": lambda view, _: view,
    "dusk (a thirtieth of the light)": _night(1.0 / 30.0, 10_000.0),
    "night (a five-hundredth)": _night(1.0 / 500.0, 10_000.0),
    "rain": _rain,
    "haze, a fifth of the contrast left": _hazy(0.8),
    "haze, a twentieth": _hazy(0.95),
    "blurred by 7 pixels": _blurred(7),
    "JPEG of quality 10": _compressed(10),
    "half the pixels": _coarser(2),
    "a third": _coarser(3),
    "barrel lens, known": _through_barrel(known=True),
    "barrel lens, unknown": _through_barrel(known=False),
}
"""What is done, by name."""
