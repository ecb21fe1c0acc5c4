"""Colours carry what they are meant to, for every kind of colour vision and on grey paper."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest

from fgrecon.core.vehicle_mesh import SIDE_COLOURS, Side, edge_sides, keypoint_sides
from fgrecon.viz import style

# Machado, Oliveira and Fernandes (2009), severity 1, on linear RGB.
VISION = {
    "full": np.eye(3),
    "protanopia": [[0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216], [-0.003882, -0.048116, 1.051998]],
    "deuteranopia": [[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413], [-0.011820, 0.042940, 0.968881]],
    "tritanopia": [[1.255528, -0.076749, -0.178779], [-0.078411, 0.930809, 0.147602], [0.004733, 0.691367, 0.303900]],
}


def lab(colour: tuple[int, int, int], vision: str = "full") -> np.ndarray:
    """CIE L*a*b* (D65) of an sRGB colour as seen with a given vision."""
    unit = np.array(colour) / 255
    linear = np.where(unit <= 0.04045, unit / 12.92, ((unit + 0.055) / 1.055) ** 2.4)
    linear = np.clip(np.asarray(VISION[vision]) @ linear, 0, 1)
    xyz = np.array([[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]]) @ linear
    f = np.cbrt(xyz / (0.9505, 1.0, 1.089))
    return np.array([116 * f[1] - 16, 500 * (f[0] - f[1]), 200 * (f[1] - f[2])])


@pytest.mark.parametrize("vision", VISION)
def test_sides_truth_and_residuals_stay_apart(vision: str) -> None:
    for a, b in combinations([*SIDE_COLOURS.values(), style.TRUTH, style.INK], 2):
        assert np.linalg.norm(lab(a, vision) - lab(b, vision)) > 20


def test_left_and_right_stay_far_apart() -> None:
    left, right = SIDE_COLOURS[Side.LEFT], SIDE_COLOURS[Side.RIGHT]
    assert min(np.linalg.norm(lab(left, v) - lab(right, v)) for v in VISION) > 40


def test_a_higher_weight_is_lighter_and_larger() -> None:
    weights = np.linspace(0, 1, 65)
    lightness = [lab(tuple(colour))[0] for colour in style.weight_colours(weights)]
    assert (np.diff(lightness) > 0).all()
    assert lightness[-1] - lightness[0] > 60
    radii = style.weight_radii(weights, 2.0, 6.0)
    assert radii[0] == 2.0
    assert radii[-1] == 6.0
    assert np.allclose(np.diff(radii**2), np.diff(radii**2)[0])


def test_weights_out_of_range_are_clipped_and_nan_is_nothing() -> None:
    colours = style.weight_colours(np.array([[-1.0, np.nan], [0.0, 2.0]]))
    assert colours.shape == (2, 2, 3)
    assert colours.dtype == np.uint8
    assert np.array_equal(colours[0, 0], colours[1, 0])
    assert np.array_equal(colours[0, 1], colours[1, 0])
    assert np.array_equal(colours[1, 1], style.weight_colours(1.0))


def test_sides_come_from_names_else_from_z() -> None:
    wireframe = np.array([[0, 0, -1.0], [0, 0, 1.0], [0, 0, 1.0], [0, 0, -1.0], [0, 0, 0.0], [0, 0, np.nan]])
    names = ("left_wheel", "right_wheel", "p3", "p4", "p5", "p6")
    sides = keypoint_sides(names, wireframe)
    assert sides == (Side.LEFT, Side.RIGHT, Side.LEFT, Side.RIGHT, Side.ACROSS, Side.ACROSS)
    split = edge_sides(np.array([(0, 2), (1, 3), (0, 1), (4, 0)]), sides)
    assert split[Side.LEFT].tolist() == [[0, 2]]
    assert split[Side.RIGHT].tolist() == [[1, 3]]
    assert split[Side.ACROSS].tolist() == [[0, 1], [4, 0]]


def test_no_edges_is_no_edges() -> None:
    split = edge_sides(np.zeros((0, 2), dtype=np.int64), (Side.LEFT,))
    assert all(edges.shape == (0, 2) for edges in split.values())


def test_series_of_one_side_differ() -> None:
    colours = style.series_colours((Side.LEFT, Side.RIGHT) * 7)
    assert len(set(colours)) == 14
    assert all(0 <= channel <= 255 for colour in colours for channel in colour)


def test_named_energies_keep_their_colours() -> None:
    assert style.energy_colour("reprojection", 3) == style.ENERGY_COLOURS["reprojection"]
    assert style.energy_colour("something_new", 3) == style.categorical(3)
    assert len(set(style.ENERGY_COLOURS.values())) == len(style.ENERGY_COLOURS)


def test_labels_are_legible_on_black_and_on_white() -> None:
    """Their contrast with either is at least 3, as WCAG asks of large text; hues stay."""
    labels = [*style.ENERGY_COLOURS.values(), *(style.categorical(i) for i in range(10)), style.VARIABLE]
    labels += [(0, 0, 0), (255, 255, 255), *map(tuple, style.weight_colours(np.linspace(0, 1, 9)))]
    found = style.readable(np.array(labels))
    assert found.shape == (len(labels), 3)
    for colour in found:
        unit = colour / 255
        linear = np.where(unit <= 0.04045, unit / 12.92, ((unit + 0.055) / 1.055) ** 2.4)
        luminance = linear @ (0.2126, 0.7152, 0.0722)
        assert (luminance + 0.05) / 0.05 >= 3
        assert 1.05 / (luminance + 0.05) >= 3
    red, green, blue = style.readable((240, 228, 66)).tolist()
    assert red > green > blue
    grey = style.readable(style.VARIABLE)
    assert np.ptp(grey) <= 1
