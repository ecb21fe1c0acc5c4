"""What `Reconstruction.plot` and notebooks show."""

import base64
import io
import pickle
import re
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

from fgrecon.core.errors import InvalidInputError, MissingPackageError
from fgrecon.core.observation import Observation
from fgrecon.core.reconstruction import Status
from fgrecon.core.track_reconstruction import TrackReconstruction
from fgrecon.io.images import write_png
from fgrecon.viz import DrawnVehicle, SolvedVehicle, notebook, recording_of, scene_picture
from fgrecon.viz.picture import as_rgb
from tests.results import changed
from tests.viz.made_up import make_example


@pytest.fixture(scope="module")
def example():
    return make_example()


@pytest.fixture(scope="module")
def track(example):
    result = example.reconstruction
    frames = (result, replace(result, status=Status.AMBIGUOUS))
    return TrackReconstruction(Status.CONVERGED, "Both.", (0, 2), frames, {1: "none"}, {}, (), (), {"joint": 1.0})


def titles(figure):
    return [axes.get_title(loc="left") for axes in figure.axes]


def test_a_result_over_its_image_in_3d_and_from_above(example, tmp_path):
    result = example.reconstruction
    figure = notebook.plot(result, example.image)
    over, solid, above = titles(figure)
    assert (over, above) == ("Result", "From above")
    assert solid.startswith("In 3D, from the ")
    assert any("rotation_y" in text.get_text() for text in figure.texts)
    plain = as_rgb(notebook.plot(result), 80)
    over = as_rgb(figure, 80)
    assert (plain != over).any()
    from_file = notebook.plot(result, write_png(tmp_path / "a.png", example.image))
    np.testing.assert_array_equal(as_rgb(from_file, 80), over)
    with_points = notebook.plot(result, example.image, observation=example.observation)
    assert (as_rgb(with_points, 80) != over).any()


def test_the_wireframe_lies_where_the_image_has_it(example):
    axes = notebook.plot(example.reconstruction).axes[0]
    (x1, x2), (y2, y1) = axes.get_xlim(), axes.get_ylim()
    pixels = example.reconstruction.pose.wireframe_uv
    assert ((pixels > (x1, y1)) & (pixels < (x2, y2))).all()


def test_without_a_pose_the_keypoints_alone(example):
    nowhere = changed(example.reconstruction, camera_T_object=np.full((4, 4), np.nan))
    assert titles(notebook.plot(nowhere, observation=example.observation)) == ["No pose"]
    assert notebook.html(nowhere).startswith("<div><img")


def test_what_cannot_be_drawn_is_refused(example, track):
    with pytest.raises(InvalidInputError, match="observation"):
        notebook.plot(example.reconstruction, observation=Observation(np.zeros((4, 2)), np.ones(4)))
    with pytest.raises(InvalidInputError, match="image"):
        notebook.plot(example.reconstruction, example.image.astype(float))
    with pytest.raises(InvalidInputError, match="images: got 2 images"):
        notebook.plot_track(track, [example.image] * 2)


def test_a_track_has_a_cell_for_each_image(example, track):
    figure = notebook.plot_track(track, [example.image] * 3)
    assert titles(figure) == ["0: converged", "2: ambiguous"]


def test_html_has_the_picture_and_the_numbers(example, track):
    for result, words in ((example.reconstruction, "keypoints trusted"), (track, "2 solved, 1 refused")):
        html = notebook.html(result)
        assert words in html
        data = re.search(r"data:image/png;base64,([^\"]+)", html).group(1)
        with Image.open(io.BytesIO(base64.b64decode(data))) as picture:
            assert min(picture.size) > 150


def test_html_escapes_what_it_tells(example):
    assert "<b>" not in notebook.html(replace(example.reconstruction, message="a <b>bold</b> claim"))


def test_a_notebook_shows_a_long_track_in_part(track):
    frames = track.frames[:1] * 30
    long = replace(track, frames=frames, numbers=tuple(range(30)))
    data = re.search(r"base64,([^\"]+)", notebook.html(long)).group(1)
    with Image.open(io.BytesIO(base64.b64decode(data))) as picture:
        assert picture.height < 700


def test_a_figure_shows_itself_without_pyplot(example):
    for figure in (example.reconstruction.plot(), as_scene(example)):
        shown = Image.open(io.BytesIO(figure._repr_png_()))
        assert 500 < shown.width <= 1200
        assert type(pickle.loads(pickle.dumps(figure))) is type(figure)


def as_scene(example):
    box = example.observation.box
    return scene_picture(None, [DrawnVehicle(0, box, example.reconstruction)], example.camera)


def test_the_widget_needs_its_package(example, monkeypatch):
    recording = recording_of(SolvedVehicle(example.reconstruction, example.observation, example.camera))
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    with pytest.raises(MissingPackageError, match=r"rerun-sdk\[notebook\]"):
        recording.widget()


def test_the_widget_gets_layout_and_content(example):
    pytest.importorskip("rerun_notebook")
    recording = recording_of(SolvedVehicle(example.reconstruction, example.observation, example.camera, example.image))
    widget = recording.widget(height=400)
    assert "Viewer" in type(widget).__name__
