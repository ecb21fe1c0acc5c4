"""The result of reconstructing one vehicle: plain arrays, to and from JSON."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fgrecon.core.checks import as_either, as_instance
from fgrecon.core.errors import InvalidInputError
from fgrecon.core.history import Alternative, GraphFactor, Iteration, LazyFields
from fgrecon.core.observation import Observation
from fgrecon.core.plotting import DEFAULT_BACKEND, as_html, plotting_backend
from fgrecon.core.repr import brief_repr
from fgrecon.core.result_fields import FIELDS, Regions, Status, read_fields
from fgrecon.core.serialise import as_arrow, as_pandas, plain, rounded_plain

if TYPE_CHECKING:
    from gtsam import Pose3

__all__ = [
    "TRUSTED",
    "Alternative",
    "Diagnostics",
    "GraphFactor",
    "Iteration",
    "Pose",
    "Reconstruction",
    "Shape",
    "Status",
    "Uncertainty",
    "rotation_y",
]

FORMAT = "fgrecon.reconstruction/1"
COMPACT = "fgrecon.reconstruction/2"

TRUSTED = 0.5
"""Keypoints of at least this weight count as trusted where results are put in words."""


@dataclass(frozen=True, eq=False)
class Pose(LazyFields):
    """Where the vehicle is and which way it faces, in the camera's frame and in the image.

    Attributes:
        camera_T_object: (4, 4) pose, maps object coordinates into the camera frame.
        wireframe_uv: (K, 2) projections of the wireframe, pixels (with lens distortion where the camera has one).
    """

    camera_T_object: NDArray[np.float64]
    wireframe_uv: NDArray[np.float64]

    @property
    def gtsam(self) -> Pose3:
        """`camera_T_object` as a GTSAM pose."""
        import gtsam  # on use: data alone need it not

        return gtsam.Pose3(self.camera_T_object)

    @property
    def rotation_y(self) -> float:
        """Yaw about the camera's y axis, radians; 0 when the vehicle faces camera +x (KITTI's)."""
        return rotation_y(self.camera_T_object)

    @property
    def location(self) -> NDArray[np.float64]:
        """(3,) object origin in the camera frame, metres."""
        return self.camera_T_object[:3, 3]

    __repr__ = brief_repr


@dataclass(frozen=True, eq=False)
class Shape(LazyFields):
    """What the vehicle looks like, in its own frame, and the model that this is an instance of.

    Attributes:
        category: Name of the category.
        prior: Name of the shape prior.
        keypoint_names: K names.
        coefficients: (N,) shape coefficients lambda.
        offsets: (K, 3) free offsets, metres; zero where they were not solved for.
        wireframe: (K, 3) keypoints in the object frame, metres, hidden ones filled in.
        box_size: (3,) length, width and height of the vehicle's box, metres.
        edges: (E, 2) pairs of keypoints to draw.
        surface_vertices: (V, 3) surface in the object frame, metres, or None.
        surface_faces: (F, 3) its triangles, or None.
        faces: The category's planar faces: indices of the keypoints around each, by name.
        symmetric_pairs: (P, 2) pairs (left, right) of mirrored keypoints.
    """

    category: str
    prior: str
    keypoint_names: tuple[str, ...]
    coefficients: NDArray[np.float64]
    offsets: NDArray[np.float64]
    wireframe: NDArray[np.float64]
    box_size: NDArray[np.float64]
    edges: NDArray[np.int64]
    surface_vertices: NDArray[np.float64] | None = field(default_factory=lambda: None)
    surface_faces: NDArray[np.int64] | None = field(default_factory=lambda: None)
    faces: Mapping[str, tuple[int, ...]] = field(default_factory=dict)
    symmetric_pairs: NDArray[np.int64] = field(default_factory=lambda: np.zeros((0, 2), dtype=np.int64))

    __repr__ = brief_repr


@dataclass(frozen=True, eq=False)
class Uncertainty:
    """How certain pose and shape are: the spread around them, and the other poses that remain.

    Attributes:
        pose_covariance: (6, 6) covariance of the pose as GTSAM has it: rotation, then translation, radians and metres,
            about the vehicle's own axes (forward, down, left), or None where it is not determined.
        size_covariance: (3, 3) covariance of the box's length, width and height, or None where it is not determined.
        coefficients_covariance: (N, N), or None.
        keypoint_covariance: (K, 3, 3) covariance of each 3D keypoint in the object frame, or None.
        regions: What the covariances rest on: `assumed`, 3.5 % of the box, as the keypoints had none; `shipped`, the
            detector's, counted as those of the shipped networks; `fitted`, counted as `fgrecon calibrate` fitted them.
        facing_probability: How probably the vehicle faces where the pose says, within a quarter turn, by the detector's
            directions, calibrated on real cars; without them by the energies of the poses. NaN where neither is known.
        alternatives: Other poses that the search ended in, best first.
    """

    pose_covariance: NDArray[np.float64] | None = None
    size_covariance: NDArray[np.float64] | None = None
    coefficients_covariance: NDArray[np.float64] | None = None
    keypoint_covariance: NDArray[np.float64] | None = None
    regions: Regions = Regions.ASSUMED
    facing_probability: float = float("nan")
    alternatives: tuple[Alternative, ...] = ()

    @property
    def pose_probability(self) -> float:
        """How probable the pose is among `alternatives`, all of which add up to 1; NaN where that is not known."""
        known = math.isfinite(self.facing_probability)
        return 1.0 - sum(other.probability for other in self.alternatives) if known else float("nan")

    __repr__ = brief_repr


@dataclass(frozen=True, eq=False)
class Diagnostics(LazyFields):
    """How the result came about: what each keypoint counted, the energy, the steps and the time.

    Attributes:
        weights: (K,) final weight of each keypoint in [0, 1].
        sigmas: (K,) final standard deviation of each keypoint's noise model, pixels; infinite at weight zero.
        visibility: (K,) probability of each keypoint to be visible at the result's pose.
        energies: Energy by term at the result, nats.
        box_excess: By how much the 2D box is larger than the vehicle looks, as a fraction, negative where it is
            smaller; NaN where there is none, or it is not wholly in the image.
        milliseconds: Wall time by stage.
        history: Every step, in order.
        graph: The factors of the graph at the result; empty where no history is kept.
        graph_iterations: Iterations that the graph's solver took from the proposal that led to the result.
        graph_gain: Nats that they took off its energy; NaN where the strategy defines none.
        left_out: Sentences that say what of the observation was not used, and why.
        mirrored_gain: Nats by which the keypoints fit better with left and right exchanged; NaN where they fit well, or
            come from a network that knows the vehicle's direction, and nobody tried.
        points: (N, 3) points of other sensors that the graph had, camera frame, metres; none where nobody gave any.
        point_weights: (N,) final weight of each in [0, 1]: how surely it is the vehicle's.
        own_shares: By what measured points (`points`, `depth`), how many of those in the middle of the 2D box are the
            vehicle's, as a share: few where something hides it, or they are not where the image has it.
        evidence: By kind of what was given beside the picture, by how many times it makes the position's standard
            deviation smaller; of `range_rate` the velocity's.
        depth_scales: (Q, 2) scale and shift of each depth map whose pixels share an error, by all vehicles that were
            solved together (`fgrecon.DepthCalibration`); of metric ones those of the inverse depth.
        depth_covariances: (Q, 2, 2) of these.
        place_errors: (S, 6) turn in radians and shift in metres, as Pose3.Expmap takes them, that take the points of
            each sensor of unsure place to where they are in the camera's frame, by all vehicles that were solved
            together.
        place_covariances: (S, 6, 6) of these.
    """

    weights: NDArray[np.float64]
    sigmas: NDArray[np.float64]
    visibility: NDArray[np.float64]
    energies: Mapping[str, float] = field(default_factory=dict)
    box_excess: float = float("nan")
    milliseconds: Mapping[str, float] = field(default_factory=dict)
    history: Sequence[Iteration] = ()
    graph: Sequence[GraphFactor] = ()
    graph_iterations: int = 0
    graph_gain: float = float("nan")
    left_out: tuple[str, ...] = ()
    mirrored_gain: float = float("nan")
    points: NDArray[np.float64] = field(default_factory=lambda: np.zeros((0, 3)))
    point_weights: NDArray[np.float64] = field(default_factory=lambda: np.zeros(0))
    own_shares: Mapping[str, float] = field(default_factory=dict)
    evidence: Mapping[str, float] = field(default_factory=dict)
    depth_scales: NDArray[np.float64] = field(default_factory=lambda: np.zeros((0, 2)))
    depth_covariances: NDArray[np.float64] = field(default_factory=lambda: np.zeros((0, 2, 2)))
    place_errors: NDArray[np.float64] = field(default_factory=lambda: np.zeros((0, 6)))
    place_covariances: NDArray[np.float64] = field(default_factory=lambda: np.zeros((0, 6, 6)))

    __repr__ = brief_repr


@dataclass(frozen=True, eq=False)
class Reconstruction:
    """Pose and shape of one vehicle.

    K keypoints, N coefficients, V surface vertices. Camera frame: x right, y down, z forward. Object frame: x forward,
    y down, z left, origin on the ground below the centre. Metres, pixels, radians.

    What most programs read is also here: `camera_T_object`, `rotation_y`, `location`, `box_size`, `wireframe` and
    `facing_probability`. Files have all fields in one level (`to_dict`), by the same names.

    Attributes:
        status: How it ended.
        message: Why, in a sentence.
        pose: Where the vehicle is and which way it faces.
        shape: What it looks like.
        uncertainty: How certain both are, and the other poses that remain.
        diagnostics: How the result came about.
        reasons: Clauses that say what makes the result weak, or its focal length ambiguous, whatever its status.
    """

    status: Status
    message: str
    pose: Pose
    shape: Shape
    uncertainty: Uncertainty
    diagnostics: Diagnostics
    reasons: tuple[str, ...] = ()

    @property
    def camera_T_object(self) -> NDArray[np.float64]:
        """(4, 4) pose, maps object coordinates into the camera frame: that of `pose`."""
        return self.pose.camera_T_object

    @property
    def rotation_y(self) -> float:
        """Yaw about the camera's y axis, radians: that of `pose`."""
        return self.pose.rotation_y

    @property
    def location(self) -> NDArray[np.float64]:
        """(3,) object origin in the camera frame, metres: that of `pose`."""
        return self.pose.location

    @property
    def heading_sigma(self) -> float | None:
        """Standard deviation of the heading, radians, about the vehicle's own y axis; None without covariance."""
        covariance = self.uncertainty.pose_covariance
        return None if covariance is None else math.sqrt(covariance[1, 1])

    @property
    def position_sigmas(self) -> NDArray[np.float64] | None:
        """(3,) standard deviations of `location` along the camera's axes, metres; None without covariance."""
        covariance, R = self.uncertainty.pose_covariance, self.camera_T_object[:3, :3]
        return None if covariance is None else np.sqrt(np.diag(R @ covariance[3:, 3:] @ R.T))

    @property
    def box_size(self) -> NDArray[np.float64]:
        """(3,) length, width and height, metres: that of `shape`."""
        return self.shape.box_size

    @property
    def wireframe(self) -> NDArray[np.float64]:
        """(K, 3) keypoints in the object frame, metres: that of `shape`."""
        return self.shape.wireframe

    @property
    def facing_probability(self) -> float:
        """How probably the vehicle faces where the pose says, within a quarter turn: that of `uncertainty`."""
        return self.uncertainty.facing_probability

    def __repr__(self) -> str:
        """A few lines: how it ended, the pose and size in words, trusted keypoints and time."""
        lines = [f"Reconstruction: {self.status.value}. {self.message}"]
        if np.isfinite(self.camera_T_object).all():
            (x, y, z), (length, width, height) = self.location, self.box_size
            turn = np.degrees(self.rotation_y)
            lines.append(f"  rotation_y {turn:.1f} degrees, location ({x:.2f}, {y:.2f}, {z:.2f}) m")
            lines.append(f"  length {length:.2f} m, width {width:.2f} m, height {height:.2f} m")
        weights, times = self.diagnostics.weights, self.diagnostics.milliseconds
        time = f", {sum(times.values()):.0f} ms" if times else ""  # that of an image is the image's
        trusted = np.count_nonzero(weights >= TRUSTED)
        lines.append(f"  {trusted} of {len(weights)} keypoints trusted, prior {self.shape.prior}{time}")
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
        """A `pandas.DataFrame` of one row: the columns of `to_row`, which exported CSV files have too.

        Raises:
            MissingPackageError: pandas is not installed.
        """
        return as_pandas([self.to_row(name)])

    def to_arrow(self, name: str = "0") -> Any:
        """A `pyarrow.Table` of one row, arrays as lists: exported Parquet files have these columns too."""
        return as_arrow([self.to_row(name, flat=False)])

    def to_dict(self, *, compact: bool = False, history: bool = False) -> dict[str, Any]:
        """Plain lists, numbers and strings for JSON; NaN and infinity become strings.

        Args:
            compact: A few kilobytes, as in results files: without surface, history and graph, and with the digits of
                `fgrecon.core.serialise`. Else everything, and numbers keep every bit.
            history: Keep history and graph in the compact form too, with every bit.
        """
        names = [name for name, f in FIELDS.items() if not (compact and f.large)]
        each = ((name, self._field(name)) for name in names)
        kept = {name: value for name, value in each if not FIELDS[name].spare or len(value)}
        if not compact:
            return {"format": FORMAT, **{name: plain(value) for name, value in kept.items()}}
        steps = {name: plain(self._field(name)) for name in ("history", "graph") if history}
        return {"format": COMPACT, **{name: rounded_plain(name, value) for name, value in kept.items()}, **steps}

    def _field(self, name: str) -> Any:
        group = FIELDS[name].group
        return getattr(getattr(self, group) if group else self, name)

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> Reconstruction:
        """Read back what `to_dict` wrote, compact or not.

        Raises:
            InvalidInputError: It is no mapping, of another format, a field is missing or malformed, or two do not fit.
        """
        as_instance("reconstruction", data, Mapping)
        if data.get("format") not in (FORMAT, COMPACT):
            raise InvalidInputError("format", data.get("format"), f"Give a result written as {COMPACT} or {FORMAT}.")
        values = read_fields(data, compact=data["format"] == COMPACT)
        parts: dict[str, dict[str, Any]] = {"": {}, "pose": {}, "shape": {}, "uncertainty": {}, "diagnostics": {}}
        for name, value in values.items():
            parts[FIELDS[name].group][name] = value
        return cls(
            **parts[""],
            pose=Pose(**parts["pose"]),
            shape=Shape(**parts["shape"]),
            uncertainty=Uncertainty(**parts["uncertainty"]),
            diagnostics=Diagnostics(**parts["diagnostics"]),
        )

    def _scalars(self) -> dict[str, Any]:
        x, y, z = self.location.tolist()
        length, width, height = self.box_size.tolist()
        covariance = self.uncertainty.pose_covariance
        parts = (None, None) if covariance is None else (covariance[:3, :3], covariance[3:, 3:])
        rotation, translation = (None if p is None else float(np.sqrt(np.linalg.eigvalsh(p).max())) for p in parts)
        return {
            "status": self.status.value,
            "message": self.message,
            "category": self.shape.category,
            "prior": self.shape.prior,
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
            "coefficients": self.shape.coefficients.tolist(),
            "keypoints": list(self.shape.keypoint_names),
            "wireframe": self.wireframe.ravel().tolist(),
            "wireframe_uv": self.pose.wireframe_uv.ravel().tolist(),
            "weights": self.diagnostics.weights.tolist(),
            "visibility": self.diagnostics.visibility.tolist(),
        }

    def _flat(self) -> dict[str, Any]:
        row = {f"lambda_{j + 1}": value for j, value in enumerate(self.shape.coefficients.tolist())}
        columns = np.column_stack(
            [self.wireframe, self.pose.wireframe_uv, self.diagnostics.weights, self.diagnostics.visibility]
        )
        for name, values in zip(self.shape.keypoint_names, columns.tolist(), strict=True):
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
