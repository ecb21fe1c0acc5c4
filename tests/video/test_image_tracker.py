"""`ImageTracker`: images in, estimates of `fgrecon.Tracker` out, with networks of one's own."""

import numpy as np
import pytest

import fgrecon
from fgrecon.core.errors import InvalidInputError
from fgrecon.io.images import write_png
from fgrecon.perception import Vehicles
from fgrecon.simulation import KITTI_CAMERA, yaw_pose
from fgrecon.video import GatedAssociation, ImageTracker
from tests.video.streets import SIZE, simulated

IMAGE = np.zeros((*SIZE[::-1], 3), dtype=np.uint8)


class Shown:
    """Both networks of a made-up street: the observations of each image, in order; each must be of RGB bytes."""

    category = "car14"

    def __init__(self, *frames):
        self.frames, self.at = frames, -1

    def boxes(self, image):
        assert (image.shape, image.dtype) == (IMAGE.shape, np.uint8)
        self.at += 1
        boxes = np.array([seen.box for seen in self.frames[self.at]]).reshape(-1, 4)
        return Vehicles(boxes, np.full(len(boxes), 0.9))

    def __call__(self, image, boxes):
        assert len(boxes) == len(self.frames[self.at])
        return list(self.frames[self.at])


def image_tracker(*frames, **arguments):
    shown = Shown(*frames)
    return ImageTracker(vehicle_detector=shown.boxes, keypoint_detector=shown, **arguments)


def test_the_estimates_are_those_of_a_tracker_that_is_given_the_keypoints(tmp_path):
    frames = list(zip(*simulated(4), strict=True))
    images = image_tracker(*frames, size_prior="kitti", shared_ground=True)
    keypoints = fgrecon.Tracker(size_prior="kitti", shared_ground=True)
    write_png(tmp_path / "3.png", IMAGE)
    given = [IMAGE, IMAGE[..., 0].astype(np.uint16), str(tmp_path / "3.png"), IMAGE]  # grey, a path
    for t, (image, observations) in enumerate(zip(given, frames, strict=True)):
        at = {"camera": KITTI_CAMERA, "ground": 1.65}
        if t < 3:
            at["world_T_camera"] = yaw_pose(0.0, np.array([0.0, 0.0, 0.3 * t]))
        found = images.update(0.1 * t, image, **at)
        expected = keypoints.update(0.1 * t, dict(enumerate(observations)), **at)
        assert sorted(found) == [0, 1]
        for i, estimate in found.items():
            np.testing.assert_array_equal(
                estimate.reconstruction.camera_T_object, expected[i].reconstruction.camera_T_object
            )
            assert (estimate.time, estimate.world_T_object is None) == (0.1 * t, t == 3)
        np.testing.assert_array_equal(images.frame.boxes[1], observations[1].box)
    assert [len(past) for past in images.tracker.smooth().values()] == [4, 4]


def test_the_ids_are_those_of_a_detector_that_is_a_tracker():
    first, second = simulated(2, seeds=(25, 26))
    shown = Shown(*zip(first, second, strict=True))

    def tracker(image):
        found = shown.boxes(image)
        return Vehicles(found.boxes, found.scores, tracks=((7, 3), (3, 9))[shown.at])

    images = ImageTracker(vehicle_detector=tracker, keypoint_detector=shown)
    assert sorted(images.update(0.0, IMAGE, camera=KITTI_CAMERA)) == [3, 7]
    assert sorted(images.update(0.1, IMAGE, camera=KITTI_CAMERA)) == [3, 9]


def test_vehicles_without_an_id_are_no_tracks_yet():
    ((seen,),) = simulated(1, seeds=(25,))
    answers = [((7,), [seen]), ((), []), ((7,), [seen]), ((), [seen])]

    def detector(order):
        shown = Shown(*(answers[i][1] for i in order))

        def tracker(image):
            shown.at += 1
            return Vehicles(np.array([seen.box]), np.ones(1), tracks=answers[order[shown.at]][0])

        return ImageTracker(vehicle_detector=tracker, keypoint_detector=shown)

    images = detector((0, 1, 2))
    found = [sorted(images.update(0.1 * t, IMAGE, camera=KITTI_CAMERA)) for t in range(3)]
    assert found[0] == found[2] == [7]
    assert 0 not in found[1]
    images = detector((3, 0))
    assert sorted(images.update(0.0, IMAGE, camera=KITTI_CAMERA)) == [0]
    with pytest.raises(InvalidInputError, match="ids from image 1 on"):
        images.update(0.1, IMAGE, camera=KITTI_CAMERA)


def test_vehicles_that_have_gone_are_forgotten_unless_an_association_keeps_them():
    (seen,) = simulated(1, seeds=(25,))
    for arguments, kept in (({}, []), ({"association": GatedAssociation()}, [0])):
        images = image_tracker(seen, [], **arguments)
        assert sorted(images.update(0.0, IMAGE, camera=KITTI_CAMERA)) == [0]
        assert images.update(3.0, IMAGE, camera=KITTI_CAMERA) == {}
        assert sorted(images.tracker.smooth()) == kept


def test_what_cannot_be_used_is_refused_and_leaves_all_as_it_was():
    seen = simulated(2, seeds=(25,))[0]
    images = image_tracker(seen[:1], seen[1:])
    assert images.frame is None
    images.update(0.0, IMAGE, camera=KITTI_CAMERA)
    for field, time, image, arguments in (
        ("time", 0.0, IMAGE, {}),
        ("time", np.nan, IMAGE, {}),
        ("image", 0.1, IMAGE[:100], {}),
        ("image", 0.1, IMAGE / 255.0, {}),
        ("world_T_camera", 0.1, IMAGE, {"world_T_camera": 2.0 * np.eye(4)}),
        ("ground", 0.1, IMAGE, {"ground": -1.0}),
    ):
        with pytest.raises(InvalidInputError, match=field):
            images.update(time, image, camera=KITTI_CAMERA, **arguments)
    assert images.update(0.1, IMAGE, camera=KITTI_CAMERA)[0].velocity is not None
    with pytest.raises(InvalidInputError, match="keypoint_detector"):
        ImageTracker(vehicle_detector=Shown().boxes, keypoint_detector=lambda image, boxes: [])
    with pytest.raises(InvalidInputError, match="window"):
        image_tracker(window=1)


def test_a_tracker_that_is_given_an_image_names_the_door_for_it():
    with pytest.raises(InvalidInputError, match=r"fgrecon\.video\.ImageTracker"):
        fgrecon.Tracker().update(0.0, IMAGE, camera=KITTI_CAMERA)
