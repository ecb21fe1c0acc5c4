"""Keypoints that a nearer vehicle hides, against rays that are cast one triangle at a time."""

import numpy as np

import fgrecon
from fgrecon.io.catalogue import load_prior
from fgrecon.simulation.vehicles import yaw_pose
from fgrecon.solve.mutual_occlusion import with_occlusion
from tests.cars import CAMERA, observe


def meets(end, triangles):
    """Whether the way from the camera to a point meets one of triangles (F, 3, 3) (Moeller and Trumbore)."""
    a, b, c = triangles.transpose(1, 0, 2)
    across = np.cross(end, c - a)
    volume = np.einsum("ij,ij->i", b - a, across)
    with np.errstate(divide="ignore", invalid="ignore"):
        u = np.einsum("ij,ij->i", -a, across) / volume
        q = np.cross(-a, b - a)
        v, t = q @ end / volume, np.einsum("ij,ij->i", c - a, q) / volume
        return bool(((u >= 0) & (v >= 0) & (u + v <= 1) & (t > 0) & (t < 1)).any())


def test_a_car_behind_another():
    prior = load_prior("car14")
    poses = [yaw_pose(0.4, np.array([0.0, 1.65, 18.0])), yaw_pose(1.2, np.array([-1.2, 1.65, 10.0]))]
    seen = [observe(prior, pose) for pose in poses]
    scene = fgrecon.reconstruct_scene(seen, CAMERA, ground=1.65)
    behind, before = scene.vehicles
    alone = [fgrecon.reconstruct(one, CAMERA, ground=1.65) for one in seen]
    turned = before.camera_T_object
    surface = before.shape.surface_vertices @ turned[:3, :3].T + turned[:3, 3]
    ends = behind.wireframe @ behind.camera_T_object[:3, :3].T + behind.camera_T_object[:3, 3]
    hidden = np.array([meets(end, surface[before.shape.surface_faces]) for end in ends])
    assert 0 < hidden.sum() < len(hidden)
    assert (behind.diagnostics.visibility[hidden] < 0.05).all()
    np.testing.assert_allclose(
        behind.diagnostics.visibility[~hidden], alone[0].diagnostics.visibility[~hidden], atol=0.1
    )
    np.testing.assert_allclose(before.diagnostics.visibility, alone[1].diagnostics.visibility, atol=0.1)
    (only,) = with_occlusion([behind])
    assert only is behind
