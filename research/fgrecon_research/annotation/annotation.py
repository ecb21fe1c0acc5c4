"""What is known of a vehicle's keypoints in one image."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fgrecon.core.camera import MIN_DEPTH, Camera
from fgrecon.core.detection import Detection
from fgrecon.core.geometry import view_azimuth
from fgrecon.io.kitti_drives import DriveFrame
from fgrecon_research.annotation.fit import Fit
from fgrecon_research.annotation.hidden import Solid, hidden_behind

Array = NDArray[np.float64]

_AGREES = 0.1  # of the box's longer side: so near is a network's point the same


@dataclass(frozen=True, eq=False)
class Annotation:
    """A vehicle's keypoints in one image."""

    frame: DriveFrame  # the image
    track: int  # number of the vehicle
    kind: str  # as labelled, such as `Car`
    box: Array  # (4,) 2D box x1, y1, x2, y2, pixels
    truncation: float  # share of the box outside the image; -1 where unknown
    occlusion: int  # KITTI's grade; -1 where unknown
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
        """What a fit says.

        Args:
            frame: The image.
            row: Index of the object in its labels.
            camera: The camera, with the size of the image.
            found: What the network found.
            fit: The fit.
            before: Surfaces of what is nearer.
        """
        labels, result, boxed = frame.objects, fit.result, bool(frame.boxed[row])
        return cls(
            frame=frame,
            track=int(frame.tracks[row]),
            kind=labels.kind[row],
            box=labels.box[row],
            truncation=float(labels.truncation[row]),
            occlusion=int(labels.occlusion[row]),
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
    seen = found.observation
    confidence = np.where(seen.measured, seen.confidence, 0.0)
    with np.errstate(invalid="ignore"):  # points that were not measured
        near = np.linalg.norm(seen.keypoints - keypoints, axis=1) <= _AGREES * seen.extent
    return float((confidence * near).sum() / max(confidence.sum(), 1e-9))
