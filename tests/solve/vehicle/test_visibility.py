"""Ray casting against brute force, the table against the cast, symmetry, monotony, and the marks made by people."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fgrecon.io.catalogue import load_prior
from fgrecon.solve.vehicle.visibility import TOLERANCE, VisibilityTable, clearance, occluder, probability

PRIOR = load_prior("car14")
MIRROR = np.array([1.0, 1.0, -1.0])


@pytest.fixture(scope="module")
def table():
    return VisibilityTable.build(PRIOR)


def camera_at(centre):
    """A level pose (4, 4) whose optical centre lies at `centre` in the object frame."""
    pose = np.eye(4)
    pose[:3, 3] = -np.asarray(centre)
    return pose


def centre_of(azimuth, elevation, distance):
    level = np.cos(elevation)
    return distance * np.array([np.cos(azimuth) * level, -np.sin(elevation), np.sin(azimuth) * level]) + [0, -0.8, 0]


def brute_force(vertices, faces, keypoints, centre):
    """Clearance by solving, triangle by triangle, centre + t ray = a + beta (b - a) + gamma (c - a)."""
    result = []
    for point in keypoints:
        ray = point - centre
        first = 1.0
        for a, b, c in vertices[faces]:
            system = np.stack([-ray, b - a, c - a], axis=1)
            if abs(np.linalg.det(system)) < 1e-14:
                continue
            t, beta, gamma = np.linalg.solve(system, centre - a)
            if beta >= 0 and gamma >= 0 and beta + gamma <= 1 and 0 < t < first:
                first = t
        result.append((1.0 - first) * np.linalg.norm(ray))
    return np.array(result)


def box(half):
    """A closed box of the given half sizes about the origin, and its twelve outward triangles."""
    corners = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) * half
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    faces = np.array([t for a, b, c, d in quads for t in ((a, b, c), (a, c, d))])
    return corners, faces


directions = st.tuples(st.floats(-np.pi, np.pi), st.floats(np.radians(-5), np.radians(60)), st.floats(4.0, 60.0))


def test_clearance_is_the_depth_behind_the_first_face():
    vertices, faces = box(np.array([1.0, 1.0, 1.0]))
    points = np.array([[1.0, 0.0, 0.2], [0.4, 0.1, 0.3], [-1.0, 0.2, -0.1], [1.5, 0.0, 0.1]])
    centre = np.array([11.0, 0.0, 0.0])
    depth = clearance(vertices, faces, points, centre)
    rays = points - centre
    entry = np.linalg.norm(rays, axis=1) * (1.0 - np.minimum(10.0 / np.abs(rays[:, 0]), 1.0))
    np.testing.assert_allclose(depth, entry, atol=1e-12)


def test_agrees_with_brute_force():
    rng = np.random.default_rng(5)
    chosen = PRIOR.surface.faces
    for _ in range(2):
        lam = rng.standard_normal(PRIOR.dimension)
        vertices, keypoints = PRIOR.surface.vertices(lam), PRIOR.keypoints(lam)
        centre = centre_of(rng.uniform(-np.pi, np.pi), rng.uniform(0, 0.5), rng.uniform(4, 30))
        expected = brute_force(vertices, chosen, keypoints, centre)
        np.testing.assert_allclose(clearance(vertices, chosen, keypoints, centre), expected, atol=1e-9)


def test_the_shipped_surface_is_closed_and_outward():
    faces = PRIOR.surface.faces
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    assert len(np.unique(edges, axis=0)) == len(edges)  # each directed edge once ...
    assert {tuple(e) for e in edges} == {tuple(e[::-1]) for e in edges}  # ... and its reverse
    a, b, c = PRIOR.surface.mean[faces].transpose(1, 0, 2)
    assert np.einsum("ij,ij->", a, np.cross(b, c)) > 0


@settings(deadline=None, max_examples=40, derandomize=True)
@given(directions, st.floats(0, 0.3), st.floats(0, 0.3))
def test_visible_points_stay_visible_at_a_larger_tolerance(direction, small, more):
    centre = centre_of(*direction)
    surface, faces, points = PRIOR.surface.mean, PRIOR.surface.faces, PRIOR.mean
    tight = clearance(surface, faces, points, centre) <= small
    loose = clearance(surface, faces, points, centre) <= small + more
    assert (loose | ~tight).all()
    assert (clearance(surface, faces, points, centre) <= 10.0).all()


@settings(deadline=None, max_examples=40, derandomize=True)
@given(directions)
def test_a_mirrored_view_shows_the_mirrored_keypoints(table, direction):
    centre = centre_of(*direction)
    mirror = PRIOR.category.mirror
    here = table.lookup(camera_at(centre))
    there = table.lookup(camera_at(centre * MIRROR))
    np.testing.assert_allclose(there, here[mirror], atol=1e-9)
    surface, faces = PRIOR.surface.mean, PRIOR.surface.faces
    exact = clearance(surface, faces, PRIOR.mean, centre)
    np.testing.assert_allclose(clearance(surface, faces, PRIOR.mean, centre * MIRROR), exact[mirror], atol=1e-6)


def test_a_symmetric_prior_is_cast_half_and_mirrored(table):
    whole = VisibilityTable.build(
        replace(PRIOR, mean=PRIOR.mean + np.array([0.0, 0.0, 2e-6]))
    )  # not symmetric any more
    assert not replace(PRIOR, mean=PRIOR.mean + np.array([0.0, 0.0, 2e-6])).is_symmetric
    assert np.abs(whole.values - table.values).mean() < 1e-3


def test_table_agrees_with_the_cast_on_mean_shapes(table):
    rng = np.random.default_rng(2)
    centres = [centre_of(rng.uniform(-np.pi, np.pi), rng.uniform(0, 0.7), rng.uniform(4, 40)) for _ in range(300)]
    looked_up = table.lookup(np.array([camera_at(c) for c in centres]))
    exact = np.array([probability(clearance(PRIOR.surface.mean, PRIOR.surface.faces, PRIOR.mean, c)) for c in centres])
    assert looked_up.shape == exact.shape == (300, 14)
    assert (looked_up >= 0).all()
    assert (looked_up <= 1).all()
    assert np.abs(looked_up - exact).mean() < 0.04
    assert ((looked_up > 0.5) == (exact > 0.5)).mean() > 0.96


def test_table_at_its_own_directions_is_the_parallel_cast(table):
    """From very far the rays are parallel and the direction is the same for every keypoint."""
    for azimuth, elevation in ((0, 0), (45, 10), (180, 20), (270, 5), (355, 60)):
        centre = centre_of(np.radians(azimuth), np.radians(elevation), 1e6)
        exact = probability(clearance(PRIOR.surface.mean, PRIOR.surface.faces, PRIOR.mean, centre))
        np.testing.assert_allclose(table.lookup(camera_at(centre)), exact, atol=2e-3)


def test_lookup_takes_one_pose_or_many_rotated_anyhow(table):
    rng = np.random.default_rng(0)
    centre = centre_of(0.3, 0.1, 12.0)
    level = camera_at(centre)
    turned = np.eye(4)
    turned[:3, :3] = np.linalg.qr(rng.standard_normal((3, 3)))[0]
    many = table.lookup(np.stack([level, turned @ level]))
    np.testing.assert_allclose(many[0], many[1], atol=1e-9)  # where the camera looks does not matter
    np.testing.assert_allclose(table.lookup(level), many[0])


def test_far_side_is_hidden_and_near_side_visible():
    names = PRIOR.category.keypoints
    seen = clearance(PRIOR.surface.mean, PRIOR.surface.faces, PRIOR.mean, centre_of(np.pi / 2, 0.05, 15.0)) <= TOLERANCE
    for name, visible in zip(names, seen, strict=True):
        if "wheel" in name:
            assert visible == name.startswith("left")


def test_without_a_surface_a_hull_hides():
    bare = replace(PRIOR, surface=None)
    shape = occluder(bare)
    assert occluder(PRIOR) is PRIOR.surface
    rng = np.random.default_rng(1)
    lam = rng.standard_normal(PRIOR.dimension)
    np.testing.assert_allclose(shape.vertices(lam)[: PRIOR.category.size], PRIOR.keypoints(lam))
    a, b, c = shape.mean[shape.faces].transpose(1, 0, 2)
    assert (np.einsum("ij,ij->i", a - shape.mean.mean(axis=0), np.cross(b - a, c - a)) > 0).all()
    table = VisibilityTable.build(bare)
    centres = [centre_of(a, 0.1, 15.0) for a in np.arange(0, 2 * np.pi, 0.2)]
    coarse = table.lookup(np.array([camera_at(c) for c in centres])) > 0.5
    fine = np.array([clearance(PRIOR.surface.mean, PRIOR.surface.faces, PRIOR.mean, c) <= TOLERANCE for c in centres])
    assert (coarse == fine).mean() > 0.8


def test_faces_behind_the_camera_hide_nothing():
    vertices, faces = box(np.array([1.0, 1.0, 1.0]))
    far = vertices + np.array([6.0, 0.0, 0.0])  # behind a camera at x = 3 that looks at the box about the origin
    both = np.concatenate([vertices, far])
    all_faces = np.concatenate([faces, faces + len(vertices)])
    point, centre = np.array([[0.2, 0.1, 0.3]]), np.array([3.0, 0.0, 0.0])
    np.testing.assert_allclose(clearance(both, all_faces, point, centre), clearance(vertices, faces, point, centre))


@pytest.mark.data
def test_marks_made_by_people(data, table):
    """The numbers of the module's docstring, to a percent, on the photographs of posed cars."""
    labels = json.loads((data / "hand_labels" / "posed_cars_keypoints14.json").read_text())
    known = {a["image"]: a for a in json.loads((data / "posed_cars" / "annotations.json").read_text())}
    marked, exact, soft = [], [], []
    for label in labels:
        pose = known[label["image"]]
        rotation, translation = np.array(pose["R"]), np.array(pose["t"])
        # Lengths are relative (a car is 0.9 long) and the origin is the centre of the car's box.
        centre = -rotation.T @ translation * 5.0 + [0.0, -0.8, 0.0]
        marked.append(label["visible"])
        exact.append(clearance(PRIOR.surface.mean, PRIOR.surface.faces, PRIOR.mean, centre) <= TOLERANCE)
        soft.append(table.lookup(camera_at(centre)))
    marked, exact, soft = np.array(marked), np.array(exact), np.array(soft)
    assert (exact & marked).sum() / exact.sum() > 0.94
    assert (exact & marked).sum() / marked.sum() > 0.88
    assert (~exact & ~marked).sum() / (~exact).sum() > 0.88
    assert (~exact & ~marked).sum() / (~marked).sum() > 0.93
    clipped = np.clip(soft, 0.02, 0.98)
    assert -np.mean(np.where(marked, np.log(clipped), np.log(1 - clipped))) < 0.26
