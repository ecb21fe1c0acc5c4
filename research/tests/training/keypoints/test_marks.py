"""Reading keypoints marked by hand."""

import json
from importlib import resources

import numpy as np
import pytest

from fgrecon.core.errors import InvalidInputError
from fgrecon.io.catalogue import load_category
from fgrecon_research.training.keypoints.marks import read_given_marks, read_photograph_marks, read_street_marks
from fgrecon_research.training.keypoints.posed_cars import read_posed_cars, read_validation_ids

GIVEN = resources.files("fgrecon") / "data" / "marks" / "posed_cars.json"
POINTS = {"keypoints_uv": [[1.0, 2.0]] * 14, "visible": [True] + [False] * 13}


def written(path, entries):
    path.write_text(json.dumps(entries))
    return path


def test_photographs_and_streets(tmp_path):
    photo = {"image": "a.jpg", "width": 20, "height": 10, **POINTS}
    (mark,) = read_photograph_marks(written(tmp_path / "p.json", [photo]), tmp_path)
    assert (mark.name, mark.group, mark.extent) == ("a.jpg", "photographs", 20.0)
    street = {"frame": "000003", "object_index": 2, "regime": "easy", "box_xyxy": [0, 0, 30, 40], **POINTS}
    (mark,) = read_street_marks(written(tmp_path / "s.json", [street]), tmp_path)
    assert (mark.name, mark.group, mark.extent) == ("000003/2", "easy", 40.0)
    assert mark.image == tmp_path / "000003.png"
    np.testing.assert_array_equal(mark.visible, [True] + [False] * 13)


def test_what_is_wrong_is_named(tmp_path):
    photo = {"image": "a.jpg", "width": 20, "height": 10, **POINTS, "visible": [1] * 14}
    with pytest.raises(InvalidInputError, match=r"\[0\].visible"):
        read_photograph_marks(written(tmp_path / "p.json", [photo]), tmp_path)
    with pytest.raises(InvalidInputError, match="list of marked cars"):
        read_street_marks(written(tmp_path / "s.json", {}), tmp_path)


def test_marks_for_the_training_name_photographs_and_keypoints(tmp_path):
    category = load_category("car14")
    entries = [{"image": "b.jpg", "keypoints": {"left_back_roof": [3.0, 4.5]}}]
    marks = read_given_marks(written(tmp_path / "m.json", entries), ["a.jpg", "b.jpg"], category)
    assert marks.shape == (2, 14, 2)
    np.testing.assert_array_equal(marks[1, 12], [3.0, 4.5])
    assert np.isnan(marks).sum() == marks.size - 2


@pytest.mark.parametrize(
    ("entry", "named"),
    [
        ({"image": "c.jpg", "keypoints": {}}, r"\[0\].image"),
        ({"image": "a.jpg", "keypoints": {"bumper": [1, 2]}}, r"keypoints.bumper"),
        ({"image": "a.jpg", "keypoints": {"left_back_roof": [1, None]}}, r"left_back_roof\[1\]"),
    ],
)
def test_marks_that_cannot_be_used_are_named(tmp_path, entry, named):
    with pytest.raises(InvalidInputError, match=named):
        read_given_marks(written(tmp_path / "m.json", [entry]), ["a.jpg"], load_category("car14"))


def test_the_marks_that_come_with_the_package_are_upper_corners_of_rear_windows():
    entries = json.loads(GIVEN.read_text())
    images = [entry["image"] for entry in entries]
    assert len(set(images)) == len(images) > 200
    marks = read_given_marks(GIVEN, images, load_category("car14"))
    marked = np.isfinite(marks).all(axis=-1)
    assert marked[:, 12:].any(axis=1).all()
    assert not marked[:, :12].any()


@pytest.mark.data
def test_no_photograph_of_a_validation_shape_is_marked(data):
    cars = {car.image.name: car for car in read_posed_cars(data / "posed_cars")}
    apart = read_validation_ids(data / "hand_labels" / "validation_cad_ids.json")
    for entry in json.loads(GIVEN.read_text()):
        car = cars[entry["image"]]
        assert car.cad_id not in apart
        assert "Convertible" not in car.name
        for u, v in entry["keypoints"].values():
            assert -0.5 <= u <= car.size[0]
            assert -0.5 <= v <= car.size[1] / 2 + 20
