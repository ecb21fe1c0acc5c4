"""Labels of a folder of photographs: what comes first, and that what is saved is read back."""

import asyncio
import json
import shutil

import numpy as np
import pytest

from fgrecon.app.label_folder import LABELS, LabelFolder
from fgrecon.app.labelling import Judgement, judge, labels_of
from fgrecon.app.picture_editor import KEYPOINTS, Editor
from fgrecon.app.requested import Requested
from fgrecon.app.solving import Uploaded
from fgrecon.app.view import view_of
from fgrecon.app.visit import instances_in_boxes
from fgrecon.core.errors import InvalidInputError
from fgrecon.io.catalogue import load_category
from fgrecon.io.coco_keypoints import read_coco_keypoints
from fgrecon.io.images import write_png

CAR14 = load_category("car14").keypoints
KITTI = Requested(camera_height="1.65", size_prior="kitti")


@pytest.fixture
def folder(sample, tmp_path):
    for name in ("street.png", "other.png"):
        shutil.copy(sample / "street.png", tmp_path / name)
    shutil.copy(sample / "cars.json", tmp_path / "cars.txt")
    return tmp_path


@pytest.fixture(scope="module")
def work(sample, tmp_path_factory):
    place = tmp_path_factory.mktemp("work")
    for name in ("street.png", "cars.json"):
        shutil.copy(sample / name, place)
    return place


@pytest.fixture(scope="module")
def labels(work):
    found, without = labels_of(work, Uploaded("cars.json", photograph="street.png"), KITTI)
    assert without == []
    return found


def test_given_keypoints_are_visible_and_the_others_hidden_where_the_graph_has_them(work, labels):
    instances = json.loads((work / "cars.json").read_text())["instances"]
    assert len(labels) == len(instances)
    for label, given in zip(labels, instances, strict=True):
        seen = {name: point for name, point, flag in zip(CAR14, label.keypoints, label.flags, strict=True) if flag == 2}
        assert 0 < len(seen) < len(CAR14)
        for name, point in seen.items():
            np.testing.assert_allclose(point, given["keypoints"][name][:2])
        assert np.isfinite(label.keypoints).all()
        assert (np.linalg.eigvalsh(label.covariance) > 0).all()
        assert 0.5 < label.agreement <= 1.0
        assert not label.boxed


def test_what_is_saved_is_read_back_and_goes_on(folder, labels):
    labelled = LabelFolder(folder)
    assert labelled.images == ["other.png", "street.png"]
    path = labelled.save("street.png", labels)
    assert path == folder / LABELS
    assert labelled.order[-1] == "street.png"
    again = LabelFolder(folder)
    assert again.righted == {"street.png"}
    assert len(again.labels("street.png")) == len(labels)
    assert again.labels("other.png") == []
    given = json.loads(again.upload("street.png").files["given.json"])
    for one, label in zip(given["instances"], labels, strict=True):
        assert [point is not None for point in one["keypoints"]] == (label.flags == 2).tolist()
    again.save("street.png", labels[:1])
    assert len(read_coco_keypoints(path).vehicles) == 1
    again.save("street.png", [])
    assert not path.exists()


def test_labels_are_solved_to_what_they_were_made_of(folder, labels, tmp_path_factory):
    labelled = LabelFolder(folder)
    labelled.save("street.png", labels)
    upload, place = labelled.upload("street.png"), tmp_path_factory.mktemp("again")
    for name, content in upload.files.items():
        (place / name).write_bytes(content if isinstance(content, bytes) else content.read_bytes())
    found, _ = labels_of(place, upload.names, KITTI)
    for first, second in zip(labels, found, strict=True):
        np.testing.assert_allclose(second.location, first.location, atol=0.5)
        assert (second.flags == first.flags).all()


def test_a_keypoint_that_is_wrong_makes_its_image_come_first(folder, work):
    right = judge(work, Uploaded("cars.json", photograph="street.png"), KITTI)
    content = json.loads((work / "cars.json").read_text())
    car = content["instances"][0]
    name = next(name for name, (_, _, confidence) in car["keypoints"].items() if confidence > 0.75)
    car["keypoints"][name][0] += 90
    (work / "wrong.json").write_text(json.dumps(content))
    wrong = judge(work, Uploaded("wrong.json", photograph="street.png"), KITTI)
    assert wrong.disagreement > right.disagreement + 0.5
    assert wrong.words.startswith(f"{car['id']}: ")
    labelled = LabelFolder(folder)
    labelled.judged = {"other.png": right, "street.png": wrong}
    assert labelled.order == ["street.png", "other.png"]


def test_images_are_looked_at_and_those_that_are_none_come_first(folder):
    (folder / "bad.png").write_bytes(b"no image")
    write_png(folder / "grey.png", np.full((100, 200, 3), 128, dtype=np.uint8))
    labelled = LabelFolder(folder)

    class Here:
        """Works in this process."""

        def place(self):
            from contextlib import nullcontext

            return nullcontext()

        async def __call__(self, files, work, *args):
            assert all(path.parent == folder for path in files.values())
            return work(folder, *args)

    asyncio.run(labelled.judge_all(Here(), KITTI))
    assert labelled.order[0] == "bad.png"
    assert labelled.judged["grey.png"] == Judgement(0.0, "no car detected")
    assert str(folder) not in labelled.judged["bad.png"].words


def test_what_is_no_folder_of_images_is_refused(tmp_path):
    with pytest.raises(InvalidInputError, match="folder"):
        LabelFolder(tmp_path / "none")
    with pytest.raises(InvalidInputError, match="with images"):
        LabelFolder(tmp_path)
    write_png(tmp_path / "a.png", np.zeros((9, 9, 3), dtype=np.uint8))
    (tmp_path / LABELS).write_text('{"format": "other"}')
    with pytest.raises(InvalidInputError, match=LABELS):
        LabelFolder(tmp_path)


def test_a_hidden_keypoint_is_put_where_the_graph_has_it(work):
    view = view_of(work, Uploaded("cars.json", photograph="street.png"), KITTI)
    editor = Editor.of(view, KEYPOINTS)
    assert editor.hidden(0) == {}
    editor.mode, editor.chosen, number, k = KEYPOINTS, (0, 3), 0, 3
    assert editor.key("Delete")
    assert editor.hidden(0) == {3: "right back wheel"}
    editor.place(number, k)
    assert k not in editor.hidden(number)
    given = editor.keypoint_file(view, {})["instances"][number]
    assert given["confidence"][k] == 1.0
    assert given["keypoints"][k] == pytest.approx(view.cars[number].steps[-1].wireframe[k], abs=0.1)


def test_a_box_that_was_drawn_gets_keypoints_and_those_by_hand_stay(work):
    view = view_of(work, Uploaded("cars.json", photograph="street.png"), KITTI)
    editor = Editor.of(view, "boxes")
    x1, y1, x2, y2 = editor.boxes[0]
    editor.press(5, 5)
    editor.move(60, 50)
    assert editor.release()
    assert editor.anew({*editor.cars}) == [len(view.cars)]
    editor.boxes[-1] = [x1, y1, x2, y2]
    (found,) = instances_in_boxes(work, "street.png", editor.boxes[-1:], KITTI)
    text = editor.keypoint_file(view, {len(view.cars): found})
    (work / "drawn.json").write_text(json.dumps(text, allow_nan=False))
    again = view_of(work, Uploaded("drawn.json", photograph="street.png"), KITTI)
    assert [car.name for car in again.cars] == [*editor.cars, f"drawn-{len(view.cars) + 1}"]
    assert again.cars[-1].cells[1] in ("converged", "weak")
