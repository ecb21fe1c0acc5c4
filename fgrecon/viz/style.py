"""Colours and sizes of recordings and pictures: colour-blind safe, the vehicle's left and right distinguishable.

Blue against vermilion (Okabe and Ito) stays apart under every common colour-vision deficiency and in grey print. The
weight map runs through viridis, whose lightness rises with the weight, so it survives a grey printer too. Colours are
8-bit RGB triples; those of the vehicle itself are in `fgrecon.core.sides`.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fgrecon.core.arrays import Array
from fgrecon.core.reconstruction import Reconstruction
from fgrecon.core.vehicle_mesh import SIDE_COLOURS, Colour, Side, edge_sides, keypoint_sides

TRUTH: Colour = (40, 185, 110)
"""What is known to be true: green."""
UNCERTAINTY: Colour = (230, 60, 160)
"""Ellipsoids of the keypoints' covariance."""
PREVIOUS: Colour = (255, 255, 255)
"""The estimate before, drawn faintly in a recording."""
VARIABLE: Colour = (128, 128, 128)
"""Variables of a factor graph in a recording, whose labels viewers draw on black or on white."""
GROUND: Colour = (150, 150, 150)
"""The ground grid of a recording."""
BACKGROUND: Colour = (244, 244, 242)
"""The canvas of a picture where no photograph is given."""
SCREEN_BACKGROUND: Colour = (72, 72, 76)
"""Images and scenes of a recording have it in light viewers and in dark ones: dark enough for light lines, light enough
for keypoints of no weight."""
ALTERNATIVE: Colour = (240, 150, 50)
"""Other poses in a recording: orange."""
MODEL: Colour = (222, 184, 120)
"""The closest car model in a recording."""
INK: Colour = (34, 34, 34)
"""Text, boxes and residuals of a picture."""
FADED: Colour = (96, 96, 96)
"""Text that matters less."""
HAIRLINE: Colour = (205, 205, 205)
"""Borders and grids of a picture."""
PAPER: Colour = (255, 255, 255)
"""Paper, and the casing that keeps lines legible on a photograph."""
SCREEN_INK: Colour = (226, 226, 226)
"""Boxes and residuals of a recording, on `SCREEN_BACKGROUND`."""

ENERGY_COLOURS: dict[str, Colour] = {
    "total": (105, 112, 125),
    "reprojection": (86, 180, 233),
    "box": (230, 159, 0),
    "dimensions": (0, 158, 115),
    "coefficients": (213, 94, 0),
    "ground": (204, 121, 167),
    "planarity": (240, 228, 66),
    "rectangularity": (148, 103, 189),
    "symmetry": (188, 189, 34),
    "laplacian": (0, 114, 178),
    "cheirality": (180, 40, 60),
    "offsets": (140, 86, 75),
    "direction": (127, 127, 127),
    "extra": (23, 190, 207),
}
"""Colour of each named energy term; a term without one takes its turn in `energy_colour`."""

_LEGIBLE = (0.12, 0.18)
"""Luminance of text that is legible on black and on white, where 1 is white."""

_CATEGORICAL: tuple[Colour, ...] = (
    (0, 114, 178),
    (213, 94, 0),
    (0, 158, 115),
    (204, 121, 167),
    (230, 159, 0),
    (86, 180, 233),
    (148, 103, 189),
    (140, 86, 75),
    (127, 127, 127),
    (188, 189, 34),
)
_PLANES: tuple[Colour, ...] = ((86, 180, 233), (230, 159, 0), (204, 121, 167), (0, 200, 150), (240, 228, 66))
# Nine samples of viridis, from dark violet (weight 0) to yellow (weight 1).
_WEIGHT_MAP = np.array(
    [
        (68, 1, 84),
        (71, 44, 122),
        (59, 81, 139),
        (44, 113, 142),
        (33, 144, 141),
        (39, 173, 129),
        (92, 200, 99),
        (170, 220, 50),
        (253, 231, 37),
    ],
    dtype=np.float64,
)


def weight_colours(weights: ArrayLike) -> NDArray[np.uint8]:
    """(..., 3) RGB of weights (...): dark violet at 0, yellow at 1; NaN counts as 0."""
    values = np.clip(np.nan_to_num(np.asarray(weights, dtype=np.float64)), 0.0, 1.0)
    at = np.linspace(0.0, 1.0, len(_WEIGHT_MAP))
    channels = [np.interp(values, at, channel) for channel in _WEIGHT_MAP.T]
    return np.rint(np.stack(channels, axis=-1)).astype(np.uint8)


def weight_radii(weights: ArrayLike, smallest: float = 2.5, largest: float = 6.0) -> Array:
    """(...) radii of weights (...): the disc's area grows linearly with the weight; NaN counts as 0."""
    values = np.clip(np.nan_to_num(np.asarray(weights, dtype=np.float64)), 0.0, 1.0)
    return np.sqrt(smallest**2 + (largest**2 - smallest**2) * values)


def readable(colours: ArrayLike) -> NDArray[np.uint8]:
    """(..., 3) RGB of 8-bit colours (..., 3), lighter or darker so that text of them is legible on black and on white.

    The hue stays; the contrast with either is at least 3 (WCAG).
    """
    unit = np.asarray(colours, dtype=np.float64) / 255.0
    linear = np.where(unit <= 0.04045, unit / 12.92, ((unit + 0.055) / 1.055) ** 2.4)
    luminance = linear @ np.array([0.2126, 0.7152, 0.0722])
    darkest, lightest = _LEGIBLE
    lighter = np.maximum(darkest - luminance, 0.0) / (1.0 - np.minimum(luminance, darkest))  # how much white is added
    linear = linear + lighter[..., None] * (1.0 - linear)
    linear = linear * (lightest / np.maximum(luminance, lightest))[..., None]
    unit = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
    return np.rint(255.0 * unit).astype(np.uint8)


def categorical(index: int) -> Colour:
    """Colour of the series with this index among several; they repeat after ten."""
    return _CATEGORICAL[index % len(_CATEGORICAL)]


def energy_colour(term: str, index: int) -> Colour:
    """Colour of an energy term: its own, else the categorical one of its index."""
    return ENERGY_COLOURS.get(term, categorical(index))


def plane_colour(index: int) -> Colour:
    """Colour of the plane with this index: light ones, which show on a dark screen."""
    return _PLANES[index % len(_PLANES)]


@lru_cache(maxsize=16)
def series_colours(sides: tuple[Side, ...]) -> tuple[Colour, ...]:
    """Colours of one series per keypoint: shades of its side's colour, darker to lighter along the vehicle."""
    colours = []
    for index, side in enumerate(sides):
        rank, count = sides[:index].count(side), max(sides.count(side) - 1, 1)
        base, mix = np.array(SIDE_COLOURS[side]), 0.75 * rank / count - 0.15
        shade = base + mix * (255 - base) if mix > 0 else base * (1 + mix)
        red, green, blue = (int(channel) for channel in shade)
        colours.append((red, green, blue))
    return tuple(colours)


def edges_by_side(result: Reconstruction) -> Mapping[Side, NDArray[np.int64]]:
    """The wireframe's edges (E, 2) by side."""
    return edge_sides(result.shape.edges, keypoint_sides(result.shape.keypoint_names, result.wireframe))
