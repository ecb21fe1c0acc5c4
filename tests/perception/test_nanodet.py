"""Boxes from the maps of NanoDet-g, by hand."""

import numpy as np
import pytest

from fgrecon.perception.vehicles import VEHICLE_NAMES, decode

NOTHING, SURE = -50.0, 50.0


def maps(rows, columns):
    """Maps of an input of 32 rows x 32 columns in which there is nothing, by rising stride."""
    cells = [np.zeros((1, 124, scale * rows, scale * columns)) for scale in (4, 2, 1)]
    for cell in cells:
        cell[:, :80] = NOTHING
    return cells


def put(cells, at, row, column, number, distances):
    """A car whose distances are sure: so many cells to the left, upper, right and lower edge."""
    cells[at][0, 2, row, column] = number
    for edge, distance in enumerate(distances):
        cells[at][0, 80 + 11 * edge + distance, row, column] = SURE


def test_a_box_by_hand():
    cells = maps(1, 2)
    put(cells, 2, 0, 1, SURE, (1, 0, 2, 0))  # stride 32: the centre at 48, 16
    put(cells, 0, 1, 3, 0.0, (2, 1, 3, 10))  # stride 8: at 28, 12
    cells[2][0, 7, 0, 1] = SURE + 1.0  # which looks more like a truck
    boxes, scores, numbers = decode(cells, 64, 0.5)
    assert [VEHICLE_NAMES[at] for at in numbers.argmax(axis=1)] == ["car", "truck"]
    assert numbers[1].tolist() == [SURE, NOTHING, NOTHING, SURE + 1.0]
    np.testing.assert_allclose(boxes, [[28 - 16, 12 - 8, 28 + 24, 12 + 80], [48 - 32, 16, 48 + 64, 16]], atol=1e-9)
    np.testing.assert_allclose(scores, [1.0 / (1.0 + np.exp(-1.25)), 1.0])
    assert len(decode(cells, 64, 0.8)[0]) == 1


def test_a_distance_is_the_mean_of_its_distribution():
    cells = maps(1, 1)
    cells[1][0, 2, 1, 0] = SURE
    cells[1][0, 80 + 11 + 3, 1, 0] = np.log(3.0) + SURE  # up: three quarters at 3 cells, a quarter at 7
    cells[1][0, 80 + 11 + 7, 1, 0] = SURE
    ((x1, y1, x2, y2),), *_ = decode(cells, 32, 0.5)
    assert (x1, x2, y2) == pytest.approx((8 - 5 * 16, 8 + 5 * 16, 24 + 5 * 16))  # the others are even: 5 cells
    assert y1 == pytest.approx(24 - 4 * 16)


def test_the_order_of_the_maps_does_not_matter():
    cells = maps(1, 2)
    put(cells, 1, 1, 3, SURE, (1, 1, 1, 1))
    for order in (cells, cells[::-1]):
        np.testing.assert_allclose(decode(order, 64, 0.5)[0], [[56 - 16, 24 - 16, 56 + 16, 24 + 16]], atol=1e-9)


def test_only_cars_count():
    cells = maps(1, 1)
    cells[0][0, 0] = SURE  # persons everywhere
    cells[1][0, 7] = SURE  # lorries
    boxes, scores, _ = decode(cells, 32, 0.01)
    assert boxes.shape == (0, 4)
    assert scores.shape == (0,)
