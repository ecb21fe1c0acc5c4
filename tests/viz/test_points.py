"""Points of other sensors in pictures, recordings and videos, used ones and others."""

from dataclasses import replace

import matplotlib.colors
import numpy as np
import pytest

from fgrecon.core.reconstruction import Reconstruction
from fgrecon.viz import DrawnVehicle, SolvedVehicle, entities, recording_of, scene_picture, style
from fgrecon.viz.overlay import annotated
from fgrecon.viz.subjects import RecordedFrame
from fgrecon.viz.video_recording import video_recording_of
from tests.results import changed

from .test_video_recording import rows_of

OFFSETS = np.array([[0.0, -0.5, -0.8], [0.4, -0.7, -0.8], [0.0, -0.5, 6.0], [9.0, 0.0, -60.0]])
WEIGHTS = np.array([0.9, 0.6, 0.1, 0.0])


@pytest.fixture
def seen(example):
    """The made-up result with four points: two of the vehicle, one behind it, and one behind the camera."""
    points = example.reconstruction.location + OFFSETS
    return changed(example.reconstruction, points=points, point_weights=WEIGHTS, evidence={"points": 3.5})


def test_used_points_have_the_vehicles_colour_in_the_photograph_and_from_above(example, seen):
    vehicle = DrawnVehicle(1, example.observation.box, seen)
    figure = scene_picture(example.image, [vehicle], example.camera, ground=example.ground)
    photograph, above, aside = figure.axes
    for axes in (photograph, above):
        crosses, dots = [one for one in axes.collections if hasattr(one, "get_sizes") and len(one.get_sizes())][-2:]
        assert len(dots.get_offsets()) == 2
        assert len(crosses.get_offsets()) == 2
        colour = matplotlib.colors.to_rgb(dots.get_facecolors()[0])
        assert tuple(np.rint(255 * np.array(colour)).astype(int)) == style.categorical(1)
    assert "points: used, not used" in [text.get_text() for text in aside.texts]


def test_without_points_nothing_is_said_of_them(example):
    vehicle = DrawnVehicle(1, example.observation.box, example.reconstruction)
    aside = scene_picture(example.image, [vehicle], example.camera).axes[-1]
    assert not any("points" in text.get_text() for text in aside.texts)


def test_they_are_recorded_in_space_and_in_the_image(example, seen, tmp_path):
    path = recording_of(SolvedVehicle(seen, example.observation, example.camera)).write(tmp_path / "points.rrd")
    ((_, places),) = _columns(path, entities.POINTS_3D, "Points3D:positions")
    np.testing.assert_allclose(places, seen.diagnostics.points, atol=1e-5)
    ((_, pixels),) = _columns(path, entities.POINTS_2D, "Points2D:positions")
    assert len(pixels) == 3  # one is behind the camera


def test_a_video_has_those_of_each_frame(example, seen, tmp_path):
    frames = [
        RecordedFrame(number, 0.1 * number, None, (DrawnVehicle(3, example.observation.box, result),))
        for number, result in enumerate((example.reconstruction, seen, example.reconstruction))
    ]
    path = video_recording_of(lambda: frames, example.camera).write(tmp_path / "video.rrd")
    shown = rows_of(path, entities.WORLD_POINTS, "Points3D:positions")
    assert [(number, len(places)) for number, places in shown] == [(1, 4), (2, 0)]
    with_points = annotated(example.image, frames[1].vehicles, example.camera)
    assert (with_points != annotated(example.image, frames[0].vehicles, example.camera)).any()


def test_results_keep_them_but_not_in_their_compact_form(seen, example):
    again = Reconstruction.from_dict(seen.to_dict())
    np.testing.assert_array_equal(again.diagnostics.points, seen.diagnostics.points)
    np.testing.assert_array_equal(again.diagnostics.point_weights, WEIGHTS)
    compact = seen.to_dict(compact=True)
    assert compact["evidence"] == {"points": 3.5}
    assert "points" not in compact
    alone = replace(example.reconstruction).to_dict()
    assert not {"points", "point_weights", "evidence"} & set(alone)


def _columns(path, entity, column):
    from rerun.chunk import RrdReader

    found = []
    for chunk in RrdReader(path).stream():
        batch = chunk.to_record_batch()
        if str(chunk.entity_path) == f"/{entity}" and column in batch.schema.names:
            found += [(None, value) for value in batch.column(column).to_pylist()]
    return found
