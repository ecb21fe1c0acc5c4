"""A result survives JSON bit for bit, whatever odd numbers it holds."""

import json
import struct
from dataclasses import fields, replace

import gtsam
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from fgrecon.core.errors import InvalidInputError
from fgrecon.core.history import Deferred
from fgrecon.core.reconstruction import (
    Alternative,
    Diagnostics,
    GraphFactor,
    Iteration,
    Pose,
    Reconstruction,
    Shape,
    Status,
    Uncertainty,
    rotation_y,
)
from fgrecon.core.vehicle_estimate import VehicleEstimate
from tests.cars import yaw_pose
from tests.results import changed


def made_up(rng, coefficients=5, history=2):
    """A result of 4 keypoints with numbers of all kinds."""

    def iteration(step):
        return Iteration(
            "joint",
            1,
            step,
            yaw_pose(rng.uniform(-3, 3)),
            rng.normal(size=coefficients),
            rng.normal(size=(4, 3)),
            rng.normal(size=(4, 2)) * 1e3,
            rng.random(4),
            {"reprojection": rng.random(), "box": float("inf")},
        )

    return Reconstruction(
        status=Status.AMBIGUOUS,
        message="Why not — ümlauts, too.",
        pose=Pose(
            camera_T_object=yaw_pose(0.4),
            wireframe_uv=rng.normal(size=(4, 2)) * 1e-300,
        ),
        shape=Shape(
            category="quad",
            prior="made up",
            keypoint_names=("a", "b", "c", "d"),
            coefficients=rng.normal(size=coefficients),
            offsets=np.zeros((4, 3)),
            wireframe=rng.normal(size=(4, 3)),
            edges=np.array([[0, 1], [1, 2]]),
            box_size=rng.random(3),
            surface_vertices=rng.normal(size=(3, 3)),
            surface_faces=np.array([[0, 1, 2]]),
            faces={"roof": (0, 1, 3, 2)},
            symmetric_pairs=np.array([[0, 1]]),
        ),
        uncertainty=Uncertainty(
            pose_covariance=rng.normal(size=(6, 6)),
            coefficients_covariance=rng.normal(size=(coefficients, coefficients)),
            keypoint_covariance=None,
            alternatives=(Alternative(yaw_pose(1.0), rng.normal(size=coefficients), float("nan")),),
        ),
        diagnostics=Diagnostics(
            weights=np.array([0.0, 1.0, 1e-12, 1 / 3]),
            sigmas=np.array([np.inf, 1.0, 2.0, 3.0]),
            visibility=rng.random(4),
            energies={"reprojection": 0.1 + 0.2},
            history=tuple(iteration(i) for i in range(history)),
            milliseconds={"pose": 1.5},
            graph=(GraphFactor("reprojection", "a", ("X(v=0,t=0)", "L(v=0)")), GraphFactor("box", "", ("X(v=0,t=0)",))),
        ),
    )


GROUPS = (Diagnostics, Pose, Shape, Uncertainty)


def assert_same(a, b):
    """Same types, shapes and bits (NaN and the sign of zero included)."""
    a, b = (tuple(x) if isinstance(x, Deferred) else x for x in (a, b))
    assert type(a) is type(b)
    if isinstance(a, np.ndarray):
        assert a.dtype == b.dtype
        assert a.shape == b.shape
        assert a.tobytes() == b.tobytes()
    elif isinstance(a, float):
        assert struct.pack("d", a) == struct.pack("d", b)
    elif isinstance(a, tuple):
        assert len(a) == len(b)
        for left, right in zip(a, b, strict=True):
            assert_same(left, right)
    elif isinstance(a, dict):
        assert list(a) == list(b)
        for key in a:
            assert_same(a[key], b[key])
    elif isinstance(a, (*GROUPS, Alternative, GraphFactor, Iteration, Reconstruction)):
        assert_same(*({each.name: getattr(one, each.name) for each in fields(a)} for one in (a, b)))
    else:
        assert a == b


def through_json(result):
    return Reconstruction.from_dict(json.loads(json.dumps(result.to_dict(), allow_nan=False)))


@pytest.mark.parametrize(("coefficients", "history"), [(5, 2), (1, 1), (0, 1), (42, 0)])
def test_round_trip(coefficients, history):
    result = made_up(np.random.default_rng(coefficients), coefficients, history)
    assert_same(result, through_json(result))


@given(arrays(np.float64, (4, 2), elements=st.floats(allow_nan=False)))
@settings(deadline=None, derandomize=True, max_examples=50)
def test_every_float_survives(pixels):
    result = made_up(np.random.default_rng(0), 2, 0)
    object.__setattr__(result.pose, "wireframe_uv", pixels)
    assert through_json(result).pose.wireframe_uv.tobytes() == pixels.tobytes()


def test_numpy_scalars_become_plain_numbers():
    result = made_up(np.random.default_rng(0))
    object.__setattr__(result.diagnostics, "energies", {"box": np.float64(0.5), "count": np.int64(3)})
    assert json.dumps(result.to_dict()["energies"]) == '{"box": 0.5, "count": 3}'


def test_what_is_not_a_result_is_refused():
    good = made_up(np.random.default_rng(0)).to_dict()
    with pytest.raises(InvalidInputError) as caught:
        Reconstruction.from_dict({**good, "format": "something else"})
    assert caught.value.field == "format"
    with pytest.raises(InvalidInputError, match="no field weights"):
        Reconstruction.from_dict({key: value for key, value in good.items() if key != "weights"})
    with pytest.raises(InvalidInputError, match="format"):
        Reconstruction.from_dict({})


ROWS = ("offsets", "wireframe", "wireframe_uv", "box_size", "weights", "sigmas", "visibility", "pose_covariance")


@pytest.mark.parametrize("name", [*ROWS, "coefficients_covariance", "camera_T_object", "surface_vertices"])
def test_arrays_that_do_not_fit_the_others_are_refused(name):
    good = made_up(np.random.default_rng(0)).to_dict()
    with pytest.raises(InvalidInputError) as caught:
        Reconstruction.from_dict({**good, name: good[name][:-1]})
    assert caught.value.field in (name, "surface_faces")  # of vertices those that they number


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("keypoint_names", ["a", "b", "c"]),
        ("keypoint_names", ["a", "b", "c", 4]),
        ("coefficients", [0.5]),
        ("edges", [[0, 4]]),
        ("symmetric_pairs", [[-1, 0]]),
        ("faces", {"roof": [0, 1, 2, 4]}),
        ("faces", {"roof": [0.5]}),
        ("weights", None),
        ("weights", {"a": 1}),
        ("message", None),
        ("status", "good"),
        ("size_covariance", [["nan"] * 3] * 3),
        ("alternatives", [{"camera_T_object": [1], "coefficients": [0.0] * 5, "excess": 1}]),
        ("alternatives", 5),
        ("history", [{"stage": "joint"}]),
        ("graph", [[]]),
    ],
)
def test_fields_that_do_not_fit_or_are_malformed_are_refused(name, value):
    good = made_up(np.random.default_rng(0)).to_dict()
    with pytest.raises(InvalidInputError):
        Reconstruction.from_dict({**good, name: value})


@pytest.mark.parametrize("yaw", np.radians([-179, -90, -1, 0, 45, 90, 135, 180]))
def test_pose_and_yaw(yaw):
    result = made_up(np.random.default_rng(0))
    object.__setattr__(result.pose, "camera_T_object", yaw_pose(yaw))
    assert result.rotation_y == pytest.approx(yaw)
    assert rotation_y(yaw_pose(yaw)[:3, :3]) == pytest.approx(yaw)
    np.testing.assert_array_equal(result.location, yaw_pose(yaw)[:3, 3])
    assert result.pose.gtsam.equals(gtsam.Pose3(gtsam.Rot3.Ry(yaw), result.location), 1e-12)


def test_sigmas_are_the_spread_of_poses_drawn_from_the_covariance():
    rng = np.random.default_rng(3)
    root = rng.normal(size=(6, 6))
    covariance = 1e-6 * root @ root.T
    result = changed(made_up(rng), camera_T_object=yaw_pose(0.7, (1.0, 1.5, 20.0)), pose_covariance=covariance)
    drawn = [result.pose.gtsam.retract(step) for step in rng.multivariate_normal(np.zeros(6), covariance, 20000)]
    places = np.array([pose.translation() for pose in drawn])
    assert result.position_sigmas == pytest.approx(places.std(axis=0), rel=0.03)
    assert result.heading_sigma == pytest.approx(np.std([rotation_y(p.matrix()) for p in drawn]), rel=0.03)
    unknown = changed(result, pose_covariance=None)
    assert (unknown.heading_sigma, unknown.position_sigmas) == (None, None)


def test_the_speed_s_sigma_is_the_spread_of_lengths_of_velocities():
    rng = np.random.default_rng(4)
    velocity, root = np.array([8.0, 0.3, -3.0]), rng.normal(size=(3, 3))
    covariance = 1e-3 * root @ root.T
    estimate = VehicleEstimate(1, 0.1, made_up(rng), velocity, 0.0, 0.9, velocity_covariance=covariance)
    drawn = np.linalg.norm(rng.multivariate_normal(velocity, covariance, 20000), axis=1)
    assert estimate.speed_sigma == pytest.approx(drawn.std(), rel=0.03)
    still = replace(estimate, velocity=np.zeros(3), velocity_covariance=np.diag([0.04, 0.01, 0.09]))
    assert still.speed_sigma == pytest.approx(0.3)
    assert replace(estimate, velocity_covariance=None).speed_sigma is None


def test_results_are_compared_by_identity():
    """Their arrays have no one truth value: a copy is another result."""
    result = made_up(np.random.default_rng(0))
    copy = Reconstruction.from_dict(result.to_dict())
    assert copy != result
    assert copy not in [result]
    assert {result: 1}[result] == 1
