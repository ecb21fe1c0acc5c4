"""Crop geometry: pixels go where the coordinates say, at any scale."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fgrecon.perception.keypoints.crops import FILL, MARGIN, crop_of, extract


@settings(deadline=None, derandomize=True, max_examples=30)
@given(st.integers(0, 2**32 - 1))
def test_the_middle_of_the_crop_is_the_middle_of_the_box(seed):
    rng = np.random.default_rng(seed)
    low = rng.uniform(-50, 500, 2)
    high = low + rng.uniform(5, 400, 2)
    crop = crop_of([*low, *high], 96)
    corners = crop.to_image([[-0.5, -0.5], [95.5, 95.5]])
    np.testing.assert_allclose(corners.mean(axis=0), (low + high) / 2, atol=1e-9)
    np.testing.assert_allclose(corners[1] - corners[0], crop.side, atol=1e-9)
    assert crop.scale == pytest.approx(96 / crop.side)


def test_the_box_fills_the_crop_but_for_the_margin():
    crop = crop_of([100, 50, 180, 90], 96)
    left, right = crop.to_image([[47.5 - 48 / MARGIN, 47.5], [47.5 + 48 / MARGIN, 47.5]])
    np.testing.assert_allclose([left, right], [[100, 70], [180, 70]])


@pytest.mark.parametrize("side", [40, 80, 333, 2000])
def test_a_blob_is_where_its_coordinates_are(side):
    """Also where the image is much finer than the crop."""
    size = 2 * side
    row, column = np.mgrid[:size, :size]
    at = np.array([0.8 * side, 1.1 * side])
    blob = np.exp(-((column - at[0]) ** 2 + (row - at[1]) ** 2) / (2 * (0.04 * side) ** 2))
    image = np.repeat((255 * blob).astype(np.uint8)[..., None], 3, axis=2)
    crop = crop_of([side / 2, side / 2, 1.5 * side, 1.5 * side], 96)
    pixels = extract(image, crop)[..., 0].astype(float)
    row, column = np.mgrid[:96, :96]
    found = np.array([(pixels * column).sum(), (pixels * row).sum()]) / pixels.sum()
    np.testing.assert_allclose(crop.to_image(found), at, atol=0.15 / crop.scale)


def test_outside_the_image_is_grey():
    image = np.zeros((40, 60, 3), dtype=np.uint8)
    pixels = extract(image, crop_of([-30, 0, 20, 40], 96))
    assert (pixels[40:56, :30] == FILL).all()
    assert (pixels[40:56, 70:] == 0).all()


def test_an_enormous_image_needs_no_enormous_copy():
    image = np.full((8, 40000, 3), 200, dtype=np.uint8)
    pixels = extract(image, crop_of([0, 0, 39999, 7], 96))
    assert pixels.shape == (96, 96, 3)
    assert pixels.max() > 127
