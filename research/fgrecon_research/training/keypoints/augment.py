"""Training samples from photographs: cars as street scenes show them.

A car is turned, mirrored, stretched and bent a little (there are more shapes than photographs show), placed before
something else, put in the shade, half hidden by other cars and blocks, cut off by the image's border, and degraded to
the resolution, exposure and compression of a street camera. Everything is drawn from the generator that is passed in.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from fgrecon.core.arrays import Array
from fgrecon.core.shape_prior import ShapePrior
from fgrecon.perception.keypoints.crops import FILL, MARGIN
from fgrecon_research.training.keypoints.deform import (
    Field,
    LabelledView,
    Partner,
    belt_of,
    deform,
    deform_points,
    move_points,
    raise_cabin,
    random_field,
)

Pixels = NDArray[np.uint8]

_TALLEST = 2.2  # times the height above the lamps: a large van beside a saloon
_MOVED = -0.15, 0.5  # share of the way by which parts are moved: a coupe's rear window begins half a roof ahead
_UNEVEN = 0.5  # standard deviation of the logarithm of the boxes' jitter
_SAME = 0.04  # of its longer side: boxes that differ by less are the same
_LEAST_SEEN = 0.3  # of a car's longer side: detectors hardly find one of which less can be seen


@dataclass(frozen=True)
class Sample:
    """What a network is trained on."""

    crop: Pixels  # (S, S, 3) RGB
    keypoints: Array  # (K, 2) pixels of the crop; NaN where unknown
    visible: Array  # (K,) probability that each can be seen
    azimuth: float  # as in `LabelledView`
    kind: int  # likewise


Another = Callable[[float | None], LabelledView]
"""Draws a photograph; one seen from about an azimuth in radians where that is given."""


@dataclass(frozen=True)
class Street:
    """How photographs are turned into samples; the numbers are probabilities where nothing else is said."""

    size: int = 96  # side S of the crop, pixels
    cut_out: float = 0.45  # the car alone is placed before another background
    neighbour: float = 0.35  # another car behind
    covered: float = 0.4  # another car in front
    aligned: float = 0.6  # other cars point the same way
    block: float = 0.2  # a block in front
    backlit: float = 0.15  # the car is in the shade, before something too bright for the camera
    # the picture has little colour, and what is dark in it is black, as a camera for driving sees a shade
    dull: float = 0.5
    truncated: float = 0.12  # the image's border cuts the car off
    # the box is around what can be seen of a hidden car, as a detector's mostly is, and not around all of it
    seen_alone: float = 0.4
    # range of the car's longer side in pixels before it is resampled to the crop
    extent: tuple[float, float] = (24.0, 220.0)
    # standard deviation of the box's centre, and of its size, as a fraction of its longer side; that of the median box,
    # since some are much worse than others
    jitter: float = 0.035
    roll: float = 3.0  # standard deviation of the rotation in the image, degrees
    stretch: float = 0.08  # standard deviation of the logarithm of the car's aspect ratio
    # largest standard deviation of a smooth displacement of the car's parts, as a fraction of the crop's side
    bend: float = 0.025
    moved: float = 0.5  # a pair of parts is moved towards another pair
    raised: float = 0.2  # the cabin is made higher, up to that of a large van
    as_it_is: float = 0.6  # a car in its street, which a camera of the street saw, is not degraded further
    moves: tuple[tuple[int, int], ...] = ()  # keypoints that may be moved, each with the one towards which
    belt: tuple[int, ...] = ()  # keypoints above which the cabin is; none is raised where it is empty

    def shaping(self, prior: ShapePrior) -> Street:
        """The same for cars of a prior: `moves` along the sides of faces off the ground, and `belt`."""
        category = prior.category
        sides = [
            pair
            for face in category.faces
            if not face.ground_parallel
            for pair in zip(face.keypoints, (*face.keypoints[1:], face.keypoints[0]), strict=True)
        ]
        along = [(a, b) for a, b in sides if category.mirror[a] != b]
        return replace(self, moves=(*along, *((b, a) for a, b in along)), belt=belt_of(category, prior.mean))

    def sample(self, view: LabelledView, another: Another, partner: Partner, rng: np.random.Generator) -> Sample:
        """Make one sample.

        Args:
            another: Draws another photograph, for backgrounds and occluders; one seen from about an azimuth where that
                is given.
        """
        if rng.random() < 0.5:
            view = view.mirrored(partner)
        if rng.random() < self.raised:
            view = raise_cabin(view, self.belt, np.exp(rng.uniform(0.0, np.log(_TALLEST))))
        matrix, around, border = self._placement(view, rng)
        car, mask = _warp(view.image, matrix, self.size), _warp(view.mask, matrix, self.size)
        canvas = self._background(another, rng)
        if rng.random() < self.cut_out and view.within is None:  # a street car is where it belongs
            for _ in range(int(rng.random() < self.neighbour) + int(rng.random() < 0.3)):
                canvas = self._paste(canvas, self._other(view, another, rng), rng)[0]
            alpha = cv2.blur(mask, (3, 3))
        else:
            whole = np.full(view.mask.shape, 255, dtype=np.uint8)
            alpha = _warp(whole, matrix, self.size)
        keypoints = view.keypoints @ matrix[:, :2].T + matrix[:, 2]
        field = self._field(keypoints, partner, rng)
        car, alpha, mask = deform(car, field), deform(alpha, field), deform(mask, field)
        keypoints = deform_points(keypoints, field)
        canvas = _blend(canvas, car, alpha)
        untouched = view.within is not None and rng.random() < self.as_it_is
        if rng.random() < self.backlit and not untouched:
            canvas = _backlit(canvas, mask, rng)
        visible = view.visible.copy()
        cover = np.zeros((self.size, self.size), dtype=np.uint8)
        if rng.random() < self.covered:
            canvas, cover = self._paste(canvas, self._other(view, another, rng), rng)
        if rng.random() < self.block:
            canvas, cover = self._block(canvas, cover, rng)
        outside = np.zeros(cover.shape, dtype=bool) if border is None else _beyond(border, self.size)
        cover[outside] = 255
        if rng.random() < self.seen_alone:
            closer = _closer(np.where(cover > 127, 0, mask), *around)
            if closer is not None:
                canvas, cover = (_warp(pixels, closer, self.size) for pixels in (canvas, cover))
                outside = _warp(outside.astype(np.uint8), closer, self.size) > 0
                keypoints = keypoints @ closer[:, :2].T + closer[:, 2]
        at = np.rint(np.nan_to_num(keypoints, nan=-1.0)).astype(int)
        inside = ((at >= 0) & (at < self.size)).all(axis=1)
        column, row = np.clip(at, 0, self.size - 1).T
        visible[~inside | (cover[row, column] > 127)] = 0.0
        crop = canvas.copy() if untouched else self._degrade(canvas, rng)
        crop[outside] = FILL  # what the camera does to its image does not happen beyond it
        return Sample(crop, keypoints, visible, view.azimuth, view.kind)

    def _placement(
        self, view: LabelledView, rng: np.random.Generator
    ) -> tuple[Array, tuple[Array, float], tuple[str, float] | None]:
        """(2, 3) map from the photograph to the crop, the car's box there, and the image's border there.

        The box by its centre (2,) and longer side, the border by side and coordinate.
        """
        low, high = view.box[:2].copy(), view.box[2:].copy()
        width, height = high - low
        side, cut = None, 0.0
        if rng.random() < self.truncated:
            side = ("left", "right", "bottom")[rng.choice(3, p=[0.42, 0.42, 0.16])]
            cut = rng.uniform(0.05, 0.5 if side != "bottom" else 0.3)
            low[0] += cut * width * (side == "left")
            high[0] -= cut * width * (side == "right")
            high[1] -= cut * height * (side == "bottom")
        aspect = np.exp(rng.normal(0.0, self.stretch) * np.array([0.5, -0.5]))
        extent = float(((high - low) * aspect).max())
        jitter = self.jitter * np.exp(rng.normal(0.0, _UNEVEN))
        centre = (low + high) / 2 + rng.normal(0.0, jitter, 2) * extent / aspect
        scale = self.size / (extent * MARGIN * np.exp(rng.normal(0.0, 1.3 * jitter)))
        angle = np.deg2rad(rng.normal(0.0, self.roll)) if side is None else 0.0
        turn = scale * np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]) * aspect
        matrix = np.column_stack([turn, (self.size - 1) / 2 - turn @ centre])
        around = turn @ (low + high) / 2 + matrix[:, 2], extent * scale
        if side is None:
            return matrix, around, None
        corner = turn @ (low if side == "left" else high) + matrix[:, 2]
        return matrix, around, (side, float(corner[1 if side == "bottom" else 0]))

    def _field(self, points: Array, partner: Partner, rng: np.random.Generator) -> Field:
        """How the car's shape is changed: a little at random, and sometimes one pair of parts by far."""
        field = random_field(self.size, rng.uniform(0.0, self.bend) * self.size, rng)
        if not self.moves or rng.random() >= self.moved:
            return field
        part, towards = self.moves[rng.integers(len(self.moves))]
        share, by = rng.uniform(*_MOVED), np.zeros_like(points)
        for a, b in ((part, towards), (partner[part], partner[towards])):
            by[a] = share * (points[b] - points[a])
        return field + move_points(self.size, points, by) if np.isfinite(by).all() else field

    def _other(self, view: LabelledView, another: Another, rng: np.random.Generator) -> LabelledView:
        """A car beside this one: in a street, cars mostly point the same way."""
        return another(view.azimuth if rng.random() < self.aligned else None)

    def _background(self, another: Another, rng: np.random.Generator) -> Pixels:
        kind = rng.random()
        if kind < 0.2:
            return np.full((self.size, self.size, 3), FILL, dtype=np.uint8)
        if kind < 0.45:
            low = rng.uniform(0, 255, (4, 4, 3)).astype(np.float32)
            smooth = cv2.resize(low, (self.size, self.size), interpolation=cv2.INTER_CUBIC)
            noise = rng.normal(0.0, rng.uniform(0, 25), smooth.shape)
            return _bytes(smooth + noise)
        other = another(None).image
        height, width = other.shape[:2]
        scale = self.size / min(height, width) * np.exp(rng.uniform(0.0, 1.2))
        shift = rng.uniform(0, 1, 2) * (self.size - scale * np.array([width, height]))
        canvas = _warp(other, np.array([[scale, 0.0, shift[0]], [0.0, scale, shift[1]]]), self.size)
        return np.asarray(cv2.blur(canvas, (5, 5)) if rng.random() < 0.5 else canvas, dtype=np.uint8)

    def _paste(self, canvas: Pixels, other: LabelledView, rng: np.random.Generator) -> tuple[Pixels, Pixels]:
        """Another car somewhere in the crop, mostly to a side, and the mask of where it is."""
        low, high = other.box[:2], other.box[2:]
        scale = self.size / MARGIN / float((high - low).max()) * np.exp(rng.normal(0.1, 0.3))
        away = rng.choice([-1.0, 1.0]) * rng.uniform(0.3, 0.75)
        middle = self.size * (0.5 + np.array([away, rng.normal(0.08, 0.15)]))
        shift = middle - scale * (low + high) / 2
        matrix = np.array([[scale, 0.0, shift[0]], [0.0, scale, shift[1]]])
        mask = _warp(other.mask, matrix, self.size)
        return _blend(canvas, _warp(other.image, matrix, self.size), cv2.blur(mask, (3, 3))), mask

    def _block(self, canvas: Pixels, cover: Pixels, rng: np.random.Generator) -> tuple[Pixels, Pixels]:
        """Posts, boxes and walls: a rectangle of one colour or of noise."""
        size = rng.uniform(0.06, 0.4, 2) * self.size
        if rng.random() < 0.4:  # a post
            size = np.array([rng.uniform(0.03, 0.12), rng.uniform(0.6, 1.5)]) * self.size
        x1, y1 = np.rint(rng.uniform(0.0, 1.0, 2) * self.size - size / 2).astype(int).clip(0)
        x2, y2 = np.rint([x1 + size[0], y1 + size[1]]).astype(int)
        part = canvas[y1:y2, x1:x2]
        colour = rng.uniform(0, 255, 3) + rng.normal(0.0, rng.uniform(0, 30), part.shape)
        canvas, cover = canvas.copy(), cover.copy()
        canvas[y1:y2, x1:x2] = _bytes(colour)
        cover[y1:y2, x1:x2] = 255
        return canvas, cover

    def _degrade(self, canvas: Pixels, rng: np.random.Generator) -> Pixels:
        low, high = np.log(self.extent)
        pixels = np.exp(rng.uniform(low, high)) * MARGIN
        small = max(int(pixels), 16)
        reduced = small < self.size
        if reduced:
            canvas = np.asarray(cv2.resize(canvas, (small, small), interpolation=cv2.INTER_AREA), dtype=np.uint8)
        if rng.random() < self.dull:
            canvas = _dull(canvas, rng)
        if rng.random() < 0.25:
            canvas = np.asarray(cv2.GaussianBlur(canvas, (0, 0), rng.uniform(0.4, 1.2)), dtype=np.uint8)
        if rng.random() < 0.3:  # a shadow
            normal, offset = rng.normal(size=2), rng.uniform(0.2, 0.8) * len(canvas)
            row, column = np.mgrid[: len(canvas), : len(canvas)]
            shaded = (column - offset) * normal[0] + (row - offset) * normal[1] > 0
            canvas = np.where(shaded[..., None], _bytes(canvas * rng.uniform(0.35, 0.8)), canvas)
        if rng.random() < 0.8:
            light = (np.arange(256) / 255.0) ** np.exp(rng.normal(0.0, 0.35))
            light = (light - 0.5) * rng.uniform(0.6, 1.4) + 0.5 + rng.normal(0.0, 0.1)
            canvas = _bytes(255.0 * light)[canvas]
        if rng.random() < 0.08:  # too bright or too dark for the camera
            canvas = _bytes(canvas * (rng.uniform(1.4, 2.2) if rng.random() < 0.6 else rng.uniform(0.3, 0.6)))
        if rng.random() < 0.12:  # light spilling over
            glare = cv2.GaussianBlur(np.where(canvas > 190, canvas, 0).astype(np.float32), (0, 0), rng.uniform(1, 3))
            canvas = _bytes(canvas + rng.uniform(0.3, 1.0) * glare)
        if rng.random() < 0.5:
            canvas = _bytes(canvas * np.exp(rng.normal(0.0, 0.08, 3)))
        if rng.random() < 0.12:
            canvas = np.repeat(canvas.mean(axis=2, keepdims=True).astype(np.uint8), 3, axis=2)
        if rng.random() < 0.4:
            canvas = _bytes(canvas + rng.normal(0.0, rng.uniform(1, 9), canvas.shape))
        if rng.random() < 0.35:
            quality = int(rng.integers(25, 95))
            canvas = np.asarray(cv2.imdecode(cv2.imencode(".jpg", canvas, [cv2.IMWRITE_JPEG_QUALITY, quality])[1], 1))
        if reduced:
            canvas = np.asarray(cv2.resize(canvas, (self.size, self.size), interpolation=cv2.INTER_LINEAR))
        return np.ascontiguousarray(canvas, dtype=np.uint8)


def _warp(pixels: Pixels, matrix: Array, size: int) -> Pixels:
    """Resample by a (2, 3) map; averages first where the result is much coarser."""
    scale = float(np.sqrt(abs(np.linalg.det(matrix[:, :2]))))
    if scale < 0.6:
        smaller = (max(int(pixels.shape[1] * scale), 1), max(int(pixels.shape[0] * scale), 1))
        ratio = np.array([pixels.shape[1] / smaller[0], pixels.shape[0] / smaller[1]])
        pixels = np.asarray(cv2.resize(pixels, smaller, interpolation=cv2.INTER_AREA), dtype=np.uint8)
        linear = matrix[:, :2] * ratio
        matrix = np.column_stack([linear, matrix[:, 2] + matrix[:, :2] @ (ratio / 2 - 0.5)])
    warped = cv2.warpAffine(pixels, matrix, (size, size), flags=cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT)
    return np.asarray(warped, dtype=np.uint8)


def _closer(image: Pixels, centre: Array, extent: float) -> Array | None:
    """(2, 3) map from a crop by a whole car's box to one by the box of what is seen, jittered alike."""
    rows, columns = np.nonzero(image > 127)
    if not len(rows):
        return None
    low, high = np.array([columns.min(), rows.min()]), np.array([columns.max(), rows.max()])
    share, away = float((high - low).max() + 1) / extent, (low + high) / 2 - centre
    if share < _LEAST_SEEN or (share > 1.0 - _SAME and np.abs(away).max() < _SAME * extent):
        return None
    scale, middle = max(1.0 / share, 1.0), (len(image) - 1) / 2
    return np.column_stack([scale * np.eye(2), middle - scale * (middle + away)])


def _blend(under: Pixels, over: Pixels, alpha: Pixels) -> Pixels:
    share = alpha[..., None].astype(np.uint16)
    return ((over * share + under * (255 - share)) // 255).astype(np.uint8)


def _backlit(canvas: Pixels, mask: Pixels, rng: np.random.Generator) -> Pixels:
    """The car darker, and what is around it brighter."""
    car = cv2.blur(mask, (3, 3))[..., None] / 255.0
    return _bytes(canvas * (rng.uniform(0.25, 0.8) * car + rng.uniform(1.2, 3.0) * (1.0 - car)))


def _dull(canvas: Pixels, rng: np.random.Generator) -> Pixels:
    """Less colour, and dark parts darker."""
    grey = canvas.mean(axis=2, keepdims=True)
    pale = (grey + rng.uniform(0.0, 0.9) * (canvas - grey)) / 255.0
    light = np.maximum(pale - rng.uniform(0.0, 0.08), 0.0) ** rng.uniform(1.0, 1.7)
    return _bytes(255.0 * rng.uniform(0.8, 1.6) * light)


def _bytes(values: NDArray[Any]) -> Pixels:
    return np.clip(values, 0, 255).astype(np.uint8)


def _beyond(border: tuple[str, float], size: int) -> NDArray[np.bool_]:
    """(S, S) which pixels lie outside the image."""
    side, at = border
    row, column = np.mgrid[:size, :size]
    return {"left": column < at, "right": column > at, "bottom": row > at}[side]
