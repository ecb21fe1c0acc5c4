"""Better 3D boxes from an image: keypoints of a made-up detector, where it is asked to look, and what stays."""

import numpy as np
import pytest

import fgrecon
from fgrecon.core.box3d import Box3D, BoxErrors
from fgrecon.core.camera import Camera
from fgrecon.core.errors import InvalidInputError
from fgrecon.core.geometry import yaw_rotation
from fgrecon.core.observation import Observation
from fgrecon.io.catalogue import load_prior
from fgrecon.perception.keypoints.detect import large_enough

CAMERA = Camera.of([700.0, 700.0, 600.0, 180.0])
IMAGE = np.zeros((370, 1220, 3), dtype=np.uint8)
PRIOR = load_prior("car14")
TRUE = [
    Box3D(np.array([x, 1.65, z]), yaw, PRIOR.box_size(np.zeros(PRIOR.dimension)))
    for x, z, yaw in ((-3.0, 14.0, 0.4), (2.5, 18.0, -1.4), (6.0, 24.0, 1.8))
]


class Detector:
    """Exact keypoints of the true vehicle whose origin is seen in a box; remembers where it was asked to look."""

    category = "car14"

    def __init__(self):
        self.boxes = None

    def __call__(self, image, boxes):
        self.boxes = np.asarray(boxes)
        return [self.find(box) for box in self.boxes]

    def find(self, box):
        centre = (box[:2] + box[2:]) / 2
        near = min(TRUE, key=lambda one: np.linalg.norm(CAMERA.project(one.corners).mean(axis=0) - centre))
        points = PRIOR.mean @ yaw_rotation(near.rotation_y).T + near.location
        bins = np.arange(36) * 2 * np.pi / 36
        x, _, z = -yaw_rotation(near.rotation_y).T @ near.location
        directions = np.exp((np.cos(np.arctan2(z, x) - bins) - 1) / 0.05)
        return Observation(
            CAMERA.project(points),
            np.full(14, 0.8),
            box,
            np.tile(np.eye(2), (14, 1, 1)),
            0.2,
            directions / directions.sum(),
        )


def moved(box, share=1.06, turn=0.15):
    return Box3D(share * box.location, box.rotation_y + turn, box.size)


def corners_of(boxes):
    pixels = [CAMERA.project(box.corners) for box in boxes]
    return np.array([[*one.min(axis=0), *one.max(axis=0)] for one in pixels])


def test_boxes_of_an_image_come_nearer_and_face_the_right_way():
    given = [moved(TRUE[0]), moved(TRUE[1], 0.94, -0.2), moved(TRUE[2], 1.03, np.pi)]
    found = fgrecon.refine_boxes(
        IMAGE, given, CAMERA, corners=corners_of(TRUE), keypoint_detector=Detector(), ground=1.65
    )
    for one, before, true in zip(found, given, TRUE, strict=True):
        assert one.changed
        assert one.given is before
        assert np.linalg.norm(one.box.location - true.location) < 0.5 * np.linalg.norm(before.location - true.location)
        assert abs(np.sin((one.box.rotation_y - true.rotation_y) / 2)) < 0.03
        assert 0.0 < np.sqrt(one.location_covariance[2, 2]) < 0.06 * true.location[2]
    assert [one.flipped for one in found] == [False, False, True]


def test_without_2d_boxes_it_looks_where_the_3d_boxes_are():
    detector, given = Detector(), [moved(box) for box in TRUE]
    found = fgrecon.refine_boxes(IMAGE, given, CAMERA, keypoint_detector=detector)
    assert all(one.changed for one in found)
    limits = np.array([1219.0, 369.0, 1219.0, 369.0])
    assert detector.boxes == pytest.approx(np.clip(corners_of(given), 0.0, limits), abs=1e-6)
    some = corners_of(TRUE)
    some[1] = np.nan
    fgrecon.refine_boxes(IMAGE, given, CAMERA, corners=some, keypoint_detector=detector)
    assert detector.boxes[1] == pytest.approx(np.clip(corners_of(given), 0.0, limits)[1], abs=1e-6)


def test_a_box_outside_the_image_stays_and_says_why():
    outside = Box3D(np.array([40.0, 1.65, 12.0]), 0.0, TRUE[0].size)
    inside, beside = fgrecon.refine_boxes(IMAGE, [moved(TRUE[0]), outside], CAMERA, keypoint_detector=Detector())
    assert inside.changed
    assert (beside.changed, beside.box is outside, beside.result) == (False, True, None)
    assert "pixels" in beside.message
    assert fgrecon.refine_boxes(IMAGE, [], CAMERA, keypoint_detector=Detector()) == []


def test_it_looks_where_other_functions_look():
    """The longer side counts, and what lies beside the image has none."""
    detector, upright, tiny, beside = (
        Detector(),
        [600.0, 160.0, 606.0, 190.0],
        [5.0, 5.0, 11.0, 12.0],
        [-9.0, 5, -2, 60],
    )
    given = [moved(box) for box in TRUE]
    found = fgrecon.refine_boxes(
        IMAGE, given, CAMERA, corners=[upright, tiny, beside], keypoint_detector=detector, ground=1.65
    )
    assert detector.boxes.tolist() == [upright]
    assert ["pixels" in one.message for one in found][1:] == [True, True]
    assert large_enough(np.array([upright, tiny, beside])).tolist() == [True, False, True]


def test_errors_say_how_far_a_box_may_move():
    """A detector that is surer than its keypoints keeps its distance."""
    given = [moved(TRUE[1], 1.05, 0.0)]
    near, kept = (
        fgrecon.refine_boxes(
            IMAGE, given, CAMERA, box_errors=errors, keypoint_detector=Detector(), corners=corners_of(TRUE[1:2])
        )[0]
        for errors in (BoxErrors(), BoxErrors(depth=0.02))
    )
    assert np.linalg.norm(kept.moved) < np.linalg.norm(near.moved)
    assert kept.location_covariance[2, 2] < near.location_covariance[2, 2]


def test_bad_input_is_refused():
    for arguments, field in (
        ({"corners": np.zeros((2, 4))}, "corners"),
        ({"camera": Camera.of_unknown(1220, 370)}, "boxes"),
        ({"boxes": [Box3D(TRUE[0].location, 0.0)]}, "size"),
    ):
        given = {"boxes": TRUE[:1], "camera": CAMERA, "keypoint_detector": Detector()} | arguments
        with pytest.raises(InvalidInputError, match=field):
            fgrecon.refine_boxes(IMAGE, **given)
