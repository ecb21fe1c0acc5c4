"""Scores of every row of the tables on simulated instances, as arrays that can be stored and put together."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fgrecon.calibration.labelled_frames import SceneKnowledge
from fgrecon.core.arrays import Array
from fgrecon.core.errors import InvalidInputError
from fgrecon.core.metrics import hausdorff_distance, orientation_error, translation_error
from fgrecon.core.options import BoxModel, Options
from fgrecon.core.reconstruction import rotation_y
from fgrecon.core.robust import StrategyName
from fgrecon.io.arrays import read_arrays, write_arrays
from fgrecon.io.files import MADE_AGAIN
from fgrecon.solve.vehicle.conditioning import of_fleet
from fgrecon.solve.vehicle.model import prepare
from fgrecon_research.evaluation.measures import keypoint_error
from fgrecon_research.evaluation.methods import select
from fgrecon_research.paper.simulated import SimulatedInstance
from fgrecon_research.paper.stages import StageEstimate, algorithm1_state, initial_state, noisy_azimuth, stages

STAGE_ROWS = ("initialisation", "pose", "sequential", "joint")
"""Rows of Table II: fgrecon, given ground and fleet, after each stage; `sequential` is the shape stage, pose fixed."""

MAIN_ROWS = (
    *("initialisation", "epnp+size", "sqpnp+size", "sqpnp_confident+size", "poselib_ransac+size", "aspnp+size"),
    *("aspnp_irls+size", "fgrecon+size", "pose", "sequential", "joint"),
)
"""Rows of Tables I and III."""

CHAIN_ROWS = ("paper_pose", "paper_sequential", "paper_joint")
"""The paper's own chain: ASPnP + IRLS with the mean shape, the shape with the pose fixed, then both together."""

_AZIMUTH_STREAM = 1  # apart from the stream that made the instance


@dataclass(frozen=True)
class Scores:
    """I instances by R rows; an instance without a detection, or that a row fails on, is wrong everywhere."""

    frame: NDArray[np.str_]  # (I,) frames, and
    index: NDArray[np.int64]  # (I,) places in their label files
    regimes: NDArray[np.bool_]  # (I, 3) which regimes count an instance
    detection: NDArray[np.int64]  # (I,) place of its detection, or -1
    visible: NDArray[np.bool_]  # (I, K) visible keypoints
    measured: Array  # (I, K) distance of each simulated measurement from the truth relative to the box's longer side
    yaw: Array  # (I, R) estimated rotation_y, radians; NaN without an estimate
    location: Array  # (I, R, 3) estimated origin in the label's frame, metres; NaN without one
    size: Array  # (I, R, 3) estimated length, width and height, metres
    orientation: Array  # (I, R) orientation error, degrees; 180 without an estimate
    translation: Array  # (I, R) distance of the origins, metres; infinite without an estimate
    # (I, R, K) distance of each projected keypoint from its true place relative to the box's longer side; infinite
    # without an estimate
    reprojection: Array
    shape: Array  # (I, R) mean distance of a keypoint from its true place in the object frame, metres
    from_mean: Array  # (I, R) Hausdorff distance of the wireframe from the mean shape, both in the object frame, metres
    from_start: Array  # (I, R) Hausdorff distance of the placed wireframe from the initialisation's, metres
    from_before: Array  # (I, R) the same from the stage before, for rows that have one
    failures: NDArray[np.str_]  # why a row failed: `frame:index row: reason`

    def __len__(self) -> int:
        """Number of instances."""
        return len(self.frame)

    @classmethod
    def join(cls, parts: Sequence[Scores]) -> Scores:
        """All instances of several parts with the same rows."""
        return cls(**{f.name: np.concatenate([getattr(part, f.name) for part in parts]) for f in fields(cls)})

    def write(self, path: Path) -> None:
        """Write an npz file, whole or not at all."""
        write_arrays(path, compressed=True, **vars(self))

    @classmethod
    def read(cls, path: Path) -> Scores:
        """Read what `write` wrote.

        Raises:
            InvalidInputError: The file is no such file.
        """
        try:
            archive = read_arrays(path, str(path), MADE_AGAIN)
            return cls(**{f.name: archive[f.name] for f in fields(cls)})
        except (OSError, ValueError, KeyError) as error:
            raise InvalidInputError(str(path), str(error), MADE_AGAIN) from error


RowSolver = Callable[[SimulatedInstance], Mapping[str, StageEstimate]]
"""Some rows' states for an instance with a detection; raises where it has none."""


def row_solvers(rows: Sequence[str], scene: SceneKnowledge, seed: int) -> tuple[RowSolver, ...]:
    """What fills the rows; each solver fills one row or several."""
    model = prepare(scene.prior, scene.size)
    kitti = Options(box=BoxModel.CUBOID)
    paper = Options(box=BoxModel.CUBOID, strategy=StrategyName.PAPER)

    def initialisation(instance: SimulatedInstance) -> dict[str, StageEstimate]:
        rng = np.random.default_rng([seed, int(instance.frame), instance.index, _AZIMUTH_STREAM])
        azimuth = noisy_azimuth(instance.rotation_y, rng)
        assert instance.observation is not None
        assert instance.observation.box is not None
        box = instance.observation.box
        return {"initialisation": initial_state(box, instance.camera, model, scene.ground, azimuth)}

    def algorithm1(instance: SimulatedInstance) -> dict[str, StageEstimate]:
        assert instance.observation is not None
        return {"aspnp_irls+size": algorithm1_state(instance.observation, instance.camera, model, paper)}

    def staged(names: Mapping[str, str], options: Options) -> RowSolver:
        def solve(instance: SimulatedInstance) -> dict[str, StageEstimate]:
            assert instance.observation is not None
            given = {"ground": scene.ground, "size_prior": scene.size}
            found = stages(instance.observation, instance.camera, scene.prior, options, **given)
            return {name: found[stage] for name, stage in names.items()}

        return solve

    solvers: list[RowSolver] = []
    if "initialisation" in rows:
        solvers.append(initialisation)
    special = {"initialisation", "aspnp_irls+size", *STAGE_ROWS, *CHAIN_ROWS}
    solvers += [_registered(name, scene) for name in rows if name not in special]
    if "aspnp_irls+size" in rows:
        solvers.append(algorithm1)
    if "joint" in rows:
        solvers.append(staged({"pose": "pose", "sequential": "shape", "joint": "joint"}, kitti))
    if "paper_joint" in rows:
        solvers.append(staged(dict(zip(CHAIN_ROWS, ("pose", "shape", "joint"), strict=True)), paper))
    return tuple(solvers)


def _registered(name: str, scene: SceneKnowledge) -> RowSolver:
    solver = select([name])[0].bind(scene)
    mean = of_fleet(scene.prior, scene.size) if "+size" in name else scene.prior
    size = mean.box_size(np.zeros(mean.dimension))

    def solve(instance: SimulatedInstance) -> dict[str, StageEstimate]:
        assert instance.observation is not None
        estimate = solver(instance.observation, instance.camera)
        return {name: StageEstimate(estimate.camera_T_object, mean.mean, size)}

    return solve


def score_instances(
    instances: Sequence[SimulatedInstance], rows: Sequence[str], solvers: Sequence[RowSolver], mean: Array
) -> Scores:
    """Run every solver on every instance with a detection.

    Args:
        rows: Rows, in the order of the arrays.
        mean: (K, 3) the mean shape.
    """
    count, size = len(instances), len(mean)
    shape = (count, len(rows))
    yaw, location = np.full(shape, np.nan), np.full((*shape, 3), np.nan)
    box, reprojection = np.full((*shape, 3), np.nan), np.full((*shape, size), np.inf)
    measured = np.full((count, size), np.inf)
    errors = {name: np.full(shape, np.inf) for name in ("shape", "from_mean", "from_start", "from_before")}
    failures: list[str] = []
    for i, instance in enumerate(instances):
        if instance.observation is None:
            continue
        extent = instance.observation.extent
        distance = np.linalg.norm(instance.observation.keypoints - instance.projections, axis=1) / extent
        measured[i] = np.nan_to_num(distance, nan=np.inf)
        states, before = _states(instance, solvers, failures)
        for r, row in enumerate(rows):
            if row not in states:
                continue
            state = states[row]
            yaw[i, r] = rotation_y(state.camera_T_object)
            location[i, r] = state.camera_T_object[:3, 3] - instance.label_offset
            box[i, r] = state.box_size
            placed = state.in_camera()
            reprojection[i, r] = _reprojection(instance, placed, extent)
            errors["shape"][i, r] = keypoint_error(state.keypoints, instance.keypoints).mean()
            errors["from_mean"][i, r] = hausdorff_distance(mean, state.keypoints)
            if "initialisation" in states:
                errors["from_start"][i, r] = hausdorff_distance(states["initialisation"].in_camera(), placed)
            if row in before:
                errors["from_before"][i, r] = hausdorff_distance(before[row].in_camera(), placed)
    origins = [instance.camera_T_object[:3, 3] - instance.label_offset for instance in instances]
    truth = np.array(origins).reshape(count, 3)
    true_yaw = np.array([instance.rotation_y for instance in instances])
    columns = range(len(rows))
    return Scores(
        frame=np.array([instance.frame for instance in instances], dtype=np.str_),
        index=np.array([instance.index for instance in instances], dtype=np.int64),
        regimes=np.array([instance.regimes for instance in instances], dtype=bool).reshape(count, -1 if count else 3),
        detection=np.array([instance.detection for instance in instances], dtype=np.int64),
        visible=np.array([instance.visible for instance in instances], dtype=bool).reshape(count, size),
        measured=measured,
        yaw=yaw,
        location=location,
        size=box,
        orientation=np.stack([orientation_error(yaw[:, r], true_yaw) for r in columns], axis=1),
        translation=np.stack([translation_error(location[:, r], truth) for r in columns], axis=1),
        reprojection=reprojection,
        failures=np.array(failures, dtype=np.str_),
        **errors,
    )


def _reprojection(instance: SimulatedInstance, placed: Array, extent: float) -> Array:
    """(K,) distance of a wireframe's pixels from the true ones as a share of the box; infinite behind the camera."""
    away = np.linalg.norm(instance.camera.project(placed) - instance.projections, axis=1) / extent
    return np.where(placed[:, 2] <= 0.0, np.inf, away)


def _states(
    instance: SimulatedInstance, solvers: Sequence[RowSolver], failures: list[str]
) -> tuple[dict[str, StageEstimate], dict[str, StageEstimate]]:
    """Every row's state, and the state before it where one solver fills several rows."""
    states: dict[str, StageEstimate] = {}
    before: dict[str, StageEstimate] = {}
    for solver in solvers:
        try:
            found = solver(instance)
            for row, state in found.items():
                if not np.isfinite(state.camera_T_object).all():
                    raise ArithmeticError(f"{row}: the pose is not finite")
            states.update(found)
            before.update(zip(list(found)[1:], found.values(), strict=False))
        except Exception as error:  # noqa: BLE001 - a crash counts like a refusal: wrong, named, never left out
            reason = " ".join(str(error).split())
            failures.append(f"{instance.frame}:{instance.index}: {type(error).__name__}: {reason}")
    return states, before
