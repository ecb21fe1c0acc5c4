"""Boxes from the maps of YOLOv4-tiny, by hand."""

import numpy as np

from fgrecon.perception.vehicles.yolo import decode

NOTHING, SURE = -50.0, 50.0


def maps(rows, columns):
    """Maps of an input of 32 rows x 32 columns in which there is nothing, as (anchor, number, row, column)."""
    return [np.full((3, 85, scale * rows, scale * columns), NOTHING) for scale in (1, 2)]


def flat(cells):
    return [cell.reshape(1, 255, *cell.shape[2:]) for cell in cells]


def test_a_box_by_hand():
    cells = maps(1, 2)
    # head of stride 32, anchor 81 x 82, second column: the middle of the cell, as large as the anchor
    cells[0][0, [0, 1, 2, 3, 4, 7], 0, 1] = [0.0, 0.0, 0.0, 0.0, SURE, SURE]
    # stride 16, 37 x 58, lower left: sigmoid(ln 3) = 0.75, stretched to 1.05 * 0.25 + 0.5 = 0.7625; width doubled
    cells[1][1, [0, 1, 2, 3, 4, 7], 1, 0] = [np.log(3.0), 0.0, np.log(2.0), 0.0, np.log(3.0), np.log(4.0)]
    boxes, scores = decode(flat(cells), 64, 0.5)
    np.testing.assert_allclose(scores, [1.0, 0.75 * 0.8])
    np.testing.assert_allclose(boxes[0], [48 - 40.5, 16 - 41, 48 + 40.5, 16 + 41])
    np.testing.assert_allclose(boxes[1], [12.2 - 37, 24 - 29, 12.2 + 37, 24 + 29])
    assert len(decode(flat(cells), 64, 0.7)[0]) == 1


def test_the_order_of_the_maps_does_not_matter():
    cells = maps(1, 2)
    cells[1][2, [0, 1, 2, 3, 4, 7], 0, 3] = [0.0, 0.0, 0.0, 0.0, SURE, SURE]
    for order in (flat(cells), flat(cells)[::-1]):
        np.testing.assert_allclose(decode(order, 64, 0.5)[0], [[56 - 40.5, 8 - 41, 56 + 40.5, 8 + 41]])


def test_only_cars_count():
    cells = maps(1, 1)
    cells[0][0, [4, 5], 0, 0] = SURE  # a person
    cells[0][1, 7, 0, 0] = SURE  # a car, if there were anything
    boxes, scores = decode(flat(cells), 32, 0.1)
    assert boxes.shape == (0, 4)
    assert scores.shape == (0,)
