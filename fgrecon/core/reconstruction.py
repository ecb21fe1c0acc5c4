"""The result of reconstructing one vehicle: plain arrays, to and from JSON."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from enum import Enum, StrEnum
from typing import Any

import gtsam
import numpy as np
from numpy.typing import NDArray

from fgrecon.core.errors import InvalidInputError

__all__ = ["Alternative", "GraphFactor", "Iteration", "Reconstruction", "Status", "rotation_y"]

FORMAT = "fgrecon.reconstruction/1"


class Status(StrEnum):
    """How a reconstruction ended."""

    CONVERGED = "converged"
    AMBIGUOUS = "ambiguous"
    """Another pose explains the keypoints nearly as well: see `alternatives`."""
    DEGENERATE = "degenerate"
    """The keypoints leave a direction undetermined, or nearly so: see `message` and the covariances."""
    FAILED = "failed"
    """The optimisation gave up, and this is the state before: see `message`."""


@dataclass(frozen=True)
class Iteration:
    """State after one step of the optimisation.

    Attributes:
        stage: `initialisation`, `pose`, `shape` or `joint`.
        irls: Index of the weight update within the stage, from 0.
        step: Index of the solver's iteration within that update, from 0.
        camera_T_object: (4, 4) pose, maps object coordinates into the camera frame.
        coefficients: (N,) shape coefficients lambda.
        keypoints: (K, 3) keypoints in the object frame, free offsets included.
        projections: (K, 2) their projections, pixels.
        weights: (K,) weight of each keypoint in [0, 1].
        energies: Energy by term, nats. That of keypoints and box is the robust one, which the weights stand for, so
            that it can be compared between stages; a strategy without an energy of its own shows a substitute.
    """

    stage: str
    irls: int
    step: int
    camera_T_object: NDArray[np.float64]
    coefficients: NDArray[np.float64]
    keypoints: NDArray[np.float64]
    projections: NDArray[np.float64]
    weights: NDArray[np.float64]
    energies: Mapping[str, float]


@dataclass(frozen=True)
class Alternative:
    """Another pose that explains the keypoints.

    Attributes:
        camera_T_object: (4, 4) pose.
        coefficients: (N,) shape coefficients that go with it.
        excess: How much more energy it has than the result, nats; NaN where the strategy defines no energy.
    """

    camera_T_object: NDArray[np.float64]
    coefficients: NDArray[np.float64]
    excess: float


@dataclass(frozen=True)
class GraphFactor:
    """One factor of the graph that the result minimises, for drawing.

    Attributes:
        term: Its energy term, such as `reprojection`.
        label: The keypoint or face that it is about; empty where the term has one factor.
        variables: Names of the variables that it ties together, such as `X(v=0,t=0)` and `L(v=0)` (`factors.key_name`).
    """

    term: str
    label: str
    variables: tuple[str, ...]


@dataclass(frozen=True)
class Reconstruction:
    """Pose and shape of one vehicle.

    K keypoints, N coefficients, V surface vertices. Camera frame: x right, y down, z forward. Object frame: x forward,
    y down, z left, origin on the ground below the centre. Metres, pixels, radians.

    Attributes:
        status: How it ended.
        message: Why, in a sentence.
        category: Name of the category.
        prior: Name of the shape prior.
        keypoint_names: K names.
        camera_T_object: (4, 4) pose, maps object coordinates into the camera frame.
        coefficients: (N,) shape coefficients lambda.
        offsets: (K, 3) free offsets, zero where they were not solved for.
        wireframe: (K, 3) keypoints in the object frame, hidden ones filled in.
        wireframe_uv: (K, 2) their projections (with lens distortion where the camera has one).
        edges: (E, 2) pairs of keypoints to draw.
        box_size: (3,) length, width and height of the vehicle's box.
        weights: (K,) final weight of each keypoint in [0, 1].
        sigmas: (K,) final standard deviation of each keypoint's noise model, pixels; infinite at weight zero.
        visibility: (K,) probability of each keypoint to be visible at the result's pose.
        pose_covariance: (6, 6) covariance of the pose in GTSAM's order and frame (rotation, translation, in the
            object's own frame), or None where it is not determined.
        coefficients_covariance: (N, N), or None.
        keypoint_covariance: (K, 3, 3) covariance of each 3D keypoint in the object frame, or None.
        energies: Energy by term at the result.
        alternatives: Other poses that the search ended in, best first.
        history: Every step, in order.
        milliseconds: Wall time by stage.
        surface_vertices: (V, 3) surface in the object frame, or None.
        surface_faces: (F, 3) its triangles, or None.
        faces: The category's planar faces: indices of the keypoints around each, by name.
        symmetric_pairs: (P, 2) pairs (left, right) of mirrored keypoints.
        graph: The factors of the graph at the result; empty where no history is kept.
    """

    status: Status
    message: str
    category: str
    prior: str
    keypoint_names: tuple[str, ...]
    camera_T_object: NDArray[np.float64]
    coefficients: NDArray[np.float64]
    offsets: NDArray[np.float64]
    wireframe: NDArray[np.float64]
    wireframe_uv: NDArray[np.float64]
    edges: NDArray[np.int64]
    box_size: NDArray[np.float64]
    weights: NDArray[np.float64]
    sigmas: NDArray[np.float64]
    visibility: NDArray[np.float64]
    pose_covariance: NDArray[np.float64] | None
    coefficients_covariance: NDArray[np.float64] | None
    keypoint_covariance: NDArray[np.float64] | None
    energies: Mapping[str, float]
    alternatives: tuple[Alternative, ...]
    history: tuple[Iteration, ...]
    milliseconds: Mapping[str, float]
    surface_vertices: NDArray[np.float64] | None = field(default=None, repr=False)
    surface_faces: NDArray[np.int64] | None = field(default=None, repr=False)
    faces: Mapping[str, tuple[int, ...]] = field(default_factory=dict, repr=False)
    symmetric_pairs: NDArray[np.int64] = field(default_factory=lambda: np.zeros((0, 2), dtype=np.int64), repr=False)
    graph: tuple[GraphFactor, ...] = field(default=(), repr=False)

    @property
    def pose(self) -> gtsam.Pose3:
        """`camera_T_object` as a GTSAM pose."""
        return gtsam.Pose3(self.camera_T_object)

    @property
    def rotation_y(self) -> float:
        """Yaw about the camera's y axis, radians; 0 when the vehicle faces camera +x (KITTI's)."""
        return rotation_y(self.camera_T_object)

    @property
    def location(self) -> NDArray[np.float64]:
        """(3,) object origin in the camera frame, metres."""
        return self.camera_T_object[:3, 3]

    def to_dict(self) -> dict[str, Any]:
        """Plain lists, numbers and strings for JSON; numbers keep every bit, NaN and infinity become strings."""
        return {"format": FORMAT, **{f.name: _plain(getattr(self, f.name)) for f in fields(self)}}

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> Reconstruction:
        """Read back what `to_dict` wrote.

        Raises:
            InvalidInputError: Another format, or a field is missing.
        """
        if data.get("format") != FORMAT:
            raise InvalidInputError("format", data.get("format"), f"Give a result written as {FORMAT}.")
        missing = [f.name for f in fields(cls) if f.name not in data]
        if missing:
            raise InvalidInputError("reconstruction", f"no field {missing[0]}", "Give a whole result.")
        integers = {"edges", "surface_faces", "symmetric_pairs"}
        plain = {"message", "category", "prior"}
        values: dict[str, Any] = {}
        for name in (f.name for f in fields(cls)):
            value = data[name]
            if name in plain or value is None:
                values[name] = value
            elif name in ("energies", "milliseconds"):
                values[name] = {k: float(v) for k, v in value.items()}
            elif name == "status":
                values[name] = Status(value)
            elif name == "keypoint_names":
                values[name] = tuple(value)
            elif name == "faces":
                values[name] = {face: tuple(keypoints) for face, keypoints in value.items()}
            elif name == "graph":
                values[name] = tuple(GraphFactor(f["term"], f["label"], tuple(f["variables"])) for f in value)
            elif name == "alternatives":
                values[name] = tuple(_record(Alternative, item) for item in value)
            elif name == "history":
                values[name] = tuple(_record(Iteration, item) for item in value)
            else:
                values[name] = np.array(value, dtype=np.int64 if name in integers else np.float64)
        for name in ("edges", "symmetric_pairs"):  # JSON's empty list tells no shape
            values[name] = values[name].reshape(-1, 2)
        if values["coefficients_covariance"] is not None:
            count = len(values["coefficients"])
            values["coefficients_covariance"] = values["coefficients_covariance"].reshape(count, count)
        return cls(**values)


def rotation_y(camera_T_object: NDArray[np.float64]) -> float:
    """KITTI's yaw of a pose (4, 4) or rotation (3, 3): angle of the forward axis about the camera's y axis, radians."""
    forward = camera_T_object[:3, 0]
    return float(np.arctan2(-forward[2], forward[0]))


def _plain(value: Any) -> Any:
    if isinstance(value, np.ndarray):
        return _plain(value.tolist())
    if isinstance(value, Enum):
        return value.value
    if isinstance(value, float | np.floating):
        return float(value) if np.isfinite(value) else str(float(value))
    if isinstance(value, np.integer):
        return int(value)
    if isinstance(value, Mapping):
        return {key: _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    if isinstance(value, Alternative | GraphFactor | Iteration):
        return {f.name: _plain(getattr(value, f.name)) for f in fields(value)}
    return value


def _record(kind: type[Any], data: Mapping[str, Any]) -> Any:
    values: dict[str, Any] = {}
    for f in fields(kind):
        value = data[f.name]
        if isinstance(value, list):
            value = np.array(value, dtype=np.float64)
        elif isinstance(value, Mapping):
            value = {k: float(v) for k, v in value.items()}
        elif f.name == "excess":
            value = float(value)
        values[f.name] = value
    return kind(**values)
