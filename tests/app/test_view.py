"""What a worker makes for the page, and what mouse and keys do to boxes and keypoints."""

import json
import shutil

import pytest

from fgrecon.app.picture_editor import BOXES, KEYPOINTS, Editor, drawing
from fgrecon.app.requested import Requested
from fgrecon.app.sample import sample_photograph
from fgrecon.app.solving import Uploaded
from fgrecon.app.view import picture_of, recording_of_upload, view_of
from fgrecon.core.errors import InvalidInputError

KITTI = Requested(camera_height="1.65", size_prior="kitti")


@pytest.fixture(scope="module")
def folder(sample, tmp_path_factory):
    place = tmp_path_factory.mktemp("upload")
    for name in ("street.png", "cars.json", "calib.txt"):
        shutil.copy(sample / name, place)
    return place


@pytest.fixture(scope="module")
def view(folder):
    return view_of(folder, Uploaded("cars.json", photograph="street.png"), KITTI)


def test_everything_of_a_keypoint_file(view):
    assert view.size == (1242, 375)
    assert view.photograph.startswith(b"\xff\xd8")
    assert view.files["cars.glb"].startswith(b"glTF")
    assert view.files["above.png"].startswith(b"\x89PNG")
    assert view.files["cars.csv"].count(b"\n") == 1 + len(view.cars)
    assert json.loads(view.files["results.json"])["instances"][0]["result"]["history"]
    assert len(view.horizon) == 2
    assert view.height == pytest.approx(1.65, abs=0.3)
    for car in view.cars:
        assert car.cells[1] == "converged"
        assert len(car.steps[-1].weights) == len(car.keypoints) == len(car.steps[-1].wireframe)
        assert sum(float(probability) for probability, *_ in car.others) == pytest.approx(1.0, abs=0.05)
        assert sum(car.factors.values()) >= len(car.keypoints) // 2


def test_a_calibration_is_the_camera_of_a_photograph(folder):
    seen = view_of(folder, Uploaded("street.png", camera="calib.txt"), KITTI)
    assert seen.camera["K"][0][0] == pytest.approx(721.5, abs=0.1)
    assert not any("No camera" in line for line in seen.warnings)


def test_a_calibration_that_is_none_is_named_without_its_folder(folder):
    (folder / "wrong.txt").write_text("nothing")
    with pytest.raises(InvalidInputError) as refused:
        view_of(folder, Uploaded("street.png", camera="wrong.txt"), KITTI)
    assert "wrong.txt" in str(refused.value)
    assert str(folder) not in str(refused.value)


def test_picture_and_recording(folder):
    uploaded = Uploaded("cars.json", photograph="street.png")
    assert picture_of(folder, uploaded, KITTI).startswith(b"\x89PNG")
    assert recording_of_upload(folder, uploaded, KITTI).startswith(b"RRF")
    assert sample_photograph(folder).startswith(b"\x89PNG")


def test_what_the_editor_gives_is_solved_to_the_same(folder, view):
    (folder / "again.json").write_text(json.dumps(Editor.of(view, KEYPOINTS).keypoint_file(view, {}), allow_nan=False))
    again = view_of(folder, Uploaded("again.json", photograph="street.png"), KITTI)
    for first, second in zip(view.cars, again.cars, strict=True):
        assert second.cells[1] == first.cells[1]
        assert float(second.cells[2]) == pytest.approx(float(first.cells[2]), abs=3.0)


def test_a_box_is_drawn_moved_by_a_corner_and_removed(view):
    editor = Editor.of(view, BOXES)
    before = len(editor.boxes)
    editor.press(900, 50)
    assert editor.move(960, 100)
    assert editor.release()
    assert editor.boxes[-1] == [900, 50, 960, 100]
    editor.press(960, 100)
    editor.move(890, 40)  # beyond the opposite corner
    editor.release()
    assert len(editor.boxes) == before + (editor.boxes[-1][2] - editor.boxes[-1][0] >= 8)
    editor.press(*_middle(editor.boxes[0]))
    editor.move(*(x + 5 for x in _middle(editor.boxes[0])))
    assert editor.release()
    assert editor.key("Delete")
    assert editor.chosen is None


def _middle(box):
    return (box[0] + box[2]) / 2, (box[1] + box[3]) / 2


def test_a_click_makes_no_box(view):
    editor = Editor.of(view, BOXES)
    boxes = [list(box) for box in editor.boxes]
    editor.press(900, 50)
    assert not editor.release()
    assert editor.boxes == boxes


def test_a_keypoint_is_dragged_within_the_image_and_moved_by_keys(view):
    editor = Editor.of(view, KEYPOINTS)
    car, k = next((c, k) for c, points in enumerate(editor.points) for k, p in enumerate(points) if p is not None)
    u, v = editor.points[car][k]
    editor.press(u, v)
    assert editor.chosen is not None
    chosen_car, chosen = editor.chosen
    editor.move(-500, v)
    assert editor.release()
    assert editor.points[chosen_car][chosen][0] == 0.0
    assert editor.key("ArrowRight", far=True)
    assert editor.points[chosen_car][chosen][0] == 10.0
    assert editor.key("Delete")
    assert editor.points[chosen_car][chosen] is None
    assert not editor.key("ArrowLeft")
    editor.key("n")
    assert editor.chosen is not None
    editor.press(5000, 5000)
    assert editor.chosen is None


def test_names_are_text_in_the_drawing(view):
    from dataclasses import replace

    named = replace(view, cars=[replace(view.cars[0], name="<script>alert(1)</script>")])
    drawn = drawing(named, Editor.of(named, KEYPOINTS), None)
    assert "<script" not in drawn
    assert "&lt;script" in drawn
