"""Frames of a video with what was found in them."""

from dataclasses import replace

import numpy as np
import pytest

from fgrecon.core.errors import InvalidInputError
from fgrecon.core.reconstruction import Status
from fgrecon.viz import DrawnVehicle, style
from fgrecon.viz.overlay import _write_names, annotated
from tests.results import changed


def near(image, colour, tolerance=40):
    """(H, W) whether a pixel has a colour."""
    return (np.abs(image.astype(int) - colour) < tolerance).all(axis=2)


def shown(example, **changes):
    return DrawnVehicle(3, example.observation.box, example.reconstruction, "9 m", **changes)


def test_a_car_is_drawn_where_it_is(example):
    blank = np.full((375, 1242, 3), 128, np.uint8)
    before = blank.copy()
    drawn = annotated(blank, [shown(example)], example.camera, caption="frame 3")
    assert (blank == before).all()
    assert drawn.shape == (375, 1242 + 396, 3)
    coloured = near(drawn, style.categorical(3))
    x1, y1, x2, y2 = example.observation.box.astype(int)
    assert coloured[max(y1, 0) : y2, x1:x2].sum() > 200
    outside = coloured.copy()
    outside[max(y1 - 40, 0) : y2 + 40, max(x1 - 40, 0) : x2 + 40] = False
    _, columns = np.nonzero(outside)
    assert len(columns) > 10  # in the view from above, which hides nothing of the image
    assert columns.min() >= 1242


@pytest.mark.parametrize(("height", "width"), [(375, 1242), (1080, 1920), (1280, 720)])
def test_the_view_from_above_is_as_high_as_the_frame_and_no_more_than_half_as_wide(height, width, example):
    blank = np.full((height, width, 3), 128, np.uint8)
    panels = [annotated(blank, vehicles, example.camera)[:, width:] for vehicles in ([], [shown(example)])]
    assert panels[0].shape == panels[1].shape
    assert 0.2 * width < panels[0].shape[1] <= 0.5 * width
    assert panels[0].mean() < 60


def test_a_pose_that_is_not_determined_is_a_box_with_words(example):
    """Neither a wireframe, which may cover the image, nor a place in the view from above."""
    blank = np.full((375, 1242, 3), 128, np.uint8)
    box = np.array([600.0, 100.0, 700.0, 180.0])
    lost = replace(example.reconstruction, status=Status.DEGENERATE)
    drawn = annotated(blank, [DrawnVehicle(3, box, lost, "degenerate")], example.camera)
    rows, columns = np.nonzero(near(drawn, style.categorical(3)))
    assert (rows.min(), rows.max(), columns.min(), columns.max()) == pytest.approx((86, 180, 600, 700), abs=3)
    assert near(drawn, style.categorical(3))[110:170, 610:690].sum() == 0


def test_the_view_from_above_is_to_scale(example):
    """A car twice as far away is twice as far up; one to the right is to the right."""
    blank = np.full((375, 1242, 3), 128, np.uint8)
    middles = []
    for x, z in ((0.0, 20.0), (0.0, 40.0), (10.0, 20.0)):
        pose = example.reconstruction.camera_T_object.copy()
        pose[:3, 3] = [x, 1.65, z]
        result = changed(example.reconstruction, camera_T_object=pose)
        drawn = annotated(blank, [DrawnVehicle(3, np.array([0.0, 0, 5, 5]), result)], example.camera)
        rows, columns = np.nonzero(near(drawn, style.categorical(3)))
        inset = columns >= 1242
        middles.append((columns[inset].mean(), rows[inset].mean()))
    (x0, y0), (x1, y1), (x2, _) = middles
    scale = (y0 - y1) / 20.0
    assert scale == pytest.approx(375 / 53, rel=0.05)
    assert x1 == pytest.approx(x0, abs=2.0)
    assert (x2 - x0) / 10.0 == pytest.approx(scale, rel=0.15)


def test_a_box_without_a_result_is_a_box(example):
    blank = np.full((375, 1242, 3), 128, np.uint8)
    drawn = annotated(blank, [DrawnVehicle(3, np.array([100.0, 100, 200, 180]))], example.camera)
    assert near(drawn, style.categorical(3))[100, 110:190].all()
    assert (drawn[300:, :1242] == 128).all()
    with pytest.raises(InvalidInputError, match="image"):
        annotated(blank[..., 0], [], example.camera)


def test_names_of_many_vehicles_do_not_overlap(example):
    """All ids can be read; what does not find room are words."""
    vehicles = [
        DrawnVehicle(n, np.array([600.0 + 4 * n, 160.0, 640.0 + 4 * n, 200.0]), words="12 m, 30 km/h")
        for n in range(12)
    ]
    taken = []
    _write_names(np.full((375, 1242, 3), 128, np.uint8), vehicles, taken)
    assert len(taken) == 12
    for index, (left, top, right, bottom) in enumerate(taken):
        assert left >= 0
        assert top >= 0
        assert not any(left < r and l < right and top < b and t < bottom for l, t, r, b in taken[:index])  # noqa: E741


def test_a_name_has_class_and_score_of_the_detection(example):
    blank = np.full((375, 1242, 3), 128, np.uint8)
    box = np.array([100.0, 100, 200, 180])
    pictures = [
        annotated(blank, [DrawnVehicle(3, box, **shown_as)], example.camera)
        for shown_as in ({"detection": "Van 0.87", "words": "9 m"}, {"words": "Van 0.87, 9 m"}, {"words": "9 m"})
    ]
    np.testing.assert_array_equal(pictures[0], pictures[1])
    assert not np.array_equal(pictures[0], pictures[2])


def test_rings_have_their_distances(example):
    """Each at its ring: the panel differs there from lines alone."""
    panel = annotated(np.full((375, 1242, 3), 128, np.uint8), [], example.camera)[:, 1242:]
    bright = near(panel, style.HAIRLINE)
    scale = 375 / 53
    for ring in (10.0, 20.0, 30.0, 40.0, 50.0):
        u, v = (
            panel.shape[1] / 2 + ring * np.sin(np.radians(28)) * scale,
            375 - (ring * np.cos(np.radians(28)) + 3) * scale,
        )
        assert bright[max(round(v) - 6, 0) : round(v) + 7, round(u) - 15 : round(u) + 16].sum() > 20
