"""The detector's inputs and outputs, with a network that has learnt nothing."""

import json
from dataclasses import replace

import numpy as np
import pytest
from safetensors import safe_open
from safetensors.numpy import load, save

from fgrecon.core.errors import InvalidInputError
from fgrecon.perception.keypoints.detect import KeypointCascade, as_rgb8
from fgrecon.perception.keypoints.layout import KNetSettings
from fgrecon.perception.keypoints.network_file import load_weights, save_weights
from tests.perception.untrained import untrained

SMALL = KNetSettings(crop=32, width=8)


@pytest.fixture(scope="module")
def detector(tmp_path_factory):
    path = tmp_path_factory.mktemp("weights") / "w.safetensors"
    save_weights(path, untrained(SMALL))
    return KeypointCascade(path)


@pytest.fixture
def image():
    return np.random.default_rng(0).integers(0, 255, (100, 160, 3), dtype=np.uint8)


def test_points_lie_in_the_crop_and_everything_is_a_probability(detector, image):
    boxes = [[10, 20, 90, 70], [100, 10, 180, 90.0]]
    found = detector(image, boxes, maps=True)
    assert len(found) == 2
    for detection, box in zip(found, boxes, strict=True):
        seen = detection.observation
        np.testing.assert_allclose(seen.box, box)
        low, high = detection.crop.to_image([[-1, -1], [32, 32]])
        assert ((seen.keypoints > low) & (seen.keypoints < high)).all()
        assert ((seen.confidence >= 0) & (seen.confidence <= 1)).all()
        assert np.linalg.eigvalsh(seen.covariance).min() > 0
        assert detection.azimuth.sum() == pytest.approx(1.0)
        np.testing.assert_allclose(detection.likelihood.sum(axis=(1, 2)), 1.0, atol=1e-5)


def test_a_batch_says_what_single_boxes_say(detector, image):
    boxes = np.array([[10, 20, 90, 70], [30, 10, 110, 90], [0, 0, 159, 99.0]])
    together = detector(image, boxes, batch=2)
    for box, detection in zip(boxes, together, strict=True):
        (alone,) = detector(image, [box])
        np.testing.assert_allclose(alone.observation.keypoints, detection.observation.keypoints, atol=1e-3)
        np.testing.assert_allclose(alone.observation.confidence, detection.observation.confidence, atol=1e-4)
    assert detector(image, np.zeros((0, 4))) == []


def test_kinds_of_images(detector, image):
    grey = image[..., 0]
    np.testing.assert_array_equal(as_rgb8(grey), np.repeat(grey[..., None], 3, axis=2))
    np.testing.assert_array_equal(as_rgb8(image.astype(np.uint16) * 257), image)
    np.testing.assert_array_equal(as_rgb8(np.dstack([image, grey])), image)
    for bad in (image.astype(float), image[None], image[:0], np.dstack([grey, grey])):
        with pytest.raises(InvalidInputError, match="image"):
            detector(bad, [[10, 20, 90, 70]])


@pytest.mark.parametrize(
    "box", [[10, 10, 14, 14], [50, 50, 40, 60], [500, 10, 600, 90], [150, 10, 400, 90], [10, 10, np.nan, 20]]
)
def test_boxes_without_keypoints_are_refused_by_number(detector, image, box):
    with pytest.raises(InvalidInputError, match=r"boxes\[1"):
        detector(image, [[10, 20, 90, 70], box])


def test_boxes_have_four_numbers(detector, image):
    with pytest.raises(InvalidInputError, match="boxes"):
        detector(image, [[1, 2, 3]])


def test_no_network_is_a_clear_error(tmp_path):
    with pytest.raises(InvalidInputError, match="weights"):
        KeypointCascade(tmp_path / "absent.safetensors")


def test_the_same_network_gives_the_same_bytes(tmp_path):
    about = {name: name for name in "edcba"} | {"ä": "°"}
    stored = untrained(SMALL, provenance=about)
    first, again = (save_weights(tmp_path / f"{i}.safetensors", stored).read_bytes() for i in range(2))
    length = int.from_bytes(first[:8], "little")
    named = list(json.loads(first[8 : 8 + length])["__metadata__"])
    assert named == sorted(named)
    assert length % 8 == 0
    assert first == again
    back = load_weights(tmp_path / "0.safetensors")
    assert back.provenance == about
    for name, value in back.state.items():
        np.testing.assert_array_equal(value, stored.state[name].astype(np.float16))


def test_the_category_is_stored_with_the_weights(tmp_path):
    stored = untrained(SMALL, category="car36")
    path = save_weights(tmp_path / "w.safetensors", stored)
    assert load_weights(path).category == "car36"
    with pytest.raises(InvalidInputError, match=r"14 keypoints in .*Category car36 has 36"):
        KeypointCascade(path)
    assert KeypointCascade(save_weights(path, replace(stored, category="car14"))).category == "car14"


def test_a_file_that_names_no_category_is_of_cars(tmp_path):
    path = save_weights(tmp_path / "w.safetensors", untrained(SMALL))
    with safe_open(str(path), framework="np") as file:
        about = {key: value for key, value in file.metadata().items() if key != "category"}
    path.write_bytes(save(load(path.read_bytes()), about))
    assert load_weights(path).category == "car14"
