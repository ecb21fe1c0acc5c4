"""A made-up but plausible result with its history, for everything that draws."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import gtsam
import numpy as np

from fgrecon.core.camera import Camera, Ground
from fgrecon.core.observation import Observation
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
)
from fgrecon.core.shape_prior import ShapePrior
from fgrecon.io.catalogue import load_prior
from fgrecon.viz import SolvedVehicle, Truth, recording_of, scene_recording_of

STAGES = {"initialisation": (1, 1), "pose": (5, 1), "shape": (3, 4), "joint": (2, 3)}
"""Weight updates and steps within each, by stage."""
OUTLIERS = (3, 8)


@dataclass(frozen=True)
class Example:
    """One car on its way from a bad start to the truth."""

    reconstruction: Reconstruction
    observation: Observation
    camera: Camera
    image: np.ndarray
    truth: Truth
    ground: Ground


def make_example(seed: int = 0) -> Example:
    """A car seen from its front left: the pose converges in `pose`, the shape in `shape` and `joint`."""
    rng = np.random.default_rng(seed)
    prior = load_prior("car14")
    camera = Camera(np.array([[721.5, 0, 609.6], [0, 721.5, 172.9], [0, 0, 1]]), image_size=(1242, 375))
    coefficients = rng.normal(size=prior.dimension)
    true_pose = _pose(-0.9, (2.5, 1.65, 9.0))
    shape = prior.keypoints(coefficients)
    pixels = camera.project(true_pose.transformFrom(shape.T).T) + rng.normal(scale=1.0, size=(len(shape), 2))
    pixels[list(OUTLIERS)] += ((30.0, 12.0), (-24.0, 18.0))
    pixels[7] = np.nan
    confidence = rng.uniform(0.6, 1.0, size=len(shape))
    low, high = np.nanmin(pixels, axis=0), np.nanmax(pixels, axis=0)
    observation = Observation(pixels, confidence, box=np.array([*(low - 6), *(high + 6)]))

    start = _pose(-0.2, (3.2, 1.5, 12.0))
    history: list[Iteration] = []
    for stage, (updates, steps) in STAGES.items():
        for irls in range(updates):
            for step in range(steps):
                left = 0.0 if stage != "pose" else 0.35 ** (irls + 1)
                left = 1.0 if stage == "initialisation" else left
                pose = true_pose.compose(gtsam.Pose3.Expmap(left * gtsam.Pose3.Logmap(true_pose.between(start))))
                share = 0.0 if stage in ("initialisation", "pose") else 1 - 0.5 ** (1 + irls * steps + step)
                history.append(_iteration(stage, irls, step, pose, share * coefficients, prior, camera, observation))
    last = history[-1]
    covariance = np.array([np.diag(rng.uniform(0.02, 0.1, size=3) ** 2) for _ in shape])
    reconstruction = Reconstruction(
        status=Status.CONVERGED,
        message="the energy changed by less than 1e-9 of itself",
        pose=Pose(
            camera_T_object=last.camera_T_object,
            wireframe_uv=last.projections,
        ),
        shape=_shape(prior, last),
        uncertainty=Uncertainty(
            pose_covariance=np.eye(6) * 1e-3,
            coefficients_covariance=np.eye(prior.dimension) * 0.1,
            keypoint_covariance=covariance,
            size_covariance=np.diag([0.09, 0.01, 0.0121]),
            alternatives=(Alternative(start.matrix(), last.coefficients, 99.0),),
        ),
        diagnostics=Diagnostics(
            weights=last.weights,
            sigmas=np.where(last.weights > 0, 2.0 / np.sqrt(np.maximum(last.weights, 1e-12)), np.inf),
            visibility=np.where(np.arange(len(shape)) % 2 == 0, 0.95, 0.1),
            energies=last.energies,
            history=tuple(history),
            milliseconds={"pose": 3.1, "shape": 6.2, "joint": 2.9},
            graph=(
                *(GraphFactor("reprojection", name, ("X(v=0,t=0)", "L(v=0)")) for name in prior.category.keypoints),
                GraphFactor("box", "", ("X(v=0,t=0)", "L(v=0)")),
                GraphFactor("planarity", "wheels", ("L(v=0)", "P(v=0,f=0)")),
            ),
        ),
    )
    truth = Truth(true_pose.matrix(), prior.box_size(coefficients), shape)
    return Example(reconstruction, observation, camera, _photograph(rng), truth, Ground.level(1.65))


def _shape(prior: ShapePrior, last: Iteration) -> Shape:
    assert prior.surface is not None
    return Shape(
        category="car14",
        prior=prior.name,
        keypoint_names=prior.category.keypoints,
        coefficients=last.coefficients,
        offsets=np.zeros_like(last.keypoints),
        wireframe=last.keypoints,
        edges=np.array(prior.category.edges),
        box_size=prior.box_size(last.coefficients),
        surface_vertices=prior.surface.vertices(last.coefficients),
        surface_faces=np.asarray(prior.surface.faces, dtype=np.int64),
        faces={face.name: face.keypoints for face in prior.category.faces},
        symmetric_pairs=np.array(prior.category.symmetric_pairs),
    )


def _pose(rotation_y: float, origin: tuple[float, float, float]) -> gtsam.Pose3:
    return gtsam.Pose3(gtsam.Rot3.Ry(rotation_y), np.array(origin))


def _iteration(stage, irls, step, pose, coefficients, prior, camera, observation) -> Iteration:
    keypoints = prior.keypoints(coefficients)
    projections = camera.project(pose.transformFrom(keypoints.T).T)
    residuals = np.linalg.norm(observation.keypoints - projections, axis=1)
    weights = np.where(np.isfinite(residuals), 1 / (1 + (residuals / 5.0) ** 2), 0.0)
    energies = {"reprojection": float(np.nansum(weights * residuals**2))}
    if stage in ("shape", "joint"):
        energies |= {"prior": float(coefficients @ coefficients), "dimensions": 1 / (1 + step + irls)}
    return Iteration(stage, irls, step, pose.matrix(), coefficients, keypoints, projections, weights, energies)


def _photograph(rng: np.random.Generator) -> np.ndarray:
    rows = np.linspace(200, 90, 375)[:, None, None]
    return np.clip(rows + rng.normal(scale=8, size=(375, 1242, 3)), 0, 255).astype(np.uint8)


def record(
    path: Path,
    result: Reconstruction,
    observation: Observation,
    camera: Camera,
    *,
    ground: Ground | None = None,
    **given,
) -> Path:
    """Write the recording of one vehicle."""
    return recording_of(SolvedVehicle(result, observation, camera, **given), ground=ground).write(path)


def record_scene(path: Path, sights: list[SolvedVehicle], *, ground: Ground | None = None) -> Path:
    """Write the recording of several vehicles."""
    return scene_recording_of(sights, ground=ground).write(path)
