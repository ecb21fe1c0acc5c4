"""What is no argument at all is named: text, None and numbers in the place of sequences, objects and paths."""

from dataclasses import replace

import numpy as np
import pytest

import fgrecon
from factors.native import native
from fgrecon.core.errors import InvalidInputError
from fgrecon.io.catalogue import load_prior
from tests.cars import CAMERA, observe, yaw_pose

PRIOR = load_prior("car14")
SEEN = observe(PRIOR, yaw_pose(0.5))
UNKNOWN = fgrecon.Camera.of_unknown(1240, 375)
IMAGE = np.zeros((375, 1240, 3), np.uint8)
BOX = fgrecon.Box3D(np.array([0.0, 1.6, 15.0]), 0.5, np.array([4.0, 1.6, 1.5]))

BAD = {
    "focal sigma None": (lambda: fgrecon.Camera(CAMERA.matrix, focal_sigma=None), "focal_sigma"),
    "focal sigma text": (lambda: fgrecon.Camera(CAMERA.matrix, focal_sigma="x"), "focal_sigma"),
    "focal sigma list": (lambda: fgrecon.Camera(CAMERA.matrix, focal_sigma=[0.1]), "focal_sigma"),
    "focal sigma array": (lambda: fgrecon.Camera(CAMERA.matrix, focal_sigma=np.array([0.1])), "focal_sigma"),
    "image None": (lambda: fgrecon.Camera.of_field_of_view(None, None), "image_size"),
    "view None": (lambda: fgrecon.Camera.of_field_of_view(100, 100, None), "field_of_view"),
    "unknown None": (lambda: fgrecon.Camera.of_unknown("x", 3), "image_size"),
    "ragged camera": (lambda: fgrecon.Camera.of([[1.0, 2.0], [3.0]]), "intrinsics"),
    "scaled None": (lambda: CAMERA.scaled(None), "ratio"),
    "scaled text": (lambda: CAMERA.scaled("2"), "ratio"),
    "scaled twice": (lambda: CAMERA.scaled([1.0, 2.0]), "ratio"),
    "scaled away": (lambda: CAMERA.scaled(0.0), "ratio"),
    "points None": (lambda: CAMERA.project(None), "points"),
    "points text": (lambda: CAMERA.project([["1", "2", "3"]]), "points"),
    "points of a plane": (lambda: CAMERA.project(np.ones((5, 2))), "points"),
    "rays of None": (lambda: CAMERA.rays(None), "pixels"),
    "rays of points": (lambda: CAMERA.rays(np.ones((5, 3))), "pixels"),
    "undistorted None": (lambda: CAMERA.undistort(None), "pixels"),
    "distorted text": (lambda: CAMERA.distort("abc"), "pixels"),
    "yaw of None": (lambda: fgrecon.rotation_y(None), "camera_T_object"),
    "yaw of text": (lambda: fgrecon.rotation_y("left"), "camera_T_object"),
    "yaw of a plane": (lambda: fgrecon.rotation_y(np.eye(2)), "camera_T_object"),
    "yaw of numbers": (lambda: fgrecon.rotation_y(np.arange(3.0)), "camera_T_object"),
    "scene None": (lambda: fgrecon.reconstruct_scene(None, CAMERA), "observations"),
    "scene number": (lambda: fgrecon.reconstruct_scene(5, CAMERA), "observations"),
    "scene text": (lambda: fgrecon.reconstruct_scene("abc", CAMERA), "observations"),
    "scenes None": (lambda: fgrecon.reconstruct_scenes(None, CAMERA), "images"),
    "scenes number": (lambda: fgrecon.reconstruct_scenes([[SEEN], 5], UNKNOWN), "images[1]"),
    "track None": (lambda: fgrecon.reconstruct_track(None, CAMERA), "observations"),
    "track number": (lambda: fgrecon.reconstruct_track(5, CAMERA), "observations"),
    "track camera": (lambda: fgrecon.reconstruct_track([SEEN], ["x"]), "cameras[0]"),
    "track cameras": (lambda: fgrecon.reconstruct_track([SEEN], 5), "cameras"),
    "track factors": (lambda: fgrecon.reconstruct_track([SEEN], CAMERA, extra_factors=None), "extra_factors"),
    "boxes text": (lambda: fgrecon.reconstruct_scene([SEEN] * 3, CAMERA, boxes="..."), "boxes"),
    "boxes number": (lambda: fgrecon.reconstruct_scene([SEEN], CAMERA, boxes=5), "boxes"),
    "boxes of numbers": (lambda: fgrecon.reconstruct_scene([SEEN], CAMERA, boxes=[1]), "boxes[0]"),
    "errors of no boxes": (lambda: fgrecon.reconstruct_scene([SEEN], CAMERA, box_errors="abc"), "box_errors"),
    "refine None": (lambda: fgrecon.refine_boxes(IMAGE, None, CAMERA), "boxes"),
    "refine text": (lambda: fgrecon.refine_boxes(IMAGE, "abc", CAMERA), "boxes"),
    "refine of None": (lambda: fgrecon.refine_boxes(IMAGE, [None], CAMERA), "boxes[0]"),
    "refine errors": (lambda: fgrecon.refine_boxes(IMAGE, [], CAMERA, box_errors="abc"), "box_errors"),
    "refine origin": (lambda: fgrecon.refine_boxes(IMAGE, [BOX], CAMERA, box_origin="top"), "box_origin"),
    "refine another size": (
        lambda: fgrecon.refine_boxes(IMAGE[:99], [BOX], replace(CAMERA, image_size=(1240, 375))),
        "image",
    ),
    "shared ground": (lambda: fgrecon.Tracker(shared_ground="x"), "shared_ground"),
    "estimated": (lambda: fgrecon.Tracker().update(0.0, {}, camera=CAMERA, estimated=0), "estimated"),
    "together": (lambda: fgrecon.reconstruct_image(IMAGE, CAMERA, boxes=[], together="x"), "together"),
    "a file's bytes": (lambda: fgrecon.reconstruct_image(b"PNG", CAMERA), "image"),
    "motion factors": (lambda: fgrecon.Tracker(motion_factors=3), "motion_factors"),
    "refine corners": (lambda: fgrecon.refine_boxes(IMAGE, [BOX], CAMERA, corners="abc"), "corners"),
    "image boxes": (lambda: fgrecon.reconstruct_image(IMAGE, CAMERA, boxes="abc"), "boxes"),
    "factors None": (lambda: fgrecon.reconstruct(SEEN, CAMERA, extra_factors=None), "extra_factors"),
    "factors text": (lambda: fgrecon.reconstruct(SEEN, CAMERA, extra_factors=["x"]), "extra_factors[0]"),
    "calibration None": (lambda: fgrecon.load_calibration(None), "calibration"),
    "category None": (lambda: fgrecon.load_category(None), "category"),
    "picture None": (lambda: fgrecon.read_image(None), "image"),
    "prior None": (lambda: fgrecon.save_prior(None, "prior.npz"), "prior"),
    "prior nowhere": (lambda: fgrecon.save_prior(PRIOR, None), "path"),
    "saved calibration None": (lambda: fgrecon.save_calibration(None, "calibration.json"), "calibration"),
    "calibration nowhere": (lambda: fgrecon.save_calibration(fgrecon.DetectorCalibration(), None), "path"),
    "calibration of boxes": (lambda: fgrecon.DetectorCalibration(boxes=5), "calibration.boxes"),
    "calibration's origin": (lambda: fgrecon.DetectorCalibration(provenance=5), "calibration.provenance"),
    "observation None": (lambda: fgrecon.Observation.of(None), "keypoints"),
    "observation number": (lambda: fgrecon.Observation.of(5), "keypoints"),
    "result": (lambda: fgrecon.Reconstruction.from_dict([]), "reconstruction"),
    "category": (lambda: fgrecon.Category.from_dict(None), "category"),
    "prior's category": (lambda: replace(PRIOR, category="car14"), "prior.category"),
    "prior's origin": (lambda: replace(PRIOR, provenance=5), "prior.provenance"),
}


@pytest.mark.parametrize(("make", "field"), BAD.values(), ids=BAD)
def test_what_is_no_argument_is_named(make, field):
    with pytest.raises(InvalidInputError) as error:
        make()
    assert error.value.field.startswith(field)
    assert error.value.fix.endswith(".")


def test_none_is_named_as_such():
    for make in (lambda: CAMERA.project(None), lambda: CAMERA.scaled(None), lambda: fgrecon.rotation_y(None)):
        with pytest.raises(InvalidInputError, match="got None"):
            make()


def test_what_is_gone_through_once_is_taken():
    scene = fgrecon.reconstruct_scene((one for one in [SEEN, SEEN]), CAMERA)
    scenes = fgrecon.reconstruct_scenes(((one for one in [SEEN]) for _ in range(2)), UNKNOWN)
    track = fgrecon.reconstruct_track((one for one in [SEEN, None]), (one for one in [CAMERA, CAMERA]))
    assert (len(scene.vehicles), [len(one.vehicles) for one in scenes], track.numbers) == (2, [1, 1], (0,))


def test_a_kernel_that_there_is_not_is_refused(monkeypatch):
    monkeypatch.setenv("FGRECON_KERNEL", "xyz")
    with pytest.raises(InvalidInputError, match="FGRECON_KERNEL: got xyz"):
        native("factors._shape")
