"""Boxes that are given by their centres are seen by the ground that they do not stand on."""

import numpy as np
import pytest

from fgrecon import refine_boxes
from fgrecon.core.box3d import Box3D
from fgrecon.core.camera import Ground
from fgrecon.core.choices import BoxOrigin
from fgrecon.errors import ContradictoryInputWarning, InvalidInputError
from fgrecon.solve.box_origin import on_bottom, stand_on_centres, with_origin

GROUND = Ground.level(1.65)
PLACES = [(-3.0, 10.0, 1.4), (2.5, 14.0, 1.5), (-9.0, 16.0, 1.8)]


def boxes(share, rise=0.0):
    """Cars whose given points are at a share of their height above a road that rises by so much a metre."""
    return [Box3D([x, 1.65 - rise * z - share * h, z], 1.6, [4.0, 1.7, h]) for x, z, h in PLACES]


def test_centres_are_noticed_by_the_given_ground():
    assert stand_on_centres(boxes(0.5), GROUND)
    assert not stand_on_centres(boxes(0.0), GROUND)
    assert not stand_on_centres(boxes(0.0, rise=0.02), GROUND)
    assert not stand_on_centres(boxes(0.5), None)
    assert not stand_on_centres([*boxes(0.5)[:2], boxes(0.0)[2]], GROUND)
    assert not stand_on_centres([], GROUND)


def test_centres_are_lowered_and_raised_again():
    lowered = on_bottom(boxes(0.5), BoxOrigin.CENTRE)
    for one, bottom, centre in zip(lowered, boxes(0.0), boxes(0.5), strict=True):
        np.testing.assert_allclose(one.location, bottom.location)
        np.testing.assert_allclose(with_origin(one, BoxOrigin.CENTRE).location, centre.location)
    with pytest.raises(InvalidInputError, match="size"):
        on_bottom([Box3D([0.0, 1.0, 9.0], 0.0)], BoxOrigin.CENTRE)


def test_none_of_them_is_refined():
    image = np.zeros((375, 1242, 3), dtype=np.uint8)
    with pytest.warns(ContradictoryInputWarning, match="half their height above the given ground"):
        refined = refine_boxes(image, boxes(0.5), (720.0, 720.0, 610.0, 173.0), ground=1.65)
    assert [box.changed for box in refined] == [False] * 3
