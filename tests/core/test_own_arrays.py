"""What is given an array keeps a copy that nobody writes into."""

from dataclasses import fields, is_dataclass

import numpy as np
import pytest

import fgrecon
from fgrecon.core.checks import as_finite, as_shape, own
from fgrecon.core.errors import InvalidInputError
from fgrecon.io.catalogue import load_prior
from fgrecon.viz.subjects import Truth
from tests.cars import CAMERA, observe, yaw_pose

PRIOR = load_prior("car14")
SEEN = observe(PRIOR, yaw_pose(0.5))
CATEGORY = PRIOR.category

MAKE = {
    "observation": (
        fgrecon.Observation,
        {
            "keypoints": SEEN.keypoints,
            "confidence": SEEN.confidence,
            "box": SEEN.box,
            "covariance": np.tile(np.eye(2), (14, 1, 1)),
            "azimuth": np.full(36, 1.0 / 36.0),
        },
    ),
    "detection": (
        fgrecon.Detection,
        {"observation": SEEN, "azimuth": np.full(36, 1.0 / 36.0), "visible": np.full(14, 0.5)},
    ),
    "camera": (fgrecon.Camera, {"matrix": CAMERA.matrix, "distortion": np.array([0.1, 0.0, 0.0, 0.0])}),
    "ground": (fgrecon.Ground, {"normal": np.array([0.0, 1.0, 0.0]), "distance": 1.65}),
    "box3d": (
        fgrecon.Box3D,
        {"location": np.array([1.0, 1.6, 20.0]), "rotation_y": 0.5, "size": np.array([4.0, 1.6, 1.5])},
    ),
    "size": (
        fgrecon.SizePrior,
        {
            "name": "mine",
            "mean": np.array([4.0, 1.6, 1.5]),
            "sigma": np.full(3, 0.1),
            "traffic": 0.1 * np.eye(3),
            "allowed": np.full(3, 0.1),
            "own": 0.05 * np.eye(3),
        },
    ),
    "surface": (fgrecon.Surface, {name: getattr(PRIOR.surface, name) for name in ("mean", "basis", "faces")}),
    "prior": (
        fgrecon.ShapePrior,
        {name: getattr(PRIOR, name) for name in ("category", "mean", "basis", "offset_sigma", "explained")}
        | {"mean_sigma": np.full((14, 3), 0.1)},
    ),
    "vehicles": (fgrecon.Vehicles, {"boxes": np.array([[1.0, 2.0, 30.0, 40.0]]), "scores": np.ones(1)}),
    "truth": (
        Truth,
        {"camera_T_object": yaw_pose(0.5), "box_size": np.array([4.0, 1.6, 1.5]), "keypoints": PRIOR.mean},
    ),
}


@pytest.mark.parametrize("kind", MAKE)
def test_arrays_that_are_given_are_copied_and_kept_from_changes(kind):
    make, given = MAKE[kind]
    given = {name: value.copy() if isinstance(value, np.ndarray) else value for name, value in given.items()}
    made = make(**given)
    assert is_dataclass(made)
    arrays = {one.name: getattr(made, one.name) for one in fields(made) if isinstance(given.get(one.name), np.ndarray)}
    before = {name: array.copy() for name, array in arrays.items()}
    for name, array in arrays.items():
        assert not np.shares_memory(array, given[name]), name
        given[name][...] = 7
        np.testing.assert_array_equal(array, before[name])
        with pytest.raises(ValueError, match="read-only"):
            array[...] = 7


def test_views_of_arrays_are_copied_even_where_they_cannot_be_written_into():
    buffer = np.array([0.0, 0.0, 10.0, 10.0, 1.0])
    view = buffer[:4]
    view.flags.writeable = False
    kept = own(view)
    buffer[:] = np.nan
    np.testing.assert_array_equal(kept, [0.0, 0.0, 10.0, 10.0])
    assert own(kept) is kept


def test_a_buffer_that_is_used_again_changes_no_result():
    box = np.array(SEEN.box)
    seen = fgrecon.Observation(SEEN.keypoints, SEEN.confidence, box)
    matrix = CAMERA.matrix.copy()
    camera = fgrecon.Camera(matrix)
    before = fgrecon.reconstruct(seen, camera)
    box[:] = np.nan
    matrix[:2] *= 2.0
    np.testing.assert_array_equal(fgrecon.reconstruct(seen, camera).camera_T_object, before.camera_T_object)
    np.testing.assert_allclose(camera.project(camera.rays([[3.0, 4.0]])), [[3.0, 4.0]])


def test_named_fleets_and_what_a_category_computed_once_are_shared_and_read_only():
    for array in (
        fgrecon.SIZE_PRIORS["kitti"].mean,
        CATEGORY.mirror,
        CATEGORY.off_faces,
        CATEGORY.dimension_operator,
        fgrecon.Ground.level(1.65).upright,
    ):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 9


def test_a_priors_origin_is_copied():
    provenance = {"source": "here"}
    prior = fgrecon.ShapePrior(
        CATEGORY, PRIOR.mean, PRIOR.basis, PRIOR.offset_sigma, PRIOR.explained, provenance=provenance
    )
    provenance["source"] = "there"
    assert prior.provenance == {"source": "here"}


def test_what_a_mask_hides_was_not_measured():
    keypoints = np.ma.array(SEEN.keypoints.copy(), mask=np.zeros((14, 2), bool))
    keypoints[3] = np.ma.masked
    assert np.isfinite(keypoints.data[3]).all()
    assert np.flatnonzero(~fgrecon.Observation.of(keypoints).measured).tolist() == [
        *np.flatnonzero(~SEEN.measured[:3]).tolist(),
        3,
        *(4 + np.flatnonzero(~SEEN.measured[4:])).tolist(),
    ]
    assert np.isnan(as_shape("numbers", np.ma.array([1, 2], mask=[False, True]), (2,))).tolist() == [False, True]


def test_a_mask_is_no_number():
    hidden = np.ma.array(SEEN.box, mask=[False, True, False, False])
    with pytest.raises(InvalidInputError, match=r"box\[1\]"):
        fgrecon.reconstruct(SEEN.keypoints, CAMERA, confidence=SEEN.confidence, box=hidden)
    with pytest.raises(InvalidInputError, match=r"size\[1\]"):
        as_finite("size", hidden, (4,))
