"""What vehicles hide of one another, against rays cast triangle by triangle."""

import numpy as np
import pytest

from fgrecon.core.box3d import Box3D
from fgrecon.core.errors import InvalidInputError
from fgrecon_research.annotation.annotation import Solid, hidden_behind, solid_of

SIZE = np.array([4.0, 1.7, 1.5])


def behind(points, solid):
    """Whether the segment from the camera to each point meets any triangle (Moeller and Trumbore)."""
    a, b, c = solid.vertices[solid.faces].transpose(1, 0, 2)
    found = []
    for point in points:
        across = np.cross(point, c - a)
        determinant = np.einsum("ij,ij->i", b - a, across)
        with np.errstate(divide="ignore", invalid="ignore"):
            u = np.einsum("ij,ij->i", -a, across) / determinant
            sideways = np.cross(-a, b - a)
            v = sideways @ point / determinant
            t = np.einsum("ij,ij->i", c - a, sideways) / determinant
        found.append(((u >= 0) & (v >= 0) & (u + v <= 1) & (t > 0) & (t < 1)).any())
    return np.array(found)


@pytest.mark.parametrize("of_prior", [True, False], ids=["car", "box"])
def test_rays_one_by_one(scene, of_prior):
    rng = np.random.default_rng(2)
    prior = scene.prior if of_prior else None
    solids = [solid_of(Box3D(np.array([x, 1.6, 9.0]), yaw, SIZE), prior) for x, yaw in ((-2.0, 0.4), (2.5, 1.9))]
    points = rng.uniform([-6, -0.5, 4.0], [7, 1.8, 18.0], (150, 3))
    expected = behind(points, solids[0]) | behind(points, solids[1])
    assert 20 < expected.sum() < 130
    np.testing.assert_array_equal(hidden_behind(points, solids), expected)


def test_a_solid_fills_its_box(scene):
    box = Box3D(np.array([1.0, 1.6, 12.0]), 0.7, SIZE)
    cuboid, car = solid_of(box, None), solid_of(box, scene.prior)
    own = (cuboid.vertices - box.location) @ np.array(
        [[np.cos(0.7), 0, np.sin(0.7)], [0, 1, 0], [-np.sin(0.7), 0, np.cos(0.7)]]
    )
    np.testing.assert_allclose(np.ptp(own, axis=0), SIZE[[0, 2, 1]], atol=1e-12)
    assert own[:, 1].max() == pytest.approx(0.0, abs=1e-12)  # it stands on its location
    assert np.linalg.norm(car.vertices.mean(axis=0) - cuboid.vertices.mean(axis=0)) < 0.5
    volumes = [
        np.einsum("ij,ij->i", a, np.cross(b, c)).sum() / 6
        for a, b, c in (s.vertices[s.faces].transpose(1, 0, 2) for s in (cuboid, car))
    ]
    assert volumes[0] == pytest.approx(SIZE.prod())  # closed, and counter-clockwise from outside
    assert 0.4 * SIZE.prod() < volumes[1] < SIZE.prod()


def test_what_is_behind_the_camera_hides_nothing():
    solid = solid_of(Box3D(np.array([0.0, 1.6, 9.0]), 0.0, SIZE), None)
    reversed_ = Solid(solid.vertices - [0, 0, 30.0], solid.faces)
    assert not hidden_behind(np.array([[0.0, 1.0, 20.0]]), [reversed_]).any()


def test_a_box_without_size_is_refused():
    with pytest.raises(InvalidInputError, match=r"box\.size"):
        solid_of(Box3D(np.array([0.0, 1.6, 9.0]), 0.0), None)
