"""What makes a result weak, on either side of each limit, and that every way of solving says it."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import fgrecon
from fgrecon.core.camera import Camera, Ground
from fgrecon.core.errors import InvalidInputError
from fgrecon.core.geometry import exponential
from fgrecon.core.observation import Observation
from fgrecon.core.options import KeypointOptions, Options
from fgrecon.core.reconstruction import Reconstruction, Status
from fgrecon.io.catalogue import load_prior
from fgrecon.simulation import KITTI_CAMERA, Vehicle, simulate
from fgrecon.solve.pipeline import reconstruct
from fgrecon.solve.result import weakened
from fgrecon.solve.scene import reconstruct_scene
from fgrecon.solve.weakness import off_ground, unknown_focal, weaknesses
from tests.cars import CAMERA, observe, yaw_pose

POSE = yaw_pose(0.6)
SIZE = np.array([4.0, 1.7, 1.5])


def reasons_of(**changed):
    """The reasons of a car that has none, but for what is changed."""
    given = {
        "observation": Observation(np.full((14, 2), 300.0), np.full(14, 0.9), confidence_midpoint=0.5),
        "weights": np.full(14, 0.6),
        "camera": replace(Camera.of(CAMERA), image_size=(1242, 375)),
        "camera_T_object": POSE,
        "coefficients": np.zeros(5),
        "box_size": SIZE,
        "ground": Ground.level(float(POSE[1, 3])),
    }
    return weaknesses(**(given | changed))


def test_a_clear_car_has_no_reasons():
    assert reasons_of() == ()


def test_few_keypoints():
    assert reasons_of(weights=np.full(14, 5.51 / 14)) == ()
    (reason,) = reasons_of(weights=np.full(14, 5.49 / 14))
    assert reason == "keypoints of weight 5.5 of 14 carry it"


def test_an_unsure_detector_and_points_without_confidences():
    points = np.full((14, 2), 300.0)
    half = Observation.of(points)  # nothing is said: each is as likely right as wrong
    assert reasons_of(observation=half) == ()
    unsure = np.full(14, 0.28)  # 0.28^2 / (0.28^2 + 0.5^2) = 0.239
    (reason,) = reasons_of(observation=Observation(points, unsure, confidence_midpoint=0.5))
    assert "holds 24 % of its keypoints right" in reason
    seen = points.copy()
    seen[8:] = np.nan  # what was not measured is not unsure
    assert reasons_of(observation=Observation(seen, np.full(14, 0.9), confidence_midpoint=0.5)) == ()


def test_a_car_mostly_outside_of_the_image():
    camera = Camera.of(CAMERA)
    corner = camera.project(POSE[:3, 3])  # in the middle of the box, about
    for width, expected in ((corner[0] + 60.0, 0), (corner[0] - 60.0, 1)):
        assert len(reasons_of(camera=replace(camera, image_size=(round(width), 375)))) == expected
    near = POSE.copy()
    near[2, 3] = 1.0  # a corner behind the camera
    assert "100 % of its box is outside" in reasons_of(camera_T_object=near, ground=None)[0]
    assert reasons_of(camera=camera) == ()  # of unknown size


def test_an_improbable_shape():
    assert reasons_of(coefficients=np.array([0.0, -2.9])) == ()
    assert reasons_of(coefficients=np.array([0.0, -3.1])) == ("its shape is 3.1 standard deviations from the mean",)
    assert reasons_of(coefficients=np.zeros(0)) == ()


def test_a_car_that_leans_on_the_ground():
    """By two standard deviations of the tilt or less than one; of a camera that may be tilted it says nothing."""
    pose = POSE.copy()
    pose[:3, :3] = exponential(np.array([0.0, 0.0, np.radians(3.5)])) @ pose[:3, :3]
    assert reasons_of(camera_T_object=pose) == ("it leans by 4 degrees on the ground, 2.0 standard deviations",)
    assert reasons_of(camera_T_object=pose, ground=Ground.of_height(1.65)) == ()
    pose[:3, :3] = exponential(np.array([0.0, 0.0, np.radians(-2.0)])) @ pose[:3, :3]
    assert reasons_of(camera_T_object=pose) == ()


def test_a_rolled_camera_that_is_given_as_level_contradicts_its_cars(prior):
    """Unlike one that looks down, it leaves them their height."""
    rolled = np.eye(4)
    rolled[:3, :3] = exponential(np.array([0.0, 0.0, np.radians(20.0)]))
    statuses = []
    for seed in range(12):
        rng = np.random.default_rng(seed)
        pose = rolled @ yaw_pose(rng.uniform(-np.pi, np.pi), (rng.uniform(-4.0, 4.0), 1.65, rng.uniform(8.0, 20.0)))
        seen = observe(prior, pose, 0.7 * rng.standard_normal(5), noise=2.0, seed=seed)
        statuses.append(reconstruct(seen, CAMERA, ground=1.65).status)
    assert Status.CONVERGED not in statuses


@pytest.mark.parametrize(("degrees", "converged"), [(0.0, (14, 20)), (10.0, (0, 2))])
def test_a_rolled_camera_contradicts_the_cars_of_a_scene(prior, degrees, converged):
    """They lean together, and take the ground with them."""
    rolled = np.eye(4)
    rolled[:3, :3] = exponential(np.array([0.0, 0.0, np.radians(degrees)]))
    results = []
    for seed in range(5):
        rng = np.random.default_rng(seed)
        poses = [
            rolled @ yaw_pose(rng.uniform(-np.pi, np.pi), (rng.uniform(-4.0, 4.0), 1.65, 8.0 + 4.0 * car))
            for car in range(4)
        ]
        seen = [observe(prior, pose, 0.7 * rng.standard_normal(5), noise=2.0, seed=seed) for pose in poses]
        results += reconstruct_scene(seen, CAMERA, ground=1.65, size_prior="kitti").vehicles
    least, most = converged
    assert least <= sum(one.status is Status.CONVERGED for one in results) <= most
    assert degrees == 0.0 or any("leans by" in reason for one in results for reason in one.reasons)


@pytest.mark.parametrize(("times", "weak"), [(1.0, False), (0.7, False), (1.6, True), (2.5, True)])
def test_a_box_that_is_larger_than_its_car_looks(prior, times, weak):
    """About the same middle, by less than the image's edges; of a smaller one the car may be hidden."""
    rng = np.random.default_rng(7)
    seen, _ = simulate(Vehicle.sample(prior, rng), KITTI_CAMERA, yaw_pose(2.0, (1.0, 1.65, 16.0)), rng)
    middle, half = (seen.box[:2] + seen.box[2:]) / 2.0, (seen.box[2:] - seen.box[:2]) / 2.0
    loose = replace(seen, box=np.concatenate([middle - times * half, middle + times * half]))
    result = reconstruct(loose, KITTI_CAMERA, ground=1.65)
    assert any("larger than it looks" in reason for reason in result.reasons) == weak
    assert result.status is (Status.WEAK if weak else Status.CONVERGED)
    assert weak == (result.diagnostics.box_excess > 0.2)


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_off_the_ground(side):
    sigma = Ground.level(1.65).height_sigma_at_depth(float(POSE[2, 3]))
    for times, expected in ((1.9, 0), (2.1, 1)):
        plane = Ground.level(float(POSE[1, 3]) - side * times * sigma)
        assert len(reasons_of(ground=plane)) == expected
    (reason,) = off_ground(side * 0.5, 0.2)
    assert reason == f"it is 0.50 m {'below' if side > 0 else 'above'} the ground, 2.5 standard deviations"
    assert reasons_of(ground=None) == ()


def test_only_what_converged_becomes_weak():
    result = reconstruct(observe(load_prior("car14"), POSE), CAMERA)
    assert (result.status, result.reasons) == (Status.CONVERGED, ())
    weak = weakened(weakened(result, ["little carries it"]), ["it flies"])
    assert (weak.status, weak.message) == (Status.WEAK, "Little carries it; it flies.")
    assert weak.reasons == ("little carries it", "it flies")
    open_ = weakened(weak, ["which camera"], Status.AMBIGUOUS)
    assert (open_.status, open_.message, open_.reasons[-1]) == (Status.AMBIGUOUS, "Which camera.", "which camera")
    ambiguous = weakened(replace(result, status=Status.AMBIGUOUS, message="Two."), ["it flies"])
    assert (ambiguous.status, ambiguous.message, ambiguous.reasons) == (Status.AMBIGUOUS, "Two.", ("it flies",))
    assert weakened(result, []) is result
    for compact in (False, True):
        again = Reconstruction.from_dict(weak.to_dict(compact=compact))
        assert (again.status, again.reasons) == (Status.WEAK, weak.reasons)
    earlier = {name: value for name, value in result.to_dict().items() if name != "reasons"}
    assert Reconstruction.from_dict(earlier).reasons == ()


def test_a_focal_length_that_was_found():
    assert unknown_focal(0.0, (), 3.0)[1] == ()
    assert unknown_focal(0.09, ((700.0, 0.0),), 3.0)[1] == ()
    rough = "the focal length is known to {} % only, and distances no better"
    assert unknown_focal(0.29, ((700.0, 0.0),), 3.0) == (Status.WEAK, (rough.format(29),))
    assert unknown_focal(0.31, ((700.0, 0.0),), 3.0) == (Status.AMBIGUOUS, (rough.format(31),))
    two = "focal lengths of 700 and 900 px explain the image, 2.9 nats apart"
    assert unknown_focal(0.05, ((700.0, 0.0), (900.0, 2.9)), 3.0) == (Status.AMBIGUOUS, (two,))
    assert unknown_focal(0.2, ((700.0, 0.0), (900.0, 2.9)), 3.0) == (Status.AMBIGUOUS, (two, rough.format(20)))
    for other in ((900.0, 3.1), (750.0, 0.1)):  # too improbable, and as good as the same
        assert unknown_focal(0.05, ((700.0, 0.0), other), 3.0)[1] == ()


def few(observation: Observation) -> Observation:
    """With the five most confident keypoints alone."""
    pixels = observation.keypoints.copy()
    pixels[np.argsort(-observation.confidence, kind="stable")[5:]] = np.nan
    return replace(observation, keypoints=pixels)


def test_cars_scenes_and_tracks_say_it():
    prior = load_prior("car14")
    whole = observe(prior, POSE)
    poor = few(whole)
    alone = reconstruct(poor, CAMERA, ground=1.65)
    assert any("carry it" in reason for reason in alone.reasons)
    assert alone.status in (Status.WEAK, Status.AMBIGUOUS)
    beside = observe(prior, yaw_pose(0.6, POSE[:3, 3] + [4.0, 0.0, 3.0]))
    scene = fgrecon.reconstruct_scene([beside, poor], CAMERA, ground=1.65)
    assert [bool(car.reasons) for car in scene.vehicles] == [False, True]
    track = fgrecon.reconstruct_track([poor, poor], CAMERA)
    assert all(frame.reasons for frame in track.frames)
    assert track.status is not Status.CONVERGED
    mixed = fgrecon.reconstruct_track([whole, whole, poor], CAMERA)
    assert mixed.frames[0].status is Status.CONVERGED
    assert mixed.status in (Status.CONVERGED, mixed.frames[2].status)


def test_a_car_on_another_ground_is_weak_in_its_scene():
    prior = load_prior("car14")
    poses = [yaw_pose(0.4, np.array([x, 1.65, z])) for x, z in ((-4.0, 14.0), (2.0, 16.0), (5.0, 20.0))]
    high = yaw_pose(0.4, np.array([-1.0, -0.2, 18.0]))
    scene = fgrecon.reconstruct_scene([observe(prior, pose) for pose in [*poses, high]], CAMERA, size_prior="kitti")
    assert [any("above the ground" in reason for reason in car.reasons) for car in scene.vehicles] == [False] * 3 + [
        True
    ]


def test_keypoints_below_the_least_confidence_are_not_measured():
    observation = observe(load_prior("car14"), POSE)
    confidence = np.linspace(0.1, 0.9, 14)
    given = replace(observation, confidence=np.where(observation.measured, confidence, 0.0))
    asked = Options(keypoints=KeypointOptions(least_confidence=0.5))
    dropped = given.of_at_least(0.5)
    assert (dropped.measured == (given.measured & (confidence >= 0.5))).all()
    assert given.of_at_least(0.0) is given
    found, expected = reconstruct(given, CAMERA, options=asked), reconstruct(dropped, CAMERA)
    np.testing.assert_array_equal(found.camera_T_object, expected.camera_T_object)
    with pytest.raises(InvalidInputError, match="least_confidence"):
        KeypointOptions(least_confidence=1.5)


def test_the_documentation_has_every_status():
    page = (Path(__file__).parents[2] / "docs/reference/result.md").read_text(encoding="utf-8")
    section = page[page.index("## Status") : page.index("## Errors")]
    assert set(re.findall(r"^\| `(\w+)` \|", section, re.MULTILINE)) == {status.value for status in Status}
