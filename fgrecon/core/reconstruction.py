"""The result of reconstructing one vehicle: plain arrays, to and from JSON."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fgrecon.core.brief import brief_repr
from fgrecon.core.checks import as_either, as_instance
from fgrecon.core.digits import shortened
from fgrecon.core.errors import InvalidInputError
from fgrecon.core.history import GraphFactor, Iteration, read_graph_factor, read_iteration
from fgrecon.core.observation import Observation
from fgrecon.core.plain import array, indices, numbers, pairs, plain, square, well_formed
from fgrecon.core.plotting import DEFAULT_BACKEND, as_html, plotting_backend
from fgrecon.core.result_shapes import check_shapes
from fgrecon.core.status import Regions, Status
from fgrecon.core.table import as_arrow, as_pandas

if TYPE_CHECKING:
    import gtsam

__all__ = ["TRUSTED", "Alternative", "GraphFactor", "Iteration", "Reconstruction", "Status", "rotation_y"]

FORMAT = "fgrecon.reconstruction/1"
COMPACT = "fgrecon.reconstruction/2"

_LARGE: Mapping[str, Any] = {"history": (), "graph": (), "surface_vertices": None, "surface_faces": None}
"""Fields that the compact form leaves out, and what stands for them."""

_LATER = frozenset(
    ("graph_iterations", "graph_gain", "facing_probability", "reasons", "size_covariance", "regions", "box_excess")
)
"""Fields that earlier files have not."""

_FIX = "Give the result as fgrecon wrote it."

_STEPS = ("history", "graph")
"""Those of them that it can have."""

_OPTIONAL = frozenset(f"{name}_covariance" for name in ("pose", "coefficients", "keypoint", "size")) | frozenset(
    ("surface_vertices", "surface_faces")
)
"""Fields that may be None."""

TRUSTED = 0.5
"""Keypoints of at least this weight count as trusted where results are told in words."""


@dataclass(frozen=True)
class Alternative:
    """Another pose that explains the keypoints.

    Attributes:
        camera_T_object: (4, 4) pose.
        coefficients: (N,) shape coefficients that go with it.
        excess: How much more energy it has than the result, nats; NaN where the strategy defines no energy.
        probability: That it is the vehicle's pose; NaN where `Reconstruction.facing_probability` is.
    """

    camera_T_object: NDArray[np.float64]
    coefficients: NDArray[np.float64]
    excess: float
    probability: float = float("nan")

    __repr__ = brief_repr


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
        history: Every step, in order; made when it is first looked at, as is the graph.
        milliseconds: Wall time by stage.
        surface_vertices: (V, 3) surface in the object frame, or None.
        surface_faces: (F, 3) its triangles, or None.
        faces: The category's planar faces: indices of the keypoints around each, by name.
        symmetric_pairs: (P, 2) pairs (left, right) of mirrored keypoints.
        graph: The factors of the graph at the result; empty where no history is kept.
        graph_iterations: Iterations that the graph's solver took from the proposal that led to the result.
        graph_gain: Nats that they took off its energy; NaN where the strategy defines none.
        facing_probability: How probably the vehicle faces where the pose says, within a quarter turn, by the detector's
            directions, calibrated on real cars; without them by the energies of the poses. NaN where neither tells.
        reasons: Clauses that say what makes the result weak, or its focal length ambiguous, whatever its status.
        size_covariance: (3, 3) covariance of `box_size`, or None where it is not determined.
        regions: What the covariances rest on.
        box_excess: By how much the 2D box is larger than the vehicle looks, as a fraction, negative where it is
            smaller; NaN where there is none, or it is not wholly in the image.
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
    history: Sequence[Iteration]
    milliseconds: Mapping[str, float]
    surface_vertices: NDArray[np.float64] | None = None
    surface_faces: NDArray[np.int64] | None = None
    faces: Mapping[str, tuple[int, ...]] = field(default_factory=dict)
    symmetric_pairs: NDArray[np.int64] = field(default_factory=lambda: np.zeros((0, 2), dtype=np.int64))
    graph: Sequence[GraphFactor] = ()
    graph_iterations: int = 0
    graph_gain: float = float("nan")
    facing_probability: float = float("nan")
    reasons: tuple[str, ...] = ()
    size_covariance: NDArray[np.float64] | None = None
    regions: Regions = Regions.ASSUMED
    box_excess: float = float("nan")

    @property
    def pose(self) -> gtsam.Pose3:
        """`camera_T_object` as a GTSAM pose."""
        import gtsam  # on use: data alone need it not

        return gtsam.Pose3(self.camera_T_object)

    @property
    def pose_probability(self) -> float:
        """How probable the pose is among `alternatives`, all of which add up to 1; NaN where that is not known."""
        known = math.isfinite(self.facing_probability)
        return 1.0 - sum(other.probability for other in self.alternatives) if known else float("nan")

    @property
    def rotation_y(self) -> float:
        """Yaw about the camera's y axis, radians; 0 when the vehicle faces camera +x (KITTI's)."""
        return rotation_y(self.camera_T_object)

    @property
    def location(self) -> NDArray[np.float64]:
        """(3,) object origin in the camera frame, metres."""
        return self.camera_T_object[:3, 3]

    def __repr__(self) -> str:
        """A few lines: how it ended, the pose and size in words, trusted keypoints and time."""
        lines = [f"Reconstruction: {self.status.value}. {self.message}"]
        if np.isfinite(self.camera_T_object).all():
            (x, y, z), (length, width, height) = self.location, self.box_size
            turn = np.degrees(self.rotation_y)
            lines.append(f"  rotation_y {turn:.1f} degrees, location ({x:.2f}, {y:.2f}, {z:.2f}) m")
            lines.append(f"  length {length:.2f} m, width {width:.2f} m, height {height:.2f} m")
        trusted = np.count_nonzero(self.weights >= TRUSTED)
        time = f", {sum(self.milliseconds.values()):.0f} ms" if self.milliseconds else ""  # of an image it has it
        lines.append(f"  {trusted} of {len(self.weights)} keypoints trusted, prior {self.prior}{time}")
        return "\n".join(lines)

    def _repr_html_(self) -> str:
        """Picture and table for a notebook."""
        return as_html(self)

    def plot(
        self,
        image: NDArray[np.uint8] | str | Path | None = None,
        *,
        observation: Observation | None = None,
        backend: str = DEFAULT_BACKEND,
    ) -> Any:
        """Draw the result: the wireframe over the image, in 3D and from above.

        Args:
            image: (H, W, 3) RGB photograph, or its file; without one there is a plain canvas.
            observation: The keypoints that it was solved from, to be drawn as well.
            backend: Name under which what draws is registered (`fgrecon.core.plotting`).

        Returns:
            A `matplotlib.figure.Figure`, by the backend of fgrecon.

        Raises:
            InvalidInputError: The image is none, or there is no backend of that name.
            MissingPackageError: There is no backend at all.
        """
        return plotting_backend(backend).plot(self, image, observation=observation)

    def to_row(self, name: str = "0", *, flat: bool = True) -> dict[str, Any]:
        """The result as a row of a table.

        Scalars: id, status, message, category, prior; rotation_y in radians; x, y, z of the origin in the camera frame
        and length, width, height in metres; the standard deviations of the pose's rotation (largest axis, radians) and
        translation (largest axis, metres), None where not determined.

        Args:
            name: The vehicle's id.
            flat: Numbers and texts alone: `lambda_1` and so on, then `<keypoint>_x`, `_y`, `_z` (object frame, metres),
                `_u`, `_v` (pixels), `_weight` and `_visibility`. Else lists: camera_T_object (16), coefficients,
                keypoints (their names), wireframe (3 per keypoint), wireframe_uv (2 per keypoint), weights, visibility.
        """
        return {"id": name, **self._scalars(), **(self._flat() if flat else self._lists())}

    def to_pandas(self, name: str = "0") -> Any:
        """A `pandas.DataFrame` of one row: the columns of `to_row`, those of an exported CSV file.

        Raises:
            MissingPackageError: pandas is not installed.
        """
        return as_pandas([self.to_row(name)])

    def to_arrow(self, name: str = "0") -> Any:
        """A `pyarrow.Table` of one row, arrays as lists: the columns of an exported Parquet file."""
        return as_arrow([self.to_row(name, flat=False)])

    def to_dict(self, *, compact: bool = False, history: bool = False) -> dict[str, Any]:
        """Plain lists, numbers and strings for JSON; NaN and infinity become strings.

        Args:
            compact: A few kilobytes, as in results files: without surface, history and graph, and with the digits of
                `fgrecon.core.digits`. Else everything, and numbers keep every bit.
            history: Keep history and graph in the compact form too, with every bit.
        """
        if not compact:
            return {"format": FORMAT, **{f.name: plain(getattr(self, f.name)) for f in fields(self)}}
        kept = [f.name for f in fields(self) if f.name not in _LARGE]
        small = {name: shortened(name, plain(getattr(self, name))) for name in kept}
        return {"format": COMPACT, **small, **({n: plain(getattr(self, n)) for n in _STEPS} if history else {})}

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> Reconstruction:
        """Read back what `to_dict` wrote, compact or not.

        Raises:
            InvalidInputError: It is no mapping, of another format, a field is missing or malformed, or two do not fit.
        """
        as_instance("reconstruction", data, Mapping)
        if data.get("format") not in (FORMAT, COMPACT):
            raise InvalidInputError("format", data.get("format"), f"Give a result written as {COMPACT} or {FORMAT}.")
        absent = _LARGE if data["format"] == COMPACT else {}
        names = [f.name for f in fields(cls) if f.name in data or f.name not in (*_LATER, *absent)]
        missing = [name for name in names if name not in data]
        if missing:
            raise InvalidInputError("reconstruction", f"no field {missing[0]}", "Give a whole result.")
        values = {**absent, **{name: _read(name, data[name]) for name in names}}
        check_shapes(values)
        return cls(**values)

    def _scalars(self) -> dict[str, Any]:
        x, y, z = self.location.tolist()
        length, width, height = self.box_size.tolist()
        covariance = self.pose_covariance
        parts = (None, None) if covariance is None else (covariance[:3, :3], covariance[3:, 3:])
        rotation, translation = (None if p is None else float(np.sqrt(np.linalg.eigvalsh(p).max())) for p in parts)
        return {
            "status": self.status.value,
            "message": self.message,
            "category": self.category,
            "prior": self.prior,
            "rotation_y": self.rotation_y,
            "x": x,
            "y": y,
            "z": z,
            "length": length,
            "width": width,
            "height": height,
            "sigma_rotation": rotation,
            "sigma_translation": translation,
        }

    def _lists(self) -> dict[str, Any]:
        return {
            "camera_T_object": self.camera_T_object.ravel().tolist(),
            "coefficients": self.coefficients.tolist(),
            "keypoints": list(self.keypoint_names),
            "wireframe": self.wireframe.ravel().tolist(),
            "wireframe_uv": self.wireframe_uv.ravel().tolist(),
            "weights": self.weights.tolist(),
            "visibility": self.visibility.tolist(),
        }

    def _flat(self) -> dict[str, Any]:
        row = {f"lambda_{j + 1}": value for j, value in enumerate(self.coefficients.tolist())}
        columns = np.column_stack([self.wireframe, self.wireframe_uv, self.weights, self.visibility])
        for name, values in zip(self.keypoint_names, columns.tolist(), strict=True):
            suffixes = ("x", "y", "z", "u", "v", "weight", "visibility")
            row |= {f"{name}_{suffix}": number for suffix, number in zip(suffixes, values, strict=True)}
        return row


def rotation_y(camera_T_object: ArrayLike) -> float:
    """KITTI's yaw of a pose (4, 4) or rotation (3, 3): angle of the forward axis about the camera's y axis, radians.

    Raises:
        InvalidInputError: It is neither.
    """
    fix = "Give a pose (4, 4) or a rotation (3, 3)."
    forward = as_either("camera_T_object", camera_T_object, ((4, 4), (3, 3)), fix)[:3, 0]
    return float(np.arctan2(-forward[2], forward[0]))


def _read(name: str, value: Any) -> Any:
    """A field of a reconstruction from plain values; what is not listed is an array of numbers."""
    reader: Callable[[Any], Any] = _READERS.get(name, array)
    if value is None and name in _OPTIONAL:
        return None
    with well_formed(name, _FIX):
        if value is None:
            raise TypeError("null")
        return reader(value)


def _alternative(data: Mapping[str, Any]) -> Alternative:
    excess, probability = float(data["excess"]), float(data.get("probability", "nan"))  # which earlier files have not
    return Alternative(array(data["camera_T_object"]), array(data["coefficients"]), excess, probability)


_READERS: Mapping[str, Callable[[Any], Any]] = {
    "status": Status,
    "graph_iterations": int,
    "graph_gain": float,
    "facing_probability": float,
    "reasons": tuple,
    "regions": Regions,
    "box_excess": float,
    "message": str,
    "category": str,
    "prior": str,
    "keypoint_names": tuple,
    "edges": pairs,
    "symmetric_pairs": pairs,
    "surface_faces": indices,
    "coefficients_covariance": square,
    "energies": numbers,
    "milliseconds": numbers,
    "alternatives": lambda items: tuple(map(_alternative, items)),
    "history": lambda items: tuple(map(read_iteration, items)),
    "graph": lambda items: tuple(map(read_graph_factor, items)),
    "faces": lambda faces: {name: tuple(keypoints) for name, keypoints in faces.items()},
}
