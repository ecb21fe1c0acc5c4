"""Car models of a folder: the same mesh from every format, in the object frame; what is none is refused by name."""

from __future__ import annotations

import json

import numpy as np
import pytest
import trimesh

from fgrecon.core.errors import InvalidInputError
from fgrecon.io.catalogue import load_category, load_prior
from fgrecon.io.models import check_axes, read_models

PRIOR = load_prior("car14")
CATEGORY = load_category("car14")
VERTICES, FACES = PRIOR.surface.mean, PRIOR.surface.faces
OBJECT_TO = {
    "x,-y": np.eye(3),
    "z,y": np.array([[0, 0, 1], [0, -1, 0], [1, 0, 0]]),  # glTF: left, up, forward
    "-y,z": np.array([[0, 0, 1], [-1, 0, 0], [0, -1, 0]]),
}


def centred(points):
    low, high = points.min(axis=0), points.max(axis=0)
    return points - [(low[0] + high[0]) / 2, high[1], (low[2] + high[2]) / 2]


@pytest.mark.parametrize(("ending", "axes"), [("obj", "x,-y"), ("ply", "x,-y"), ("glb", "z,y"), ("obj", "-y,z")])
def test_a_mesh_comes_into_the_object_frame(tmp_path, ending, axes):
    turn = OBJECT_TO[axes]
    assert np.linalg.det(turn) == pytest.approx(1.0)
    mesh = trimesh.Trimesh(VERTICES @ turn.T + (3.0, -2.0, 1.0), FACES, process=False)
    mesh.export(tmp_path / f"car.{ending}")
    own = None if axes in ("x,-y", "z,y") else axes
    (found,) = read_models(tmp_path, CATEGORY, own)
    assert found.name == "car"
    assert found.vertices.min(axis=0) == pytest.approx(centred(VERTICES).min(axis=0), abs=1e-4)
    assert found.vertices.max(axis=0) == pytest.approx(centred(VERTICES).max(axis=0), abs=1e-4)
    assert found.faces.shape == FACES.shape


def test_keypoints_beside_a_mesh_move_with_it(tmp_path):
    turn, moved = OBJECT_TO["z,y"], np.array([3.0, -2.0, 1.0])
    trimesh.Trimesh(VERTICES @ turn.T + moved, FACES, process=False).export(tmp_path / "car.glb")
    wheel = PRIOR.mean[0]
    (tmp_path / "car.json").write_text(json.dumps({"keypoints": {"left_front_wheel": (turn @ wheel + moved).tolist()}}))
    (found,) = read_models(tmp_path / "car.glb", CATEGORY)
    away = centred(VERTICES)[0] - VERTICES[0]
    assert found.keypoints["left_front_wheel"] == pytest.approx(wheel + away, abs=1e-4)
    (tmp_path / "car.json").write_text(json.dumps({"keypoints": {"wheel": [0, 0, 0]}}))
    with pytest.raises(InvalidInputError, match="wheel"):
        read_models(tmp_path, CATEGORY)


def archive(path, **arrays):
    shapes = np.stack([PRIOR.mean, PRIOR.keypoints(np.ones(PRIOR.dimension))])
    whole = {"car_names": np.array(["a", "b"]), "vertices": np.stack([VERTICES, VERTICES]), "faces": FACES}
    np.savez(path, **{k: v for k, v in (whole | {"keypoints": shapes} | arrays).items() if v is not None})
    return path


def test_an_archive_has_many(tmp_path):
    one, two = read_models(archive(tmp_path / "cars.npz"), CATEGORY)
    assert (one.name, two.name) == ("a", "b")
    assert np.array_equal(one.vertices, VERTICES)
    assert two.keypoints[CATEGORY.keypoints[3]] == pytest.approx(PRIOR.keypoints(np.ones(PRIOR.dimension))[3])
    bare, _ = read_models(archive(tmp_path / "bare.npz", keypoints=None), CATEGORY)
    assert bare.keypoints == {}
    named = archive(tmp_path / "named.npz", keypoints=np.zeros((2, 1, 3)), keypoint_names=np.array(["tow_bar"]))
    assert list(read_models(named, CATEGORY)[0].keypoints) == ["tow_bar"]


@pytest.mark.parametrize(
    ("arrays", "named"),
    [
        ({"faces": None}, "vertices"),
        ({"faces": FACES + 9000}, "triangles"),
        ({"vertices": np.stack([VERTICES, VERTICES]) * 100}, "long"),
        ({"vertices": np.stack([VERTICES * np.nan, VERTICES])}, "nan"),
        ({"keypoints": np.zeros((2, 3, 3))}, "keypoint_names"),
    ],
    ids=["faces", "indices", "centimetres", "nan", "keypoints"],
)
def test_what_is_no_model_is_refused(tmp_path, arrays, named):
    with pytest.raises(InvalidInputError, match=named):
        read_models(archive(tmp_path / "cars.npz", **arrays), CATEGORY)


def test_damaged_and_missing_files_are_named(tmp_path):
    with pytest.raises(InvalidInputError, match="nowhere"):
        read_models(tmp_path / "nowhere", CATEGORY)
    with pytest.raises(InvalidInputError, match="Give a folder"):
        read_models(tmp_path, CATEGORY)
    for ending in ("obj", "ply", "glb", "npz"):
        (file := tmp_path / f"bad.{ending}").write_bytes(b"no mesh at all")
        with pytest.raises(InvalidInputError, match=f"bad.{ending}"):
            read_models(file, CATEGORY)
    (file := tmp_path / "car.stl").write_bytes(b"solid")
    with pytest.raises(InvalidInputError, match="stl"):
        read_models(file, CATEGORY)


@pytest.mark.parametrize("axes", ["x", "x,x", "x,-x", "x,y,z", "a,b", ""])
def test_axes_that_are_none(axes):
    with pytest.raises(InvalidInputError, match="models_axes"):
        check_axes(axes)
