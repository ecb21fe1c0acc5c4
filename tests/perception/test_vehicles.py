"""The car detector: passes and suppression by hand, the shipped file at work."""

import hashlib
import json
from functools import partial

import cv2
import numpy as np
import pytest

from fgrecon.calibration.labelled_boxes import box_overlap, match_detections
from fgrecon.core.errors import InvalidInputError
from fgrecon.io.catalogue import load_prior, shipped_class_sizes
from fgrecon.io.images import read_image
from fgrecon.io.kitti_files import Objects
from fgrecon.perception import vehicles
from fgrecon.perception.vehicles import DetectionSettings, NanodetVehicleDetector, NetworkPass, shipped, suppress
from fgrecon.simulation.sample import demo_scene
from fgrecon_research.evaluation.kitti_devkit import REGIMES, regime_members
from fgrecon_research.io.kitti_sets import read_labels


@pytest.fixture(scope="module")
def detector():
    return NanodetVehicleDetector()


def test_of_boxes_that_overlap_the_best_stays():
    # overlaps with the second: 90 / 110, and 60 / 140 = 0.43; with the third: 70 / 130 = 0.54
    boxes = np.array([[1.0, 0, 11, 10], [0, 0, 10, 10], [4, 0, 14, 10], [50, 0, 60, 10]])
    assert suppress(boxes, np.array([0.8, 0.9, 0.5, 0.4]), 0.45).tolist() == [1, 2, 3]
    assert suppress(boxes, np.array([0.8, 0.6, 0.9, 0.95]), 0.45).tolist() == [3, 2, 1]
    assert suppress(boxes, np.array([0.8, 0.6, 0.9, 0.95]), 0.6).tolist() == [3, 2, 0]
    assert suppress(np.zeros((0, 4)), np.zeros(0), 0.45).tolist() == []


def test_the_file_is_small_and_has_a_model_card():
    assert shipped().stat().st_size < 8e6
    card = shipped().with_suffix(".md").read_text(encoding="utf-8")
    assert hashlib.sha256(shipped().read_bytes()).hexdigest() in card


def test_the_terms_of_the_network_come_with_it():
    terms = shipped().with_suffix(".LICENSE.txt").read_text(encoding="utf-8")
    for words in (
        "Copyright 2020-2021 RangiLyu",
        "Apache License",
        "Copyright (c) 2021 Vladimir Mandic",
        "MIT License",
    ):
        assert words in terms


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
    assert box_overlap(detector(image[..., 1]).boxes[:1], expected.boxes[:1])[0, 0] > 0.75
    with pytest.raises(InvalidInputError, match="image"):
        detector(image.astype(float))
    with pytest.raises(InvalidInputError, match="least_score"):
        detector(image, least_score=0.0)
    assert len(detector(image, least_score=1.0)) == 0


def test_files_that_hold_no_network(tmp_path):
    (tmp_path / "text.onnx").write_text("text")
    for path in (tmp_path / "absent.onnx", tmp_path / "text.onnx", tmp_path):
        with pytest.raises(InvalidInputError, match="weights"):
            NanodetVehicleDetector(path)


def test_no_more_threads_than_opencv_has_and_cores_are_free(monkeypatch):
    asked = []
    maps = [np.zeros((1, vehicles.CHANNELS, 2, 2), np.float32) for _ in vehicles.STRIDES]

    def opened(model, threads, device):
        asked.append(threads)
        return lambda blob: maps

    monkeypatch.setattr("fgrecon.perception.vehicles.open_session", opened)
    for free, threads in ((1000, cv2.getNumThreads()), (1, 1)):
        monkeypatch.setattr("fgrecon.perception.vehicles.threads_of_networks", lambda free=free: free)
        NanodetVehicleDetector()
        assert asked[-1] == threads


def test_a_network_of_another_kind_is_refused(monkeypatch):
    monkeypatch.setattr(vehicles, "CHANNELS", 255)
    with pytest.raises(InvalidInputError, match=r"weights.*maps of \[124, 124, 124\] numbers"):
        NanodetVehicleDetector(shipped())


@pytest.fixture
def sizes_seen(monkeypatch):
    return partial(_sizes_seen, monkeypatch)


def _sizes_seen(monkeypatch, image, passes, boxes):
    """What a detector finds in whose every pass the network sees these boxes, as shares; and the input's sizes."""
    inputs = []

    def decode(maps, width, least_score):
        return (
            np.array(boxes)[:, :4] * np.tile(inputs[-1][::-1], 2),
            np.linspace(0.9, 0.8, len(boxes)),
            2.0 * np.eye(4)[np.arange(len(boxes)) % 4],
        )

    monkeypatch.setattr(vehicles, "SETTINGS", DetectionSettings(passes, 0.5, 0.5))
    monkeypatch.setattr(vehicles, "decode", decode)
    detector = NanodetVehicleDetector()
    detector._network = lambda blob: inputs.append(blob.shape[2:])
    return detector(image), inputs


def test_each_look_has_its_area_and_its_size_of_boxes(sizes_seen):
    image = np.zeros((375, 1242, 3), np.uint8)
    boxes = [[0.1, 0.1, 0.2, 0.3], [0.3, 0.1, 0.69, 0.9], [0.55, 0.2, 0.96, 0.8]]
    found, inputs = sizes_seen(image, (NetworkPass(928 * 288), NetworkPass(256 * 80, 0.4)), boxes)
    assert inputs == [(288, 928), (64, 256)]
    assert len(found) == 3  # what the second look sees again is suppressed
    likely = [max(one.probabilities, key=lambda name: one.probabilities[name]) for one in found.classes]
    assert likely == ["car", "bus", "tram"]
    assert found.take(np.array([2])).classes[0] is found.classes[2]
    alone, inputs = sizes_seen(image, (NetworkPass(256 * 80, 0.4),), boxes)
    assert inputs == [(64, 256)]
    np.testing.assert_allclose(alone.boxes, np.array([boxes[2]]) * [1242, 375, 1242, 375] - 0.5)
    tall, _ = sizes_seen(image, (NetworkPass(256 * 80, 0.4),), [[-0.5, 0.0, 0.2, 1.0]])
    assert len(tall) == 0  # what is beyond the border does not count


def test_what_looks_more_like_a_truck_is_more_probably_a_van():
    sizes = shipped_class_sizes()
    odds = [sizes.detected("car", margin) for margin in (-3.0, -0.5, 1.0)]
    assert [one["van"] > 0.5 for one in odds] == [False, False, True]
    assert odds[0]["van"] < 0.01 < 0.1 < odds[1]["van"]
    either = {one["car"] + one["van"] for one in odds}
    assert max(either) - min(either) < 1e-12, "what the name says of lorries stays"
    assert all(sum(one.values()) == pytest.approx(1.0, abs=1e-3) for one in odds)


def test_boxes_that_are_given_have_a_class_as_well(monkeypatch):
    detector = NanodetVehicleDetector()
    boxes = np.array([[10.0, 10, 50, 40], [12.0, 10, 50, 40], [80.0, 10, 120, 40]])
    numbers = np.array([[1.0, -9, -9, -3], [0.0, -9, -9, 1], [-1.0, -9, -9, 3]])
    monkeypatch.setattr(detector, "_detect", lambda *_: (boxes, np.array([0.4, 0.2, 0.05]), numbers))
    image, given = np.zeros((60, 200, 3), np.uint8), np.array([[10.0, 10, 50, 40], [81.0, 10, 120, 40], [0.0, 0, 5, 5]])
    first, second, none = detector.class_numbers(image, given)
    weights = np.array([0.4, 0.2 * 38.0 / 40.0])
    np.testing.assert_allclose(first, weights @ numbers[:2] / weights.sum())
    np.testing.assert_allclose(second, numbers[2])
    assert none is None
    car, van, any_class = detector.classes_of(image, given)
    assert car.probabilities["van"] < 0.2 < van.probabilities["van"]
    assert any_class.probabilities == {"car": 0.0}, "as often as each is"
    assert len(detector(image)) == 1, "the others are no cars"


def test_small_and_narrow_images_are_made_large_enough(sizes_seen):
    for shape, expected in (((1, 1, 3), (64, 64)), ((3, 900, 3), (64, 896)), ((500, 40, 3), (512, 64))):
        _, inputs = sizes_seen(np.zeros(shape, np.uint8), (NetworkPass(928 * 288),), [[0.0, 0.0, 1.0, 1.0]])
        assert inputs == [expected]


def test_a_car_that_fills_a_large_image_is_found(detector):
    picture = demo_scene(load_prior("car14"), 6)
    x1, y1, x2, y2 = np.round(picture.observation.box).astype(int)
    crop = picture.picture.image[max(y1 - 4, 0) : y2 + 4, max(x1 - 4, 0) : x2 + 4]
    large = cv2.resize(crop, (1200, round(1200 * crop.shape[0] / crop.shape[1])), interpolation=cv2.INTER_CUBIC)
    found = detector(large)
    height, width = large.shape[:2]
    assert box_overlap(found.boxes, np.array([[0.0, 0.0, width, height]])).max() > 0.7


def test_scores_are_probabilities(detector, data):
    """On the images on which they were fitted: as many boxes are right as the scores say."""
    right, scores = judged(detector, data, 0.05)
    assert len(scores) > 60
    assert abs(right.sum() - scores.sum()) < 6.0
    sure = scores > 0.5
    assert 0.8 < right[sure].mean() <= 1.0
    assert right[~sure].mean() < 0.3


def streets(data):
    """Images of KITTI and their labels."""
    folder = data / "kitti_object" / "training"
    files = sorted((folder / "image_2").glob("*.png"))
    if not files:
        pytest.skip("the images of KITTI are absent from the real data")
    labels, _ = read_labels(folder / "label_2", [file.stem for file in files])
    return [(read_image(file), labels[file.stem]) for file in files]


def judged(detector, data, least):
    """Whether each box of at least 25 pixels' height is a car or van, and its score; unlabelled areas left out."""
    right, scores = [], []
    for image, labels in streets(data):
        found = detector(image, least_score=least)
        found = Objects.detections(["Car"] * len(found), found.boxes, found.scores)
        found = found.take(found.box[:, 3] - found.box[:, 1] >= 25)
        kinds = np.array(labels.kind)
        matched = match_detections(labels.take(np.isin(kinds, ["Car", "Van"])), found, 0.5)
        good = np.isin(np.arange(len(found)), matched)
        unlabelled = (box_overlap(found.box, labels.box[kinds == "DontCare"], of_first=True) > 0.5).any(axis=1)
        right.append(good[good | ~unlabelled])
        scores.append(found.score[good | ~unlabelled])
    return np.concatenate(right), np.concatenate(scores)


def test_cars_of_real_streets_are_found(detector, data):
    cars = found_cars = boxes = 0
    for image, labels in streets(data):
        found = detector(image)
        assert (np.diff(found.scores) <= 0).all()
        assert (found.boxes >= 0).all()
        assert (found.boxes[:, 2:] <= [image.shape[1] - 1, image.shape[0] - 1]).all()
        moderate = labels.take(regime_members(labels, REGIMES[1]) & np.array([kind == "Car" for kind in labels.kind]))
        detected = Objects.detections(["Car"] * len(found), found.boxes, found.scores)
        cars += len(moderate)
        found_cars += int((match_detections(moderate, detected, 0.5) >= 0).sum())
        boxes += len(found)
    assert found_cars >= 0.95 * cars
    assert boxes < 4 * cars


@pytest.mark.parametrize("enlarged", [1, 4])
def test_photographs_that_a_car_fills(detector, data, enlarged):
    annotations = data / "posed_cars" / "annotations.json"
    if not annotations.is_file():
        pytest.skip("the photographs are absent from the real data")
    found = 0
    for entry in json.loads(annotations.read_text())[::320]:
        image = read_image(data / "posed_cars" / "images" / entry["image"])
        image = cv2.resize(image, None, fx=enlarged, fy=enlarged, interpolation=cv2.INTER_CUBIC)
        whole = np.array([[-0.5, -0.5, image.shape[1] - 0.5, image.shape[0] - 0.5]])
        found += box_overlap(detector(image).boxes, whole).max(initial=0.0) > 0.5
    assert found >= 18  # of 20
