"""Pictures of keypoint labels."""

import numpy as np
import pytest

from fgrecon.core.errors import InvalidInputError
from fgrecon.core.vehicle_mesh import SIDE_COLOURS, Side
from fgrecon.viz.picture import as_rgb
from fgrecon_research.viz.label_sheet import label_sheet
from tests.io.test_coco_keypoints import make_labels

IMAGE = np.full((375, 1242, 3), 128, dtype=np.uint8)


def drawn(axes):
    """Centres and face colours of the dots."""
    dots = [one for one in axes.collections if hasattr(one, "get_sizes")]
    return [(np.array(one.get_offsets()), one.get_facecolors()) for one in dots]


def test_visible_keypoints_are_filled_and_hidden_ones_hollow(tmp_path):
    labels = make_labels(tmp_path)
    figure = label_sheet(labels, [(vehicle, IMAGE) for vehicle in labels.vehicles], columns=2)
    assert len(figure.axes) == 3
    for axes, vehicle in zip(figure.axes, labels.vehicles, strict=True):
        (visible, filled), (hidden, hollow) = drawn(axes)
        seen = vehicle.flags == 2
        np.testing.assert_allclose(visible, vehicle.keypoints[seen])
        np.testing.assert_allclose(hidden, vehicle.keypoints[~seen])
        left = np.array([name.startswith("left") for name in labels.keypoints])[seen]
        expected = np.where(left[:, None], SIDE_COLOURS[Side.LEFT], SIDE_COLOURS[Side.RIGHT])
        np.testing.assert_allclose(255 * filled[:, :3], expected, atol=0.5)
        assert (hollow[:, :3] == 1.0).all()
        assert f"{vehicle.kind} {vehicle.track}: {seen.sum()} visible" in axes.get_title(loc="left")
    assert as_rgb(figure, dpi=40).std() > 10


def test_nothing_to_draw_is_refused(tmp_path):
    labels = make_labels(tmp_path)
    with pytest.raises(InvalidInputError, match="cells"):
        label_sheet(labels, [])
    with pytest.raises(InvalidInputError, match="columns"):
        label_sheet(labels, [(labels.vehicles[0], IMAGE)], columns=0)
    with pytest.raises(InvalidInputError, match="image"):
        label_sheet(labels, [(labels.vehicles[0], IMAGE[..., 0])])
