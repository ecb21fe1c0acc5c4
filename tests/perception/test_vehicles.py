"""The car detector: decoding and suppression by hand, the shipped file at work."""

import cv2
import numpy as np
import pytest

from fgrecon.core.errors import InvalidInputError
from fgrecon.evaluation.kitti_devkit import REGIMES, match_detections, regime_members
from fgrecon.evaluation.kitti_overlap import box_overlap
from fgrecon.io.catalogue import load_prior
from fgrecon.io.images import read_image
from fgrecon.io.kitti_files import Objects, read_labels
from fgrecon.perception.keypoints import sessions
from fgrecon.perception.vehicles.detect import YoloVehicleDetector, decode, shipped, suppress
from fgrecon.simulation.demo import demo_scene

NOTHING, SURE = -50.0, 50.0


@pytest.fixture(scope="module")
def detector():
    return YoloVehicleDetector()


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


def test_of_boxes_that_overlap_the_best_stays():
    # overlaps with the second: 90 / 110, and 60 / 140 = 0.43; with the third: 70 / 130 = 0.54
    boxes = np.array([[1.0, 0, 11, 10], [0, 0, 10, 10], [4, 0, 14, 10], [50, 0, 60, 10]])
    assert suppress(boxes, np.array([0.8, 0.9, 0.5, 0.4])).tolist() == [1, 2, 3]
    assert suppress(boxes, np.array([0.8, 0.6, 0.9, 0.95])).tolist() == [3, 2, 1]
    assert suppress(np.zeros((0, 4)), np.zeros(0)).tolist() == []


def test_the_file_is_small_and_has_a_model_card():
    assert shipped().stat().st_size < 13e6
    assert shipped().with_suffix(".md").is_file()


@pytest.mark.parametrize("seed", [1, 6])
def test_a_rendered_car_is_found(detector, seed):
    scene = demo_scene(load_prior("car14"), seed)
    found = detector(scene.picture.image)
    assert len(found) == 1
    assert box_overlap(found.boxes, scene.observation.box[None])[0, 0] > 0.75


def test_no_cars_where_there_are_none(detector):
    noise = np.random.default_rng(0).integers(0, 255, (200, 300, 3), dtype=np.uint8)
    grey, line, point = (np.full(shape, 128, np.uint8) for shape in ((375, 1242, 3), (3, 900), (1, 1)))
    for image in (noise, grey, line, point):
        found = detector(image)
        assert found.boxes.shape == (0, 4)
        assert found.scores.shape == (0,)


def test_kinds_of_images(detector):
    image = demo_scene(load_prior("car14"), 6).picture.image
    expected = detector(image)
    for same in (image.astype(np.uint16) * 257, np.dstack([image, image[..., 0]])):
        np.testing.assert_array_equal(detector(same).boxes, expected.boxes)
    assert len(detector(image[..., 1])) == 1
    with pytest.raises(InvalidInputError, match="image"):
        detector(image.astype(float))
    with pytest.raises(InvalidInputError, match="least_score"):
        detector(image, least_score=0.0)
    assert len(detector(image, least_score=1.0)) == 0


@pytest.mark.parametrize("runtime", ["opencv", "onnx"])
def test_files_that_hold_no_network(tmp_path, runtime):
    if runtime == "onnx":
        pytest.importorskip("onnxruntime")
    (tmp_path / "text.onnx").write_text("text")
    for path in (tmp_path / "absent.onnx", tmp_path / "text.onnx", tmp_path):
        with pytest.raises(InvalidInputError, match="weights"):
            YoloVehicleDetector(path, runtime=runtime)


@pytest.mark.parametrize("size", [(320, 960), (97, 61)])
def test_boxes_are_the_same_on_every_runtime(size):
    pytest.importorskip("onnxruntime", reason="the extra fgrecon[onnx] is not installed")
    detectors = [YoloVehicleDetector(runtime=runtime) for runtime in ("opencv", "onnx")]
    assert [detector.runtime for detector in detectors] == ["opencv", "onnx"]
    picture = demo_scene(load_prior("car14"), 6).picture.image
    for image in (picture, cv2.resize(picture, size[::-1])):
        first, second = (detector(image, least_score=0.02) for detector in detectors)
        assert len(first) > 0
        np.testing.assert_allclose(second.boxes, first.boxes, atol=0.01)
        np.testing.assert_allclose(second.scores, first.scores, atol=1e-4)


def test_without_onnx_runtime_the_detector_runs_on_opencv(monkeypatch):
    monkeypatch.setattr(sessions, "find_spec", lambda name: None)
    assert YoloVehicleDetector().runtime == "opencv"
    with pytest.raises(InvalidInputError, match=r"runtime.*fgrecon\[onnx\]"):
        YoloVehicleDetector(runtime="onnx")


def test_no_more_threads_than_opencv_has(monkeypatch):
    pytest.importorskip("onnxruntime")
    asked = []
    monkeypatch.setattr("fgrecon.perception.vehicles.detect.open_session", lambda model, threads: asked.append(threads))
    YoloVehicleDetector(runtime="onnx")
    assert asked == [cv2.getNumThreads()]


def test_cars_of_real_streets_are_found(detector, data):
    folder = data / "kitti_object" / "training"
    files = sorted((folder / "image_2").glob("*.png"))
    if not files:
        pytest.skip("the images of KITTI are absent from the real data")
    labels, _ = read_labels(folder / "label_2", [file.stem for file in files])
    cars = found_cars = boxes = 0
    for file in files:
        image = read_image(file)
        found = detector(image)
        assert (np.diff(found.scores) <= 0).all()
        assert (found.boxes >= 0).all()
        assert (found.boxes[:, 2:] <= [image.shape[1] - 1, image.shape[0] - 1]).all()
        own = labels[file.stem]
        moderate = own.take(regime_members(own, REGIMES[1]) & np.array([kind == "Car" for kind in own.kind]))
        detected = Objects.detections(["Car"] * len(found), found.boxes, found.scores)
        cars += len(moderate)
        found_cars += int((match_detections(moderate, detected, 0.5) >= 0).sum())
        boxes += len(found)
    assert found_cars >= 0.85 * cars
    assert boxes < 3 * cars
