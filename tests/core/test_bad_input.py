"""What `fgrecon.reconstruct` refuses, and that each refusal names the field, its value and what to do."""

import numpy as np
import pytest

import fgrecon
from fgrecon.core.errors import DegenerateProblemError, FgreconError, InvalidInputError
from fgrecon.simulation.vehicles import KITTI_CAMERA, yaw_pose

PRIOR = fgrecon.load_prior("car14")
POSE = yaw_pose(2.5, np.array([1.0, 1.65, 12.0]))
KEYPOINTS = KITTI_CAMERA.project(PRIOR.mean @ POSE[:3, :3].T + POSE[:3, 3])
NAN, INFINITY = float("nan"), float("inf")


def with_rows(rows, value):
    changed = KEYPOINTS.copy()
    changed[rows] = value
    return changed


def attempt(keypoints=KEYPOINTS, intrinsics=KITTI_CAMERA, **settings):
    return fgrecon.reconstruct(keypoints, intrinsics, **settings)


def test_the_same_input_unspoilt_is_accepted():
    assert attempt().status is fgrecon.Status.CONVERGED


@pytest.mark.parametrize(
    ("spoilt", "field"),
    [
        ({"keypoints": KEYPOINTS[:13]}, "keypoints"),
        ({"keypoints": KEYPOINTS.T}, "keypoints"),
        ({"keypoints": KEYPOINTS.ravel()}, "keypoints"),
        ({"keypoints": None}, "keypoints"),
        ({"keypoints": "left"}, "keypoints"),
        ({"keypoints": [[1.0, 2.0], [3.0]]}, "keypoints"),
        ({"keypoints": with_rows(3, INFINITY)}, "keypoints"),
        ({"confidence": np.ones(13)}, "confidence"),
        ({"confidence": np.full(14, 1.2)}, "confidence"),
        ({"confidence": np.full(14, -0.1)}, "confidence"),
        ({"confidence": np.full(14, NAN)}, "confidence"),
        ({"box": [5, 5, 5, 5]}, "box"),
        ({"box": [50, 5, 5, 50]}, "box"),
        ({"box": [5, 5, 50]}, "box"),
        ({"box": [5, 5, NAN, 50]}, "box[2]"),
        ({"covariance": np.zeros((14, 2, 2))}, "covariance"),
        ({"covariance": np.eye(2)}, "covariance"),
        ({"covariance": np.full((14, 2, 2), NAN)}, "covariance"),
        ({"covariance": np.tile([[1.0, 0.5], [0.0, 1.0]], (14, 1, 1))}, "covariance"),
        ({"intrinsics": np.zeros((3, 3))}, "intrinsics"),
        ({"intrinsics": np.diag([700.0, 0.0, 1.0])}, "intrinsics"),
        ({"intrinsics": np.diag([700.0, 700.0, 0.0])}, "intrinsics"),
        ({"intrinsics": np.eye(2)}, "intrinsics"),
        ({"intrinsics": [[700, 0, NAN], [0, 700, 180], [0, 0, 1]]}, "intrinsics[0, 2]"),
        ({"intrinsics": (700.0, 700.0, 600.0)}, "intrinsics"),
        ({"intrinsics": KITTI_CAMERA.matrix, "distortion": [0.1]}, "distortion"),
        ({"intrinsics": KITTI_CAMERA.matrix, "distortion": [0.1, NAN, 0, 0]}, "distortion[1]"),
        ({"prior": "lorry"}, "prior"),
        ({"ground": -1.65}, "ground"),
        ({"ground": NAN}, "ground"),
        ({"ground": "level"}, "ground"),
        ({"ground": [0.0, 1.0, 0.0, 1.65]}, "ground"),
        ({"initial": NAN}, "initial"),
        ({"initial": "left"}, "initial"),
        ({"size_prior": "large"}, "size_prior"),
        ({"size_prior": "4,0,1.5"}, "size_prior.mean"),
    ],
)
def test_bad_arguments_name_the_field(spoilt, field):
    with pytest.raises(InvalidInputError) as error:
        attempt(**spoilt)
    assert error.value.field == field
    assert error.value.fix.endswith(".")
    assert isinstance(error.value, ValueError)
    assert isinstance(error.value, FgreconError)


@pytest.mark.parametrize(
    ("spoilt", "field"),
    [
        ({"keypoints": with_rows(slice(None), NAN)}, "keypoints"),
        ({"keypoints": with_rows(slice(2, None), NAN)}, "keypoints"),
        ({"keypoints": with_rows(slice(None), (300.0, 200.0))}, "keypoints"),
        ({"keypoints": np.linspace((100.0, 100.0), (400.0, 250.0), 14)}, "keypoints"),
        ({"keypoints": with_rows(slice(3, None), NAN), "confidence": [0.5, 0.5, *[0.0] * 12]}, "keypoints"),
        ({"confidence": np.zeros(14)}, "confidence"),
    ],
    ids=["none", "two", "one place", "one line", "two with weight", "no weight"],
)
def test_what_determines_no_pose_is_degenerate(spoilt, field):
    for strategy in ("mixture", "paper", "huber"):
        with pytest.raises(DegenerateProblemError) as error:
            attempt(**spoilt, options=fgrecon.Options(strategy=fgrecon.strategy(strategy)))
        assert error.value.field == field
        assert error.value.fix


@pytest.mark.filterwarnings("ignore::fgrecon.errors.ContradictoryInputWarning")
@pytest.mark.parametrize("offset", [(0.0, 0.0), (1e5, -1e5)])
def test_random_points_never_crash(offset):
    """Garbage that is well formed gives a result or a refusal, never another exception nor a dead process.

    Points beside the camera's axis by nearly a right angle are refused, all of them.
    """
    rng = np.random.default_rng(7)
    results = 0
    for _ in range(15):
        keypoints = rng.uniform(0.0, 400.0, (14, 2)) + offset
        keypoints[rng.random(14) < rng.random()] = NAN
        try:
            result = attempt(keypoints, confidence=rng.random(14))
        except FgreconError:
            continue
        results += 1
        assert np.isfinite(result.camera_T_object).all()
        assert result.message
    assert (0 < results < 15) if offset == (0.0, 0.0) else results == 0


def test_three_points_are_the_fewest_and_are_not_called_certain():
    result = attempt(with_rows(slice(3, None), NAN))
    assert np.flatnonzero(result.diagnostics.weights).tolist() == [0, 1, 2]
    assert result.status is fgrecon.Status.DEGENERATE
    with pytest.raises(DegenerateProblemError, match="2 usable points"):
        attempt(with_rows(slice(2, None), NAN))
