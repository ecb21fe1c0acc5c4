"""The tables of the paper from scores, each cell with its number and its interval."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fgrecon.core.arrays import Array
from fgrecon.core.category import Category
from fgrecon_research.evaluation.bootstrap import Interval, mean_interval, statistic_interval
from fgrecon_research.evaluation.kitti_devkit import REGIMES
from fgrecon_research.evaluation.measures import THRESHOLDS
from fgrecon_research.paper.known_shape import KNOWN_SHAPE_ROWS, KnownShapeScores
from fgrecon_research.paper.simulated_scores import CHAIN_ROWS, STAGE_ROWS, Scores

Cell = Interval | float | None
Row = tuple[str, tuple[Cell, ...]]
"""Label and cells."""

PAPER = "paper: "
"""Labels of rows that are the paper's own figures begin so."""

APK_ALPHA = 0.1
"""Tolerance of the paper's APK, of the box's longer side. Of cars whose boxes are given the tables count the share of
right points; `fgrecon keypoints evaluate` has the average precision by confidence as well."""

NEAR, FAR = 20.0, 40.0

LABELS: Mapping[str, str] = {
    "network": "keypoint network",
    "initialisation": "initialisation alone",
    "epnp+size": "EPnP",
    "sqpnp+size": "SQPnP",
    "sqpnp_confident+size": "SQPnP, confident points",
    "poselib_ransac+size": "PoseLib RANSAC",
    "aspnp+size": "ASPnP",
    "aspnp_irls+size": "ASPnP + IRLS (paper's)",
    "fgrecon+size": "fgrecon, no ground plane",
    "pose": "fgrecon, pose stage",
    "sequential": "fgrecon, then shape (pose fixed)",
    "joint": "fgrecon, then both jointly",
    "paper_pose": "paper's: ASPnP + IRLS, mean shape",
    "paper_sequential": "paper's: then shape (pose fixed)",
    "paper_joint": "paper's, then both jointly",
}
"""What tables call the rows."""


# What the paper prints (Murthy et al., ICRA 2017). Its instances, keypoints and initial boxes are not public, so these
# rows stand beside ours and not against them: 14,327 cars of 3,424 images, with its own network.
Nine = tuple[float, float, float, float, float, float, float, float, float]
Three = tuple[float, float, float]

PRINTED_AOP: Mapping[str, Nine] = {
    "ObjProp3D (stereo)": (40.04, 81.37, 91.83, 36.76, 77.41, 89.31, 33.98, 73.22, 85.81),
    "Mono3D": (42.20, 84.59, 92.90, 38.52, 80.60, 90.08, 35.78, 76.27, 86.67),
    "ASPnP": (1.06, 6.18, 27.26, 1.59, 6.35, 25.40, 2.87, 6.90, 25.29),
    "Pose adjustment": (53.62, 90.44, 95.95, 48.50, 85.67, 94.44, 44.72, 80.98, 89.08),
}
"""Table I: percent within 5, 15, 30 degrees on Easy, Moderate, Hard."""

PRINTED_APK: Mapping[str, Three] = {
    "Initialization": (47.31, 51.65, 43.17),
    "Pose adjustment": (62.42, 62.72, 59.89),
    "Shape adjustment": (80.72, 81.81, 71.39),
}
"""Table II: APK on Easy, Moderate, Hard, percent."""

PRINTED_HAUSDORFF: Mapping[str, Three] = {
    "Initialization": (0.00, 0.00, 0.00),
    "Pose adjustment": (3.71, 4.64, 4.79),
    "Shape adjustment": (3.75, 4.69, 4.83),
    "Between pose and shape adjustment": (0.27, 0.28, 0.04),
}
"""Table II: Hausdorff distance from the mean shape where the initialisation puts it (no unit is printed)."""

PRINTED_MAE: Mapping[str, Three] = {
    "ObjProp3D (stereo)": (17.32, 21.86, 26.87),
    "Mono3D": (15.14, 15.15, 17.82),
    "ASPnP": (98.17, 98.82, 98.83),
    "Pose adjustment": (8.79, 12.57, 16.19),
}
"""Table III: mean absolute orientation error, degrees."""

PRINTED_MS: Mapping[str, float] = {"pose adjustment": 9.97, "keypoint network (GPU)": 200.79, "shape adjustment": 52.0}
"""Table IV: milliseconds an instance."""


@dataclass(frozen=True)
class Table:
    """One table."""

    key: str  # name in the JSON document
    title: str  # heading
    note: str  # what to know when reading it
    columns: tuple[str, ...]  # headings of the columns after the first
    rows: tuple[Row, ...]
    decimals: int = 1  # digits after the point

    def text(self, cell: Cell) -> str:
        """A cell as text; an interval as its value and half its width."""
        if cell is None:
            return "-"
        if isinstance(cell, int):
            return str(cell)
        if not isinstance(cell, Interval):
            return f"{cell:.{self.decimals}f}" if np.isfinite(cell) else "-"
        if not np.isfinite(cell.high - cell.low):
            return self.text(cell.value)
        return f"{cell.value:.{self.decimals}f} ±{(cell.high - cell.low) / 2:.{self.decimals}f}"

    def document(self) -> dict[str, Any]:
        """Plain values for JSON; what is not finite is null."""

        def plain(cell: Cell) -> Any:
            if isinstance(cell, Interval):
                return {"value": plain(cell.value), "low": plain(cell.low), "high": plain(cell.high)}
            return None if cell is None or not np.isfinite(cell) else float(cell)

        rows = {label: [plain(cell) for cell in cells] for label, cells in self.rows}
        return {"title": self.title, "note": self.note, "columns": list(self.columns), "rows": rows}


def row_label(row: str) -> str:
    """What tables call a row."""
    return LABELS.get(row, row)


def _groups(scores: Scores) -> NDArray[np.intp]:
    return np.unique(scores.frame, return_inverse=True)[1]


def _detected(scores: Scores) -> list[NDArray[np.bool_]]:
    """(I,) which detected cars each regime counts."""
    return [scores.regimes[:, regime] & (scores.detection >= 0) for regime in range(len(REGIMES))]


def aop_table(key: str, title: str, scores: Scores, rows: Sequence[str], note: str, *, printed: bool = True) -> Table:
    """Table I: AOP at every threshold and regime, in percent, over all labelled cars of the regime."""
    groups = _groups(scores)
    lines: list[Row] = [(f"{PAPER}{name}", cells) for name, cells in PRINTED_AOP.items()] if printed else []
    for r, row in enumerate(rows):
        cells: list[Cell] = []
        for regime in range(len(REGIMES)):
            used = scores.regimes[:, regime]
            for threshold in THRESHOLDS:
                right = 100.0 * (scores.orientation[used, r] <= threshold)
                cells.append(mean_interval(right, groups[used]) if used.any() else None)
        lines.append((row_label(row), tuple(cells)))
    columns = tuple(f"{regime.name} ≤{threshold}°" for regime in REGIMES for threshold in THRESHOLDS)
    return Table(key, title, note, columns, tuple(lines))


def simulated_parts(scores: Scores, rows: Sequence[str]) -> Mapping[str, Array]:
    """APK of each keypoint over the detected Hard cars, percent (K,), as measured and by stage."""
    used = _detected(scores)[-1]
    away = {"as measured": scores.measured} | {row: scores.reprojection[:, rows.index(row)] for row in STAGE_ROWS}
    return {row_label(row): 100.0 * (values[used] <= APK_ALPHA).mean(axis=0) for row, values in away.items()}


def per_part_table(key: str, title: str, note: str, shares: Mapping[str, Array], category: Category) -> Table:
    """The paper's per-part figure as numbers: percent of each keypoint that is right (K,), by stage."""
    lines = tuple(
        (f"{k + 1} {name}", tuple(float(share[k]) for share in shares.values()))
        for k, name in enumerate(category.keypoints)
    )
    return Table(key, title, note, tuple(shares), lines)


def mae_table(key: str, title: str, scores: Scores, rows: Sequence[str], note: str, *, printed: bool = True) -> Table:
    """Table III: mean and median orientation error and median translation error over the detected cars."""
    groups, used = _groups(scores), _detected(scores)
    lines: list[Row] = []
    if printed:
        lines += [(f"{PAPER}{name}", (*cells, *6 * [None])) for name, cells in PRINTED_MAE.items()]
    for r, row in enumerate(rows):
        means = [mean_interval(scores.orientation[u, r], groups[u]) if u.any() else None for u in used]
        medians = [_median(scores.orientation[u, r]) for u in used]
        away = [_median(scores.translation[u, r]) for u in used]
        lines.append((row_label(row), (*means, *medians, *away)))
    columns = tuple(f"{regime.name} {what}" for what in ("mean °", "median °", "median m") for regime in REGIMES)
    return Table(key, title, note, columns, tuple(lines), decimals=2)


def _median(values: Array) -> float | None:
    return float(np.median(values)) if len(values) else None


def stage_table(scores: Scores, rows: Sequence[str]) -> Table:
    """Table II: APK and Hausdorff distances by stage, over the detected cars."""
    groups, used = _groups(scores), _detected(scores)

    def over(values: Array, keep: NDArray[np.bool_] | None = None) -> list[Cell]:
        chosen = [u if keep is None else u & keep for u in used]
        return [mean_interval(values[u], groups[u]) if u.any() else None for u in chosen]

    def apk(distances: Array) -> list[Cell]:
        return over(100.0 * (distances <= APK_ALPHA).mean(axis=1))

    lines: list[Row] = [
        (f"{PAPER}{name}", (*PRINTED_APK.get(name, (None,) * 3), *cells, *3 * [None]))
        for name, cells in PRINTED_HAUSDORFF.items()
    ]
    lines.append(("keypoints as measured", (*apk(scores.measured), *6 * [None])))
    for row in STAGE_ROWS:
        r = rows.index(row)
        solved = np.isfinite(scores.from_start[:, r])
        cells = (
            *apk(scores.reprojection[:, r]),
            *over(scores.from_start[:, r], solved),
            *over(scores.from_mean[:, r], solved),
        )
        lines.append((row_label(row), cells))
    for label, row in (("between pose and shape stage", "sequential"), ("between shape stage and joint", "joint")):
        moved = scores.from_before[:, rows.index(row)]
        lines.append((label, (*3 * [None], *over(moved, np.isfinite(moved)), *3 * [None])))
    what = ("APK %", "Hausdorff m, placed", "Hausdorff m, shape alone")
    columns = tuple(f"{regime.name} {measure}" for measure in what for regime in REGIMES)
    note = (
        "All 14 keypoints count, hidden ones too, at 0.1 of the box's longer side. 'Placed' is the distance from the "
        "mean shape where the initialisation puts it, as the paper seems to measure; 'shape alone' that from the mean "
        "shape in the vehicle's own frame. Means over detected cars."
    )
    title = "Table II: each step's effect on the wireframe (simulated)"
    return Table("table_2", title, note, columns, tuple(lines), decimals=2)


def decoupling_table(ours: Scores, our_rows: Sequence[str], chain: Scores, chain_rows: Sequence[str]) -> Table:
    """Whether pose and shape can be solved one after the other: the same stages with and without a joint solve."""
    lines: list[Row] = []
    for scores, rows, names in ((ours, our_rows, STAGE_ROWS[1:]), (chain, chain_rows, CHAIN_ROWS)):
        used = _detected(scores)[-1]
        groups = _groups(scores)[used]
        for row in names:
            r = rows.index(row)
            cells: tuple[Cell, ...] = (
                mean_interval(scores.orientation[used, r], groups),
                _median(scores.orientation[used, r]),
                _median(scores.translation[used, r]),
                mean_interval(100.0 * (scores.reprojection[used, r] <= APK_ALPHA).mean(axis=1), groups),
                statistic_interval(100.0 * scores.shape[used, r], np.median),
            )
            lines.append((row_label(row), cells))
    columns = ("mean °", "median °", "median m", "APK %", "3D keypoint cm, median")
    note = (
        "Hard regime, detected cars. In fgrecon's pose stage pose and coefficients already move together; the paper's "
        "chain estimates the pose with the mean shape, so there the shape stage is what the paper describes. 3D "
        "keypoint error: mean over the keypoints in the vehicle's own frame."
    )
    title = "Do pose and shape decouple? One after the other against jointly (simulated)"
    return Table("decoupling", title, note, columns, tuple(lines), decimals=2)


def ms_table(times: Mapping[str, Sequence[float]], load: float) -> Table:
    """Table IV: wall time of each stage, and the load of the machine while they were taken."""
    lines: list[Row] = [(f"{PAPER}{name}", (ms, None)) for name, ms in PRINTED_MS.items()]
    lines += [(name, (float(np.mean(values)), float(np.median(values)))) for name, values in times.items()]
    note = (
        "Wall time, one instance after the other in one process with one thread, without a history; the keypoint "
        f"network is not part of this run. The machine's load meanwhile was {load:.1f}: above the number of its cores "
        "everything takes longer."
    )
    return Table("table_4", "Table IV: run time", note, ("ms, mean", "ms, median"), tuple(lines), decimals=2)


def known_shape_tables(scores: KnownShapeScores, note: str) -> tuple[Table, Table]:
    """Errors on cars of known shape: over all, and by distance and number of marks."""
    columns = ("rotation °", "position %", "keypoint cm", "rotation > 30°")
    lines = [(row, _known(scores, r, np.ones(len(scores.names), dtype=bool))) for r, row in enumerate(KNOWN_SHAPE_ROWS)]
    title = "Known shape: real marks on real cars (ApolloCar3D), medians"
    whole = Table("known_shape", title, note, columns, tuple(lines), decimals=2)
    groups = {
        f"nearer than {NEAR:g} m": scores.distance < NEAR,
        f"{NEAR:g} to {FAR:g} m": (scores.distance >= NEAR) & (scores.distance < FAR),
        f"beyond {FAR:g} m": scores.distance >= FAR,
        **{f"{count} keypoints marked": scores.marks == count for count in np.unique(scores.marks).tolist()},
        "half for choosing": ~scores.held_out,
        "held-out half": scores.held_out,
    }
    split = []
    for row in ("sqpnp", "joint", "joint+others", "sqpnp+size", "joint+size", "joint+size+others"):
        r = KNOWN_SHAPE_ROWS.index(row)
        split += [(f"{row}, {name} ({int(g.sum())})", _known(scores, r, g)) for name, g in groups.items() if g.any()]
    parts = Table(
        "known_shape_split",
        "Known shape by distance, number of keypoints and half of the images, medians",
        "Halves by a hash of the image's name: vectors, relation of sizes and frequencies were chosen on the first.",
        columns,
        tuple(split),
        decimals=2,
    )
    return whole, parts


def _known(scores: KnownShapeScores, r: int, used: NDArray[np.bool_]) -> tuple[Cell, ...]:
    errors = (scores.rotation[used, r], 100.0 * scores.translation[used, r], 100.0 * scores.keypoint[used, r])
    intervals = [statistic_interval(values, np.median) for values in errors]
    return (*intervals, int((scores.rotation[used, r] > 30.0).sum()))
