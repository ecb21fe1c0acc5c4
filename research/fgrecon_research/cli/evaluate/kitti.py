"""`fgrecon evaluate kitti`: from KITTI's photographs to poses, scored by regime."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import typer

from fgrecon.calibration.labelled_drives import GivenScene
from fgrecon.calibration.labelled_frames import Setup
from fgrecon.cli.commands import option
from fgrecon.cli.options import Delivery, JsonOption, LabelledScene, TogetherOption, TrafficOption, WeightsOption
from fgrecon.cli.outputs import check_not_over, check_outputs
from fgrecon.cli.terminal import Screen, Terminal
from fgrecon.core.choices import BoxModel
from fgrecon.core.errors import InvalidInputError
from fgrecon.core.options import Options
from fgrecon.core.text import counted
from fgrecon.io.files import check_folder
from fgrecon.io.images import read_image
from fgrecon.perception.keypoints.detect import KeypointCascade
from fgrecon.simulation.vehicles import yaw_pose
from fgrecon.viz import SolvedVehicle, contact_sheet, save_picture
from fgrecon.viz.recording import recordings_of
from fgrecon.viz.subjects import Truth
from fgrecon_research.cli.evaluate.data_options import DATA, DataOption, MarkdownOption, ResultsOption
from fgrecon_research.evaluation import kitti_images
from fgrecon_research.evaluation.boxes_summary import plain_boxes, tables
from fgrecon_research.evaluation.kitti_images import Car, ImageBoxes, ImageFrame, score_boxes, summarise
from fgrecon_research.evaluation.text_table import TextTable
from fgrecon_research.io.kitti_sets import read_image_set, stated_model, write_results

_TRAINING = "DATA/kitti_object/training"


@dataclass(frozen=True)
class KittiFolders:
    """Where images, labels and calibrations are: in KITTI's layout, or each in a folder of its own."""

    data: DataOption = DATA
    images: Path | None = option("Images.", metavar="FOLDER", show_default=f"{_TRAINING}/image_2")
    labels: Path | None = option("Label files.", metavar="FOLDER", show_default=f"{_TRAINING}/label_2")
    calib: Path | None = option("Calibration files.", metavar="FOLDER", show_default=f"{_TRAINING}/calib")
    split: Path | None = option("File of frame names.", metavar="FILE", show_default="all images")

    def paths(self) -> tuple[Path, Path, Path]:
        """Folders of images, labels and calibrations.

        Raises:
            InvalidInputError: One is not given, and there are no data in KITTI's layout.
        """
        training = self.data / "kitti_object" / "training"
        if None in (self.images, self.labels, self.calib) and not training.is_dir():
            fix = (
                "Give --data FOLDER (or FGRECON_DATA), which has kitti_object/training, or all of --images, --labels "
                "and --calib."
            )
            raise InvalidInputError("data", str(self.data), fix)
        return (
            self.images or training / "image_2",
            self.labels or training / "label_2",
            self.calib or training / "calib",
        )


@dataclass(frozen=True)
class KittiCars:
    """The 2D boxes that cars are looked for in, and how they are reconstructed."""

    boxes: Path | None = option(
        "2D detections, lines `image class score x1 y1 x2 y2`.", metavar="FILE", show_default="the labelled boxes"
    )
    overlap: float = option(
        "Overlap with the labelled box that a detected one must exceed.", default=0.7, min=0.0, max=1.0
    )
    box_model: BoxModel | None = option("What the 2D boxes enclose.", show_default="cuboid; of FILE what its lines say")
    weights: WeightsOption = None
    together: TogetherOption = True
    traffic: TrafficOption = None

    def setup(self, known: GivenScene) -> Setup:
        """What every car is reconstructed with."""
        stated = stated_model(self.boxes) if self.boxes is not None and self.box_model is None else None
        return Setup(
            detector=KeypointCascade(self.weights),
            prior=known.scene.prior,
            ground=known.ground,
            size_prior=known.size,
            options=Options(box=self.box_model or stated or BoxModel.CUBOID, traffic=self.traffic),
            overlap=self.overlap,
            together=self.together,
        )


@dataclass(frozen=True)
class KittiOutputs:
    """What is written beside the tables."""

    picture: Path | None = option("Contact sheet of every car.", metavar="FILE")
    results_out: ResultsOption = None
    markdown: MarkdownOption = None
    json_out: JsonOption = None

    def check(self, frames: Sequence[ImageFrame], inputs: Sequence[Path]) -> None:
        """Refuse results that would go over labels or calibrations in some folders."""
        if self.results_out is None:
            return
        check_folder(self.results_out)
        for frame in frames:
            name = f"{frame.name}.txt"
            check_not_over("results", self.results_out / name, [folder / name for folder in inputs])

    def write(self, found: ImageBoxes, made: Sequence[TextTable], screen: Screen) -> None:
        """The tables as Markdown, and the boxes."""
        screen.write_text(self.markdown, "\n".join(one.markdown() for one in made))
        if self.results_out is not None:
            write_results(self.results_out, found.results)
            screen.wrote(self.results_out)


def kitti_command(
    folders: KittiFolders,
    cars: KittiCars,
    labelled: LabelledScene,
    outputs: KittiOutputs,
    delivery: Delivery,
    terminal: Terminal,
) -> None:
    """Find keypoints in KITTI's images, reconstruct every labelled car, and score poses and 3D boxes.

    Regimes are cumulative; a car without a detection or a result counts as 180 degrees and stays in. Below stand the 3D
    boxes as `evaluate boxes` scores them, with intervals of 95 % by bootstrap over images; average precision is over
    the boxes of labelled cars alone. --verbose shows every car's errors.

    Exit code 1: no car could be reconstructed.
    """
    check_outputs(outputs.json_out, outputs.markdown, picture=outputs.picture)
    delivery.check()
    screen = terminal.screen(outputs.json_out)
    paths, known = folders.paths(), labelled.given()
    setup = cars.setup(known)
    names = None if folders.split is None else read_image_set(folders.split)
    frames, problems = kitti_images.read_frames(*paths, names, cars.boxes)
    outputs.check(frames, paths[1:])
    scored = [car for frame in screen.watch(frames, "Images") for car in kitti_images.score_frame(frame, setup)]

    kind = "detected" if cars.boxes else "labelled"
    found = score_boxes(frames, scored)
    made = tables({f"{kind} boxes": found.groups}, {f"{kind} boxes": found.curves})
    images = counted(len(frames), "image")
    screen.print(f"{images}, {counted(len(scored), 'car')}, {kind} boxes; {known.origin}.", _table(scored).shown())
    screen.print(*(one.shown() for one in made))
    for car in scored:
        off = car.outcome
        screen.detail(f"{car.name}: {off.failure or f'{off.degrees:.1f} degrees, {off.metres:.2f} m'}")
    screen.print(*map(str, problems))
    given = {
        "images": len(frames),
        "boxes": "labels" if cars.boxes is None else cars.boxes.name,
        "overlap": cars.overlap,
        "ground": known.origin,
        "size_prior": labelled.size_prior,
        "box_model": setup.options.box.model.value,
        "together": cars.together,
        "traffic": cars.traffic,
        "network": setup.detector.provenance,
    }
    content = kitti_images.document(scored, given)
    content["boxes"] = plain_boxes(found.groups, found.curves, found.vehicles)
    screen.write_document(content)
    outputs.write(found, made, screen)
    drawn = outputs.picture is not None or delivery.requested
    sights = _sights(scored) if drawn else []
    if outputs.picture is not None and sights:
        screen.wrote(save_picture(outputs.picture, contact_sheet(sights, columns=5)))
    if delivery.requested:
        delivery.deliver(recordings_of(sights, setup.ground), screen, several=True)
    if all(car.outcome.failure is not None for car in scored):
        screen.fail("No car could be reconstructed.")
        raise typer.Exit(1)


def _table(cars: list[Car]) -> TextTable:
    rows = [
        {"regime": one["name"], "cars": str(one["cars"])}
        | {f"AOP {most}°": f"{100 * one['aop'][most]:.1f} ({count})" for most, count in one["within"].items()}
        | {"mean °": f"{one['mean_degrees']:.1f}", "median °": f"{one['median_degrees']:.1f}"}
        | {"median m": f"{one['median_metres']:.2f}", "failed": str(one["failures"])}
        for one in summarise(cars)
    ]
    return TextTable.of(rows)


def _sights(cars: list[Car]) -> list[SolvedVehicle]:
    """Every car with a result, with its photograph and the labelled box."""
    photographs = {path: read_image(path) for path in {car.frame.image for car in cars}}
    sights = []
    for car in cars:
        if car.found is not None and car.found.result is not None:
            photograph = photographs[car.frame.image]
            camera = car.frame.calibration.camera.with_size_of(photograph)
            truth = Truth(yaw_pose(car.truth.rotation_y, car.truth.location), car.frame.labels.size[car.index])
            seen = car.found.detection.observation
            sights.append(SolvedVehicle(car.found.result, seen, camera, photograph, truth, car.name))
    return sights
