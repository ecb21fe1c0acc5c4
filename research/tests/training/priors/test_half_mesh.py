"""The mirrored half of a mesh: closed, symmetric, close to the original."""

import numpy as np
import pytest

from fgrecon_research.training.priors.apollo79 import mirrored_half


def icosphere(levels=2):
    """Closed triangle mesh of the unit sphere, turned so that no vertex lies on z = 0."""
    golden = (1 + 5**0.5) / 2
    points = [[-1, golden, 0], [1, golden, 0], [-1, -golden, 0], [1, -golden, 0]]
    points = np.array([np.roll(p, shift) for shift in range(3) for p in points], dtype=float)
    points /= np.linalg.norm(points[0])
    from scipy.spatial import ConvexHull

    for _ in range(levels):
        simplices = ConvexHull(points).simplices
        middles = np.concatenate([points[simplices[:, [a, b]]].mean(axis=1) for a, b in ((0, 1), (1, 2), (2, 0))])
        points = np.unique(
            np.vstack([points, middles / np.linalg.norm(middles, axis=1, keepdims=True)]).round(9), axis=0
        )
    faces = ConvexHull(points).simplices
    normals = np.cross(points[faces[:, 1]] - points[faces[:, 0]], points[faces[:, 2]] - points[faces[:, 0]])
    inward = (normals * points[faces].mean(axis=1)).sum(axis=1) < 0
    faces[inward] = faces[inward][:, ::-1]
    turn = np.linalg.qr(np.random.default_rng(0).normal(size=(3, 3)))[0]
    turn *= np.linalg.det(turn)
    return points @ turn.T, faces.astype(np.int32)


def volume(vertices, faces):
    corners = vertices[faces]
    return np.einsum("ij,ij->", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])) / 6


@pytest.fixture(scope="module")
def meshes():
    points, faces = icosphere()
    scales = np.array([[2.0, 1.0, 0.8], [1.8, 1.2, 0.9], [2.2, 1.1, 0.7]])
    vertices = points * scales[:, None]
    return vertices, faces, mirrored_half(vertices, faces)


def test_symmetric_to_the_last_bit(meshes):
    mesh = meshes[2]
    assert np.array_equal(mesh.vertices, mesh.vertices[:, mesh.mirror] * [1.0, 1.0, -1.0])
    assert np.array_equal(mesh.mirror[mesh.mirror], np.arange(len(mesh.mirror)))
    triangles = {tuple(sorted(face)) for face in mesh.faces.tolist()}
    assert {tuple(sorted(mesh.mirror[list(face)].tolist())) for face in triangles} == triangles


def test_closed_and_turned_outward(meshes):
    vertices, faces, mesh = meshes
    edges = np.concatenate([mesh.faces[:, [0, 1]], mesh.faces[:, [1, 2]], mesh.faces[:, [2, 0]]])
    directed, counts = np.unique(edges, axis=0, return_counts=True)
    assert (counts == 1).all()  # each edge once in each direction: closed, all faces turned alike
    assert {tuple(edge) for edge in directed.tolist()} == {tuple(edge) for edge in directed[:, ::-1].tolist()}
    for original, half in zip(vertices, mesh.vertices, strict=True):
        assert volume(half, mesh.faces) == pytest.approx(volume(original, faces), rel=0.03)


def test_left_vertices_stay_where_they_were(meshes):
    from scipy.spatial import cKDTree

    vertices, _, mesh = meshes
    left = (mesh.vertices.mean(axis=0)[:, 2] > 0) & (mesh.mirror > np.arange(len(mesh.mirror)))
    for original, half in zip(vertices, mesh.vertices, strict=True):
        assert cKDTree(original).query(half[left])[0].max() == 0
