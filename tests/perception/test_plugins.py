"""Detectors of one's own plug in by their call signature; what does not fit is refused by name."""

import warnings
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from PIL import Image

import fgrecon
from fgrecon.core.detection import Detection
from fgrecon.core.errors import AssumedCameraWarning, InvalidInputError
from fgrecon.core.observation import Observation
from fgrecon.core.options import Options
from fgrecon.io.catalogue import load_prior
from fgrecon.io.images import write_png
from fgrecon.perception import KeypointDetector, VehicleDetector, Vehicles, reconstruct_image
from fgrecon.perception.keypoints import CascadeDetection, KeypointCascade
from fgrecon.perception.vehicles import NanodetVehicleDetector
from fgrecon.solve.proposals.terms import direction_penalty
from tests.cars import CAMERA, observe, yaw_pose

FAST = Options(keep_history=False, box="off")
POSE = yaw_pose(0.8)
IMAGE = np.zeros((375, 1242, 3), dtype=np.uint8)


@pytest.fixture(scope="module")
def seen():
    return observe(load_prior("car14"), POSE)


class Own:
    """A keypoint detector that answers the same to everything."""

    category = "car14"

    def __init__(self, *answer):
        self.answer, self.calls = list(answer), []

    def __call__(self, image, boxes):
        self.calls.append((image, boxes))
        return self.answer


def solve(detector, boxes, image=IMAGE, camera=CAMERA, **known):
    return reconstruct_image(image, camera, boxes, keypoint_detector=detector, options=FAST, **known)


def test_an_own_keypoint_detector_is_called_once_with_image_and_boxes(seen):
    own = Own(seen, seen)
    cars = solve(own, [seen.box, seen.box])
    ((image, boxes),) = own.calls
    np.testing.assert_array_equal(image, IMAGE)
    np.testing.assert_array_equal(boxes, [seen.box, seen.box])
    assert [type(car.detection) for car in cars] == [Detection, Detection]
    for car in cars:
        assert car.error is None
        assert car.result.rotation_y == pytest.approx(0.8, abs=0.05)


def test_the_result_is_that_of_the_keypoints(seen):
    (car,) = solve(Own(seen), [seen.box])
    direct = fgrecon.reconstruct(seen.keypoints, CAMERA, confidence=seen.confidence, box=seen.box, options=FAST)
    np.testing.assert_array_equal(car.result.camera_T_object, direct.camera_T_object)


def test_an_own_vehicle_detector_finds_the_boxes_and_small_ones_are_left_out(seen):
    boxes = np.array([seen.box, [3.0, 3.0, 9.0, 8.0]])
    images = []
    own = Own(seen)
    cars = solve(own, None, vehicle_detector=lambda image: images.append(image) or Vehicles(boxes, [0.9, 0.8]))
    assert len(cars) == len(images) == 1
    np.testing.assert_array_equal(own.calls[0][1], [seen.box])


def test_results_have_the_ids_of_a_tracker(seen):
    far = np.add(seen.box, [40.0, 0.0, 40.0, 0.0])
    boxes = np.array([seen.box, [3.0, 3.0, 9.0, 8.0], far])
    detector = lambda _: Vehicles(boxes, [0.9, 0.8, 0.7], tracks=(7, 8, 3))  # noqa: E731
    assert [car.track for car in solve(Own(seen, seen), None, vehicle_detector=detector)] == [7, 3]
    assert [car.track for car in solve(Own(seen), [seen.box])] == [None]


def test_where_no_vehicle_is_no_keypoints_are_asked_for():
    own = Own()
    assert solve(own, None, vehicle_detector=lambda _: Vehicles(np.zeros((0, 4)), np.zeros(0))) == []
    assert own.calls == []


@pytest.mark.parametrize("camera", [CAMERA.matrix, CAMERA.matrix[[0, 1, 0, 1], [0, 1, 2, 2]]])
def test_kinds_of_cameras_and_images(seen, camera, tmp_path):
    (car,) = solve(Own(seen), [seen.box], image=write_png(tmp_path / "street.png", IMAGE), camera=camera)
    (same,) = solve(Own(seen), [seen.box], image=IMAGE[..., 0])
    np.testing.assert_array_equal(car.result.camera_T_object, same.result.camera_T_object)


def test_without_a_camera_its_focal_length_is_found_and_said_so(seen):
    with pytest.warns(AssumedCameraWarning, match=r"focal length is \d+ pixels, to \d+ %") as caught:
        (car,) = solve(Own(seen), [seen.box], camera=None)
    assert caught[0].filename == __file__
    assert 0.0 < car.camera.focal_sigma <= 0.5
    np.testing.assert_allclose(
        car.camera.project(car.result.location), car.result.pose.wireframe_uv.mean(axis=0), atol=80
    )


def test_the_focal_length_of_the_file_is_taken(seen, tmp_path):
    exif = Image.Exif()
    exif.get_ifd(0x8769)[0xA405] = 25  # millimetres of a 35 mm film
    Image.fromarray(IMAGE).save(tmp_path / "street.jpg", exif=exif)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        (car,) = solve(Own(seen), [seen.box], image=tmp_path / "street.jpg", camera=None)
    assert car.camera.matrix[0, 0] == pytest.approx(25 / 43.27 * np.hypot(1242, 375), rel=0.1)
    assert car.camera.focal_sigma <= 0.05


def test_one_that_is_refused_has_its_error_and_the_others_go_on(seen):
    nothing = Observation(np.full((14, 2), np.nan), np.zeros(14), seen.box)
    refused, solved = solve(Own(nothing, Detection(seen)), [seen.box, seen.box])
    assert refused.result is None
    assert isinstance(refused.error, InvalidInputError)
    assert solved.error is None


def test_detector_and_prior_of_different_categories_are_refused_before_anything_runs(seen):
    prior = load_prior("car14")
    other = replace(prior, category=replace(prior.category, name="lorry14"))
    own = Own(seen)
    with pytest.raises(InvalidInputError, match=r"keypoint_detector.category: got car14.*lorry14"):
        solve(own, [seen.box], prior=other)
    assert own.calls == []


@pytest.mark.parametrize(
    ("answer", "message"),
    [
        (None, "a returned NoneType"),
        ([], "0 returned detections"),
        ([np.zeros((14, 2))], r"detection\[0\]: got a returned ndarray"),
        ([Observation(np.zeros((4, 2)), np.ones(4))], "4 keypoints. Category car14 has 14"),
    ],
)
def test_wrong_answers_of_a_keypoint_detector_are_named(seen, answer, message):
    own = Own()
    own.answer = answer
    with pytest.raises(InvalidInputError, match=f"keypoint_detector.*{message}"):
        solve(own, [seen.box])


@pytest.mark.parametrize("detector", [lambda image, boxes: [], SimpleNamespace(category="car14"), "yolo"])
def test_what_is_no_keypoint_detector_is_refused(seen, detector):
    with pytest.raises(InvalidInputError, match="keypoint_detector"):
        solve(detector, [seen.box])


@pytest.mark.parametrize(
    ("detector", "message"),
    [
        ("yolo", "vehicle_detector"),
        (lambda _: np.zeros((1, 4)), r"vehicle_detector: got a returned ndarray.*Vehicles\(boxes, scores\)"),
        (lambda _: Vehicles([[1, 2, 3]], [1.0]), "vehicles.boxes"),
        (lambda _: Vehicles([[1, 2, 3, 4]], [1.0], ("delivery van",)), r"vehicles.kinds\[0\]"),
        (lambda _: Vehicles([[1, 2, 3, 4]], [1.0], ("Van", "Car")), "vehicles.kinds"),
        (lambda _: Vehicles([[1, 2, 30, np.nan]], [1.0]), "vehicles.boxes"),
        (lambda _: Vehicles([[30, 2, 1, 40]], [1.0]), "vehicles.boxes"),
        (lambda _: Vehicles([[1, 2, 30, 40]], [1.0, 2.0]), "vehicles.scores"),
        (lambda _: Vehicles([[1, 2, 30, 40]], [1.0], tracks=(1, 2)), "vehicles.tracks"),
        (lambda _: Vehicles([[1, 2, 30, 40]] * 2, [1.0, 1.0], tracks=(1, 1)), "vehicles.tracks"),
    ],
)
def test_wrong_answers_of_a_vehicle_detector_are_named(detector, message):
    with pytest.raises(InvalidInputError, match=message):
        solve(Own(), None, vehicle_detector=detector)


@pytest.mark.parametrize(
    ("known", "message"),
    [
        ({"azimuth": [0.5, 0.4]}, "azimuth"),
        ({"azimuth": [1.5, -0.5]}, "azimuth"),
        ({"visible": np.ones(3)}, "visible"),
        ({"visible": np.full(14, 1.5)}, "visible"),
    ],
)
def test_directions_and_visibilities_are_probabilities(seen, known, message):
    with pytest.raises(InvalidInputError, match=f"detection.{message}"):
        Detection(seen, **known)
    with pytest.raises(InvalidInputError, match=r"detection.observation"):
        Detection(seen.keypoints)


def test_a_detector_without_directions_prefers_none(seen):
    assert direction_penalty(Detection(seen).azimuth, POSE) == 0.0
    towards = np.full(8, 0.125)
    assert direction_penalty(Detection(seen, towards).azimuth, POSE) == pytest.approx(0.0)


def test_the_detectors_of_the_package_fit_their_protocols():
    assert isinstance(Own(), KeypointDetector)
    assert isinstance(NanodetVehicleDetector(), VehicleDetector)
    cascade = KeypointCascade()
    assert isinstance(cascade, KeypointDetector)
    assert cascade.category == "car14"
    assert issubclass(CascadeDetection, Detection)
