"""The whole evaluation of the paper."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from fgrecon.io.kitti_files import Objects
from fgrecon.io.track_file import Track, read_track
from fgrecon_research.evaluation.kitti_devkit import Space, evaluate
from fgrecon_research.io.kitti_sets import count_defects, write_results
from fgrecon_research.paper.apollocar3d import CONSISTENT, FEWEST_MARKS, MarkedCars, read_apollocar3d
from fgrecon_research.paper.claims import Claim, claims
from fgrecon_research.paper.known_shape import (
    BASIS,
    KNOWN_SHAPE_OPTIONS,
    KnownShapeScores,
    score_known_shapes,
)
from fgrecon_research.paper.network import network_parts, network_table, parts_note, read_hand_labels
from fgrecon_research.paper.simulated import Fleet
from fgrecon_research.paper.simulated_run import (
    CONDITIONS,
    ConditionResult,
    PaperSettings,
    Validation,
    read_validation,
    run_conditions,
    vehicles_of,
)
from fgrecon_research.paper.simulated_scores import Scores
from fgrecon_research.paper.single_process import Measured, measure, some_instances
from fgrecon_research.paper.tables import (
    Table,
    aop_table,
    decoupling_table,
    known_shape_tables,
    mae_table,
    ms_table,
    per_part_table,
    simulated_parts,
    stage_table,
)
from fgrecon_research.training.priors.apollo79 import Apollo79, load_apollo79

_TRACK_FORMAT = "kitti_tracking_keypoints14"
_SIMULATED_PARTS = "APK of each part on Hard (simulated)"
_NETWORK_PARTS = "APK of each part on Hard (real images, own network)"
_PARTS_NOTE = (
    "Percent of the detected Hard cars whose keypoint projects within 0.1 of the box's longer side of the truth."
)


@dataclass(frozen=True)
class PaperEvaluation:
    """What came out."""

    conditions: tuple[str, ...]  # what was run under which conditions, a paragraph each
    claims: tuple[Claim, ...]  # what the numbers say about the paper's claims
    tables: tuple[Table, ...]
    problems: Mapping[str, int]  # defects of the files, counted by kind, and
    defects: tuple[str, ...]  # each by name
    failures: tuple[str, ...]  # instances that some row failed on, with the reason
    throughput: Mapping[str, float]  # simulated instances that were worked on now, seconds, and instances a second


@dataclass(frozen=True)
class _Inputs:
    """The data, read and checked."""

    models: Apollo79
    cars: MarkedCars
    tracks: Sequence[Track]
    images: Sequence[Track]
    validation: Validation

    @classmethod
    def read(cls, settings: PaperSettings) -> _Inputs:
        data, category = settings.data, settings.scene.prior.category
        models = load_apollo79(data)
        marks = data / "hand_labels" / "kitti_object_keypoints14.json"
        return cls(
            models=models,
            cars=read_apollocar3d(data / "apollocar3d_val" / "annotations.json", models),
            tracks=[read_track(path, category) for path in sorted((data / _TRACK_FORMAT).glob("*.json"))],
            images=read_hand_labels(marks, data / "kitti_object", category),
            validation=read_validation(data / "kitti_object"),
        )


def evaluate_paper(
    settings: PaperSettings, advance: Callable[[str, int, int], None] = lambda *_: None
) -> PaperEvaluation:
    """Run everything: the simulated set, the cars of known shape, real tracks and images, and run times.

    Args:
        settings: What to run on.
        advance: Called with the step, how much of it is done, and how much there is.

    Raises:
        InvalidInputError: Something of the data is missing or cannot be used.
    """
    inputs = _Inputs.read(settings)
    outcomes = run_conditions(inputs.validation, CONDITIONS, inputs.models, settings, advance)
    known = score_known_shapes(
        inputs.cars,
        inputs.models,
        workers=settings.workers,
        advance=lambda done, total: advance("known shape", done, total),
    )
    fleet = Fleet(vehicles_of(inputs.models), inputs.models.size, seed=settings.seed)
    instances = some_instances(inputs.validation, fleet)
    measured = measure(inputs.tracks, inputs.images, instances, settings, advance)
    main, chain = outcomes["validation"], outcomes["chain"]
    solved, seconds = sum(o.solved for o in outcomes.values()), sum(o.seconds for o in outcomes.values())
    tables = _tables(inputs, settings, outcomes, known, measured)
    return PaperEvaluation(
        conditions=_conditions(settings, outcomes, inputs.validation),
        claims=claims(main.scores, main.condition.rows, chain.scores, chain.condition.rows),
        tables=tables,
        problems=count_defects(inputs.validation.problems),
        defects=tuple(map(str, inputs.validation.problems)),
        failures=(*(f for o in outcomes.values() for f in o.scores.failures.tolist()), *known.failures),
        throughput={"instances": solved, "seconds": seconds, "per_second": solved / max(seconds, 1e-9)},
    )


def _tables(
    inputs: _Inputs,
    settings: PaperSettings,
    outcomes: Mapping[str, ConditionResult],
    known: KnownShapeScores,
    measured: Measured,
) -> tuple[Table, ...]:
    """Every table, Table I first."""
    main, rows = outcomes["validation"].scores, outcomes["validation"].condition.rows
    chain, chain_rows = outcomes["chain"].scores, outcomes["chain"].condition.rows
    category = settings.scene.prior.category
    counted = main.regimes.sum(axis=0).tolist()
    found = (main.regimes & (main.detection >= 0)[:, None]).sum(axis=0).tolist()
    note = (
        f"{counted[0]} / {counted[1]} / {counted[2]} labelled cars on Easy / Moderate / Hard, of which {found[0]} / "
        f"{found[1]} / {found[2]} have a detection of IoU > 0.7; a car without one is wrong at every threshold. ± is "
        "half the 95 % bootstrap interval over images. Every row is given the fleet's mean size; the initialisation "
        "and fgrecon's stages are given the ground plane as well."
    )
    title_3 = "Table III: orientation error (simulated keypoints)"
    detected = f"Over the {found[0]} / {found[1]} / {found[2]} detected cars."
    on_images = network_parts(measured.network)
    return (
        aop_table("table_1", "Table I: orientation precision (simulated keypoints)", main, rows, note),
        stage_table(main, rows),
        mae_table("table_3", title_3, main, rows, detected),
        ms_table(measured.times, measured.load),
        per_part_table("per_part", _SIMULATED_PARTS, _PARTS_NOTE, simulated_parts(main, rows), category),
        network_table(measured.network),
        per_part_table("per_part_real", _NETWORK_PARTS, parts_note(measured.network), on_images, category),
        decoupling_table(main, rows, chain, chain_rows),
        *_variants(outcomes),
        _kitti_table(inputs.validation, main, rows, settings.out),
        *known_shape_tables(known, _known_note(inputs.cars)),
        *measured.real,
    )


def _conditions(
    settings: PaperSettings, outcomes: Mapping[str, ConditionResult], validation: Validation
) -> tuple[str, ...]:
    scene, main = settings.scene, outcomes["validation"].scores
    length, width, height = scene.size.mean
    share = "all parts" if settings.every == 1 else f"every {settings.every}th part"
    return (
        (
            f"Simulated: {len(main)} cars of KITTI's validation images ({len(validation.frames)} frames read, "
            f"{share}), at their labelled poses and sizes. Each has the shape of one of the 79 car models, drawn at "
            "random and scaled to its label; keypoints, confidences and confusions are drawn from a noise model fitted "
            "to what a stacked-hourglass network did on 76 frames of KITTI tracking; 2D boxes are a real detector's. A "
            "keypoint is hidden by the car itself, by other labelled objects, or by the image's border. The default "
            "prior is learnt from the same 79 models: how it does on cars that it does not know is shown under 'known "
            "shape'."
        ),
        (
            f"Given: fleet of {length:g} x {width:g} x {height:g} m on average, camera {scene.ground.distance:g} m "
            f"above a level ground, prior {scene.prior.name}. Seed {settings.seed}."
        ),
        (
            "'Initialisation alone' stands for Mono3D's boxes, which are not to be had: the mean shape filling the "
            "detected 2D box, at the true azimuth with an error of 8.5 degrees (1 sigma), anywhere on the circle in "
            "7.5 % of cars."
        ),
    )


def _known_note(cars: MarkedCars) -> str:
    return (
        f"{len(cars.cars)} of {cars.total} cars: {cars.too_few} have fewer than {FEWEST_MARKS} of our keypoints "
        f"marked, {len(cars.inconsistent)} have labels that disagree by more than {CONSISTENT:g} m. The car's own "
        f"model, and its duplicate, are left out of everything that is learnt ({BASIS} vectors). Keypoint: mean "
        "distance of the 14 keypoints about their centroid, in the camera frame, so that an error of rotation counts. "
        f"Marks are {100 * cars.noise:.1f} % of the box from the labelled model; they are given "
        f"{100 * KNOWN_SHAPE_OPTIONS.keypoints.sigma_relative:g} %, no ground plane, no 2D box and no Laplacian term. "
        "'+size' knows the true length, width and height (SQPnP through the mean shape given that size), '+others' "
        "what the cars of all other models tell: where people put their marks relative to the models' keypoints and, "
        "without the size, how frequent each model is."
    )


def _variants(outcomes: Mapping[str, ConditionResult]) -> tuple[Table, Table, Table]:
    harder, strategies = outcomes["harder"], outcomes["strategies"]
    note = f"{len(harder.scores)} cars with the network's mistakes made worse (severity {harder.condition.severity:g})."
    title = "Harder keypoints (simulated)"
    by_strategy = f"fgrecon given ground and fleet, by robust strategy; {len(strategies.scores)} cars."
    return (
        aop_table(
            "harder", f"{title}: orientation precision", harder.scores, harder.condition.rows, note, printed=False
        ),
        mae_table(
            "harder_mae", f"{title}: orientation error", harder.scores, harder.condition.rows, note, printed=False
        ),
        mae_table(
            "strategies",
            "Robust strategies (simulated)",
            strategies.scores,
            strategies.condition.rows,
            by_strategy,
            printed=False,
        ),
    )


def _kitti_table(validation: Validation, scores: Scores, rows: Sequence[str], out: Path) -> Table:
    """KITTI's own measures of the detections with fgrecon's poses; the result files are written as well."""
    r, worked = rows.index("joint"), set(scores.frame.tolist())
    frames = [frame for frame in validation.frames if frame.name in worked]
    results = {frame.name: _posed(frame.detections, scores, frame.name, r) for frame in frames}
    write_results(out / "kitti_results", results)
    labels = {frame.name: frame.labels for frame in frames}
    lines: list[tuple[str, tuple[float | None, ...]]] = []
    for space, name in ((Space.IMAGE, "2D AP"), (Space.GROUND, "bird's eye AP"), (Space.VOLUME, "3D AP")):
        curves = evaluate(labels, results, "Car", space)
        lines.append((name, tuple(v for c in curves for v in c.average_precision)))
        if space is Space.IMAGE:
            lines.append(("AOS", tuple(v for c in curves for v in c.orientation_similarity or (None, None))))
    columns = tuple(f"{regime} {points}" for regime in ("Easy", "Moderate", "Hard") for points in ("R11", "R40"))
    note = (
        f"{len(frames)} frames with a car that counts: the real detector's boxes and scores, with the poses that "
        "fgrecon found from simulated keypoints. A detection of no labelled car has no pose; it is a false positive "
        "whatever its orientation."
    )
    return Table("kitti", "KITTI's own AP and AOS, cars (simulated keypoints)", note, columns, tuple(lines), decimals=2)


def _posed(detections: Objects, scores: Scores, frame: str, r: int) -> Objects:
    """The frame's cars among the detections, with pose and size where there is an estimate."""
    cars = np.flatnonzero([kind == "Car" for kind in detections.kind])
    posed = detections.take(cars)
    values: dict[str, Any] = {name: getattr(posed, name).copy() for name in ("alpha", "size", "location", "rotation_y")}
    values["alpha"][:] = 0.0
    for i in np.flatnonzero((scores.frame == frame) & (scores.detection >= 0) & np.isfinite(scores.yaw[:, r])):
        at = int(np.flatnonzero(cars == scores.detection[i])[0])
        x, _, z = scores.location[i, r]
        values["alpha"][at] = scores.yaw[i, r] - np.arctan2(x, z)
        values["location"][at], values["rotation_y"][at] = scores.location[i, r], scores.yaw[i, r]
        values["size"][at] = scores.size[i, r]
    return Objects(**{**vars(posed), **values})
