"""Boxes that are given by their centres are seen by the ground that they do not stand on."""

import numpy as np
import pytest

from fgrecon import refine_boxes
from fgrecon.core.box3d import Box3D
from fgrecon.core.camera import Ground
from fgrecon.core.choices import BoxOrigin
from fgrecon.errors import ContradictoryInputWarning, InvalidInputError
from fgrecon.io.box_lines import read_box_lines
from fgrecon.solve.box_origin import BOTTOMS, CENTRES, contradicted_origin, on_bottom, with_origin

GROUND = Ground.level(1.65)
PLACES = [(-3.0, 10.0, 1.4), (2.5, 14.0, 1.5), (-9.0, 16.0, 1.8)]


def boxes(share, rise=0.0):
    """Cars whose given points are at a share of their height above a road that rises by so much a metre."""
    return [Box3D([x, 1.65 - rise * z - share * h, z], 1.6, [4.0, 1.7, h]) for x, z, h in PLACES]


def stand_on_centres(some, ground):
    said = contradicted_origin(some, ground, BoxOrigin.BOTTOM)
    assert said in (None, CENTRES)
    return said is not None


def test_bottoms_that_are_said_to_be_centres_are_noticed():
    lowered = on_bottom(boxes(0.0), BoxOrigin.CENTRE)
    assert contradicted_origin(lowered, GROUND, BoxOrigin.CENTRE) == BOTTOMS
    assert contradicted_origin(boxes(0.0), GROUND, BoxOrigin.CENTRE) is None


def test_centres_are_noticed_by_the_given_ground():
    assert stand_on_centres(boxes(0.5), GROUND)
    assert not stand_on_centres(boxes(0.0), GROUND)
    assert not stand_on_centres(boxes(0.0, rise=0.02), GROUND)
    assert not stand_on_centres(boxes(0.5), None)
    assert not stand_on_centres([*boxes(0.5)[:2], boxes(0.0)[2]], GROUND)
    assert not stand_on_centres([], GROUND)


def test_images_together_tell_more_than_one():
    far = [Box3D([3.0, 1.65 - 0.5 * 1.5, z], 1.6, [4.0, 1.7, 1.5]) for z in (40.0, 50.0, 60.0, 45.0, 55.0)]
    assert not any(stand_on_centres([box], GROUND) for box in far)
    assert stand_on_centres(4 * far, GROUND)


def test_one_that_hangs_in_the_air_does_not_hide_the_others():
    assert stand_on_centres([*boxes(0.5), Box3D([0.0, -3.0, 12.0], 0.0, [4.0, 1.7, 1.5])], GROUND)


@pytest.mark.data
@pytest.mark.parametrize("of", ["labels", "a detector"])
def test_real_boxes_are_noticed_only_when_they_are_raised(data, of):
    if of == "labels":
        files = sorted((data / "kitti_tracking" / "label_02").glob("*.txt"))
    else:
        files = sorted((data / "mono_detections" / "dd3d" / "kitti_tracking_0001").glob("*.txt"))
    images = [[line.box(np.zeros(3)) for line in read_box_lines(file) if kept(line)] for file in files]
    together = images if of == "labels" else [[box for image in images for box in image]]
    for found in together:
        standing = [box for box in found if box is not None]
        assert len(standing) > 50
        assert not stand_on_centres(standing, GROUND)
        assert stand_on_centres([with_origin(box, BoxOrigin.CENTRE) for box in standing], GROUND)


def kept(line):
    return line.kind in ("Car", "Van") and line.score >= 0.5


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
