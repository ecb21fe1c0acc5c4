"""The networks that come with the package, on rendered cars: no data is needed."""

import numpy as np
import pytest
from safetensors import safe_open

from fgrecon.core.metrics import orientation_error
from fgrecon.core.reconstruction import rotation_y
from fgrecon.io.catalogue import load_category, load_prior
from fgrecon.perception.from_image import reconstruct_image
from fgrecon.perception.keypoints.detect import KeypointCascade, detect_keypoints
from fgrecon.perception.keypoints.network_file import load_weights, shipped
from fgrecon.simulation.sample import demo_scene


@pytest.fixture(scope="module")
def scenes():
    return [demo_scene(load_prior("car14"), seed) for seed in (0, 1, 2)]


@pytest.fixture(scope="module")
def detector():
    return KeypointCascade()


def test_the_file_is_small_and_says_what_it_is():
    assert shipped().stat().st_size < 25e6
    assert shipped().with_suffix(".md").is_file()
    stored = load_weights(shipped())
    assert stored.settings["keypoints"] == load_category("car14").size
    assert stored.provenance["data"]
    with safe_open(str(shipped()), framework="pt") as file:
        assert file.metadata()["category"] == stored.category == "car14"


def test_keypoints_of_rendered_cars_are_found_and_hidden_ones_known(scenes, detector):
    right, sure, hidden = [], [], []
    for scene in scenes:
        (found,) = detector(scene.picture.image, [scene.observation.box])
        seen = found.observation
        error = np.linalg.norm(seen.keypoints - scene.truth.projections, axis=1) / scene.observation.extent
        right += (error[scene.truth.visible] < 0.1).tolist()
        sure += seen.confidence[scene.truth.visible].tolist()
        hidden += seen.confidence[~scene.truth.visible].tolist()
    assert np.mean(right) > 0.85
    assert np.mean(sure) > np.mean(hidden) + 0.3


def test_rendered_cars_are_reconstructed_from_their_pixels(scenes, detector):
    for scene in scenes:
        (vehicle,) = reconstruct_image(
            scene.picture.image,
            scene.camera,
            [scene.observation.box],
            keypoint_detector=detector,
            ground=scene.ground,
        )
        truth = rotation_y(scene.truth.camera_T_object)
        assert orientation_error([vehicle.result.rotation_y], [truth])[0] < 10.0


def test_the_mirror_image_has_the_mirrored_keypoints(scenes, detector):
    scene, mirror = scenes[0], load_category("car14").mirror
    width = scene.picture.image.shape[1]
    x1, y1, x2, y2 = scene.observation.box
    (found,) = detector(scene.picture.image, [[x1, y1, x2, y2]])
    flipped = np.ascontiguousarray(scene.picture.image[:, ::-1])
    (turned,) = detector(flipped, [[width - 1 - x2, y1, width - 1 - x1, y2]])
    sure = found.observation.confidence > 0.5
    back = turned.observation.keypoints[mirror] * [-1, 1] + [width - 1, 0]
    distance = np.linalg.norm(back - found.observation.keypoints, axis=1)[sure] / scene.observation.extent
    assert np.median(distance) < 0.03


def test_one_call_from_image_to_observations(scenes, detector):
    scene = scenes[0]
    (seen,) = detect_keypoints(scene.picture.image, [scene.observation.box])
    (found,) = detector(scene.picture.image, [scene.observation.box])
    for name in ("keypoints", "confidence", "covariance"):
        np.testing.assert_array_equal(getattr(seen, name), getattr(found.observation, name))
    np.testing.assert_allclose(seen.box, scene.observation.box)
