"""With and without the compiled kernels: the same results, down to what the solver's last step leaves."""

import os
import subprocess
import sys

import numpy as np
import pytest

from factors.native import native
from fgrecon.core.geometry import transform
from fgrecon.core.observation import Observation
from fgrecon.core.options import Options, SearchOptions, ShapeOptions
from fgrecon.io.catalogue import load_prior
from fgrecon.solve.pipeline import reconstruct
from fgrecon.solve.proposals import _polynomial
from fgrecon.solve.proposals.aspnp import aspnp
from fgrecon.solve.proposals.problem import Problem
from fgrecon.solve.proposals.starts import _extents
from fgrecon.solve.track import reconstruct_track
from fgrecon.solve.vehicle.model import prepare
from fgrecon.solve.vehicle.visibility import clearance, occluder
from tests.cars import CAMERA, observe, yaw_pose

pytestmark = pytest.mark.skipif(native("fgrecon.solve._native") is None, reason="no compiled kernel")

DIRECTION = np.exp(2.0 * np.cos(np.arange(72) * 2.0 * np.pi / 72))
SETTINGS = {
    "defaults": {},
    "ground and size": {"ground": 1.65, "size_prior": "kitti"},
    "cuboid": {"options": Options(box="cuboid"), "ground": 1.65},
    "no box": {"options": Options(box="off")},
    "no offsets": {"options": Options(shape=ShapeOptions(free_offsets=False)), "size_prior": "kitti"},
    "fixed pose": {"options": Options(shape=ShapeOptions(joint=False))},
    "search with shape": {"options": Options(search=SearchOptions(basis_vectors=3)), "size_prior": "kitti"},
    "every term": {"options": Options(disabled_terms=()), "ground": 1.65},
}


def car(seed, *, direction=False):
    rng = np.random.default_rng(seed)
    seen = observe(load_prior("car14"), yaw_pose(rng.uniform(-3, 3)), rng.normal(size=5), noise=4.0, seed=seed)
    pixels = seen.keypoints.copy()
    pixels[seed % 14] += 60.0
    azimuth = np.roll(DIRECTION, seed * 7) / DIRECTION.sum() if direction else None
    return Observation(pixels, rng.uniform(0.2, 0.95, 14), seen.box, azimuth=azimuth)


@pytest.mark.parametrize("name", SETTINGS)
def test_a_car_is_the_same(name, monkeypatch):
    for seed in range(4):
        seen = car(seed, direction=seed % 2 == 0)
        compiled = reconstruct(seen, CAMERA, **SETTINGS[name])
        with monkeypatch.context() as patch:
            patch.setenv("FGRECON_KERNEL", "numpy")
            plain = reconstruct(seen, CAMERA, **SETTINGS[name])
        assert compiled.status is plain.status
        np.testing.assert_allclose(compiled.camera_T_object, plain.camera_T_object, atol=1e-9)
        np.testing.assert_allclose(compiled.wireframe, plain.wireframe, atol=1e-9)
        np.testing.assert_allclose(compiled.diagnostics.weights, plain.diagnostics.weights, atol=1e-8)
        np.testing.assert_allclose(compiled.diagnostics.visibility, plain.diagnostics.visibility, atol=1e-8)
        np.testing.assert_allclose(compiled.uncertainty.pose_covariance, plain.uncertainty.pose_covariance, rtol=1e-5)
        assert compiled.diagnostics.energies == pytest.approx(plain.diagnostics.energies, abs=1e-7)
        assert len(compiled.uncertainty.alternatives) == len(plain.uncertainty.alternatives)
        assert len(compiled.diagnostics.history) == len(plain.diagnostics.history)
        assert compiled.diagnostics.graph == plain.diagnostics.graph


def test_a_track_is_the_same(monkeypatch):
    seen = [car(seed) for seed in range(3)]
    compiled = reconstruct_track(seen, CAMERA, size_prior="kitti", in_order=False)
    monkeypatch.setenv("FGRECON_KERNEL", "numpy")
    plain = reconstruct_track(seen, CAMERA, size_prior="kitti", in_order=False)
    for one, other in zip(compiled.frames, plain.frames, strict=True):
        np.testing.assert_allclose(one.camera_T_object, other.camera_T_object, atol=1e-8)


def test_newton_finds_the_minima_that_the_roots_give():
    """From 48 starts; where the global method says that nothing is missing, nothing is."""
    rng = np.random.default_rng(0)
    found = missed = 0
    for _ in range(200):
        A = rng.normal(size=(20, 10))
        L = rng.normal(size=(4, 4))
        every = _polynomial.minima(A.T @ A, L + L.T)
        some = _polynomial.minima(A.T @ A, L + L.T, every=False)
        assert not some.complete
        for q, value in zip(every.q, every.value, strict=True):
            near = np.abs(some.q @ q) / np.linalg.norm(some.q, axis=1) / np.linalg.norm(q) > 1 - 1e-8
            found += near.any()
            missed += not near.any()
            if near.any():
                np.testing.assert_allclose(some.value[near], value, rtol=1e-9)
    assert found > 200
    assert missed <= 0.01 * found


def test_poses_from_points_are_numpys(monkeypatch):
    rng, found = np.random.default_rng(1), 0
    points = load_prior("car14").mean
    for angle in np.arange(0.0, 6.0, 0.3):
        pixels = CAMERA.project(transform(yaw_pose(angle), points)) + rng.normal(size=(len(points), 2))
        rays, weights = CAMERA.rays(pixels)[:, :2], rng.uniform(0.1, 1.0, len(points))
        compiled = aspnp(points, rays, weights, every=False, tolerance=np.inf)
        with monkeypatch.context() as patch:
            patch.setenv("FGRECON_KERNEL", "numpy")
            plain = aspnp(points, rays, weights, every=False, tolerance=np.inf)
        found += len(plain)
        for one, other in zip(compiled, plain, strict=True):
            np.testing.assert_allclose(one.camera_T_object, other.camera_T_object, rtol=1e-9, atol=1e-9)
            np.testing.assert_allclose([one.cost, one.rms], [other.cost, other.rms], rtol=1e-9)
            assert one.weight_in_front == pytest.approx(other.weight_in_front, abs=1e-12)
    assert found > 20


def test_extents_and_rays_are_numpys(monkeypatch):
    model = prepare(load_prior("car14"))
    rotation = np.array([yaw_pose(angle)[:3, :3] for angle in np.arange(0, 6, 0.5)])
    ray = np.array([0.3, -0.1, 1.0])
    surface = occluder(model.prior)
    centres = [yaw_pose(angle)[:3, :3].T @ [-3.0, -1.0, -9.0] for angle in np.arange(0, 6, 0.5)]

    def all_of_it():
        extents = _extents(model.outline.mean, rotation, ray)
        return [*extents, *(clearance(surface.mean, surface.faces, model.prior.mean, centre) for centre in centres)]

    compiled = all_of_it()
    monkeypatch.setenv("FGRECON_KERNEL", "numpy")
    for one, other in zip(compiled, all_of_it(), strict=True):
        np.testing.assert_allclose(one, other, atol=1e-12)


def test_visibility_from_a_pose_is_the_tables():
    model = prepare(load_prior("car14"))
    problem = Problem.of(car(0), CAMERA, model, None, Options())
    assert problem.energy.compiled is not None
    for angle in np.arange(-3.0, 3.0, 0.4):
        pose = yaw_pose(angle)
        np.testing.assert_allclose(problem.energy.visible_from(pose), model.visibility.lookup(pose), atol=1e-12)


def test_the_kernel_is_left_alone_where_it_is_not_wanted():
    code = "from factors.native import native; print(native('factors._energy'))"
    environment = {**os.environ, "FGRECON_KERNEL": "numpy"}
    child = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, env=environment, check=True)
    assert child.stdout.strip() == "None"
    assert native("factors._no_such_kernel") is None
