"""Annotation of a vehicle's keypoints in one image."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fgrecon.core.arrays import Array
from fgrecon.core.box3d import Box3D, box_corners
from fgrecon.core.camera import MIN_DEPTH, Camera
from fgrecon.core.detection import Detection
from fgrecon.core.errors import InvalidInputError
from fgrecon.core.geometry import transform, view_azimuth, yaw_rotation
from fgrecon.core.reconstruction import Reconstruction
from fgrecon.core.shape_prior import ShapePrior
from fgrecon.core.size_prior import SizePrior
from fgrecon.io.kitti_files import DriveFrame
from fgrecon.solve.vehicle.model import prepare
from fgrecon.solve.vehicle.visibility import clearance, occluder

# A vehicle fitted to one of its images.


@dataclass(frozen=True, eq=False)
class Fit:
    """A vehicle in one image: where it is, where its keypoints are seen, and what it hides."""

    result: Reconstruction  # the reconstruction
    covariance: Array  # (K, 2, 2) of the projected keypoints, square pixels
    solid: Solid  # its surface in the camera's frame; where the prior has none, a hull made from the keypoints

    @classmethod
    def of(cls, result: Reconstruction, covariance: Array, prior: ShapePrior) -> Fit:
        """The fit of a result, with the covariance (K, 2, 2) of the projected keypoints in square pixels."""
        surface = occluder(prior)
        vertices = transform(result.camera_T_object, surface.vertices(result.shape.coefficients))
        return cls(result, covariance, Solid(vertices, surface.faces.astype(np.int64)))

    @property
    def points(self) -> Array:
        """(K, 3) keypoints in the camera's frame, metres."""
        return transform(self.result.camera_T_object, self.result.wireframe)


# Which keypoints of a vehicle other vehicles hide, by rays against the surfaces in their 3D boxes.


_TRIANGLES = np.array(
    [
        *([0, 3, 1], [0, 2, 3], [4, 7, 6], [4, 5, 7], [0, 5, 4], [0, 1, 5]),
        *([2, 7, 3], [2, 6, 7], [0, 6, 2], [0, 4, 6], [1, 7, 5], [1, 3, 7]),
    ]
)
"""Of a cuboid whose corners are in the order of `box_corners`, counter-clockwise as seen from outside."""
_SHARE = 0.03  # of a vehicle's own size that is known of each dimension


@dataclass(frozen=True, eq=False)
class Solid:
    """A closed surface in the camera's frame."""

    vertices: Array  # (V, 3) metres
    faces: NDArray[np.integer]  # (F, 3) triangles, counter-clockwise as seen from outside


def solid_of(box: Box3D, prior: ShapePrior | None) -> Solid:
    """What fills a 3D box: the prior's vehicle of its size, or the box itself without a prior.

    Raises:
        InvalidInputError: The box has no size.
    """
    if box.size is None:
        raise InvalidInputError("box.size", None, "Give the box's length, width and height.")
    if prior is None:
        vertices, faces = box_corners(box.size), _TRIANGLES
    else:
        size = np.round(box.size, 2)  # a vehicle's images share what is prepared for it
        model = prepare(prior, SizePrior("of the box", size, _SHARE * size))
        surface = occluder(model.prior)
        vertices, faces = surface.mean, surface.faces
    return Solid(vertices @ yaw_rotation(box.rotation_y).T + box.location, faces)


def hidden_behind(points: Array, solids: Sequence[Solid]) -> NDArray[np.bool_]:
    """(K,) which points (K, 3) in the camera's frame lie behind one of the solids."""
    hidden = np.zeros(len(points), dtype=bool)
    for solid in solids:
        if solid.vertices[:, 2].max() > 0.0:
            hidden |= clearance(solid.vertices, solid.faces, points, np.zeros(3)) > 0.0
    return hidden


_AGREES = 0.1  # of the box's longer side: so near is a network's point the same


@dataclass(frozen=True, eq=False)
class Annotation:
    """A vehicle's keypoints in one image."""

    frame: DriveFrame  # the image
    track: int  # number of the vehicle
    kind: str  # as labelled, such as `Car`
    box: Array  # (4,) 2D box x1, y1, x2, y2, pixels
    camera: Camera  # the camera, with the size of the image
    camera_T_object: Array  # (4, 4) pose
    size: Array  # (3,) length, width and height of the labelled box, metres; without one those of the fitted shape
    keypoints: Array  # (K, 2) pixels, hidden ones as well
    # (K,) probability that each can be seen: the vehicle itself, nearer ones and the image's border count
    visible: Array
    covariance: Array  # (K, 2, 2) of the keypoints, square pixels
    vertices: Array  # (V, 3) surface in the camera's frame, metres
    faces: NDArray[np.integer]  # (F, 3) its triangles
    before: tuple[Solid, ...]  # surfaces of vehicles that are nearer
    agreement: float  # share of the network's confidence that agrees with the keypoints
    boxed: bool  # whether its 3D box was labelled; else it was reconstructed

    @classmethod
    def of(
        cls, frame: DriveFrame, row: int, camera: Camera, found: Detection, fit: Fit, before: tuple[Solid, ...]
    ) -> Annotation:
        """What a fit says."""
        labels, result, boxed = frame.objects, fit.result, bool(frame.boxed[row])
        return cls(
            frame=frame,
            track=int(frame.tracks[row]),
            kind=labels.kind[row],
            box=labels.box[row],
            camera=camera,
            camera_T_object=result.camera_T_object,
            size=labels.size[row] if boxed else result.box_size,
            keypoints=result.pose.wireframe_uv,
            visible=_visible(fit, camera, before),
            covariance=fit.covariance,
            vertices=fit.solid.vertices,
            faces=fit.solid.faces,
            before=before,
            agreement=_agreement(found, result.pose.wireframe_uv),
            boxed=boxed,
        )

    @property
    def azimuth(self) -> float:
        """Direction from the vehicle to the camera, radians; 0 ahead of it, pi / 2 to its left."""
        return float(view_azimuth(self.camera_T_object[:3, :3], self.camera_T_object[:3, 3]))


def _visible(fit: Fit, camera: Camera, before: tuple[Solid, ...]) -> Array:
    """(K,) probability of each keypoint to be seen."""
    points, (u, v) = fit.points, fit.result.pose.wireframe_uv.T
    width, height = camera.image_size or (np.inf, np.inf)
    inside = (u > -0.5) & (v > -0.5) & (u < width - 0.5) & (v < height - 0.5) & (points[:, 2] > MIN_DEPTH)
    return np.where(inside & ~hidden_behind(points, before), fit.result.diagnostics.visibility, 0.0)


def _agreement(found: Detection, keypoints: Array) -> float:
    observation = found.observation
    confidence = np.where(observation.measured, observation.confidence, 0.0)
    with np.errstate(invalid="ignore"):  # points that were not measured
        near = np.linalg.norm(observation.keypoints - keypoints, axis=1) <= _AGREES * observation.extent
    return float((confidence * near).sum() / max(confidence.sum(), 1e-9))
