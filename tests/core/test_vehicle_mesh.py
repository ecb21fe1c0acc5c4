"""The closest model: distances by hand, of keypoints where all models have them, else of surfaces."""

from __future__ import annotations

import numpy as np
import pytest

from fgrecon.core.errors import InvalidInputError
from fgrecon.core.metrics import hausdorff_distance
from fgrecon.core.vehicle_mesh import VehicleMesh, closest_model, model_distances
from tests.results import changed
from tests.viz.made_up import Example, make_example

SQUARE = np.array([[0, 0, 0], [2, 0, 0], [2, 0, 2], [0, 0, 2]], dtype=np.float64)
FACES = np.array([[0, 1, 2], [0, 2, 3]])
NAMES = ("a", "b", "c", "d")


@pytest.fixture(scope="module")
def example() -> Example:
    return make_example()


def model(name: str, moved: float, *, keypoints: bool = True) -> VehicleMesh:
    points = SQUARE + np.array([0.0, moved, 0.0])
    return VehicleMesh(name, points, FACES, dict(zip(NAMES, points, strict=True)) if keypoints else {})


def test_distances_of_keypoints_and_of_surfaces_are_those_by_hand() -> None:
    found = model_distances(NAMES, SQUARE, None, [model("near", 0.1), model("far", -0.5)])
    assert found.between == "keypoints"
    assert found.hausdorff == pytest.approx([0.1, 0.5])
    assert found.keypoints == pytest.approx([0.1, 0.5])
    bare = [model("near", 0.1), model("far", -0.5, keypoints=False)]  # one without: none are compared by keypoints
    found = model_distances(NAMES, SQUARE, bare[0].surface_points, bare)
    assert found.between == "surfaces"
    assert found.hausdorff == pytest.approx([0.0, 0.6])
    assert np.isnan(found.keypoints).all()


def test_keypoints_are_matched_by_name() -> None:
    turned = VehicleMesh("turned", SQUARE, FACES, dict(zip(reversed(NAMES), reversed(SQUARE), strict=True)))
    assert model_distances(NAMES, SQUARE, None, [turned]).keypoints == pytest.approx([0.0])
    some = VehicleMesh("some", SQUARE, FACES, {"b": SQUARE[1] + np.array([0.0, 0.3, 0.0]), "unknown": SQUARE[0]})
    assert model_distances(NAMES, SQUARE, None, [some]).hausdorff == pytest.approx([0.3])


def test_points_stand_for_large_triangles() -> None:
    """A sheet of two triangles is the same surface as one of many."""
    sheet = model("sheet", 0.0).surface_points
    rng = np.random.default_rng(0)
    anywhere = np.column_stack([rng.uniform(0, 2, 500), np.zeros(500), rng.uniform(0, 2, 500)])
    assert hausdorff_distance(np.concatenate([sheet, anywhere]), sheet) < 0.1
    assert len(sheet) < 1500


def test_the_closest_of_moved_results(example) -> None:
    result = example.reconstruction
    points = [result.wireframe + np.array([0.0, moved, 0.0]) for moved in (0.3, 0.05, -0.1)]
    models = [
        VehicleMesh(
            name,
            result.shape.surface_vertices,
            result.shape.surface_faces,
            dict(zip(result.shape.keypoint_names, p, strict=True)),
        )
        for name, p in zip("abc", points, strict=True)
    ]
    found = closest_model(result, models)
    assert (found.model.name, found.second, found.count) == ("b", "c", 3)
    assert found.hausdorff == pytest.approx(0.05)
    assert found.margin == pytest.approx(0.05)
    assert found.to_dict()["keypoints"] == pytest.approx(0.05)
    assert str(found) == "b, 5 cm away (Hausdorff distance of the keypoints); c is 5 cm farther"
    alone = closest_model(result, models[:1])
    assert (alone.second, alone.to_dict()["second"], alone.to_dict()["margin"]) == ("", None, None)


def test_what_cannot_be_compared_is_refused(example) -> None:
    result = changed(example.reconstruction, surface_vertices=None, surface_faces=None)
    with pytest.raises(InvalidInputError, match="no keypoints"):
        closest_model(result, [model("bare", 0.0, keypoints=False)])
    with pytest.raises(InvalidInputError, match="models"):
        closest_model(result, [])
