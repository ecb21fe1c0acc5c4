"""The keypoint network on cars with marked keypoints, and pose and shape adjustment of its output."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fgrecon.core.arrays import Array
from fgrecon.core.camera import Camera, Ground
from fgrecon.core.category import Category
from fgrecon.core.errors import FgreconError, InvalidInputError
from fgrecon.core.metrics import hausdorff_distance, orientation_error
from fgrecon.core.observation import Observation
from fgrecon.core.options import BoxModel, BoxOptions, Options, ShapeOptions
from fgrecon.core.reconstruction import Reconstruction, rotation_y
from fgrecon.core.size_prior import size_prior
from fgrecon.io.catalogue import load_prior
from fgrecon.io.kitti_calibration import read_calibration
from fgrecon.io.track_file import GroundTruth, Track, TrackFrame
from fgrecon.perception.from_image import reconstruct_detection
from fgrecon.perception.keypoints.detect import KeypointCascade
from fgrecon.solve.vehicle.model import prepare
from fgrecon_research.evaluation.bootstrap import mean_interval
from fgrecon_research.io.kitti_sets import read_labels
from fgrecon_research.paper.stages import StageEstimate, initial_state, noisy_azimuth, stages_of
from fgrecon_research.paper.tables import APK_ALPHA, LABELS, PAPER, PRINTED_APK, PRINTED_HAUSDORFF, Cell, Row, Table
from fgrecon_research.training.keypoints.evaluate import GROUPS, Scored, adjusted, score_marks
from fgrecon_research.training.keypoints.marks import read_street_marks
from fgrecon_research.training.keypoints.posed_cars import Progress, no_progress, read_posed_cars

_CAMERA_HEIGHT = 1.65  # of KITTI's cameras, metres
_REGIMES = ("easy", "moderate", "hard")
_STAGES = {"pose": "pose", "sequential": "shape", "joint": "joint"}  # stage of the history that fills a row
_AZIMUTH_STREAM = 2  # apart from the simulated instances'


def read_hand_labels(path: Path, kitti: Path, category: Category) -> list[Track]:
    """Read the marks: visible points have confidence 1, hidden ones hold a guess and are left out.

    Args:
        path: JSON list of cars with `frame`, `object_index` (line of the label file), `regime`, `box_xyxy`,
            `keypoints_uv` and `visible`: see `read_street_marks`.
        kitti: Folder with `training/label_2` and `training/calib`.
        category: The category whose keypoints the file holds, in its order.

    Raises:
        InvalidInputError: The file cannot be read, a field is missing, or a car's label does not exist.
    """
    tracks = []
    for mark in read_street_marks(path, kitti / "training" / "image_2", category.size):
        frame, _, line = mark.name.partition("/")
        index = int(line)
        labels, problems = read_labels(kitti / "training" / "label_2", [frame])
        if problems or not 0 <= index < len(labels[frame]):
            reason = str(problems[0]) if problems else f"{len(labels[frame])} objects"
            raise InvalidInputError(f"{path}: {mark.name}: object_index", index, f"Give a labelled object ({reason}).")
        points = np.where(mark.visible[:, None], mark.keypoints, np.nan)
        observation = Observation(points, mark.visible.astype(np.float64), mark.box) if mark.visible.any() else None
        truth = GroundTruth(labels[frame].location[index], float(labels[frame].rotation_y[index]))
        calibration = read_calibration(kitti / "training" / "calib" / f"{frame}.txt")
        frames = (TrackFrame(f"{frame}:{index}", observation, truth),)
        tracks.append(Track(f"{frame}:{index}", calibration.camera, calibration.label_offset, frames))
    if not tracks:
        raise InvalidInputError(str(path), "no car", "Give a list of marked cars.")
    return tracks


def adjust_marked(
    scored: Sequence[Scored],
    data: Path,
    *,
    keep_history: bool = False,
    joint: bool = True,
    progress: Progress = no_progress,
) -> list[Reconstruction | None]:
    """Pose and shape of marked cars from the network's keypoints; None where they are refused.

    Cars on streets have KITTI's ground, fleet and kind of box; photographs their own camera and no more.

    Args:
        keep_history: Whether to record every iteration.
        joint: Whether pose and shape move together; else the shape is solved at the proposal's pose.
    """
    prior, fleet, plane = load_prior("car14"), size_prior("kitti"), Ground.level(_CAMERA_HEIGHT)
    outline = Options(keep_history=keep_history, shape=ShapeOptions(joint=joint))
    street = {"options": replace(outline, box=BoxOptions(BoxModel.CUBOID)), "ground": plane, "size_prior": fleet}
    posed = {}
    if any(item.mark.group in GROUPS["photographs"] for item in scored):
        posed = {car.image.name: car.matrix for car in read_posed_cars(data / "posed_cars")}
    results: list[Reconstruction | None] = []
    for item in progress(scored, "Marked cars, adjusted"):
        alone = item.mark.group in GROUPS["photographs"]
        camera = Camera(posed[item.mark.name]) if alone else _street_camera(item, data)
        given = {"options": outline} if alone else street
        try:
            results.append(reconstruct_detection(item.detection, camera, prior=prior, **given))
        except FgreconError:
            results.append(None)
    return results


@dataclass(frozen=True)
class NetworkScores:
    """Marked street cars by rows: `network`, `initialisation` and fgrecon's stages `pose`, `sequential`, `joint`."""

    cars: tuple[str, ...]  # (C,) frame of each car, and
    groups: tuple[str, ...]  # (C,) the regime that its label belongs to
    visible: NDArray[np.bool_]  # (C, K) marked as visible: what is scored
    # by row, (C, K) distance from the mark as a fraction of the box's longer side; infinite where refused
    away: Mapping[str, Array]
    # by row but the network's, (C,) Hausdorff distance of the placed wireframe from the initialisation's, metres;
    # infinite where refused
    placed: Mapping[str, Array]
    orientation: Mapping[str, Array]  # by row but the network's, (C,) orientation error, degrees; 180 where refused
    observations: Mapping[str, Observation]  # what the network found, by `frame:line of the label file`

    def used(self, regime: str) -> NDArray[np.bool_]:
        """(C,) whether a regime, which holds the easier ones, counts a car."""
        return np.array([group in GROUPS[regime] for group in self.groups], dtype=bool)


def score_network(data: Path, seed: int = 0, detector: KeypointCascade | None = None) -> NetworkScores:
    """Run the network, pose and shape on the marked cars of KITTI's images.

    Args:
        detector: The network; None for that of the package.

    Raises:
        InvalidInputError: Marks, images or labels are missing or cannot be used.
    """
    training = data / "kitti_object" / "training"
    marks = read_street_marks(data / "hand_labels" / "kitti_object_keypoints14.json", training / "image_2")
    scored = score_marks(KeypointCascade() if detector is None else detector, marks)
    cameras = [_street_camera(item, data) for item in scored]
    labels, _ = read_labels(training / "label_2", sorted({_frame(item) for item in scored}))
    yaw = np.array([labels[_frame(item)].rotation_y[_index(item)] for item in scored])
    states: list[dict[str, StageEstimate]] = []
    model, plane = prepare(load_prior("car14"), size_prior("kitti")), Ground.level(_CAMERA_HEIGHT)
    found = adjust_marked(scored, data, keep_history=True)
    fixed = adjust_marked(scored, data, keep_history=True, joint=False)
    for item, camera, true, result, at_pose in zip(scored, cameras, yaw.tolist(), found, fixed, strict=True):
        azimuth = noisy_azimuth(true, np.random.default_rng([seed, int(_frame(item)), _index(item), _AZIMUTH_STREAM]))
        start = {"initialisation": initial_state(item.mark.box, camera, model, plane, azimuth)}
        after = {} if result is None or at_pose is None else stages_of(result, at_pose, model.prior.category)
        states.append(start | {row: after[stage] for row, stage in _STAGES.items() if after})
    rows = ("initialisation", *_STAGES)
    away = {"network": np.array([item.error for item in scored])}
    for row in rows:
        pixels = [c.project(s[row].in_camera()) if row in s else None for c, s in zip(cameras, states, strict=True)]
        away[row] = np.array([item.error for item in adjusted(scored, pixels)])
    return NetworkScores(
        cars=tuple(_frame(item) for item in scored),
        groups=tuple(item.mark.group for item in scored),
        visible=np.array([item.mark.visible for item in scored]),
        away=away,
        placed={row: np.array([_moved(state, row) for state in states]) for row in rows},
        orientation={
            row: orientation_error([rotation_y(s[row].camera_T_object) if row in s else np.nan for s in states], yaw)
            for row in rows
        },
        observations={f"{_frame(item)}:{_index(item)}": item.detection.observation for item in scored},
    )


def network_table(scores: NetworkScores) -> Table:
    """Table II on real images: APK over visible points, movement of the wireframe, and orientation, by stage."""
    lines: list[Row] = [
        (f"{PAPER}{name}", (*PRINTED_APK[name], *PRINTED_HAUSDORFF[name], *4 * [None])) for name in PRINTED_APK
    ]
    images = np.unique(scores.cars, return_inverse=True)[1]
    used = [scores.used(regime) for regime in _REGIMES]
    for row, away in scores.away.items():
        cells: list[Cell] = []
        for keep in used:
            points = scores.visible & keep[:, None]
            right = 100.0 * (away[points] <= APK_ALPHA)
            cells.append(mean_interval(right, images[np.nonzero(points)[0]]) if len(right) else None)
        if row in scores.placed:
            finite = np.isfinite(scores.placed[row])
            cells += [
                mean_interval(scores.placed[row][keep & finite]) if (keep & finite).any() else None for keep in used
            ]
            hard = scores.orientation[row][used[-1]]
            cells += [float(np.mean(hard)), float(np.median(hard))]
        else:
            cells += 5 * [None]
        points = scores.visible & used[-1][:, None]
        cells += [100.0 * float(np.median(away[points])), int((~np.isfinite(away[used[-1]]).all(axis=1)).sum())]
        lines.append((LABELS[row], tuple(cells)))
    columns = (
        *(f"{regime.capitalize()} APK %" for regime in _REGIMES),
        *(f"{regime.capitalize()} Hausdorff m, placed" for regime in _REGIMES),
        *("Hard mean °", "Hard median °", "Hard median keypoint, % of the box", "refused"),
    )
    cars = " / ".join(str(int(keep.sum())) for keep in used)
    visible = " / ".join(str(int(scores.visible[keep].sum())) for keep in used)
    note = (
        f"{cars} cars on Easy / Moderate / Hard with {visible} visible keypoints marked by hand, in "
        f"{len(set(scores.cars))} colour images of KITTI. The shipped keypoint network in the labelled box, then "
        "fgrecon given KITTI's ground, fleet and kind of box. Visible points alone count, since where hidden ones are "
        "is a guess. The marks are never learnt from."
    )
    title = "Table II on real images: own network's keypoints"
    return Table("table_2_real", title, note, columns, tuple(lines), decimals=2)


def parts_note(scores: NetworkScores) -> str:
    """How many visible points of each keypoint the parts are shares of."""
    counts = (scores.visible & scores.used("hard")[:, None]).sum(axis=0)
    return f"Percent of the visible points, of which there are {', '.join(map(str, counts.tolist()))} in this order."


def network_parts(scores: NetworkScores) -> Mapping[str, Array]:
    """Percent of the visible points of each keypoint on Hard that are right, (K,) by row; NaN where none is visible."""
    keep = scores.visible & scores.used("hard")[:, None]
    with np.errstate(invalid="ignore"):
        shares = {row: ((away <= APK_ALPHA) & keep).sum(axis=0) / keep.sum(axis=0) for row, away in scores.away.items()}
    return {LABELS[row]: 100.0 * share for row, share in shares.items()}


def _frame(item: Scored) -> str:
    return item.mark.name.partition("/")[0]


def _index(item: Scored) -> int:
    return int(item.mark.name.partition("/")[2])


def _street_camera(item: Scored, data: Path) -> Camera:
    calibration = data / "kitti_object" / "training" / "calib" / f"{_frame(item)}.txt"
    return read_calibration(calibration).camera


def _moved(states: Mapping[str, StageEstimate], row: str) -> float:
    """Hausdorff distance between a row's placed wireframe and the initialisation's."""
    if row not in states:
        return float("inf")
    return hausdorff_distance(states["initialisation"].in_camera(), states[row].in_camera())
